"""Verify the hypothesis that an aligned drawing is the pad: features, and the confidence that a logistic model gives them.

For each part of the drawing (H, ring, disc's edge, arrowhead) a feature says how well its shape correlates with the frame at that
place alone, so that no part adds evidence to another. Further features compare the relations between the paints with the
drawing's. Both are independent of the light: correlation is free of the gain, and the orange's place between disc and white is
the same under any light that does not saturate.
"""

import math

import numpy as np

from estimator.contracts.geometry import F64
from estimator.core.library import CORE

FEATURES = tuple(name.removeprefix("FEATURE_").lower() for name in CORE.names("align_feature") if name != "FEATURES")
"""Names of the model's inputs, in order. A part counts by the better half of the directions from the centre, so that an occluder
on one side of the pad does not count against it, and by all directions (`_all`).
"""

COEFFICIENTS = np.array(
    [
        -0.592,
        1.004,
        0.455,
        -0.079,
        0.155,
        -0.082,
        0.059,
        1.197,
        0.625,
        1.123,
        -0.661,
        1.009,
        0.378,
        0.164,
        0.928,
        0.423,
        1.020,
        2.702,
        0.498,
        0.993,
        1.156,
        1.171,
        -1.284,
        0.425,
        0.000,
        3.352,
        0.546,
        0.000,
        -1.006,
        0.280,
        0.147,
    ]
)
"""Weights in the order of `FEATURES`. Fitted by `python -m benches.verification_fit --frames 3000` (6130 candidates)."""


TRACKED_LOG_ODDS = 3.0
"""Prior for `confidence` of a drawing aligned where the filter expects the pad: right twenty times as often as a guess without
prior.
"""


ALONE_LOG_ODDS = -2.5
"""Prior for `confidence`, times `alone`, of a candidate of acquisition: an H on something green may be of any size."""


def alone(values: F64) -> float:
    """Return 0..1: to what degree only the H is in view, with neither ring nor edge beside it."""
    h_marking = float(values[FEATURES.index("h_marking")])
    return min(1.0, float(values[FEATURES.index("h_alone")]) / h_marking) if h_marking > 0.1 else 0.0


def confidence(values: F64, prior_log_odds: float = 0.0) -> float:
    """Return the confidence, 0..1, from the features of an aligned drawing.

    Args:
        prior_log_odds: log-odds from evidence other than the frame; 0 for a candidate of acquisition.
    """
    z = log_odds(values) + prior_log_odds
    return 1.0 / (1.0 + math.exp(-max(-30.0, min(30.0, z))))


def log_odds(values: F64) -> float:
    """Return the log-odds that `confidence` converts to a probability."""
    return float(values @ COEFFICIENTS)
