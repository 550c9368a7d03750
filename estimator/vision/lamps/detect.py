"""Find and measure a pad by its lamps in one frame; the core does it in one call (`estimator/core/vision/lamps/lamps.c`)."""

from __future__ import annotations

import numpy as np

from estimator.contracts.estimates import Feature, Sighting
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Frame
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, start_of
from estimator.vision.camera import Camera
from estimator.vision.lamps.packed import light_address, packed_pattern
from estimator.vision.native import address, packed_camera
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.packed import packed_prior
from estimator.vision.register.sighting import sighting_in_level

_FIND, _ROOM = CORE.function("find_lamps"), CORE.function("lamps_room")
_SEEN = 1
_AT, _WORDS = places_of("lamps_seen"), size_of("lamps_seen")
_LIT, _CONFIDENCE, _LEVEL, _UV = _AT["lit"].start, _AT["confidence"].start, _AT["seen"], _AT["uv_px"]


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
    lens = address(packed_camera(camera))
    prior, scratch, out = packed_prior(orientation), np.empty(_ROOM(lens), np.uint32), np.empty(_WORDS)
    at = None if expected is None else np.concatenate([expected.R_cam_pad.matrix.ravel(), expected.t_cam_pad, [reach_px]])
    found = _FIND(
        lens, int(px.ctypes.data), light_address(), packed_pattern(pad, camera)[1], start_of(prior),
        None if at is None else start_of(at), int(scratch.ctypes.data), start_of(out),
    )  # fmt: skip
    return _sighting(frame, out) if found == _SEEN else None


def _sighting(frame: Frame, seen: F64) -> Sighting:
    lit = int(seen[_LIT : _LIT + 1].view(np.int64)[0])
    features = (Feature("point", "lamp", seen[_UV][: 2 * lit].reshape(-1, 2)),)
    return sighting_in_level(frame, seen[_LEVEL], False, seen.item(_CONFIDENCE), features, "lamps")
