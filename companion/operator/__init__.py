"""The commands of people: one arbiter for all their sources, manual flight, and the limits of every command to the vehicle."""
