"""Guidance turns an estimate and orders into a command: the mission, the control laws, the arbiter of orders, and the pilot."""
