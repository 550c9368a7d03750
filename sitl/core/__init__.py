"""The simulator's hot part in C99: what a camera sees of sea, deck and pad, and the physics of vessel, vehicle and sensors."""
