"""A flight of a few seconds, for tests that are about something else."""

NEAR = """
title = "A motionless pad close by"
duration_limit_s = 40.0
[sea]
significant_height_m = 0.0
[vessel]
moored = false
[wind]
speed_m_s = 0.0
gust_sigma_m_s = 0.0
[start]
height_m = 2.0
pad_right_m = 0.3
pad_forward_m = -0.2
heading_deg = 20.0
"""
"""The text of a scenario file."""
