"""Verify that an aligned drawing, and a registration, is the pad: features, and the confidence that logistic models give them.

For each part of the drawing (H, ring, disc's edge, arrowhead) a feature says how well its shape correlates with the frame at that
place alone, so that no part adds evidence to another. Further features compare the relations between the paints with the
drawing's. Both are independent of the light: correlation is free of the gain, and the orange's place between disc and white is
the same under any light that does not saturate.

A helipad of other proportions resembles the pad while the drawing is aligned roughly. Once the H fits to a fraction of a pixel,
its ring or the disc's edge does not: a second model is of the agreement of the drawing's edges where it is registered. The native
core computes its inputs (`estimator/core/vision/look/evidence.c`) in the order of `look_evidence` (`look.h` beside it).
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
_BY_SUPPORT = 6.0  # Log-odds of twice the support that clutter may give: more support by clutter is exponentially rarer
_SLOPE = 5.0  # Log-odds that a sure find gains, per log-odds: of 105 finds that said 0.5 to 0.98, 102 were right
_MOST = 3.0  # The most that it gains


def alone(values: F64) -> float:
    """Return 0..1: to what degree only the H is in view, with neither ring nor edge beside it."""
    h_marking = float(values[FEATURES.index("h_marking")])
    return min(1.0, float(values[FEATURES.index("h_alone")]) / h_marking) if h_marking > 0.1 else 0.0


def confidence(log_odds: float) -> float:
    """Return the confidence, 0..1, from the log-odds of all evidence for and against the pad."""
    return 1.0 / (1.0 + math.exp(-max(-30.0, min(30.0, log_odds))))


def log_odds(values: F64) -> float:
    """Return the log-odds by the features of an aligned drawing, without evidence other than the frame."""
    return float(values @ COEFFICIENTS)


_FITTED = {
    "one": 0.167,
    "template_score": 2.068,
    "inliers": 1.423,
    "disc_off": 0.878,
    "ring_off": 0.000,
    "h_off": 0.000,
    "ring_unseen": 0.760,
    "h_unseen": 1.500,
    "dense": -0.107,
    "dense_inliers": 1.009,
    "rms": 0.000,
    "visible": -0.560,
    "dense_template_score": -0.542,
    "dense_disc": 0.337,
    "dense_orange": 1.462,
}
"""Weights fitted by `python -m benches.verification_fit --registered --frames 2400`: 2526 registrations.

The weight of `h_unseen` is set and not fitted: glare on a green disc with a ring may hide the H.
"""
_HAND_SET = {
    "no_ring": -3.0,
    "no_h": -2.5,
    "disc_unseen": -1.5,
    "painted": 1.5,
    "no_disc": -4.0,
    "h_contrast_odd": -4.0,
    "disagrees": -2.0,
    "not_brighter": -2.0,
    "corner": -3.0,
    "edges_astray": -8.0,
    "h_astray": -8.0,
    "half_disagrees": -0.7,
    "no_h_in_view": -6.0,
    "h_disagrees": -8.0,
}
"""Log-odds of further inputs, set by hand because too few of the fit's false candidates look like the pad.

no_ring: the ring is out of view, does not show, or is not of the ring's paint; an H on something green may be of any size.
no_h: the H does not show, nor the arrowhead; a ring on something green may be anything.
disc_unseen: the edge of a nearby disc is in view and has no contrast.
painted: ring and H of a distant pad show in their paints; a helipad's ring on green is off by half of the distance from disc to H
and more.
no_disc: a distant disc does not stand out from its surroundings; none of 177 right registrations of whole discs had this, and 90
of 223 without a pad.
h_contrast_odd: a distant H shows much less or more than the ring beside it implies; four of 300 confident and right registrations
had this, two of them of half-covered pads.
disagrees: fewer pixels of a distant pad agree with the drawing than of all but two of 659 right registrations; a life raft with a
stripe has 0.45.
not_brighter: what is drawn as a distant H is not brighter than the disc in every channel, where the paints are; of 850 right
registrations in all lights 12 were so, three of them sure, and of 12 rafts and helipads 7.
corner: a corner of a nearby H is in view, and the edge of the disc does not show; a green hexagon with a ring and an arrow may
show as much.
edges_astray: the edges of a nearby pad with a disc are displaced by more than pose, blur and noise explain; of 473 right
registrations one in a hundred had more than 0.5 px, none 0.9. A helipad in strong glare, whose ring and H fit nearly, had 1 px.
h_astray: of a nearby pad only the H shows, or a fiftieth of the ring beside it, and parts of the H are not where the drawing has
them; so was another H on green, and a square frame with another mark in it, whose polygons are the H. Or lettering of a second
paint is in view and has no contrast: so was another octagon, with other marks in it.
half_disagrees: half of a distant pad's pixels disagree with the drawing, the light hardly follows it, and the disc's edge is not
clear; of 218 sure and right registrations at most three, and another helipad and two life rafts.
no_h_in_view: neither the H nor the arrowhead of a nearby pad is in view or shows, and it has no fiducials; so were 3 of 3,552
right registrations, and 14 of 31 green discs with a ring and glare that had 0.5 and more, cut by the frame or a presumed cover.
h_disagrees: half of a distant pad's pixels disagree with the drawing, by the fraction of the H's edges that do so, too. It lowers
8 of 18 such discs in glare, and 6 of 2,364 right registrations, below 0.5. Not without colour, where the ring may be burnt out.
"""

_UNTRACKED = ("no_ring", "no_h", "corner", "edges_astray", "h_astray", "half_disagrees", "no_h_in_view", "h_disagrees")
"""Inputs that count only while no track has confirmed the pad before."""

FITTED, HAND_SET, EVIDENCE = tuple(_FITTED), tuple(_HAND_SET), (*_FITTED, *_HAND_SET)
"""Names of the inputs with fitted weights, of those set by hand, and of all, in the order of the core's `look_evidence`."""
SEARCHED = np.array([*_FITTED.values(), *_HAND_SET.values()])
"""Weights in the order of `EVIDENCE` of a drawing where a search or a cue led to."""
TRACKED = np.where([name in _UNTRACKED for name in EVIDENCE], 0.0, SEARCHED)
"""Weights in the order of `EVIDENCE` where a track has confirmed the pad before."""


def support_log_odds(times_least: float) -> float:
    """Return the most log-odds that the support of a drawing allows.

    Args:
        times_least: support times the share that follows the drawing (the core's `dl_drawing_support`), over the pad's
            least. Few pixels give little support, and hidden ones none.
    """
    return _BY_SUPPORT * (times_least - 1.0)


def calibrate(said: float) -> float:
    """Return a find's confidence as it is called: what is sure is surer, and nothing that is not sure becomes so.

    Finds from 0.1 to 0.5 stay as they are: most are right, but a raft's ring in glare is among them at 0.37.
    """
    log_odds = math.log(max(said, 1e-13) / max(1.0 - said, 1e-13))
    return confidence(log_odds + min(_SLOPE * log_odds, _MOST)) if log_odds > 0.0 else said
