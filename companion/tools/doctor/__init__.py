"""Diagnose a setup: a snapshot of autopilot, links and files, and rules that name every known fault with its fix."""
