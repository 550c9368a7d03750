"""The ship's network beside the flight."""
