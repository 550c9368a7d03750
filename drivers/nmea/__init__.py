"""A ship's own sentences: NMEA 0183 of her GNSS and compass, and AIS."""
