"""Detect what lies on the pad, stands about it or moves there."""
