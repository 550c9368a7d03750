"""The learned second opinion on whether a candidate is the pad."""
