"""Stand-ins for the autopilot programs: what ArduCopter and PX4 were measured to do on a deck, without the programs."""
