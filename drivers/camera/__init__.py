"""Frames from V4L2 devices, network streams and files."""
