"""Rehearse tracking in drawn frames, before the first real one.

The first look builds the drawing's maps, the camera's rays and the tables of light: ten times as much work as any later look. For
a pad with lamps, one frame is drawn by day and one by night.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.estimates import RelativeState
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera.camera import Camera
from estimator.vision.detect.template import paints_at
from estimator.vision.detection import Detection
from estimator.vision.pad.information import alike_headings, confusable_turns
from estimator.vision.pad.lamps import places_of
from estimator.vision.pad.pad import Pad
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track

_RADII = 5.0  # Height of the drawn view in radii of the pad's disc: all of the pad fits into any camera's frame
_AT = Stamp(MonoNs(0), MonoNs(0), 0.001, "sim")
_DECK, _H, _ORANGE, _DISC, _BLACK = (110, 105, 100), (235, 235, 235), (30, 120, 230), (60, 130, 50), (20, 20, 20)
"""Colours of deck and paints, BGR; fiducials are dark on light."""


def rehearse(tracker: TrackerConfig) -> Detection:
    """Search a frame that is drawn for this camera and pad, then track the pad in it. No memory of it is kept.

    Returns:
        The second detection of the pad's paint.
    """
    for kept in (alike_headings, confusable_turns):  # the first frame in doubt would wait for them
        kept(tracker.pad)
    if tracker.pad.lamps:
        _seen_twice(tracker, drawn_lamps(tracker.camera, tracker.pad))
    return _seen_twice(tracker, drawn(tracker.camera, tracker.pad))


def _seen_twice(tracker: TrackerConfig, px: NDArray[np.uint8]) -> Detection:
    frame = Frame(_AT, 0, px)
    # The camera's axes are those of `ned` while it looks straight down with the top of its image to the west.
    attitude = Attitude(_AT, tracker.camera.T_body_cam.R.inv, 1e-4 * np.eye(3))
    searched, memory = track(tracker, TrackerMemory(), frame, attitude)
    seen = searched.selected
    if seen is None:
        return searched
    still, cov = np.zeros(3), 1e-4 * np.eye(7)
    estimate = RelativeState(_AT.measured_at, "ekf", seen.d_body_pad_level, still, seen.yaw_rad, cov, _AT.measured_at, True)
    return track(tracker, memory, frame, attitude, estimate)[0]


def drawn(camera: Camera, pad: Pad) -> NDArray[np.uint8]:
    """Return the pad, (height, width, 3) BGR, as the camera sees it straight below, without distortion."""
    height_m = _RADII * pad.disc_radius_m
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    xy_m = height_m * np.stack([(u.ravel() - camera.cx) / camera.fx, (v.ravel() - camera.cy) / camera.fy], axis=1)
    h_marking, ring, arrow, disc = paints_at(xy_m, pad)
    px = np.full((camera.width * camera.height, 3), _DECK, np.uint8)
    h_bgr, disc_bgr = (_BLACK, _H) if pad.markings.fiducials else (_H, _DISC)
    for mask, colour in ((disc, disc_bgr), (ring | arrow, _ORANGE), (h_marking, h_bgr)):
        px[mask] = colour
    return np.asarray(cv2.GaussianBlur(px.reshape(camera.height, camera.width, 3), (0, 0), 0.8), np.uint8)


def drawn_lamps(camera: Camera, pad: Pad) -> NDArray[np.uint8]:
    """Return the pad's lamps in the dark, (height, width, 3) BGR, as the camera sees them straight below, without distortion."""
    height_m = _RADII * pad.disc_radius_m
    px = np.zeros((camera.height, camera.width, 3), np.uint8)
    for x_m, y_m in places_of(pad.lamps).tolist():
        centre = round(camera.cx + camera.fx * x_m / height_m), round(camera.cy + camera.fy * y_m / height_m)
        cv2.circle(px, centre, 2, (255, 255, 255), -1)
    return np.asarray(cv2.GaussianBlur(px, (0, 0), 0.8), np.uint8)
