"""Recordings as ROS 2 bags, with the standard messages and the axes of REP-103. Nothing here needs ROS."""
