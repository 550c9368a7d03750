"""A simulated world on the same wire protocols: sea, vessel, vehicle, camera, sensors."""
