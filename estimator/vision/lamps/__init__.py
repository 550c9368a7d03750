"""Find and measure a pad by its lamps, where its paint is in the dark."""
