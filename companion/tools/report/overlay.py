"""Draw over a frame: features and the estimated pad, and where the filter expected it by the errors that it knows."""

import math
from itertools import pairwise

import cv2
import numpy as np
from msgspec import Struct, structs
from numpy.typing import NDArray

from companion.base.observer import ProcessedFrame
from companion.recording.palette import OUTLINE, bgr, colour
from estimator.contracts.estimates import Feature, PathName, RelativeState, Sighting
from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.pad import Pad

U8 = NDArray[np.uint8]

_SHIFT = 4
_FAR_PX = 20_000.0
_DOTS_FROM = 32
"""Number of points of one feature from which each is drawn as a dot: crosses would hide what lies below them."""


class Overlay(Struct, frozen=True, eq=False):
    """The items to draw over one frame."""

    sightings: tuple[Sighting, ...] = ()
    """The sightings of this frame."""
    estimate: RelativeState | None = None
    """The belief nearest to the exposure."""
    R_level_body: Rotation | None = None
    """The roll and pitch at the exposure; the body is taken as level if they are not known."""
    d_expected_level: F64 | None = None
    """Vector at which the estimate expected the pad's centre in this frame, (3,) m; None to draw it at the estimate."""


def annotated_size(width: int, height: int, scale: float = 1.0) -> tuple[int, int]:
    """Return the (width, height) of the image that `annotate` returns: even numbers, as H.264 requires."""
    w, h = round(width * scale), round(height * scale)
    return w + w % 2, h + h % 2


def annotate(image: U8, overlay: Overlay, camera: Camera, pad: Pad, scale: float = 1.0) -> U8:
    """Return a scaled copy of the frame with everything drawn over it.

    Args:
        frame: (H, W, 3) BGR of any size; drawings follow `camera`'s pixels.

    Returns:
        BGR of `annotated_size(camera.width, camera.height, scale)`.
    """
    out_w, out_h = annotated_size(camera.width, camera.height, scale)
    how = cv2.INTER_LINEAR if scale >= 1.0 else cv2.INTER_AREA
    canvas = np.asarray(cv2.resize(image, (out_w, out_h), interpolation=how), np.uint8)
    pen = _Pen(canvas, scale)
    if overlay.estimate is not None:
        drawn = overlay.estimate
        if overlay.d_expected_level is not None:
            drawn = structs.replace(drawn, d_body_pad_level=overlay.d_expected_level)
        for line in pad_lines(drawn, overlay.R_level_body or Rotation.identity(), camera, pad):
            pen.polyline(line, bgr(OUTLINE), closed=True)
    for sighting in overlay.sightings:
        if sighting.method == "selected" and len(overlay.sightings) > 1:
            continue
        for feature in sighting.features:
            pen.feature(feature, bgr(colour(sighting.method)))
    return canvas


class _Pen:
    """Draws in the camera's pixels onto a scaled frame, each stroke with a dark rim so that it shows on any ground."""

    def __init__(self, view: U8, scale: float) -> None:
        self._view = view
        self._scale = scale
        self._line = max(1, round(1.2 * scale))

    def _fixed(self, uv_px: F64) -> NDArray[np.int32]:
        # the centre of pixel 0 sits half a pixel in, before and after scaling
        uv = (np.asarray(uv_px, dtype=float) + 0.5) * self._scale - 0.5
        return np.asarray(np.round(uv * 2**_SHIFT), dtype=np.int32)

    def polyline(self, uv_px: F64, ink: tuple[int, int, int], closed: bool) -> None:
        """Draw a line through (n, 2) points; points that are nan or far off break it."""
        runs = [self._fixed(run) for run in runs_of(uv_px, _FAR_PX, closed=closed)]
        for width, shade in ((self._line + 1, (0, 0, 0)), (self._line, ink)):
            cv2.polylines(self._view, runs, False, shade, width, cv2.LINE_AA, _SHIFT)

    def feature(self, feature: Feature, ink: tuple[int, int, int]) -> None:
        uv = np.asarray(feature.uv_px, dtype=float).reshape(-1, 2)
        if feature.kind != "point":
            self.polyline(uv, ink, closed=feature.kind != "line")
            return
        arm_px = 4.0 if len(uv) < _DOTS_FROM else 0.5
        for at in uv:
            for arm in ((arm_px, 0.0), (0.0, arm_px)):
                self.polyline(np.array([at - arm, at + arm]), ink, closed=False)


def runs_of(uv_px: F64, far_px: float, *, closed: bool) -> list[F64]:
    """Return a line of (n, 2) points in runs of two points and more, without those that are nan or far off."""
    ring = np.concatenate([uv_px, uv_px[:1]]) if closed else uv_px
    with np.errstate(invalid="ignore"):
        good = np.all(np.abs(ring) < far_px, axis=1)
    edges = [0, *np.flatnonzero(np.diff(good)) + 1, len(ring)]
    return [ring[a:b] for a, b in pairwise(edges) if b - a > 1 and good[a]]


def pad_lines(estimate: RelativeState, R_level_body: Rotation, camera: Camera, pad: Pad) -> list[F64]:
    """Return lines of (n, 2) px: the circle around the pad, and if the heading is known the borders of all that is painted."""
    shapes = [pad.circle(pad.disc_radius_m)]
    if estimate.yaw_rad is not None:
        shapes += pad.borders()
    R_level_pad = Rotation.from_rpy(0.0, 0.0, -(estimate.yaw_rad or 0.0))
    R_body_level, T_cam_body = R_level_body.inv, camera.T_body_cam.inv
    return [camera.project(T_cam_body @ (R_body_level @ (R_level_pad @ p + estimate.d_body_pad_level))) for p in shapes]


def expected_in_body(processed: ProcessedFrame, path: PathName | None) -> F64 | None:
    """Return where the path's estimate expected the pad's centre in the frame, (3,) m in `body`, with the camera file's mount.

    It is what vision saw less the innovation. Drawn from the reported attitude and the nominal mount, an estimate lies beside the
    pad in the picture by the errors of both.

    Returns:
        None for a frame that was not compared with the path's estimate.
    """
    seen = None if processed.detection is None else processed.detection.selected
    if seen is None or processed.attitude is None:
        return None
    compared = next((one for one in processed.results if one.path == path and one.innovation is not None), None)
    if compared is None or compared.innovation is None:
        return None
    return less_innovation(processed.attitude.R_ned_body.without_heading(), seen.d_body_pad_level, compared.innovation)


def less_innovation(R_level_body: Rotation, d_seen_level: F64, innovation: F64) -> F64:
    """Return the expected place, (3,) m in `body`.

    Args:
        R_level_body: roll and pitch that levelled the sighting.
        d_seen_level: what vision saw, (3,) m in `level`.
        innovation: of that sighting, (4,): forward, right, down (m in `body`), heading.
    """
    in_body: F64 = R_level_body.inv @ d_seen_level - innovation[:3]
    return in_body


def camera_lean(processed: ProcessedFrame, belief: RelativeState | None) -> Rotation | None:
    """Return the rotation in `body` from the pad by the reported attitude to the pad where the filter expects it in the frame.

    The filter knows errors of the attitude and of the camera's mount, degrees in all, that neither the reported attitude nor the
    camera's file has. It is None for a frame that was not compared with the steering estimate.
    """
    expected = None if belief is None else expected_in_body(processed, belief.path)
    if belief is None or expected is None or processed.attitude is None:
        return None
    estimated: F64 = processed.attitude.R_ned_body.without_heading().inv @ belief.d_body_pad_level
    axis = np.cross(estimated, expected)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return Rotation.identity()
    return Rotation.from_rotvec(axis * (math.atan2(sine, float(estimated @ expected)) / sine))
