"""Find poses of a pad by its fiducials, which OpenCV's detector reads."""

import math
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.detect.guesses import Plane
from estimator.vision.detect.pyramid import U8
from estimator.vision.pad.fiducial import PaintedFiducial, cells_apart, dictionary_of
from estimator.vision.pad.pad import Pad

WINDOWS_PX = (5, 13, 23)
"""Sides of the neighbourhood whose mean divides light from dark, in the order in which they are tried: the least one is quickest
and reads the smallest cells, larger ones stand more blur and noise.
"""
WORK_FIDUCIALS = 3.0
"""Work of reading the fiducials of one dictionary with one window; see `hypotheses.Kind`."""
_POSES = 3  # Largest number of poses of one frame: two pads in view, or a pose and its mirror image
_CORNER_PX = 0.7  # Standard deviation of a corner's place as the detector finds it
_TILT_RAD = math.radians(4.0)  # Standard deviation of the tilt between the deck and a vehicle of known attitude
_SAME_SIDES = 0.25
"""Largest distance of a fiducial's corners from their place by another fiducial's pose, in its sides in the frame."""
_MIRRORED = 6.0  # Difference of two squared errors, in variances, below which a pose and its mirror image are both tried
_UNIT = np.eye(3)


class _Read(Struct, frozen=True, eq=False):
    """A fiducial as read in a frame."""

    p_pad: F64
    """Its corners on the pad, (4, 3) m."""
    uv_px: F64
    """Its corners in the frame, (4, 2) px."""

    @property
    def side_px(self) -> float:
        return float(np.linalg.norm(self.uv_px - np.roll(self.uv_px, 1, axis=0), axis=1).min())


class FiducialPose(NamedTuple):
    """A pose from fiducials."""

    pose: PadPose
    off_px: float
    """Largest error of the pad's farthest visible edge by errors of the corners alone, px."""


def fiducial_poses(grey: U8, camera: Camera, pad: Pad, plane: Plane, window_px: int) -> list[FiducialPose]:
    """Return poses of a pad from its fiducials, best supported first; empty if none is read.

    Args:
        grey: (H, W) luminance.
        plane: the plane that the pad is taken to lie in.
        window_px: one of `WINDOWS_PX`.
    """
    left = sorted(_read(grey, pad, window_px), key=lambda read: -read.side_px)
    found: list[tuple[int, list[FiducialPose]]] = []
    while left and len(found) < _POSES:
        agreeing = left[:1]
        poses = _solved(agreeing, camera, plane)
        if poses:
            agreeing += [read for read in left[1:] if any(_agrees(read, pose, camera) for pose in poses)]
            poses = _solved(agreeing, camera, plane) or poses
            found.append((len(agreeing), [FiducialPose(pose, _off_px(agreeing, pose, camera, pad)) for pose in poses]))
        left = [read for read in left if not any(read is other for other in agreeing)]
    found.sort(key=lambda of: -of[0])
    return [pose for _, poses in found for pose in poses][:_POSES]


def _read(grey: U8, pad: Pad, window_px: int) -> list[_Read]:
    """Return the pad's fiducials that the detector reads."""
    found = []
    for detector, fiducials in _detectors(pad.markings.fiducials, window_px):
        corners, numbers, _ = detector.detectMarkers(grey)
        for uv, number in zip(corners, [] if numbers is None else np.ravel(numbers), strict=True):
            p_pad = np.pad(fiducials[int(number)].corners_read(), ((0, 0), (0, 1)))
            found.append(_Read(p_pad, np.asarray(uv, float).reshape(4, 2)))
    return found


@lru_cache(maxsize=16)
def _detectors(
    fiducials: tuple[PaintedFiducial, ...], window_px: int
) -> list[tuple[cv2.aruco.ArucoDetector, list[PaintedFiducial]]]:
    """Return a detector for each dictionary, which knows these fiducials alone, and the fiducials by the number that it gives."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.errorCorrectionRate = 1.0
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = window_px
    out = []
    for name in dict.fromkeys(f.dictionary for f in fiducials):
        of, own = dictionary_of(name), [f for f in fiducials if f.dictionary == name]
        known = cv2.aruco.Dictionary(of.bytesList[[f.id for f in own]], of.markerSize, _correctable(own))
        out.append((cv2.aruco.ArucoDetector(known, parameters), own))
    return out


def _correctable(fiducials: list[PaintedFiducial]) -> int:
    """Return how many wrong cells leave each of a pad's own markers the nearest one.

    That is more than the dictionary allows, whose other markers are not there. What is read wrongly is refused by the drawing.
    """
    cells = [fiducial.cells() for fiducial in fiducials]
    turned_itself = [cells_apart(own, own, (1, 2, 3)) for own in cells]
    return (min([*turned_itself, *(cells_apart(a, b) for a, b in combinations(cells, 2))]) - 1) // 2


def _off_px(reads: list[_Read], pose: PadPose, camera: Camera, pad: Pad) -> float:
    """Return what the farthest edge in view may be off by: the corners' error times the pad's size over that of what is read."""
    uv = np.concatenate([read.uv_px for read in reads])
    radius_px = float(np.linalg.norm(uv - uv.mean(axis=0), axis=1).max())
    pad_px = pose.px_of(pad.disc_radius_m, camera)
    return _CORNER_PX * min(pad_px, 0.5 * math.hypot(camera.width, camera.height)) / max(radius_px, 1.0)


def _agrees(read: _Read, pose: PadPose, camera: Camera) -> bool:
    p_cam = pose.points(read.p_pad)
    if float(p_cam[:, 2].min()) < 0.01:
        return False
    off = np.linalg.norm(camera.project(p_cam) - read.uv_px, axis=1)
    return bool(off.max() < _SAME_SIDES * read.side_px)


def _solved(reads: list[_Read], camera: Camera, plane: Plane) -> list[PadPose]:
    """Return the likeliest pose, and its mirror image if that is about as likely."""
    p_pad, uv = (np.concatenate(all_of) for all_of in ([r.p_pad for r in reads], [r.uv_px for r in reads]))
    rays = camera.rays(uv)
    if not np.isfinite(rays).all():
        return []
    _, turns, places, errors = cv2.solvePnPGeneric(p_pad, rays, _UNIT, np.zeros(5), flags=cv2.SOLVEPNP_IPPE)
    rated: list[tuple[float, PadPose]] = []
    for turn, place, error in zip(turns, places, np.ravel(errors).tolist(), strict=True):
        R, t = np.asarray(cv2.Rodrigues(turn)[0], float), np.asarray(place, float)[:, 0]
        if not (np.isfinite(R).all() and np.isfinite(t).all() and t[2] > 0.0 and R[2, 2] > 0.0):
            continue
        # The error is the root mean square over both coordinates of all corners.
        off = 2.0 * len(uv) * (error * camera.fx / _CORNER_PX) ** 2
        if plane.known:
            off += (math.acos(min(1.0, float(R[:, 2] @ plane.R_cam_plane[:, 2]))) / _TILT_RAD) ** 2
        rated.append((off, PadPose(Rotation(R), t)))
    rated.sort(key=lambda of: of[0])
    return [pose for off, pose in rated if off < rated[0][0] + _MIRRORED]
