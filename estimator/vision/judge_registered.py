"""Is what registration found the pad? The judge's opinion of the drawing where it came to lie, and how well its edges agree.

A helipad of other proportions passes for the pad while the drawing lies on it roughly; once the letter fits to a fraction of a
pixel, its ring or the disc's edge does not.
"""

from __future__ import annotations

import math

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision import judge
from estimator.vision.acquire_align import Laid
from estimator.vision.drawing import EdgeKind
from estimator.vision.pad import Pad
from estimator.vision.registration import Registration

EVIDENCE = (
    "one", "drawn", "inliers", "disc_off", "ring_off", "letter_off", "ring_unseen", "letter_unseen", "whole", "whole_inliers",
    "rms", "visible",
)  # fmt: skip
"""Names of the model's inputs, in order; `no_disc` comes last and is not fitted."""

_TELLING = 5.0
"""A kind of edge of which a fifth is in view counts as fully in view."""

_PLAIN_DISC = 0.1
"""Contrast of the disc to its surroundings over the letter's to the disc: 0.15 on a grey deck, less on a dark one."""
_NO_DISC = -4.0
"""Log odds of a distant disc that does not stand out of its surroundings. None of 177 right registrations of whole discs had one
and 90 of 223 without a pad; too few of these look like the pad otherwise for a fit to weigh it."""

_COEFFICIENTS = np.array([0.141, 1.986, 0.683, 1.426, 0.000, 0.000, 0.935, 1.000, 0.161, 0.145, 0.000, 0.723])
"""In the order of `EVIDENCE`. Fitted by `python -m benches.judge_fit --registered --frames 1800`: 1699 registrations.
`letter_unseen` is set and not fitted: glare on a green disc with a ring leaves open whether it has a letter. It costs 3 of 805
right registrations their 0.5."""


def evidence(laid: Laid, found: Registration, pad: Pad) -> F64:
    """(len(EVIDENCE) + 1,) inputs of the model, each of order one.

    Args:
        laid: the drawing at the registered pose.
    """
    drawn = float(judge.log_odds(judge.features(laid, pad)))
    kinds = (EdgeKind.DISC, EdgeKind.RING, EdgeKind.H)
    shown = {kind: min(1.0, _TELLING * found.edges[kind].in_view) for kind in kinds}
    off = {kind: -shown[kind] * (1.0 - found.edges[kind].inliers) for kind in kinds}
    unseen = {kind: -shown[kind] * (not found.edges[kind].seen) for kind in kinds}
    whole = float(found.whole)
    return np.array([
        1.0, max(-8.0, min(8.0, drawn)), found.inliers, *off.values(), unseen[EdgeKind.RING], unseen[EdgeKind.H],
        whole, whole * found.inliers, -min(1.0, found.edge_rms_px), found.visible, whole * _faint(found),
    ])  # fmt: skip


def _faint(found: Registration) -> float:
    """0..1: how surely the disc stands out less than a third as much as paint of its kind does."""
    disc, letter = (float(np.linalg.norm(found.edges[kind].contrast_bgr)) for kind in (EdgeKind.DISC, EdgeKind.H))
    less = math.log(_PLAIN_DISC * max(letter, 1e-3) / max(disc, 1e-6))
    return min(1.0, max(0.0, 2.0 * (less - 0.5)))


def confidence(values: F64, prior_log_odds: float = 0.0) -> float:
    """0..1 of the evidence of a registration; `prior_log_odds` as for `judge.confidence`."""
    z = float(values[:-1] @ _COEFFICIENTS) + _NO_DISC * float(values[-1]) + prior_log_odds
    return 1.0 / (1.0 + math.exp(-max(-30.0, min(30.0, z))))
