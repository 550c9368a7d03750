"""The sea: spectra, the waves drawn from them, and a scenario's table of it."""
