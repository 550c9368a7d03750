"""Settings: the model, its checks and pages, and the objects built from it."""
