"""The landing's mission: its states, the table that joins them, and what they know and decide by."""
