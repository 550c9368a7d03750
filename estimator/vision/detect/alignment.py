"""Align the whole drawing with the frame: estimate pose and paints together, by Gauss-Newton on the pixels (dense alignment).

The frame near the pad is modelled as a mixture of four paints (H, orange, disc, surroundings). The drawing gives the coverage of
each paint in every pixel. Light is additive, so for a given pose the paints follow by linear least squares under any
illumination. The pose then follows the model's gradient (Lucas and Kanade 1981, as compositional alignment with the drawing as
template, and with Cauchy weights against occlusion and glare). The result is near enough for edge-based registration to start,
and it holds the inputs of the confidence classifier. The native core computes it (`estimator/core/vision/align/`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.core.abi import (
    APPROACH_SAMPLES,
    APPROACH_STEPS,
    FINAL_SAMPLES,
    LOCAL_MAX,
    SAMPLE_LANES,
    SCRATCH_ROWS,
)
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, start_of
from estimator.vision.camera import Camera
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.detect.template import Template, template
from estimator.vision.native import address, packed_camera, pixels
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.srgb import LINEAR_LIGHT

FLOOR = 0.01
"""Light, as a fraction of full scale, below which there is only noise."""
TABLES = np.stack([LINEAR_LIGHT, np.sqrt(LINEAR_LIGHT), np.log1p(LINEAR_LIGHT / FLOOR)]).astype(np.float32)
"""(3, 256) linear light, its square root, and its logarithm log1p(light / floor)."""
TABLES.setflags(write=False)


_VIEW, _ARROW_VIEW, _MOVE, _FIT, _COVER = (
    CORE.function(name) for name in ("align_view", "align_arrow_view", "align_move", "align_fit", "align_cover")
)
_POSE_WORDS, _PART_WORDS, _HOW_WORDS, _ALIGNED_WORDS = map(size_of, ("pad_pose", "frame_part", "alignment", "aligned_pad"))
_HOW, _ALIGNED = places_of("alignment"), places_of("aligned_pad")
_COVER_WORDS, _LINE = size_of("cover_line"), places_of("cover_line")
UNCUT = np.zeros(3)
"""The cut that hides nothing. A cut (3,) is a line across the frame: rays (x, y) with `a x + b y + c < 0` do not count."""
UNCUT.setflags(write=False)

_SAMPLES = 700
"""Largest number of samples in the disc's bounding box during a search."""
SIGMA_TILT_RAD = math.radians(3.0)
"""Standard deviation of the tilt between the deck and a vehicle of measured attitude."""
SIGMA_TILT_FREE_RAD = math.radians(15.0)
"""Standard deviation of the tilt if neither attitude is known."""


@dataclass(frozen=True, slots=True)
class ArrowPlace:
    """The measurements at one of the two places where an arrowhead may be."""

    found: float
    """Strength of the arrowhead there times the fraction of the variation it explains, 0..1."""
    seen: float
    """Fraction of the place inside the frame; 0 if the pixels are too coarse."""
    clear: float
    """Confidence, 0..1, that only disc, ring and perhaps an arrowhead are there."""


@dataclass(frozen=True, slots=True, eq=False)
class AlignedTemplate:
    """The drawing as aligned with one frame."""

    pose: PadPose
    paints: F64
    """Linear light of H, orange, disc and surroundings, (4, 3), 0..1, in blue, green, red."""
    sample_m: float
    """Side of a sample on the pad, m."""
    in_view: float
    """Fraction of the disc's area inside the frame."""
    tilt_sigmas: float
    """Tilt of the pose relative to its start, in standard deviations of the prior."""
    arrow: tuple[ArrowPlace, ArrowPlace]
    """Support for the arrowhead at its place, and at the place where it would be with the drawing turned by 180 degrees."""
    features: F64
    """Inputs of the confidence classifier, in the order of `verification.FEATURES`."""


class Cover(NamedTuple):
    """What seems to cover a part of the pad."""

    cut: F64
    """The line beyond which it lies, (3,); see `UNCUT`."""
    gain: float
    """By how much the logarithm of the residuals' variance falls, on average, if a thing of one colour is beyond the line."""
    left: float
    """Share of the light's variation on this side of the line that the drawing leaves, 0..1."""


class DrawingAddresses(NamedTuple):
    """Addresses of what stays the same from frame to frame, and what keeps it in memory."""

    camera: int
    template: int
    coverage: int
    local: int
    light: int
    kept: tuple[F64, Template]


@lru_cache(maxsize=4)
def drawing_addresses(camera: Camera, pad: Pad) -> DrawingAddresses:
    """Return where the core finds a camera and a pad's drawing; the result is cached."""
    lens, drawn = packed_camera(camera), template(pad)
    maps = address(drawn.coverage, np.int16), address(drawn.local, np.int16)
    return DrawingAddresses(address(lens), address(drawn.words), *maps, address(TABLES, np.float32), (lens, drawn))


class _Part(NamedTuple):
    """A part of a level of the pyramid: addresses, and what keeps them in memory."""

    words: int
    px: int
    stride: int
    """Bytes from row to row."""
    scratch: int
    kept: tuple[NDArray[Any], ...]


def align(
    pyramid: Pyramid,
    camera: Camera,
    pad: Pad,
    pose: PadPose,
    sigma_tilt_rad: float,
    steps: int = 4,
    *,
    local: bool = False,
    side: F64 | None = None,
    cut: F64 = UNCUT,
) -> AlignedTemplate | None:
    """Align the drawing with the frame from a rough pose.

    Args:
        sigma_tilt_rad: standard deviation of the tilt of the start pose's normal.
        steps: number of Gauss-Newton steps; the first half uses a drawing blurred twice as much. With 0 the pose is unchanged.
        local: use the light minus its mean in the neighbourhood, against glare and shadows; the reach is a little shorter.
        side: (2,) unit direction in x and y of the pad: use only the half of the disc on this side, because the other is covered.
        cut: the line beyond which something covers the pad, (3,); see `UNCUT`.

    Returns:
        The aligned template; None if too little of the pad is in view, or if the pose diverges.
    """
    words, tilt_sigmas, fixed = _packed(pose), 0.0, drawing_addresses(camera, pad)
    if steps > 0:
        moved = _moved(pyramid, fixed, words, sigma_tilt_rad, steps, local, _SAMPLES, side, cut)
        if moved is None:
            return None
        tilt_sigmas = moved
        pose = _unpacked(words)
    part = _part(pyramid, fixed, words, FINAL_SAMPLES)
    if part is None:
        return None
    out = np.empty(_ALIGNED_WORDS)
    arrow_part = np.empty(_PART_WORDS)
    _ARROW_VIEW(fixed.camera, fixed.template, start_of(words), start_of(arrow_part))
    level, left, top, width, height = arrow_part.view(np.int64).tolist()
    arrow_image = pyramid.cut(level, left, top, left + width, top + height)
    found = _FIT(
        fixed.camera, fixed.template, fixed.coverage, fixed.local, fixed.light,
        part.words, part.px, part.stride, start_of(arrow_part),
        *pixels(arrow_image), start_of(words), tilt_sigmas, address(cut), start_of(pyramid.quality),
        part.scratch, start_of(out),
    )  # fmt: skip
    return _aligned(pose, out) if found else None


def cover(pyramid: Pyramid, camera: Camera, pad: Pad, pose: PadPose) -> Cover | None:
    """Return the line across the frame beyond which most probably something covers the pad, which lies about at this pose.

    There is always such a line unless too little of the pad is in view; `gain` and `left` say what it is worth.
    """
    words, fixed = _packed(pose), drawing_addresses(camera, pad)
    part = _part(pyramid, fixed, words, _SAMPLES)
    out = np.empty(_COVER_WORDS)
    if part is None or not _COVER(
        fixed.camera, fixed.template, fixed.coverage, fixed.light, part.words, part.px, part.stride,
        start_of(words), part.scratch, start_of(out),
    ):  # fmt: skip
        return None
    return Cover(out[_LINE["cut"]], *(float(out[_LINE[name].start]) for name in ("gain", "left")))


def approach(pyramid: Pyramid, camera: Camera, pad: Pad, pose: PadPose, sigma_tilt_rad: float) -> PadPose | None:
    """Return a pose that edge-based registration can start from, given a rough one.

    This is `align` without the inputs of the classifier.
    """
    words = _packed(pose)
    moved = _moved(pyramid, drawing_addresses(camera, pad), words, sigma_tilt_rad, APPROACH_STEPS, False, APPROACH_SAMPLES)
    return None if moved is None else _unpacked(words)


def _moved(
    pyramid: Pyramid,
    fixed: DrawingAddresses,
    pose: F64,
    sigma_tilt_rad: float,
    steps: int,
    local: bool,
    most: int,
    side: F64 | None = None,
    cut: F64 = UNCUT,
) -> float | None:
    """Move a packed pose by some steps; return its tilt away from the start in standard deviations, None if it diverges."""
    part = _part(pyramid, fixed, pose, most)
    if part is None:
        return None
    tilt_sigmas, how = np.empty(1), np.zeros(_HOW_WORDS)
    integers = how.view(np.int64)
    integers[_HOW["steps"]], integers[_HOW["local"]], integers[_HOW["one_side"]] = steps, local, side is not None
    how[_HOW["sigma_tilt_rad"]], how[_HOW["cut"]], how[_HOW["noise"]] = sigma_tilt_rad, cut, pyramid.noise
    if side is not None:
        how[_HOW["side"]] = side
    found = _MOVE(
        fixed.camera, fixed.template, fixed.local if local else fixed.coverage, fixed.light, part.words, part.px, part.stride,
        start_of(how), start_of(pose), start_of(tilt_sigmas), part.scratch,
    )  # fmt: skip
    return float(tilt_sigmas[0]) if found else None


def _part(pyramid: Pyramid, fixed: DrawingAddresses, pose: F64, most: int) -> _Part | None:
    """Return the pixels about the disc, from the pyramid level that has a suitable number of them there."""
    words = np.empty(_PART_WORDS)
    if not _VIEW(fixed.camera, fixed.template, start_of(pose), most, start_of(words)):
        return None
    level, left, top, width, height = words.view(np.int64).tolist()
    room = -(-width * height // SAMPLE_LANES) * SAMPLE_LANES
    scratch = np.empty(SCRATCH_ROWS * room + width + 2 * LOCAL_MAX, np.float32)
    px = pyramid.cut(level, left, top, left + width, top + height)
    return _Part(start_of(words), *pixels(px), start_of(scratch), (words, px, scratch))


def _packed(pose: PadPose) -> F64:
    words = np.empty(_POSE_WORDS)
    words[:9] = pose.R_cam_pad.matrix.ravel()
    words[9:] = pose.t_cam_pad
    return words


def _unpacked(words: F64) -> PadPose:
    return PadPose(Rotation(words[:9].reshape(3, 3)), words[9:])


def _aligned(pose: PadPose, words: F64) -> AlignedTemplate:
    arrow = words[_ALIGNED["arrow"]].tolist()
    sample_m, in_view, tilt_sigmas = (float(words[_ALIGNED[name].start]) for name in ("sample_m", "in_view", "tilt_sigmas"))
    return AlignedTemplate(
        pose, words[_ALIGNED["paints"]].reshape(4, 3), sample_m, in_view, tilt_sigmas,
        (ArrowPlace(*arrow[:3]), ArrowPlace(*arrow[3:])), words[_ALIGNED["features"]],
    )  # fmt: skip
