"""The vessel: her motion on the sea, her deck, the air over her, and her files."""
