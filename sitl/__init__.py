"""A world that speaks the same wires: sea, vessel, vehicle, camera, sensors."""
