"""Find a pad by its lamps, where its paint is not seen.

Lamps are found and measured where the filter expects them, else anywhere in the frame; the native core does all of it in one call
(`estimator/core/vision/lamps/lamps.c`).
"""

from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.estimates import CENTRE, Feature, RelativeState, Sighting
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Attitude, Frame
from estimator.core.abi import DL_LAMP_PAIRS_MAX
from estimator.core.library import CORE
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.native import checked, image_of, native_prior, tracker_of
from estimator.vision.pad.lamps import Lamp, places_of
from estimator.vision.pad.pad import Pad
from estimator.vision.register.sighting import sighting_in_level
from estimator.vision.track.config import TrackerConfig as TrackerConfig
from estimator.vision.track.expected import EXPECTED_SIGMAS, expected, sigma_of
from estimator.vision.track.memory import TrackerMemory as TrackerMemory

_FOUND = 1  # Count of pads that the core returns where it finds the lamps
REACH_PX = 40.0
"""Largest reach about the expected position in which lamps are assigned to spots; beyond it the frame is searched for them."""


def detect_lamps(
    frame: Frame, camera: Camera, pad: Pad, orientation: Orientation, expected: PadPose | None = None, reach_px: float = 0.0
) -> Sighting | None:
    """Return the sighting of a pad by its lamps, of method "lamps"; None if its lamps are not seen.

    Args:
        orientation: the attitude at the exposure.
        expected: where the pad is expected; if it is not seen there, or with None, the whole frame is searched.
        reach_px: how far the pad may be from there in the frame.

    Raises:
        ValueError: the frame is not of the camera's size.
    """
    px = np.ascontiguousarray(frame.px, np.uint8)
    if px.shape != (camera.height, camera.width, 3):
        raise ValueError(f"want a frame of shape {(camera.height, camera.width, 3)}, got {px.shape}")
    out, at = CORE.record("dl_found_lamps"), CORE.ffi.NULL
    if expected is not None:
        pose = (expected.R_cam_pad.matrix.ravel().tolist(), expected.t_cam_pad.tolist())
        at = CORE.ffi.new("dl_expected_lamps *", (pose, reach_px))
    prior = CORE.ffi.new("dl_tilt_prior *", native_prior(orientation))
    found = CORE.lib.dl_find_lamps(
        tracker_of(camera),
        image_of(px),
        CORE.array("dl_lamp_pattern", pattern_of(pad)),
        prior,
        at,
        CORE.array("dl_found_lamps", out),
    )
    return _sighting(frame, out, camera) if checked(found) == _FOUND else None


def _sighting(frame: Frame, seen: NDArray[Any], camera: Camera) -> Sighting:
    lit, centre = seen["uv_px"][: 2 * int(seen["lit"])].reshape(-1, 2), camera.project(seen["pose"]["t"][None])
    features = Feature("point", "lamp", lit), Feature("point", CENTRE, centre)
    return sighting_in_level(frame, seen["seen"], False, float(seen["confidence"]), features, "lamps")


@lru_cache(maxsize=8)
def pattern_of(pad: Pad) -> NDArray[Any]:
    """Return the core's `dl_lamp_pattern`."""
    places, pairs = places_of(pad.lamps), tried_pairs(pad.lamps)
    return CORE.record(
        "dl_lamp_pattern", lamps=len(pad.lamps), pairs=len(pairs), pair=pairs, x_m=places[:, 0], y_m=places[:, 1],
        radius_m=[lamp.radius_m for lamp in pad.lamps], size_sigma_m=pad.size_sigma_m,
    )  # fmt: skip


def tried_pairs(lamps: Sequence[Lamp]) -> NDArray[np.int64]:
    """Return the pairs of lamps that a search tries, (P, 2): near the pad only the inner lamps are in view.

    They are those that are the farthest apart among all lamps, and as many among the inner half.
    """
    places = places_of(lamps)
    order = np.argsort(np.linalg.norm(places - np.median(places, axis=0), axis=1))
    inner = order[: max(3, len(places) // 2)]
    return np.array([*_farthest(places, range(len(places))), *_farthest(places, inner.tolist())])


def _farthest(places: F64, among: Sequence[int]) -> list[tuple[int, int]]:
    pairs = sorted(combinations(among, 2), key=lambda pair: -float(np.linalg.norm(places[pair[0]] - places[pair[1]])))
    return pairs[: DL_LAMP_PAIRS_MAX // 2]


def by_lamps(
    tracker: TrackerConfig, memory: TrackerMemory, frame: Frame, attitude: Attitude | None, belief: RelativeState | None
) -> Sighting | None:
    """Return the sighting of a pad by its lamps; None if they are not seen."""
    orientation, start, reach_px = Orientation.of(attitude, tracker.options.deck_tilt_sigma_rad), None, 0.0
    if belief is not None and attitude is not None:
        start = expected(belief, attitude, tracker.camera, memory.alike_yaw_rad)
        if start is not None and start.t_cam_pad[2] > 0.05:
            reach_px = EXPECTED_SIGMAS * sigma_of(belief) * tracker.camera.fx / float(start.t_cam_pad[2])
    near = start is not None and 0.0 < reach_px < REACH_PX
    return detect_lamps(frame, tracker.camera, tracker.pad, orientation, start if near else None, reach_px)
