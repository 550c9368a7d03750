"""What few users need beside the simulator: the experiments of the thesis, training grounds, and fits of error models."""
