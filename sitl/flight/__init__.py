"""Flights in virtual time: one flight, its grades and its ending."""
