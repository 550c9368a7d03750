"""State of the flight that the page shows: faults, the live picture. Values in, values out."""

import math
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.base.health import HealthSnapshot, missing_inputs
from companion.base.liveness import stuck
from companion.base.observer import Decision, ProcessedFrame
from companion.parts.page.messages import HealthCause, Level, PageHealth, PictureLine
from companion.recording.frame_encoder import VideoQuality
from companion.settings.links import HttpSettings
from companion.tools.report.overlay import pad_lines, runs_of
from estimator.contracts.estimates import RelativeState, Verdict
from estimator.contracts.geometry import F64, Rotation
from estimator.ekf import Forecast
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad

# The live picture: what the estimate says of a frame, as lines that the page draws itself, and the frame as JPEG. Pure.
#
# Lines instead of painted pixels stay sharp on any screen, can be switched off, and cost the drone's computer no drawing.

AHEAD_S = (1.0, 2.0)
"""Horizons at which the deck is drawn, s; the drone is assumed to keep its velocity."""
_CHI2_95 = 5.991
"""95 % quantile of the chi-square distribution with two degrees of freedom."""
_FAR_PX = 4000.0
_CIRCLE = np.linspace(0.0, math.tau, 36, endpoint=True)


def video_quality(settings: HttpSettings) -> VideoQuality:
    """Return the settings of the encoder of one browser's pictures: little work, and a key frame only where it begins."""
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
    for run in runs_of(uv_px, _FAR_PX, closed=closed):
        yield tuple(np.round(run, 1).ravel().tolist())


HORIZONS_S = tuple(0.25 * k for k in range(13))
"""Instants at which the deck's height is shown ahead, s."""
_FLOWS = (("Frame", "camera"), ("Attitude", "attitude"), ("VehicleStatus", "status"))
_STAGES = (("look", "vision"), ("exposure_to_command", "exposure to command"), ("guidance_late", "guidance late"))


def page_health(health: HealthSnapshot, decision: Decision | None, *, flying: bool) -> PageHealth:
    """Return what is wrong, the worst first, and the figures of the service."""
    rank: dict[Level, int] = {"fault": 0, "warning": 1, "info": 2}
    causes = sorted(_causes(health, decision, flying=flying), key=lambda cause: rank[cause.level])
    return PageHealth(causes=tuple(causes), figures=tuple(_figures(health)))


def _causes(health: HealthSnapshot, decision: Decision | None, *, flying: bool) -> Iterator[HealthCause]:
    why = stuck(health, flying)
    if why is not None:
        yield HealthCause(level="fault", text=why)
    for name, part in health.parts.items():
        if not part.up:
            level: Level = "fault" if name in health.vital else "warning"
            yield HealthCause(level=level, text=f"{name} is down: {part.last_error or 'not begun'}")
    if health.too_slow is not None:
        yield HealthCause(level="fault", text=health.too_slow)
    for text in missing_inputs(health):
        yield HealthCause(level="fault" if flying else "warning", text=text)
    belief = None if decision is None else decision.belief
    for alert in () if belief is None else belief.alerts:
        yield HealthCause(level="warning", text=alert.value)
    for lost in () if belief is None else belief.lost:
        yield HealthCause(level="warning", text=lost)
    if belief is not None and not belief.consistent and not belief.alerts:
        yield HealthCause(level="warning", text="the estimate of the pad contradicts itself")
    if decision is not None and decision.limit:
        yield HealthCause(level="warning", text=decision.limit)
    for name, count in health.counters.get("contained", {}).items():
        yield HealthCause(level="info", text=f"{name} failed {count:.0f} times; the flight goes on")


def _figures(health: HealthSnapshot) -> Iterator[tuple[str, str]]:
    for flow, name in _FLOWS:
        found = health.flows.get(flow)
        rate = None if found is None else found.rate_hz
        yield name, "none" if rate is None else f"{rate:.0f} Hz"
    for stage, name in _STAGES:
        times = health.stages.get(stage)
        if times is not None and times.p50_s is not None and times.p99_s is not None:
            yield name, f"{1000 * times.p50_s:.0f} ms, worst {1000 * times.p99_s:.0f}"
    frames = sum(health.frames.values())
    if frames:
        yield "frames used", f"{100 * health.frames.get(Verdict.FUSED.value, 0) / frames:.0f} % of {frames}"
