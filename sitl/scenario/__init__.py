"""Scenario files: what a flight is flown in, checked as a whole."""
