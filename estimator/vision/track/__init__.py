"""Track the pad from frame to frame, by its paint or its lamps, from where the filter expects it."""
