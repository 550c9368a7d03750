"""Bytes and devices in, samples out; commands in, bytes out."""
