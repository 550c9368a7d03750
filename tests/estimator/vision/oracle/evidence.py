"""The inputs of the verification of a registration, in numpy."""

from __future__ import annotations

import math

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.detect import verification
from estimator.vision.detect.alignment import AlignedTemplate
from estimator.vision.detect.colour import disc_has_colour
from estimator.vision.drawing import EdgeKind
from estimator.vision.pad import Pad
from estimator.vision.register.registration import Registration
from estimator.vision.srgb import light_table

_TELLING = 5.0
_SNR_VISIBLE = 5.0
_RING_GAINS, _HALF_A_RING = (1.6, 2.2), 0.4
_PLAIN_DISC = 0.1
_SNR_GREY = (10.0, 20.0)
_H_OVER_RING = (0.6, 3.0)
_H_IN_VIEW = 0.02
_RING_IN_VIEW = 0.02
_CORNER_OF_H = (0.2, 0.3)
_DENSE_INLIERS = (0.45, 0.485)
_HALF_AGREES = (0.5, 0.52)
_BRIGHTER = (-2.6, -2.1)
_H_INLIERS = (0.8, 0.95)
_ASTRAY_PX = (0.6, 0.9)


def evidence(aligned: AlignedTemplate, found: Registration, pad: Pad) -> F64:
    """Return the (len(EVIDENCE),) inputs of the model.

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
        dense * _half_disagrees(found, template_score),
        (1.0 - dense) * _no_h_in_view(found) * bool(marks.letters and not marks.fiducials),
        dense * _h_disagrees(found) * bool(marks.letters and disc_has_colour(pad)),
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
    return float(found.edges[EdgeKind.H].in_view > _H_IN_VIEW and _no_h_shows(found))


def _no_h_in_view(found: Registration) -> float:
    """Return the same of an H that is out of view."""
    return float(found.edges[EdgeKind.H].in_view <= _H_IN_VIEW and _no_h_shows(found))


def _no_h_shows(found: Registration) -> bool:
    return not found.edges[EdgeKind.H].seen and not found.edges[EdgeKind.ARROW].seen


def _h_disagrees(found: Registration) -> float:
    """Return 0..1: the fraction of the H's edges that disagree, as surely as half of the pixels do."""
    return float(np.interp(found.inliers, _HALF_AGREES, (1.0, 0.0))) * (1.0 - found.edges[EdgeKind.H].inliers)


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


def _half_disagrees(found: Registration, template_score: float) -> float:
    """Return 0..1: how surely half of the pixels disagree, the light hardly follows, and the disc's edge is not clear."""
    disc = found.edges[EdgeKind.DISC].snr
    values = ((found.inliers, (0.52, 0.7)), (template_score, (0.0, 1.0)), (disc, (20.5, 30.0)))
    return math.prod(float(np.interp(value, limits, (1.0, 0.0))) for value, limits in values)


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
    ring = found.edges[EdgeKind.RING]
    if any(found.edges[kind].seen for kind in (EdgeKind.DISC, EdgeKind.ARROW)) or (ring.seen and ring.in_view > _RING_IN_VIEW):
        return 0.0
    return float(np.interp(found.edges[EdgeKind.H].inliers, _H_INLIERS, (1.0, 0.0)))


def _corner(found: Registration) -> float:
    """Return 0..1: how surely a corner of the H and perhaps a part of the ring are all that is in view."""
    h_marking = found.edges[EdgeKind.H]
    if found.edges[EdgeKind.DISC].seen or not h_marking.seen:
        return 0.0
    return float(np.interp(h_marking.in_view, _CORNER_OF_H, (1.0, 0.0)))
