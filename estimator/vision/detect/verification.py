"""Verify the hypothesis that an aligned drawing is the pad: features, and the confidence that a logistic model gives them.

For each part of the drawing (H, ring, disc's edge, arrowhead) a feature says how well its shape correlates with the frame at that
place alone, so that no part adds evidence to another. Further features compare the relations between the paints with the
drawing's. Both are independent of the light: correlation is free of the gain, and the orange's place between disc and white is
the same under any light that does not saturate.
"""

import math

import numpy as np

from estimator.contracts.geometry import F64

_WEIGHTS = {
    "one": -0.592,
    "h_marking": 1.004,
    "ring": 0.455,
    "edge": -0.079,
    "h_marking_all": 0.155,
    "ring_all": -0.082,
    "edge_all": 0.059,
    "h_and_ring": 1.197,
    "h_and_edge": 0.625,
    "ring_and_edge": 1.123,
    "two_of_three": -0.661,
    "some_ring": 1.009,
    "some_edge": 0.378,
    "some_two": 0.164,
    "h_alone": 0.928,
    "no_h": 0.423,
    "no_ring": 1.020,
    "no_edge": 2.702,
    "ring_lags": 0.498,
    "flanks": 0.993,
    "arrow": 1.156,
    "no_arrow": 1.171,
    "template_gain": -1.284,
    "inliers": 0.425,
    "white": 0.000,
    "orange_place": 3.352,
    "orange_odd": 0.546,
    "disc_place": 0.000,
    "size": -1.006,
    "in_view": 0.280,
    "tilt": 0.147,
}
"""Weight of each input, in the order of the core's `align_feature` (`estimator/core/vision/align/align.h`).

A part counts by the better half of the directions from the centre, so that an occluder on one side of the pad does not count
against it, and by all directions (`_all`). Fitted by `python -m benches.verification_fit --frames 3000` (6130 candidates).
"""
FEATURES, COEFFICIENTS = tuple(_WEIGHTS), np.array(list(_WEIGHTS.values()))
"""Names and weights of the inputs, in order."""


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
