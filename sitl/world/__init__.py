"""The world of one flight: vessel, sea, vehicle, sensors and camera in one clock."""
