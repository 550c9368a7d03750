"""The live picture: what the estimate says of a frame, as lines that the page draws itself, and the frame as JPEG. Pure.

Lines instead of painted pixels stay sharp on any screen, can be switched off, and cost the drone's computer no drawing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.observer import ProcessedFrame
from companion.parts.page.messages import PictureLine
from companion.recording.frame_encoder import VideoQuality
from companion.settings.page import PageSettings
from companion.tools.report.overlay import pad_lines
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.ekf import Forecast
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad

AHEAD_S = (1.0, 2.0)
"""How far ahead the deck is drawn, s; the drone is taken to keep its velocity."""
_CHI2_95 = 5.991
"""95 % quantile of the chi-square distribution with two degrees of freedom."""
_FAR_PX = 4000.0
_CIRCLE = np.linspace(0.0, math.tau, 36, endpoint=True)


def video_quality(settings: PageSettings) -> VideoQuality:
    """Return what the encoder of one browser's pictures is asked for: little work, and a key frame only where it begins."""
    return VideoQuality(crf=26, key_each=300, preset="ultrafast", kbit_s=settings.bitrate_kbit_s)


def jpeg(image: NDArray[np.uint8], quality: int) -> bytes:
    """Return a picture as JPEG.

    Raises:
        ValueError: it cannot be encoded.
    """
    done, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise ValueError(f"a frame of {image.shape} cannot be encoded as JPEG")
    return encoded.tobytes()


def picture_lines(
    processed: ProcessedFrame, belief: RelativeState | None, ahead: Forecast | None, lean: Rotation, camera: Camera, pad: Pad
) -> tuple[PictureLine, ...]:
    """Return what is drawn over a picture.

    Args:
        belief: the estimate at the exposure.
        ahead: the deck after the exposure.
        lean: see `camera_lean`.
    """
    return tuple(_lines(processed, belief, ahead, lean, camera, pad))


def _lines(
    processed: ProcessedFrame, belief: RelativeState | None, ahead: Forecast | None, lean: Rotation, camera: Camera, pad: Pad
) -> Iterator[PictureLine]:
    found = processed.detection
    seen = None if found is None else found.selected or found.elsewhere
    for feature in () if seen is None else seen.features:
        if feature.kind != "point":
            for uv in _pieces(np.asarray(feature.uv_px, dtype=float).reshape(-1, 2), closed=feature.kind != "line"):
                yield PictureLine("seen", uv)
    if belief is None:
        return
    R_level_body = Rotation.identity() if processed.attitude is None else processed.attitude.R_ned_body.without_heading()
    R_level_body = R_level_body @ lean.inv
    for line in pad_lines(belief, R_level_body, camera, pad):
        for uv in _pieces(line, closed=True):
            yield PictureLine("pad", uv)
    to_cam, R_body_level = camera.T_body_cam.inv, R_level_body.inv
    on_deck = belief.d_body_pad_level + _ellipse(belief.cov[:2, :2])
    for uv in _pieces(camera.project(to_cam @ (R_body_level @ on_deck)), closed=False):
        yield PictureLine("sigma", uv)
    for d in () if ahead is None else ahead.d_body_pad_level:
        disc = pad.circle(pad.disc_radius_m, 36) + d
        for uv in _pieces(camera.project(to_cam @ (R_body_level @ disc)), closed=True):
            yield PictureLine("ahead", uv)


def _ellipse(cov: F64) -> F64:
    """Return (36, 3) m: the ellipse that holds 95 % of a (2, 2) covariance, around the origin."""
    variances, axes = np.linalg.eigh(cov)
    radii = np.sqrt(_CHI2_95 * np.maximum(variances, 0.0))
    xy = np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)], axis=1) * radii @ axes.T
    return np.concatenate([xy, np.zeros((len(xy), 1))], axis=1)


def _pieces(uv_px: F64, *, closed: bool) -> Iterator[tuple[float, ...]]:
    """Yield a line of (n, 2) points in pieces, without the points that are nan or far off."""
    ring = np.concatenate([uv_px, uv_px[:1]]) if closed and len(uv_px) else uv_px
    with np.errstate(invalid="ignore"):
        good = np.all(np.abs(ring) < _FAR_PX, axis=1)
    if good.all():
        runs: Sequence[F64] = [ring]
    else:
        edges = np.flatnonzero(np.diff(good)) + 1
        runs = [run for run, ok in zip(np.split(ring, edges), good[np.concatenate([[0], edges])], strict=True) if ok]
    for run in runs:
        if len(run) > 1:
            yield tuple(np.round(run, 1).ravel().tolist())
