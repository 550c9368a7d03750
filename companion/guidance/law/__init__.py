"""The control laws: what brings the vehicle to a target, and what is known of how it answers."""
