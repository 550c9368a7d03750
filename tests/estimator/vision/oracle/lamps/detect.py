"""Find and measure a pad by its lamps in one frame: its sighting, with the confidence that these lights are its lamps.

Confidence: how many poses would explain as many spots if lights lay anywhere (number of false alarms, Desolneux, Moisan and
Morel, Meaningful alignments, IJCV 40(1), 2000), and how many lamps in view do not shine.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from estimator.contracts.estimates import Feature, Sighting
from estimator.contracts.samples import Frame
from estimator.vision.camera import Camera
from estimator.vision.lamp import places_of, points_of
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation, OrientedCamera
from estimator.vision.register.sighting import sighting_of
from tests.estimator.vision.oracle.lamps.fit import LampFit, fit
from tests.estimator.vision.oracle.lamps.pattern import Assignment, assign
from tests.estimator.vision.oracle.lamps.search import SPOTS, search, tried
from tests.estimator.vision.oracle.lamps.spots import Spots, find_spots

_SEARCHED_PX, _FITTED_PX = 3.0, 0.8
"""Reach of a lamp's spot about a searched pose, and about a fitted one."""
_MARGIN, _MARGIN_PX = 0.25, 24.0
"""Margin of the part of a frame about the expected lamps: as a part of their extent, and px."""
_MOST_OF_FRAME = 0.5
"""Share of the frame from which on such a part is taken as the whole."""
_TILTED = 0.04
"""What a deck's and an attitude's errors of tilt add to the first reach, as a part of the pattern's radius in the frame."""
_WITHIN_PX = (0.1, 0.25, 0.4, 0.6, 0.9, 1.3)
"""Distances of spots from their lamps within which it is asked how many lie there by chance."""
_LEAST_SEARCHED, _LEAST_TRACKED = 4, 3
"""Least number of spots that are lamps, from a search and where the pad is expected."""
_LEAST_SHARE = 0.6
"""Least part of the spots that the lamps in view would make."""
_EXPECTED_TESTS = 20.0
"""Number of different poses about an expected one."""
_EVEN_LOG10 = -2.0
"""Logarithm of the number of false alarms at which lights are as likely the pad's as not: one frame in a hundred."""
_WORTH_TELLING = 0.01
"""Confidence below which lights are no sighting at all."""
_TURNED_RAD = 0.2
"""Angle by which two different answers are turned: less than a lamp's own step around the pad."""
_STRANGER_LOG10 = 0.7
"""What a light among the lamps that is none of them speaks against the pad."""
_ASTRAY_SIGMAS, _ASTRAY_LOG10 = 3.0, 1.0
"""What each standard deviation by which the middle spot is farther off than so many speaks against the pad."""
_MISSING_LOG10 = 0.5
"""What a lamp in view that does not shine speaks against the pad."""


def detect_lamps(
    frame: Frame, camera: Camera, pad: Pad, orientation: Orientation, expected: PadPose | None = None, reach_px: float = 0.0
) -> Sighting | None:
    """Return the sighting of a pad by its lamps, of method "lamps"; None if its lamps are not seen.

    Args:
        orientation: the attitude at the exposure.
        expected: where the pad is expected; if it is not seen there, or with None, the whole frame is searched.
        reach_px: how far the pad may be from there in the frame.
    """
    found: list[_Explained] = []
    spots = Spots.none()
    if expected is not None:
        spots = _spots_about(expected, frame, camera, pad, reach_px)
        start = _shifted(spots, expected, reach_px, camera, pad)
        found += _at(spots, start, camera, pad, orientation, _EXPECTED_TESTS, _LEAST_TRACKED)
    if not found or found[0].log10_odds < 0.0:
        found, spots = [], find_spots(frame.px)
        paired = min(SPOTS, len(spots))
        tests = max(1.0, paired * (paired - 1.0) * len(tried(tuple(map(tuple, places_of(pad.lamps).tolist())))))
        for pose in search(spots, places_of(pad.lamps), OrientedCamera(camera, orientation)):
            if all(_differs(pose, one.fit.pose) for one in found):
                found += _at(spots, pose, camera, pad, orientation, tests, _LEAST_SEARCHED)
    if not found:
        return None
    best = max(found, key=lambda one: one.log10_odds)
    # What explains the frame nearly as well in another place or heading is as likely the pad.
    others = [one.log10_odds - best.log10_odds for one in found if _differs(one.fit.pose, best.fit.pose)]
    sure = 1.0 / ((1.0 + 10.0 ** -min(12.0, best.log10_odds)) * (1.0 + sum(10.0**odds for odds in others)))
    if sure < _WORTH_TELLING:
        return None
    seen = sighting_of(frame, best.fit.pose, best.fit.cov, camera, orientation, False, sure)
    lit = spots.uv_px[np.unique(best.lamps.spot)]
    return replace(seen, method="lamps", features=(Feature("point", "lamp", lit),))


def _spots_about(pose: PadPose, frame: Frame, camera: Camera, pad: Pad, reach_px: float) -> Spots:
    """Return the spots of the part of a frame where a pad is expected, as far as others speak against it."""
    uv = camera.project(pose.points(points_of(pad.lamps)))
    if not np.all(np.isfinite(uv)):
        return Spots.none()
    low, high = uv.min(axis=0), uv.max(axis=0)
    margin = reach_px + _MARGIN_PX + _MARGIN * float(np.linalg.norm(high - low))
    (left, top), (right, below) = np.floor(low - margin).tolist(), np.ceil(high + margin).tolist()
    window = (int(max(0, left)), int(max(0, top)), int(min(camera.width, right)), int(min(camera.height, below)))
    if window[2] - window[0] < _MARGIN_PX or window[3] - window[1] < _MARGIN_PX:
        return Spots.none()
    area = (window[2] - window[0]) * (window[3] - window[1])
    return find_spots(frame.px, None if area > _MOST_OF_FRAME * camera.width * camera.height else window)


def _first_reach_px(pose: PadPose, camera: Camera, pad: Pad) -> float:
    """Return the reach of a lamp's spot about a pose that is not fitted."""
    return _SEARCHED_PX + _TILTED * camera.fx * float(np.linalg.norm(places_of(pad.lamps), axis=1).max()) / pose.range_m


def _shifted(spots: Spots, expected: PadPose, reach_px: float, camera: Camera, pad: Pad) -> PadPose:
    """Return an expected pose shifted so that its lamps lie near the most spots.

    Each shift within reach that puts a lamp on a spot is tried.
    """
    uv, within_px = camera.project(expected.points(points_of(pad.lamps))), _first_reach_px(expected, camera, pad)
    lit = spots.uv_px[:SPOTS]
    shifts = (lit[None] - uv[:, None]).reshape(-1, 2)
    shifts = shifts[(shifts**2).sum(axis=1) <= reach_px**2]
    if not len(shifts):
        return expected
    away2 = ((uv[None, :, None] + shifts[:, None, None] - lit[None, None]) ** 2).sum(axis=-1).min(axis=-1)
    du, dv = shifts[np.argmax((1.0 - np.minimum(away2, within_px**2) / within_px**2).sum(axis=1))]
    z = expected.t_cam_pad[2]
    return PadPose(expected.R_cam_pad, expected.t_cam_pad + np.array([du * z / camera.fx, dv * z / camera.fy, 0.0]))


class _Explained(NamedTuple):
    """A pose of the pad, the spots that its lamps are, and how likely these are its lamps."""

    fit: LampFit
    lamps: Assignment
    log10_odds: float


def _differs(a: PadPose, b: PadPose) -> bool:
    """Return whether two poses are two answers: apart by a tenth of the range, or turned."""
    apart_m = float(np.linalg.norm(a.t_cam_pad - b.t_cam_pad))
    return apart_m > 0.1 * b.range_m or a.R_cam_pad.angle_to(b.R_cam_pad) > _TURNED_RAD


def _at(
    spots: Spots, start: PadPose, camera: Camera, pad: Pad, orientation: Orientation, tests: float, least: int
) -> list[_Explained]:
    """Return the pose fitted from a start; none if too few spots are lamps."""
    pose, lamps_m = start, places_of(pad.lamps)
    explained: list[_Explained] = []
    if len(spots) < least:
        return []
    for reach in (_first_reach_px(start, camera, pad), _SEARCHED_PX, _FITTED_PX):
        of = assign(spots, pad.lamps, pose, camera, reach)
        if of.groups < least or of.groups < _LEAST_SHARE * of.expected:
            return []
        made = fit(spots, lamps_m, of, pose, camera, orientation, pad.size_sigma_m)
        if made is None:
            return []
        pose, explained = made.pose, [_Explained(made, of, _log10_odds(of, made, camera, tests))]
    return explained


def _log10_odds(of: Assignment, made: LampFit, camera: Camera, tests: float) -> float:
    """Return the logarithm of the odds that these spots are the pad's lamps and no other lights.

    Two spots tell a similarity; a third one lies within reach of a tilt that is not known.
    """
    n, tilt_px = max(of.expected, of.groups), _TILTED * made.extent_px**2 / camera.fx
    alarms = math.inf
    for within_px in _WITHIN_PX:
        within = int(np.count_nonzero(made.off_px <= within_px))
        third = math.log10((n - 2) * _chance(of, within_px + tilt_px)) if within > 2 else 0.0
        alarms = min(alarms, min(0.0, third) + _log10_tail(n - 3, within - 3, _chance(of, within_px)))
    alarms += math.log10(tests * len(_WITHIN_PX))
    alarms += _STRANGER_LOG10 * of.strangers + _MISSING_LOG10 * (n - of.groups)
    alarms += _ASTRAY_LOG10 * max(0.0, made.middle_sigmas - _ASTRAY_SIGMAS)
    return max(-12.0, _EVEN_LOG10 - alarms)


def _chance(of: Assignment, within_px: float) -> float:
    """Return the probability that one of the spots about the pad lies this near to a place by chance."""
    return min(0.9, (of.groups + of.strangers) * math.pi * within_px**2 / of.area_px2)


def _log10_tail(n: int, k: int, p: float) -> float:
    """Return the logarithm of the probability that of n independent events of probability p at least k happen."""
    if k <= 0:
        return 0.0
    tail = sum(math.comb(n, i) * p**i * (1.0 - p) ** (n - i) for i in range(k, n + 1))
    return math.log10(max(tail, 1e-300))
