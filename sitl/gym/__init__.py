"""The simulated sea as a training ground for controllers that learn (docs/training.md)."""
