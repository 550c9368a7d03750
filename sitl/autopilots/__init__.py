"""The sea, the vessel and the vehicle as physics backend of a real autopilot program, which has the sticks and the loops."""
