"""The V4L2 driver against a real kernel: the `vivid` test camera in a virtual machine, by software emulation alone."""
