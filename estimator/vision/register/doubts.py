"""Doubts that letters and fiducials leave on a registration, as log-odds.

Edges alone do not distinguish a fiducial from itself a quarter turn or a cell aside, where most of them lie on edges again. Its
cells do, as far as the frame resolves them. Where it does not, this many more of the edges have to agree. A letter's edges have
to be clear, as plates and lines have such edges, too.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, wrap_pi
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.pad.drawing import EdgeKind
from estimator.vision.pad.fiducial import PaintedFiducial
from estimator.vision.pad.pad import Pad
from estimator.vision.register.registration import Registration

LETTER_MOST = 2.2
"""Most log-odds of a letter alone: another marking may have the same one."""
_INLIERS = (0.9, 0.7)
"""Share of the edges that agree from which they do not count against a pose, and at which they refute it: 0.98 or more at
right poses.
"""
_INLIERS_TRACKED = (0.5, 0.3)
"""Share of agreeing edges where an estimate led to the place: the drone's own shadow crosses most edges of a near letter."""
_INLIERS_FAR, _SNR_FAR = (0.95, 0.85), (100.0, 50.0)
"""Share of agreeing pixels of a distant letter, and its contrast: 0.97 and 420 or more at right poses from 3 to 14 m in plain
light. A fit that has taken the bare deck for a letter of another size has fewer that agree, or no contrast (68 and less).
"""
_OFF_PX = (0.15, 0.3)
"""Unexplained displacement of edges at which they do not count, and at which they refute a pose.

Right poses have 0.01, other markings 0.27 and more.
"""
_SNR = (20.0, 8.0)
"""Contrast over its deviation at which it does not count, and at which it refutes a pose.

Right poses in plain light have 65 or more.
"""
_VISIBLE = (0.8, 0.7)
"""Share of the edges in view at which it does not count, and at which it refutes a pose.

It holds where no estimate led to the place: an end of a stroke may be of anything.
"""
_REFUTED = -25.0  # Log-odds of a refuted pose: more than all other evidence together

_FINE = 8  # Samples along a cell's side of the drawing whose blur is looked up
_BLUR_STEPS = 4.0  # Steps of the blur that drawings are kept for, by doubling
_PIXEL_PX = 0.3  # Standard deviation of a pixel's own square, px
_LEAST_SPAN = 12.0  # Least difference of light and dark cells in the frame, 8-bit, that is read
_READ = 0.65
"""Agreement from which the cells do not count against the pose.

It is 0.82 or more at right poses of uncovered pads, half of that if half of them is covered, at most 0.4 a quarter turn off, and
about 0 at a random place.
"""
_MISREAD = 0.35  # Agreement at which they refute it
_ENOUGH, _ENOUGH_SHARE = 5.0, 0.25
"""Number of clear cells, and their share of those in view, from which they count in full."""
_EDGES_AGREE, _EDGES_OFF = 0.8, 0.55
"""Share of the edges that agree from which they do not count against a pose whose cells are not resolved, and at which they
refute it: 0.89 or more at right poses of whole pads, 0.5 or less at wrong ones.
"""


def letter_log_odds(found: Registration, tracked: bool) -> float:
    """Return the log-odds, at most 0, that the edges add to the confidence of a registration.

    From afar edges merge, and a letter resembles what else is small and bright: there it is followed and not found.

    Args:
        tracked: whether a belief led to this place.
    """
    clear = found.edges[EdgeKind.H].snr
    if tracked:
        inliers, least_snr = (_INLIERS_FAR, _SNR_FAR) if found.dense else (_INLIERS_TRACKED, _SNR)
        return _REFUTED * max(_between(-found.inliers, inliers, -1.0), _between(-clear, least_snr, -1.0))
    if found.dense:
        return _REFUTED
    doubts = (
        (found.inliers, _INLIERS, -1.0),
        (found.edge_rms_px, _OFF_PX, 1.0),
        (clear, _SNR, -1.0),
        (found.visible, _VISIBLE, -1.0),
    )
    return _REFUTED * max(_between(sign * value, limits, sign) for value, limits, sign in doubts)


def _between(value: float, limits: tuple[float, float], sign: float = 1.0) -> float:
    good, bad = (sign * limit for limit in limits)
    return min(1.0, max(0.0, (value - good) / (bad - good)))


def nearest_of_four(pose: PadPose, R_level_cam: np.ndarray, yaw_rad: float) -> PadPose:
    """Return the pose of a drawing that looks the same after a quarter turn whose heading is nearest to a given one, rad."""
    x, y, _ = (R_level_cam @ pose.R_cam_pad.matrix)[:, 0].tolist()
    return pose.turned(0.5 * math.pi * round(wrap_pi(-math.atan2(y, x) - yaw_rad) / (0.5 * math.pi)))


def cells_log_odds(px: NDArray[np.uint8], camera: Camera, pad: Pad, found: Registration) -> float:
    """Return the log-odds, at most 0, that the cells of a pad's fiducials add to the confidence of a registration.

    Args:
        px: (H, W, 3) BGR, the registered frame.
    """
    read = read_cells(px, camera, pad, found.pose, found.blur_px)
    resolved = min(1.0, read.clear / max(_ENOUGH, _ENOUGH_SHARE * read.in_view))
    misread = min(1.0, max(0.0, (_READ - read.agreement) / (_READ - _MISREAD)))
    off = min(1.0, max(0.0, (_EDGES_AGREE - found.inliers) / (_EDGES_AGREE - _EDGES_OFF)))
    return _REFUTED * (resolved * misread + (1.0 - resolved) * off)


class ReadCells(NamedTuple):
    """The bits of a pad's fiducials as read in a frame."""

    agreement: float
    """Agreement: 1 if they are as drawn, 0 by chance; 1 if none is read."""
    clear: float
    """Number of resolved features: each counts by the square of its contrast in the blurred drawing."""
    in_view: int


def read_cells(px: NDArray[np.uint8], camera: Camera, pad: Pad, pose: PadPose, blur_px: float) -> ReadCells:
    """Read the bits of a pad's fiducials at a pose; arguments as for `cells_log_odds`.

    Args:
        blur_px: standard deviation of the point spread at the pad.
    """
    px_per_m = camera.fx / max(float(pose.t_cam_pad[2]), 1e-3)
    blur_m = math.hypot(blur_px, _PIXEL_PX) / px_per_m
    drawn = [_drawn(fiducial, _step_of(blur_m / fiducial.cell_m)) for fiducial in pad.markings.fiducials]
    p_pad, light, own = (np.concatenate(part) for part in zip(*drawn, strict=True))
    p_cam = pose.points(np.pad(p_pad, ((0, 0), (0, 1))))
    uv = camera.project(p_cam)
    seen = (p_cam[:, 2] > 0.01) & np.all((uv > 1.0) & (uv < (camera.width - 2.0, camera.height - 2.0)), axis=1)
    bits = own[seen]
    if not bits.any():
        return ReadCells(1.0, 0.0, 0)
    at = uv[seen].astype(np.float32)
    shown = cv2.remap(px, at[:, :1], at[:, 1:], cv2.INTER_LINEAR).reshape(-1, 3).mean(axis=1)
    dark, bright = np.percentile(shown, (10.0, 90.0)).tolist()
    expected = (2.0 * light[seen] - 1.0)[bits]
    clear = max(float(expected @ expected), 1e-6)
    if bright - dark < _LEAST_SPAN:
        return ReadCells(0.0, clear, len(expected))
    read = np.clip(2.0 * (shown[bits] - dark) / (bright - dark) - 1.0, -1.0, 1.0)
    return ReadCells(float(expected @ read) / clear, clear, len(expected))


def _step_of(blur_cells: float) -> int:
    return round(_BLUR_STEPS * math.log2(max(blur_cells, 0.02)))


@lru_cache(maxsize=512)
def _drawn(fiducial: PaintedFiducial, step: int) -> tuple[F64, F64, NDArray[np.bool_]]:
    """Return the middles of a fiducial's cells and of those around it, (N, 2) m, how light they are seen, 0..1, and its bits.

    Which are its bits is (N,): its border and what lies around are the same for all fiducials.

    Args:
        step: of the blur in cells, by `_step_of`.
    """
    cells = np.pad(fiducial.cells(), 1)
    n, blur_cells = len(cells), 2.0 ** (step / _BLUR_STEPS)
    around = np.pad(~cells, 2, constant_values=True).astype(np.float32)
    fine = np.asarray(np.kron(around, np.ones((_FINE, _FINE), np.float32)), np.float32)
    blurred = cv2.GaussianBlur(fine, (0, 0), _FINE * min(blur_cells, 2.0), borderType=cv2.BORDER_REPLICATE)
    middle = slice(2 * _FINE + _FINE // 2, (2 + n) * _FINE, _FINE)
    light = np.asarray(blurred[middle, middle], float)
    index = np.arange(n) - 0.5 * (n - 1)
    x, y = np.meshgrid(fiducial.at_m[0] - index * fiducial.cell_m, fiducial.at_m[1] + index * fiducial.cell_m, indexing="ij")
    own = np.zeros((n, n), bool)
    own[2:-2, 2:-2] = True
    return np.stack([x.ravel(), y.ravel()], axis=1), light.ravel(), own.ravel()
