"""Verify that a registration found the pad: the classifier of the aligned drawing, and the agreement of the drawing's edges.

A helipad of other proportions resembles the pad while the drawing is aligned roughly. Once the H fits to a fraction of a pixel,
its ring or the disc's edge does not.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.detect import verification
from estimator.vision.detect.alignment import AlignedTemplate
from estimator.vision.detect.colour import disc_has_colour
from estimator.vision.drawing import EdgeKind
from estimator.vision.pad import Pad
from estimator.vision.register.pixels import light_table
from estimator.vision.register.registration import Registration

FITTED_FEATURES = (
    "one", "template_score", "inliers", "disc_off", "ring_off", "h_off", "ring_unseen", "h_unseen", "dense", "dense_inliers",
    "rms", "visible", "dense_template_score", "dense_disc", "dense_orange",
)  # fmt: skip
"""Names of the model's inputs, in order. The last three apply to a distant pad, where contrasts tell more than shapes."""

_TELLING = 5.0
"""Factor on the visible fraction: a kind of edge of which a fifth is in view counts as fully in view."""

_SNR_VISIBLE = 5.0
"""Contrast over its standard deviation below which an edge hardly shows."""
_RING_GAINS, _HALF_A_RING = (1.6, 2.2), 0.4
"""Gains of the better half of a ring between which it counts as increasingly visible, and the remaining weight of the missing
ring if a quarter of it agrees.
"""
_PLAIN_DISC = 0.1
"""Contrast of the disc to its surroundings over the H's to the disc: 0.15 on a grey deck, less on a dark one."""
_SNR_GREY = (10.0, 20.0)
"""Contrast of a disc without colour over its standard deviation up to which it counts as none, and from which as one."""
_H_OVER_RING = (0.6, 3.0)
"""Contrast of the H over the ring's: 1 to 2.4 on pads in nearly all lights. Glare on green that resembles an H has a tenth of it,
or four times as much.
"""
_H_IN_VIEW = 0.02
"""Share of an H that is in view from which on it would show."""
_CORNER_OF_H = (0.2, 0.3)
"""Share of a nearby H that is in view, up to which it is only a corner, and from which on it is not. Of 490 right registrations
from 0.2 m on two showed less than 0.28 of an H.
"""
_DENSE_INLIERS = (0.45, 0.485)
"""Share of a distant pad's pixels that agree with the drawing, up to which it surely disagrees, and from which on it does not."""
_BRIGHTER = (-2.6, -2.1)
"""`white` of `verification.FEATURES`, the logarithm of the H's least contrast in any channel, up to which it surely is not
brighter than the disc, and from which on it is. In haze the least of right registrations that are sure is -1.9.
"""
_H_INLIERS = (0.8, 0.95)
"""Share of an H's edges that agree, where nothing else shows, up to which it surely is another H, and from which on it is not."""
_ASTRAY_PX = (0.6, 0.9)
"""Unexplained displacement of the edges, rms, up to which they are in place, and from which on they are not."""
_HAND_SET = {
    "no_ring": -3.0,
    "no_h": -2.0,
    "disc_unseen": -1.5,
    "painted": 1.5,
    "no_disc": -4.0,
    "h_contrast_odd": -4.0,
    "disagrees": -2.0,
    "not_brighter": -2.0,
    "corner": -3.0,
    "edges_astray": -3.0,
    "h_astray": -2.0,
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
edges_astray: the edges of a nearby pad are displaced by more than its pose, its blur and their noise explain; of 473 right
registrations one in a hundred had more than 0.5 px, none 0.9. A helipad in strong glare, whose ring and H fit nearly, had 1 px.
h_astray: of a nearby pad only the H shows, and parts of it are not where the drawing has them; so was another H on green.
"""

_UNTRACKED = ("no_ring", "no_h", "corner", "edges_astray", "h_astray")
"""Those that count only while no track has confirmed the pad before."""

HAND_SET_FEATURES = tuple(_HAND_SET)
"""Further inputs, after those of `FITTED_FEATURES`. Their coefficients are not fitted."""

_COEFFICIENTS = np.array(
    [0.167, 2.068, 1.423, 0.878, 0.000, 0.000, 0.760, 1.500, -0.107, 1.009, 0.000, -0.560, -0.542, 0.337, 1.462]
)
"""Weights in the order of `FITTED_FEATURES`. Fitted by `python -m benches.verification_fit --registered --frames 2400`: 2526
registrations. The weight of `h_unseen` is set and not fitted: glare on a green disc with a ring may hide the H.
"""
_SEARCHED = np.array([*_COEFFICIENTS, *_HAND_SET.values()])
_TRACKED = np.array([*_COEFFICIENTS, *(0.0 if name in _UNTRACKED else weight for name, weight in _HAND_SET.items())])


def features(aligned: AlignedTemplate, found: Registration, pad: Pad) -> F64:
    """Return the (len(FITTED_FEATURES) + len(HAND_SET_FEATURES),) inputs of the model, each of order one.

    Args:
        aligned: the drawing aligned at the registered pose.
        pad: what is compared with a part that it does not have counts as nothing.
    """
    values = aligned.features
    template_score = verification.log_odds(values)
    kinds = (EdgeKind.DISC, EdgeKind.RING, EdgeKind.H)
    shown = {kind: min(1.0, _TELLING * found.edges[kind].in_view) for kind in kinds}
    off = {kind: -shown[kind] * (1.0 - found.edges[kind].inliers) for kind in kinds}
    unseen = {kind: -shown[kind] * (not found.edges[kind].seen) for kind in kinds}
    marks = pad.markings
    has_ring, has_both = bool(marks.ring_outer_m), bool(marks.ring_outer_m and marks.letters)
    has_field = bool(marks.field_radius_m)
    faint_disc = found.edges[EdgeKind.DISC].snr < _SNR_VISIBLE
    dense, off_by_channel = float(found.dense), _orange_off(found, pad) if found.dense and has_both else [0.0]
    return np.array([
        1.0, max(-8.0, min(8.0, template_score)), found.inliers, *off.values(), unseen[EdgeKind.RING], unseen[EdgeKind.H],
        dense, dense * found.inliers, -min(1.0, found.edge_rms_px), found.visible,
        dense * max(-8.0, min(8.0, template_score)), dense * _clear(found, EdgeKind.DISC) * has_field,
        -sum(min(1.0, one) for one in off_by_channel) / len(off_by_channel),
        _no_ring(values, found) * has_ring, _no_h(found) * bool(marks.letters),
        (1.0 - dense) * shown[EdgeKind.DISC] * faint_disc,
        dense * _painted(found, max(off_by_channel)) * has_both, dense * _faint(found, pad) * bool(has_field and marks.letters),
        dense * _h_contrast_odd(found) * has_both, dense * _disagrees(found),
        dense * _not_brighter(values, pad) * has_both, (1.0 - dense) * _corner(found) * bool(marks.letters),
        (1.0 - dense) * float(np.interp(found.edge_rms_px, _ASTRAY_PX, (0.0, 1.0))), (1.0 - dense) * _h_astray(found),
    ])  # fmt: skip


def _clear(found: Registration, kind: EdgeKind) -> float:
    """Return -1..1: how clearly one kind of edge shows; 0 at five standard deviations."""
    return max(-1.0, min(1.0, 0.5 * math.log(max(found.edges[kind].snr, 1e-3) / 5.0)))


def _orange_off(found: Registration, pad: Pad) -> list[float]:
    """Return by channel the distance of the ring's light from its place between the disc's (0) and the H's (1).

    No illumination changes that place.
    """
    ring, h_marking = (found.edges[kind].contrast_bgr.tolist() for kind in (EdgeKind.RING, EdgeKind.H))
    least = 0.1 * max(*map(abs, h_marking), 1e-3)
    channels = zip(ring, h_marking, *_orange_places(pad), strict=True)
    return [abs(side * r / max(side * h, least) - place) for r, h, side, place in channels]


@lru_cache(maxsize=8)
def _orange_places(pad: Pad) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return by channel the H's nominal side of the disc, -1 if darker, and the ring's place between disc (0) and H (1)."""
    table = light_table(True)
    of_ring, of_h, of_disc = (
        table[list(rgb[::-1])] for rgb in (pad.markings.colours.ring, pad.markings.colours.h, pad.markings.colours.disc)
    )
    side = np.where(of_h - of_disc <= -0.05, -1.0, 1.0)
    place = side * (of_ring - of_disc) / np.maximum(side * (of_h - of_disc), 0.05)
    return tuple(side.tolist()), tuple(place.tolist())


def _no_ring(values: F64, found: Registration) -> float:
    """Return 0..1: how surely there is no ring.

    The value is lower if enough of the ring is in view and half of that is clear, because the rest may be covered.
    """
    ring = found.edges[EdgeKind.RING]
    if ring.seen:
        return 0.0
    if found.dense:
        return 1.0
    half = ring.in_view > 0.25 and ring.snr > 2.0 * _SNR_VISIBLE and ring.likeness > 0.8 and ring.inliers > 0.25
    low, high = _RING_GAINS
    shown = (float(values[verification.FEATURES.index("ring")]) - low) / (high - low)
    return (_HALF_A_RING if half else 1.0) * (1.0 - min(1.0, max(0.0, shown)))


def _no_h(found: Registration) -> float:
    """Return whether an H that is in view does not show, nor the arrowhead, which no other helipad has."""
    h_marking = found.edges[EdgeKind.H]
    return float(h_marking.in_view > _H_IN_VIEW and not h_marking.seen and not found.edges[EdgeKind.ARROW].seen)


def _painted(found: Registration, off: float) -> float:
    """Return 0..1: to what degree ring and H show, with the ring in its own paint, of which its worst channel is off by so much.

    A life raft's dark rim is off by 0.6 in red alone; of 150 right registrations at 8 to 26 m one in ten is off by 0.37.
    """
    if not (found.edges[EdgeKind.RING].seen and found.edges[EdgeKind.H].seen):
        return 0.0
    return max(0.0, 1.0 - 2.0 * off)


def _faint(found: Registration, pad: Pad) -> float:
    """Return 0..1: how surely the disc's contrast is less than a third of that of its kind of paint.

    A grey disc may be as bright as any deck: there a faint disc is a disc as long as its edge shows.
    """
    if not disc_has_colour(pad):
        hidden, shown = _SNR_GREY
        edge = found.edges[EdgeKind.DISC].snr
        return min(1.0, max(0.0, (shown - edge) / (shown - hidden))) * _less_than_paint(found)
    return _less_than_paint(found)


def _less_than_paint(found: Registration) -> float:
    disc, h_marking = (math.hypot(*found.edges[kind].contrast_bgr.tolist()) for kind in (EdgeKind.DISC, EdgeKind.H))
    less = math.log(_PLAIN_DISC * max(h_marking, 1e-3) / max(disc, 1e-6))
    return min(1.0, max(0.0, 2.0 * (less - 0.5)))


def _h_contrast_odd(found: Registration) -> float:
    """Return 0..1: how surely the H shows less or more than the ring beside it implies."""
    ring, h_marking = (max(math.hypot(*found.edges[kind].contrast_bgr.tolist()), 1e-6) for kind in (EdgeKind.RING, EdgeKind.H))
    low, high = _H_OVER_RING
    return min(1.0, 2.0 * max(0.0, math.log(low * ring / h_marking), math.log(h_marking / (high * ring))))


def _disagrees(found: Registration) -> float:
    """Return 0..1: how surely too few pixels agree with the drawing."""
    return float(np.interp(found.inliers, _DENSE_INLIERS, (1.0, 0.0)))


def _not_brighter(values: F64, pad: Pad) -> float:
    """Return 0..1: how surely the H's paint is not brighter than the disc's in some channel, although the pad's is in all."""
    if min(_orange_places(pad)[0]) < 0.0:
        return 0.0
    return float(np.interp(values[verification.FEATURES.index("white")], _BRIGHTER, (1.0, 0.0)))


def _h_astray(found: Registration) -> float:
    """Return 0..1: how surely what shows, an H alone, is another H."""
    if any(found.edges[kind].seen for kind in (EdgeKind.DISC, EdgeKind.RING, EdgeKind.ARROW)):
        return 0.0
    return float(np.interp(found.edges[EdgeKind.H].inliers, _H_INLIERS, (1.0, 0.0)))


def _corner(found: Registration) -> float:
    """Return 0..1: how surely a corner of the H and perhaps a part of the ring are all that is in view."""
    h_marking = found.edges[EdgeKind.H]
    if found.edges[EdgeKind.DISC].seen or not h_marking.seen:
        return 0.0
    return float(np.interp(h_marking.in_view, _CORNER_OF_H, (1.0, 0.0)))


def confidence(values: F64, prior_log_odds: float = 0.0, shape_log_odds: float = 0.0) -> float:
    """Return the confidence, 0..1, of a registration from its inputs.

    Args:
        prior_log_odds: as for `verification.confidence`.
        shape_log_odds: of `fiducial_cells.cells_log_odds` or `letter_alone.letter_log_odds`.
    """
    weights = _SEARCHED if prior_log_odds <= 0.0 else _TRACKED
    z = float(values @ weights) + prior_log_odds + shape_log_odds
    return 1.0 / (1.0 + math.exp(-max(-30.0, min(30.0, z))))
