"""Recordings as files: the messages of an MCAP file, written and read back, and video of frames."""
