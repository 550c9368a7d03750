"""Read recordings of other programs as samples and frames: autopilot logs, AR.Drone captures, videos and attitude tables.

Each source keeps its own clock, which begins at 0 with its first datum. The caller that combines sources knows their offsets.
"""
