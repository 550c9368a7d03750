"""What others recorded, as samples and frames: autopilots' logs, captures of AR.Drones, videos and attitude tables.

Each source keeps its own clock, which begins at 0 with its first datum. Whoever puts sources together knows their offsets.
"""
