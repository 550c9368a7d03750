"""The simulator's step in plain Python floats: another implementation, against which the core's is checked."""
