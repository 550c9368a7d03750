"""The simulated sea, vessel and vehicle as the physics backend of a real autopilot program, which flies the vehicle."""
