"""The local socket by which terminals on this computer give orders."""
