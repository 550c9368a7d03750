"""The features of the verification."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.detect.template import AROUND, DISC, ORANGE, H, disc_edge_m
from estimator.vision.pad import Pad
from estimator.vision.srgb import linear_light
from tests.estimator.vision.oracle.alignment import Aligned
from tests.estimator.vision.oracle.template import F32

_NOISE = 0.012
"""Residual in the square root of light, full scale 1, that a right drawing leaves anyway (noise, wear, ripples)."""
_ENOUGH = 4.0
"""Largest gain that counts: a larger one depends more on the blur than on the pad."""
_SECTORS = 8
_TELLING = 5.0
"""Factor on the visible fraction of a part: a part of which a fifth is in view and that does not show counts as missing."""
_ONE_EMPTY = 0.4
"""Weight of one place without an arrowhead while the other is out of view, relative to two."""


def features(aligned: Aligned, pad: Pad) -> F64:
    """Return the (len(FEATURES),) inputs of the model, each of order one."""
    local = aligned.local
    # With the channels outermost numpy's inner loops are long.
    xy, light, coverage = aligned.xy_m.T, local.light.T, local.coverage.T
    paints = local.paints.astype(np.float32)
    residual = light - paints.T @ coverage
    squared = (residual * residual).sum(axis=0)
    r2 = xy * xy
    r = np.sqrt(r2[0] + r2[1])
    x, y = np.abs(xy)
    reach = max(0.02, 1.0 * aligned.sample_m)
    disc = disc_edge_m(pad)
    zones = (
        (x < pad.markings.h_length_m / 2 + reach) & (y < pad.markings.h_width_m / 2 + reach),
        (r > pad.markings.ring_inner_m - 2 * reach) & (r < pad.markings.ring_outer_m + 2 * reach),
        r > disc - 2.5 * reach,
    )
    around = ((np.arctan2(xy[1], xy[0]) + math.pi) * (_SECTORS / math.tau)).astype(np.intp) % _SECTORS
    areas = (
        pad.markings.h_length_m * pad.markings.h_width_m,
        math.pi * ((pad.markings.ring_outer_m + 2 * reach) ** 2 - (pad.markings.ring_inner_m - 2 * reach) ** 2),
        math.pi * ((1.12 * pad.disc_radius_m + aligned.sample_m) ** 2 - (disc - 2.5 * reach) ** 2),
    )
    gains, shown = [], []
    for zone, paint, area in zip(zones, (H, ORANGE, AROUND), areas, strict=True):
        at = zone.nonzero()[0]
        way = (local.paints[DISC] - local.paints[paint]).astype(np.float32)
        along, covered = way @ residual.take(at, axis=1), coverage[paint].take(at)
        gains.append(_gains(squared.take(at), along, covered, way, around.take(at), aligned))
        shown.append(min(1.0, len(at) * aligned.sample_m**2 / area))
    (h_marking, h_marking_all), (ring, ring_all), (edge, edge_all) = gains
    two = sorted((h_marking, ring, edge))[1]
    everything = _gain(squared, (light * light).sum(axis=0), local.weight, aligned)
    white, orange, green = (local.paints[k] for k in (H, ORANGE, DISC))
    off = min(1.0, _TELLING * shown[1]) * _orange_place(white, orange, green, pad, aligned.contrast, _brightest_h(aligned))
    size_px = pad.disc_radius_m / aligned.sample_m
    return np.array([
        1.0,
        h_marking, ring, edge, h_marking_all, ring_all, edge_all,
        min(h_marking, ring), min(h_marking, edge), min(ring, edge), two,
        _some(ring), _some(edge), _some(two), h_marking * (1.0 - min(1.0, 2.0 * max(shown[1:]))),
        *(-min(1.0, _TELLING * part) * math.exp(-2.0 * max(0.0, gain[0])) for part, gain in zip(shown, gains, strict=True)),
        -min(1.0, _TELLING * shown[1]) * max(0.0, h_marking - ring - 0.7),
        -_flanks(aligned, residual, r, pad),
        abs(arrow_support(aligned)), -_empty(aligned),
        everything,
        float(local.weight.mean()),
        _clip(math.log(max(1e-3, float((white - green).min())) / 0.2), -3.0, 1.5),
        -off, -max(0.0, off - 0.5),
        _disc_place(aligned.paints[H], aligned.paints[DISC], pad),
        _clip(math.log(size_px / 10.0), -1.5, 1.5),
        min(1.0, aligned.in_view),
        -min(2.0, 0.2 * aligned.tilt_sigmas**2),
    ])  # fmt: skip


def arrow_support(aligned: Aligned) -> float:
    """Return -1..1: 1 for an orange arrowhead at its place, -1 for one where it would be with the drawing turned by 180 degrees.

    The value is 0 if neither, both or nothing of the kind is in view.
    """
    fore, aft = aligned.arrow
    return fore.found * fore.seen - aft.found * aft.seen


def _empty(aligned: Aligned) -> float:
    """Return 0..1: how surely the possible places of an arrowhead are in view, clear, and without one."""
    fore, aft = (place.seen * place.clear for place in aligned.arrow)
    none = 1.0 - max(place.found for place in aligned.arrow)
    return none * max(fore * aft, _ONE_EMPTY * max(fore, aft))


def _flanks(aligned: Aligned, residual: F32, r: F32, pad: Pad) -> float:
    """Return 0..1: the excess of ring paint just inside or outside of the ring, which indicates a ring that is too wide.

    A ring that is merely displaced has a deficit of the same size on its other flank.
    """
    way = (aligned.local.paints[ORANGE] - aligned.local.paints[DISC]).astype(np.float32)
    length = float(way @ way)
    width = pad.markings.ring_outer_m - pad.markings.ring_inner_m
    if length < 1e-4:
        return 0.0
    aside = r - pad.markings.ring_radius_m
    near = (np.abs(aside) < 1.3 * width).nonzero()[0]
    aside, much = aside.take(near), way @ residual.take(near, axis=1)
    sides = []
    for sign in (-1.0, 1.0):
        beside = np.abs(sign * aside - 0.9 * width) < 0.4 * width
        n = int(np.count_nonzero(beside))
        sides.append(float(much @ beside) / n / length if n >= 6 else 0.0)
    return _clip(max(sides) + min(0.0, *sides), 0.0, 1.0)


def _some(gain: float) -> float:
    """Return 0..1, saturating quickly: from afar a part can gain little, and any gain counts."""
    return max(0.0, gain) / (max(0.0, gain) + 0.4)


def _gains(squared: F32, along: F32, coverage: F32, way: F32, sector: NDArray[np.intp], of: Aligned) -> tuple[float, float]:
    """Return `_gain` by direction from the centre: the mean of the better half of the directions in view, and of all of them.

    Args:
        squared: (n,) squared residuals of the whole drawing.
        along: (n,) the residuals times `way`.
        coverage: (n,) coverage by the part's paint.
        way: (3,) change of a sample fully covered by that paint if the part is removed.
    """
    if len(squared) < 6:
        return 0.0, 0.0
    n = np.bincount(sector, minlength=_SECTORS)
    floor = (_NOISE * of.contrast) ** 2 * 3.0 * n + 1e-9
    without = coverage * coverage
    without *= float(way @ way)
    change = np.bincount(sector, without, _SECTORS)
    with_it = _above_noise(n, np.bincount(sector, squared, _SECTORS), of) + 1e-9
    without -= 2.0 * coverage * along
    without_it = np.maximum(np.bincount(sector, without, _SECTORS) + with_it, floor)
    gain = np.log(without_it / with_it)[change > 0.2 * float(change.max()) + 1e-9]
    if not len(gain):
        return 0.0, 0.0
    each = sorted(_clip(g, -1.0, _ENOUGH) for g in gain.tolist())
    best = each[len(each) // 2 :]
    return sum(best) / len(best) * min(1.0, len(each) / 3.0), sum(each) / len(each)


def _above_noise(n: F64, squared: F64, of: Aligned) -> F64:
    """Return squared residuals of n samples without what noise adds to them, and what is left for chance and for wear."""
    count = 3.0 * n
    left = np.maximum(0.0, squared - of.noise**2 * count)
    return np.asarray(left + of.noise**2 * np.sqrt(2.0 * count) + (_NOISE * of.contrast) ** 2 * count)


def _gain(squared: F32, nothing: F32, weight: F32, of: Aligned) -> float:
    """Return the drawing's gain: the logarithm of the squared residuals without it over those with it.

    Args:
        squared: (n,) squared residuals with the drawing.
        nothing: (n,) squared residuals without it: the light itself.
        weight: (n,) weights of the samples.
    """
    if len(squared) < 6:
        return 0.0
    sums = np.array([weight @ nothing, weight @ squared], float)
    without, with_it = _above_noise(np.full(2, float(weight.sum())), sums, of)
    return _clip(math.log(without / with_it), 0.0, _ENOUGH)


def _orange_place(white: F64, orange: F64, green: F64, pad: Pad, contrast: float, brightest_h: F64) -> float:
    """Return the distance of the orange from its nominal place between disc and white, mean over the channels; 0 is nominal.

    Args:
        brightest_h: (3,) light of the H. Where a frame clips it, orange may be any lower than it seems.
    """
    side = np.where(_nominal_span(pad) < 0.0, -1.0, 1.0)
    span = np.maximum(side * (white - green), 0.04 * contrast)
    place = np.clip(side * (orange - green) / span, -0.5, 1.5)
    above = place - _nominal_place(pad)
    hidden = (side > 0.0) & (brightest_h >= 0.98) & (above > 0.0)
    return float(np.where(hidden, 0.0, np.abs(above)).mean())


def _brightest_h(aligned: Aligned) -> F64:
    """Return the brightest light of the samples that are some of the H, by channel, (3,)."""
    return np.asarray(aligned.light[aligned.coverage[:, H] >= 0.25].max(axis=0, initial=0.0), float)


def _nominal_span(pad: Pad) -> F64:
    white, green = (np.sqrt(linear_light(rgb[::-1])) for rgb in (pad.markings.colours.h, pad.markings.colours.disc))
    return np.asarray(white - green)


@lru_cache(maxsize=8)
def _nominal_place(pad: Pad) -> F64:
    white, orange, green = (
        np.sqrt(linear_light(rgb[::-1])) for rgb in (pad.markings.colours.h, pad.markings.colours.ring, pad.markings.colours.disc)
    )
    return np.asarray((orange - green) / (white - green))


def _disc_place(white: F64, green: F64, pad: Pad) -> float:
    """Return the logarithm of the disc's excess in its dominant channel over the others, measured against white."""
    main = 2 - int(np.argmax(pad.markings.colours.disc))
    ratio = (np.maximum(green, 0.0) + 0.01) / (np.maximum(white, 0.0) + 0.01)
    return _clip(math.log(ratio[main] / max(ratio[(main + 1) % 3], ratio[(main + 2) % 3])), -1.0, 2.0)


def _clip(x: float, low: float, high: float) -> float:
    return min(high, max(low, x))
