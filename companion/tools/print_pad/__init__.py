"""Print the pad and the calibration board on paper, true to scale."""
