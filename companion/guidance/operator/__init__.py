"""People and guidance as commanders of the vehicle, by rank, and the limits that hold for both."""
