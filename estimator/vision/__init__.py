"""Pixels to Sighting."""
