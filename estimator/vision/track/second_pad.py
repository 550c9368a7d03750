"""Search a frame for a second pad beside the one that was seen.

A pad that is followed without an attitude may leave the picture. It is known again if any other pad would have shown beside it.
That search has no limit of work, and takes some times as long as an ordinary look: it is not made in each frame.
"""

import dataclasses
import math

import cv2
import numpy as np
from msgspec.structs import replace

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.camera.camera import Camera
from estimator.vision.detect.acquire import FRESH_SEARCH
from estimator.vision.track.config import TrackerConfig as TrackerConfig
from estimator.vision.track.expected import in_camera
from estimator.vision.track.memory import TrackerMemory as TrackerMemory
from estimator.vision.track.tracker import sight

_COVERED = 1.3  # Radius, in radii of the disc, of what is covered of a pad to look for another one
_DOUBTFUL = 0.05  # Confidence from which something may be another pad
_SEEN = 0.5  # Confidence from which it is one
_RIM = _COVERED * np.stack(
    [np.cos(_turn := np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)), np.sin(_turn), 0.0 * _turn], axis=1
)


def alone_in(tracker: TrackerConfig, memory: TrackerMemory, frame: Frame, attitude: Attitude, pad: Sighting) -> F64 | None:
    """Search a frame for a second pad; return which part of the deck shows none.

    Args:
        memory: of the look that saw the pad.
        pad: the one that was seen.

    Returns:
        Corners, (4, 2) m in `level`, within which all of a pad's disc is in the frame; empty if a second pad is there, and None
        if that is in doubt or if too little of the deck is in the frame.
    """
    camera, radius_m = tracker.camera, tracker.pad.disc_radius_m
    R_level_body = attitude.R_ned_body.without_heading()
    pose = in_camera(pad.d_body_pad_level, pad.yaw_rad or 0.0, R_level_body, camera)
    corners = _shown(camera, attitude, pad.d_body_pad_level.item(2), pose.px_of(radius_m, camera))
    if corners is None:
        return None
    rim = pose.points(radius_m * _RIM)
    if rim[:, 2].min() < 0.05:
        return None
    uv, px = np.round(camera.project(rim)).astype(np.int32), frame.px.copy()
    u, v = np.clip(uv, 0, (camera.width - 1, camera.height - 1)).T
    cv2.fillConvexPoly(px, uv, np.median(px[v, u], axis=0).tolist())  # with the deck's colour: else it would be a disc again
    whole = dataclasses.replace(tracker, search_work=math.inf)
    other = sight(whole, dataclasses.replace(memory, search=FRESH_SEARCH), replace(frame, px=px), attitude)[0].selected
    if other is None or other.confidence < _DOUBTFUL:
        return corners
    if math.dist(other.d_body_pad_level[:2], pad.d_body_pad_level[:2]) < tracker.integrity.pads_apart_m:
        return None  # what is left of the same one, where the edge of the frame cut it and its place is off
    return None if other.confidence < _SEEN else np.empty((0, 2))


def _shown(camera: Camera, attitude: Attitude, down_m: float, inset_px: float) -> F64 | None:
    """Return the corners on the deck of a frame that is smaller by an inset on each side; None if nothing is left of it."""
    u, v = (np.array([inset_px, size - 1.0 - inset_px]) for size in (camera.width, camera.height))
    if u[1] <= u[0] or v[1] <= v[0]:
        return None
    uv = np.array([(u[0], v[0]), (u[1], v[0]), (u[1], v[1]), (u[0], v[1])])
    R_level_body = attitude.R_ned_body.without_heading().matrix
    rays = np.column_stack([camera.rays(uv), np.ones(4)]) @ (R_level_body @ camera.T_body_cam.R.matrix).T
    origin = R_level_body @ camera.T_body_cam.t
    if rays[:, 2].min() < 0.1:
        return None
    return np.asarray(origin[:2] + rays[:, :2] * ((down_m - origin[2]) / rays[:, 2:]))
