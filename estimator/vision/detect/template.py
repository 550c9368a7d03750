"""The drawing as arrays: coverage by each paint in polar cells around the centre, and as maps at several blurs.

Its paints' colours are learned under the present light: an aligned and trusted drawing gives the paint of every pixel. The memory
is an input and an output; it moves slowly, fades while the pad is not found, and is ignored below a certain trust. Where the disc
stands out by its colour, a search begins with colour.
"""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.abi import DL_POLAR_ANGLES, DL_POLAR_RADII, DL_TEMPLATE_ONE
from estimator.vision.pad.geometry import covers, is_slanted, rectangles_of
from estimator.vision.pad.pad import Pad
from estimator.vision.pad.shapes import Lettering
from estimator.vision.srgb import LUMA, linear_light

F32 = NDArray[np.float32]
I16 = NDArray[np.int16]

ANGLES, _RADII = DL_POLAR_ANGLES, DL_POLAR_RADII
_FINE = 4  # Sub-samples per polar cell and axis: coverage to about 2 %
STEP_M = 0.004
"""Distance between samples of the maps: about a quarter of the ring's width."""
BLURS_M = (0.005, 0.010, 0.020, 0.040, 0.080)
"""Standard deviations of the maps' blur. They match pixels from 0.7 m to 40 m away."""
LOCAL_M = 0.06
"""Standard deviation of the neighbourhood that a point is compared with where the light is uneven: wider than the strokes,
narrower than glare and shadows.
"""
REACH = 1.22
"""Extent of the maps, in radii of the disc."""

_ARROW_PITCH_M, _ARROW_MARGIN_M = 0.008, 0.02
"""Distance between samples about the arrowhead, and the width of the border around it."""

_LEAST_SPAN = 0.04
"""Least difference of two paints in a channel, in square roots of light, that a third is placed between; as in the core."""

H = 0
"""Index of the H in maps and tables."""
ORANGE = 1
"""Index of ring and arrowhead."""
DISC = 2
"""Index of the disc."""
AROUND = 3
"""Index of the surroundings."""
LEARNED_AT = 0.9
"""Confidence that a frame needs to update the memory."""
FADING = 0.08
"""Fraction of the trust lost with each frame without the pad: full trust is lost in 28 frames."""
TRUSTED = 0.10
"""Trust above which the memory is used: three confident frames."""
_BROAD = 1.0  # Variance, in natural logarithms squared, of a paint that nothing is known about: a factor e either way


def disc_edge_m(pad: Pad) -> float:
    """Return the radius at which the disc's own paint ends: at the rim if there is one; on a bare deck where the pad ends."""
    return pad.markings.field_radius_m or pad.disc_radius_m


def paints_at(xy_m: F64, pad: Pad) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return disjoint masks of lettering, ring, arrowhead and disc or panel at (N, 2) positions on the pad, m.

    Lettering of a second paint is in none of them.
    """
    x, y = xy_m[:, 0], xy_m[:, 1]
    r = np.hypot(x, y)
    marks, nothing = pad.markings, np.zeros(len(r), bool)
    h_marking, ring, arrow = nothing, nothing, nothing
    for fiducial in marks.fiducials:
        h_marking = h_marking | fiducial.covers(xy_m)
    h_marking = h_marking | _lettered([letter for letter in marks.letters if letter not in marks.fiducials], xy_m)
    if marks.triangle is not None:
        h_marking = h_marking | covers(marks.triangle, xy_m)
    if marks.ring_outer_m:
        ring = (r >= marks.ring_inner_m) & (r <= marks.ring_outer_m)
    if marks.arrow_tip_m:
        behind = marks.arrow_tip_m - x
        slanted = np.abs(y) * marks.arrow_depth_m <= behind * marks.arrow_half_base_m
        arrow = (behind >= 0) & (behind <= marks.arrow_depth_m) & slanted & ~ring
    ground = r <= disc_edge_m(pad) if marks.panel is None else covers(marks.panel, xy_m)
    if marks.upper:
        above = _lettered(marks.upper, xy_m)
        h_marking, ground = h_marking & ~above, ground & ~above
    return h_marking, ring, arrow, ground & ~h_marking & ~ring & ~arrow


def _lettered(letters: Sequence[Lettering], xy_m: F64) -> NDArray[np.bool_]:
    """Return whether positions (N, 2) m lie on some lettering."""
    x, y = xy_m.T
    out = np.zeros(len(xy_m), bool)
    for x0, x1, y0, y1 in rectangles_of(letters):
        out |= (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
    for letter in letters:
        if is_slanted(letter):
            out |= covers(letter, xy_m)
    return out


def _shares_at(xy_m: F64, pad: Pad) -> tuple[F64, F64, F64, F64]:
    """Return the shares of lettering, ring, arrowhead and disc or panel at (N, 2) positions on the pad, m.

    The drawing has four paints: lettering of a second one is drawn as the mixture of lettering and ground that is as bright.
    """
    masks, marks = paints_at(xy_m, pad), pad.markings
    h_marking, ring, arrow, disc = (np.asarray(mask, float) for mask in masks)
    if marks.colours.upper is not None:
        upper, letters, ground = (linear_light(rgb) @ LUMA for rgb in (marks.colours.upper, marks.colours.h, marks.colours.disc))
        share = float(np.clip((upper - ground) / (letters - ground or 1.0), 0.0, 1.0))
        above = _lettered(marks.upper, xy_m)
        h_marking[above], disc[above] = share, (1.0 - share) * marks.has_ground
    return h_marking, ring, arrow, disc


@lru_cache(maxsize=8)
def polar_drawing(pad: Pad) -> Mapping[str, Any]:
    """Return the drawing in the core's `dl_polar_pad`. The outermost tenth of the radii lies around the disc."""
    outer = 1.12 * pad.disc_radius_m
    r = (np.arange(_RADII) + 0.5) / _RADII * outer
    a = np.arange(ANGLES) * math.tau / ANGLES

    def places(radii: F64, angles: F64) -> F64:
        rr, aa = np.meshgrid(radii, angles, indexing="ij")
        return np.stack([rr * np.cos(aa), rr * np.sin(aa)], axis=2).reshape(-1, 2)

    fine_r = (np.arange(_RADII * _FINE) + 0.5) / (_RADII * _FINE) * outer
    fine_a = (np.arange(ANGLES * _FINE) - (_FINE - 1) / 2) * math.tau / (ANGLES * _FINE)
    masks = _shares_at(places(fine_r, fine_a), pad)
    h_marking, ring, arrow, disc = (m.reshape(_RADII, _FINE, ANGLES, _FINE).mean(axis=(1, 3)) for m in masks)
    inside = (h_marking + ring + arrow + disc).mean(axis=1, keepdims=True) > 0.5
    area = (r / r.mean()).astype(np.float32)[:, None]
    return {
        "xy_m": places(r, a), "area_inside": area * inside, "ring": ring.mean(axis=1, keepdims=True).astype(np.float32),
        "h_marking": h_marking.astype(np.float32), "arrow": arrow.astype(np.float32),
        "polarity": 1.0 if pad.markings.is_bright else -1.0, "radius_m": pad.disc_radius_m,
    }  # fmt: skip


class Template(Struct, frozen=True, eq=False):
    """The drawing as the native core takes it: coverage by each paint over the pad's plane, blurred, and its lengths.

    Maps are (`BLURS_M`, n, n, 4): row by x, column by y, the centre in the middle, full coverage is `DL_TEMPLATE_ONE`.
    """

    coverage: I16
    """Coverage by H, orange, disc and surroundings."""
    local: I16
    """Coverage minus its mean in the neighbourhood (`LOCAL_M`)."""
    lengths: Mapping[str, Any]
    """The members of the core's `dl_pad_template`."""


@lru_cache(maxsize=8)
def template(pad: Pad) -> Template:
    """Return the `Template` of a pad."""
    sharp = _sharp(pad)
    coverage, local = (np.empty((len(BLURS_M), *sharp.shape), np.int16) for _ in range(2))
    for k, blur_m in enumerate(BLURS_M):
        blurred = _blurred(sharp, blur_m)
        coverage[k] = np.rint(blurred * DL_TEMPLATE_ONE)
        local[k] = np.rint((blurred - _blurred(blurred, LOCAL_M)) * DL_TEMPLATE_ONE)
    for maps in (coverage, local):
        maps.setflags(write=False)
    return Template(coverage, local, _lengths(pad, len(sharp)))


def _sharp(pad: Pad) -> F32:
    """Return the (n, n, 4) coverage by each paint, without blur."""
    half = math.ceil(REACH * pad.disc_radius_m / STEP_M)
    n = 2 * half + 1
    fine = (np.arange(3 * n) - (3 * n - 1) / 2) * STEP_M / 3
    gx, gy = np.meshgrid(fine, fine, indexing="ij")
    h_marking, ring, arrow, disc = _shares_at(np.stack([gx.ravel(), gy.ravel()], axis=1), pad)
    orange = ring + arrow
    flat = np.stack([h_marking, orange, disc, 1.0 - h_marking - orange - disc], axis=1).astype(np.float32)
    return np.asarray(flat.reshape(n, 3, n, 3, 4).mean(axis=(1, 3)))


def _lengths(pad: Pad, n: int) -> Mapping[str, Any]:
    marks = pad.markings
    rows, columns = (
        math.ceil((length_m + 2.0 * _ARROW_MARGIN_M) / _ARROW_PITCH_M - 1e-9)
        for length_m in (marks.arrow_depth_m, 2.0 * marks.arrow_half_base_m)
    )
    return {
        "n": n, "disc_channel": 2 - int(np.argmax(marks.colours.disc)), "arrow_rows": rows, "arrow_columns": columns + 1,
        "disc_drawn": bool(pad.markings.field_radius_m),
        "per_m": 1.0 / STEP_M, "log_blur": np.log(BLURS_M), "local_m": LOCAL_M, "reach_m": REACH * pad.disc_radius_m,
        "disc_radius_m": pad.disc_radius_m, "disc_edge_m": disc_edge_m(pad),
        "h_half_length_m": marks.lettering_m[0] / 2, "h_half_width_m": marks.lettering_m[1] / 2,
        "ring_inner_m": marks.ring_inner_m, "ring_outer_m": marks.ring_outer_m,
        "arrow_tip_m": marks.arrow_tip_m, "arrow_depth_m": marks.arrow_depth_m, "arrow_half_base_m": marks.arrow_half_base_m,
        "arrow_margin_m": _ARROW_MARGIN_M, "arrow_pitch_m": _ARROW_PITCH_M, "orange_place": _orange_place(pad),
        "h_side": np.where(_h_over_disc(pad) <= -_LEAST_SPAN, -1.0, 1.0),
    }  # fmt: skip


def _orange_place(pad: Pad) -> F64:
    """Return the (3,) nominal place of the orange between disc (0) and H (1), by square roots of light in blue, green, red."""
    orange, green = (np.sqrt(linear_light(rgb[::-1])) for rgb in (pad.markings.colours.ring, pad.markings.colours.disc))
    span = _h_over_disc(pad)
    return np.asarray((orange - green) / np.where(np.abs(span) < _LEAST_SPAN, _LEAST_SPAN, span))


def _h_over_disc(pad: Pad) -> F64:
    """Return the (3,) nominal difference of the H from the disc, by square roots of light in blue, green, red."""
    h_marking, disc = (np.sqrt(linear_light(rgb[::-1])) for rgb in (pad.markings.colours.h, pad.markings.colours.disc))
    return np.asarray(h_marking - disc)


def _blurred(coverage: F32, sigma_m: float) -> F32:
    return np.asarray(cv2.GaussianBlur(coverage, (0, 0), sigma_m / STEP_M, borderType=cv2.BORDER_REPLICATE), np.float32)


class PaintMemory(Struct, frozen=True, eq=False):
    """Mean and variance of the logarithm of each paint's light, and their trust."""

    mean: F64
    """Mean of log1p(light / floor), (4, 3): of H, orange, disc, surroundings in blue, green, red."""
    var: F64
    """Variance of the same, (4, 3)."""
    trust: float
    """Trust in the memory, 0..1."""

    @property
    def trusted(self) -> bool:
        return self.trust >= TRUSTED

    def dominance(self, pad: Pad) -> tuple[float, float] | None:
        """Return the excess of the disc's dominant channel over the others, on the disc and around it, in natural logarithms.

        Return None if the memory is not trusted, or if the two values are not two standard deviations apart.
        """
        if not self.trusted:
            return None
        main = 2 - int(np.argmax(pad.markings.colours.disc))
        others = [(main + 1) % 3, (main + 2) % 3]
        disc, around = (float(self.mean[k, main] - self.mean[k, others].max()) for k in (DISC, AROUND))
        spread = float(np.sqrt(self.var[[DISC, AROUND]].mean()))
        return (disc, around) if disc - around > 2.0 * spread else None


FRESH = PaintMemory(np.zeros((4, 3)), np.full((4, 3), _BROAD), 0.0)
"""The memory before any learning."""


def fade(memory: PaintMemory) -> PaintMemory:
    """Return the memory after a frame without the pad: less trusted and broader, and in the end equal to `FRESH`."""
    trust = memory.trust * (1.0 - FADING)
    if trust < 0.5 * TRUSTED:
        return FRESH
    return PaintMemory(memory.mean, memory.var + FADING * (_BROAD - memory.var), trust)
