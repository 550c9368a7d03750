"""The law that follows the deck in plain Python, beside which the core's is held."""
