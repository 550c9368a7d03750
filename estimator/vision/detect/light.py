"""The light of each value of a pixel, as alignment measures it."""

from __future__ import annotations

import numpy as np

from estimator.vision.srgb import LINEAR_LIGHT

FLOOR = 0.01
"""Light, as a fraction of full scale, below which there is only noise."""
TABLES = np.stack([LINEAR_LIGHT, np.sqrt(LINEAR_LIGHT), np.log1p(LINEAR_LIGHT / FLOOR)]).astype(np.float32)
"""(3, 256) linear light, its square root, and its logarithm log1p(light / floor)."""
TABLES.setflags(write=False)
