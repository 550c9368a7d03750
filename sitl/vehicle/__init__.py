"""The simulated vehicle: airframe, rotors, flight dynamics, and its files."""
