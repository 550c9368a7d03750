"""The ship's own reports beside the flight."""
