"""Settings: every option, the model, its checks and pages, and what is read from the files that they name."""
