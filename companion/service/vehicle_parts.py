"""Make the vehicle that the settings describe: its link, with or without a camera beside it, its observers, and its parts.

The exposure of the camera is driven by the light on the pad: where the pad is in each frame, and how fast the picture moves. That
runs beside the flight as an observer, so that no fault of it touches the flight: the camera then keeps what it holds.
"""

from __future__ import annotations

import logging
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace

import numpy as np

from companion.base.observer import NullObserver, ProcessedFrame
from companion.cycle.ports import Assembly, MakeVehicle, OpenLink, VehicleLink, VehicleParts
from companion.guidance.pilot import Pilot
from companion.settings.capabilities import vehicle_kind
from companion.settings.load import camera_model
from drivers.camera.exposure import ExposureDrive
from drivers.camera.exposure_law import ExposureGovernor
from drivers.camera.open_camera import open_camera
from drivers.camera.options import CameraOptions, ExposureOptions, Lens, Size, check_size
from drivers.camera.source import VideoSource
from drivers.mailbox import Latest, Line
from estimator.contracts.commands import Command
from estimator.contracts.errors import refused
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Frame, Imu, Sample
from estimator.contracts.tables import imported
from estimator.contracts.time import Clock, MonoNs, seconds_between
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation

log = logging.getLogger(__name__)

_TRACKED_S = 1.0
"""Age of the newest sighting up to which the pad's outline is predicted."""
_PEAK_S = 1.0
"""Time in which a peak of the turn rate is forgotten: a swing comes back sooner."""
_NEAREST_M = 0.15
_SAID_S = 3.0
"""Time for which the picture must be too dark or too bright at the camera's limits before that is logged."""


class ExposurePart(NullObserver):
    """Drives the exposure of one camera."""

    def __init__(self, options: ExposureOptions, pilot: Pilot) -> None:
        self._o, self._pilot = options, pilot
        self._drive: ExposureDrive | None = None
        self._governor: ExposureGovernor | None = None
        self._rate_rad_s, self._rate_at = 0.0, MonoNs(0)
        self._short_since: MonoNs | None = None
        self._said = False
        self._metered = {"pad": 0, "search": 0, "dark": 0, "bright": 0}

    def attach(self, drive: ExposureDrive | None) -> None:
        """Drive this camera from now on."""
        self._drive = drive
        self._governor = None if drive is None else ExposureGovernor(self._o, drive)

    def counted(self) -> dict[str, float]:
        """Return for health what is held, and the numbers of frames and changes."""
        out: dict[str, float] = {f"frames_{name}": n for name, n in self._metered.items()}
        drive = self._drive
        if drive is not None:
            out |= {"changes": drive.changes, "refused": drive.refused}
            if drive.held is not None:
                out |= {"exposure_ms": round(1e3 * drive.held.exposure_s, 3), "gain": round(drive.held.gain, 2)}
        return out

    def on_sample(self, sample: Sample) -> None:
        if type(sample) is not Imu:
            return
        rate, at = math.hypot(*sample.w_body.tolist()), sample.stamp.measured_at
        left = math.exp(-max(0.0, seconds_between(self._rate_at, at)) / _PEAK_S)
        self._rate_rad_s, self._rate_at = max(rate, left * self._rate_rad_s), at

    def on_frame(self, processed: ProcessedFrame) -> None:
        if self._governor is None:
            return
        frame, camera = processed.frame, processed.camera or self._pilot.camera
        if frame.px.shape[:2] != (camera.height, camera.width):
            return
        estimate = self._pilot.estimator.at(frame.stamp.measured_at)
        if estimate is not None and estimate.age_s(frame.stamp.measured_at) > _TRACKED_S:
            estimate = None
        outline = None if estimate is None else self._outline(processed, camera, estimate)
        self._metered["search" if outline is None else "pad"] += 1
        self._governor.on_frame(frame, outline, self._speed_px_s(camera, estimate))
        self._note(self._governor.short_of_ev, processed.done)

    def _outline(self, processed: ProcessedFrame, camera: Camera, believed: RelativeState) -> F64 | None:
        """Return the pad's outline in the frame, (N, 2) px; None if it is not before the camera."""
        seen = None if processed.detection is None else processed.detection.selected
        d = believed.d_body_pad_level if seen is None else seen.d_body_pad_level
        R_level_body = Orientation.of(processed.attitude).R_level_body
        p_body = (self._pilot.pad.circle(self._pilot.pad.disc_radius_m, 24) + d) @ R_level_body.matrix
        uv = camera.project((p_body - camera.T_body_cam.t) @ camera.T_body_cam.R.matrix)
        return uv if np.isfinite(uv).all() else None

    def _speed_px_s(self, camera: Camera, believed: RelativeState | None) -> float:
        """Return how fast the picture of the pad moves over the sensor at most."""
        rate = self._rate_rad_s
        if believed is not None:
            forward, right, down = believed.v_pad_level.tolist()
            height_m = max(believed.height_m, _NEAREST_M)
            edge = min(self._pilot.pad.disc_radius_m / height_m, 0.5 * camera.width / camera.fx)
            rate += math.hypot(forward, right) / height_m + edge * abs(down) / height_m
        return camera.fx * rate

    def _note(self, short_ev: float, now: MonoNs) -> None:
        """Count frames of a pad that the camera's limits leave too dark or too bright, and log when that lasts."""
        if short_ev == 0.0:
            if self._said:
                log.info("the pad is rightly exposed again")
            self._short_since, self._said = None, False
            return
        self._metered["dark" if short_ev > 0.0 else "bright"] += 1
        self._short_since = self._short_since or now
        if self._said or seconds_between(self._short_since, now) < _SAID_S or self._drive is None or self._drive.held is None:
            return
        self._said, held = True, self._drive.held
        log.warning(
            "the pad is %.1f stops too %s at %.1f ms and gain %.1f, which the motion and the camera limit",
            abs(short_ev), "dark" if short_ev > 0.0 else "bright", 1e3 * held.exposure_s, held.gain,
        )  # fmt: skip


class LinkWithCamera:
    """The vehicle's samples and commands, the camera's frames."""

    def __init__(self, vehicle: VehicleLink, camera: VideoSource) -> None:
        self.vehicle = vehicle
        self.camera = camera

    @property
    def frames(self) -> Latest[Frame]:
        return self.camera.frames

    @property
    def samples(self) -> Line[Sample]:
        return self.vehicle.samples

    def command(self, command: Command) -> None:
        self.vehicle.command(command)

    def release(self) -> None:
        self.vehicle.release()


def with_camera(
    open_vehicle: OpenLink,
    options: CameraOptions,
    size: Size,
    clock: Clock,
    attach: Callable[[ExposureDrive | None], None] = lambda drive: None,
    lens: Lens = None,
) -> OpenLink:
    """Return what opens both. A camera that goes away comes back by itself, and the vehicle is not involved.

    Args:
        size: the width and height of the camera's frames, px.
        attach: receives the exposure of each camera that was opened; None if it is not driven.
        lens: of the camera file.
    """

    @asynccontextmanager
    async def both() -> AsyncIterator[VehicleLink]:
        async with open_vehicle() as vehicle, open_camera(options, size, clock, lens) as camera:
            attach(camera.exposure)
            yield LinkWithCamera(vehicle, camera)

    return both


def vehicle_parts(service: Assembly) -> VehicleParts:
    """Return the vehicle of the settings, with its separate camera if there is one.

    Raises:
        BadInput: a signing key or the camera file cannot be read.
    """
    settings = service.settings
    make: MakeVehicle = imported(vehicle_kind(settings.vehicle.kind).parts)
    parts = make(service)
    if settings.camera.source == "vehicle":
        return parts
    camera = camera_model(settings)
    with refused(str(settings.camera.file), ValueError):
        size = check_size((camera.width, camera.height))
    if not settings.camera.exposure.driven:
        lens = (camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2])
        return replace(parts, open_link=with_camera(parts.open_link, settings.camera, size, service.clock, lens=lens))
    exposure = ExposurePart(settings.camera.exposure, service.pilot)
    service.health.counters("exposure", exposure.counted)
    open_link = with_camera(parts.open_link, settings.camera, size, service.clock, exposure.attach)
    return replace(parts, open_link=open_link, observers=(*parts.observers, exposure))


def join(service: Assembly) -> None:
    """Add the vehicle. Its observers come first: an autopilot waits for the pad, and nobody else does."""
    service.vehicle = parts = vehicle_parts(service)
    service.observers[:0] = parts.observers
