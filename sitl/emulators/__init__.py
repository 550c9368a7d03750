"""Vehicles on real sockets and autopilot programs, for the service that flies them in real time."""
