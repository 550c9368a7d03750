"""Faults of a simulated flight: their kinds as a scenario lists them, when each is active, and their effect on streams."""
