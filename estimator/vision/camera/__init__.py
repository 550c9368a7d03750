"""Cameras: their lens and mount, their files, poses of what they see, and rolling shutters."""
