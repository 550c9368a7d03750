"""Accuracy with which a pad can be measured in a frame, resolution of its headings, and its contrast with a deck."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.geometry import covers, reach_of
from estimator.vision.pad.pad import Pad
from estimator.vision.srgb import LUMA, linear_light

NOISE = 0.01
"""Assumed noise of a pixel's linear light, full scale 1."""
BLUR_PX = 0.8
"""Assumed standard deviation of the point spread."""
_FINE, _FINE_TO_PX = 3, 100.0
"""Points along a pixel's side, and the radius in the frame beyond which one is enough."""
_ALIKE = 0.02  # Share of the painted ground that may differ between two headings that a camera cannot distinguish
_NEARLY_ALIKE = 0.2
"""Share of the painted ground that may differ between two headings that a search may confuse; a look at both decides."""
_TURNS = tuple(math.radians(degrees) for degrees in (60.0, 72.0, 90.0, 120.0, 144.0, 180.0))
"""Turns one way after which regular shapes look the same, rad."""


@dataclass(frozen=True, slots=True)
class PadAccuracy:
    """The Cramer-Rao bound of one frame from straight above, its tilt known: no unbiased estimator has less."""

    height_m: float
    radius_px: float
    """Radius of the pad in the frame."""
    in_view: float
    """Fraction of the pad within the frame."""
    lateral_m: float
    """Standard deviation along the worse direction."""
    range_m: float
    yaw_rad: float
    """Infinite for a pad without a heading."""


def paint_at(pad: Pad, xy_m: F64, deck: F64) -> F64:
    """Return the linear red, green, blue (N, 3) of a pad at points (N, 2) m, on a deck of that linear light (3,)."""
    out = np.broadcast_to(deck, (len(xy_m), 3)).copy()
    for region in pad.regions:
        near = np.flatnonzero(np.hypot(*xy_m.T) < reach_of(region)[1])
        out[near[covers(region, xy_m[near])]] = linear_light(pad.rgb(region))
    return out


def accuracy(pad: Pad, camera: Camera, height_m: float, deck: F64) -> PadAccuracy:
    """Return the bound on the accuracy of one frame at a height over the pad's centre.

    The information is that of every pixel's luminance on position, height and heading, with white noise (`NOISE`), a Gaussian
    point spread (`BLUR_PX`) and known paints. Source: Kay, Fundamentals of Statistical Signal Processing 1, sec. 3.9.

    Args:
        deck: (3,) linear red, green, blue of the bare deck.
    """
    focal_px = 0.5 * (camera.fx + camera.fy)
    radius_px = focal_px * pad.disc_radius_m / height_m
    fine = _FINE if radius_px < _FINE_TO_PX else 1
    half_w, half_h = (min(0.5 * size, radius_px + 6.0) for size in (camera.width, camera.height))
    columns, rows = 2 * math.ceil(half_w), 2 * math.ceil(half_h)
    u, v = ((np.arange(n * fine) + 0.5) / fine - 0.5 * n for n in (columns, rows))
    gu, gv = np.meshgrid(u, v)
    # The top of the frame is ahead: x of the pad is up, y to the right.
    places = np.stack([-gv.ravel(), gu.ravel()], axis=1) * (height_m / focal_px)
    sharp = (paint_at(pad, places, deck) @ LUMA).reshape(gu.shape)
    light = cv2.GaussianBlur(sharp, (0, 0), fine * BLUR_PX, borderType=cv2.BORDER_REPLICATE)
    light = light.reshape(rows, fine, columns, fine).mean(axis=(1, 3))
    by_v, by_u = np.gradient(light)
    pu, pv = np.meshgrid(np.arange(columns) + 0.5 - 0.5 * columns, np.arange(rows) + 0.5 - 0.5 * rows)
    scale = focal_px / height_m
    J = np.stack([by_v * scale, -by_u * scale, (pu * by_u + pv * by_v) / height_m, pv * by_u - pu * by_v]).reshape(4, -1)
    information = J @ J.T / NOISE**2
    known = [0, 1, 2] if alike_headings(pad) == 0 else [0, 1, 2, 3]
    cov = np.linalg.pinv(information[np.ix_(known, known)])
    angle = np.linspace(0.0, math.tau, 360, endpoint=False)
    seen = (np.abs(radius_px * np.cos(angle)) < 0.5 * camera.width) & (np.abs(radius_px * np.sin(angle)) < 0.5 * camera.height)
    return PadAccuracy(
        height_m, radius_px, float(seen.mean()), math.sqrt(float(np.linalg.eigvalsh(cov[:2, :2])[-1])),
        math.sqrt(float(cov[2, 2])), math.sqrt(float(cov[3, 3])) if len(known) == 4 else math.inf,
    )  # fmt: skip


@lru_cache(maxsize=8)
def alike_headings(pad: Pad) -> int:
    """Return in how many headings the pad looks the same: 1 if its heading is unique, 0 if it has none, as a ring alone."""
    differs = _difference_of(pad, 241)

    def turned(angle_rad: float) -> bool:
        return differs(angle_rad) < _ALIKE

    if turned(math.radians(37.0)) and turned(math.radians(71.0)):
        return 0
    return 1 + sum(turned(math.radians(degrees)) for degrees in (90.0, 180.0, 270.0))


@lru_cache(maxsize=8)
def confusable_turns(pad: Pad) -> tuple[float, ...]:
    """Return the turns, rad, after which the pad looks nearly the same, and that only a look at both headings distinguishes.

    Those of a pad whose arrowhead or fiducial says which is right, those of a letter alone, and turns after which it looks the
    same are none of them.
    """
    if pad.markings.arrow is not None or pad.markings.fiducials or pad.markings.is_letter_alone:
        return ()
    # A turn the other way differs by as much.
    differs = _difference_of(pad, 121)
    alike = [turn for turn in _TURNS if differs(turn) < _ALIKE]
    near = [turn for turn in _TURNS if _ALIKE <= differs(turn) < _NEARLY_ALIKE]
    # After half a turn more, a turn by a right angle is the one the other way.
    both = [turn for turn in near if not (math.pi in alike and turn == 0.5 * math.pi)]
    return (*near, *(-turn for turn in both if turn < math.pi))


def _difference_of(pad: Pad, n: int) -> Callable[[float], float]:
    """Return a function of a turn, rad: the share of the painted ground that differs after it, by n points across."""
    axis = (np.arange(n) - (n - 1) / 2) / ((n - 1) / 2) * pad.disc_radius_m
    gx, gy = np.meshgrid(axis, axis, indexing="ij")
    places = np.stack([gx.ravel(), gy.ravel()], axis=1)
    places = places[np.hypot(*places.T) < pad.disc_radius_m]
    grey = np.full(3, 0.2)
    own = paint_at(pad, places, grey)
    marked = max(1, int(np.count_nonzero(np.any(np.abs(own - _commonest(own)) > 0.02, axis=1))))

    def differs(angle_rad: float) -> float:
        c, s = math.cos(angle_rad), math.sin(angle_rad)
        other = paint_at(pad, places @ np.array([[c, -s], [s, c]]), grey)
        return int(np.count_nonzero(np.any(np.abs(own - other) > 0.02, axis=1))) / marked

    return differs


_APART = np.array([1.0, math.pi, math.e])  # Weights of red, green and blue that give two colours of six decimals two numbers


def _commonest(colours: F64) -> F64:
    # One number for each colour: sorting rows keeps the interpreter for a tenth of a second.
    rounded = colours.round(6)
    _, first, counts = np.unique(rounded @ _APART, return_index=True, return_counts=True)
    return np.asarray(rounded[first[int(np.argmax(counts))]])
