"""Guidance turns an estimate into a command: a sequential planner and a position controller, pure functions of time and state."""
