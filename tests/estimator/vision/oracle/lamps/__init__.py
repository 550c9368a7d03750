"""A pad's lamps in numpy and OpenCV: the oracle that the core's `look_at_lamps` and `search_lamps` are held to."""
