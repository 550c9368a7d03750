"""The experiments of the thesis, training grounds and fits of error models, for those who study the simulator."""
