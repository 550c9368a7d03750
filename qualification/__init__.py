"""Slow proofs of devices, installations and the learned detector, which a change of Python rarely breaks: `make qualify`."""
