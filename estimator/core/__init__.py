"""The estimator's hot part in C99 behind a plain C ABI: sources, their interface, and the door to the built library."""
