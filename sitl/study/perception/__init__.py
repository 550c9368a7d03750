"""Fit the error models of simulated perception to recorded flights."""
