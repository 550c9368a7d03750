"""A vehicle that speaks no MAVLink, shown to ground stations as one that does."""
