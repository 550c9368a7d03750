"""Gamepads on Linux: the kernel's event devices, read directly, and a file that maps axes and buttons to sticks and orders."""
