"""Stands in for ROS 2's Python library."""
