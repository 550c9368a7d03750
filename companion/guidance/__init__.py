"""From an estimate to a command: the sequential planner and the position controller, plain functions of time and state."""
