"""Peers that nobody here wrote, against our end of the same wires."""
