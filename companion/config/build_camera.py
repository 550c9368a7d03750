"""A camera beside the vehicle: from settings to its driver's options, and one link of both."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager

from companion.config.model import Settings
from companion.config.settings import camera_model
from companion.runtime.daemon import OpenLink, VehicleLink
from drivers.camera.source import VideoSource
from drivers.camera.video_source import open_camera
from drivers.camera.video_source_options import CameraOptions, SourceTimeouts, StreamOptions, V4l2Options
from drivers.mailbox import Latest, Line
from estimator.contracts.commands import Command
from estimator.contracts.errors import BadInput
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Frame, Sample


def camera_options(settings: Settings) -> CameraOptions | None:
    """How the camera beside the vehicle is opened; None when frames come from the vehicle. Its size is the camera file's.

    Raises:
        BadInput: keys that do not go together, controls that cannot be read, or a camera file with a fault.
    """
    c = settings.camera
    if fault := c.fault():
        raise BadInput(f"camera.{fault}")
    if c.source == "vehicle":
        return None
    model = camera_model(settings)
    if c.source == "stream":
        return StreamOptions(
            c.device,
            size=(model.width, model.height),
            latency_s=c.latency_s,
            sigma_s=c.latency_sigma_s,
            exposure_s=c.exposure_s,
            timeouts=SourceTimeouts(c.silence_s, c.reconnect_first_s, c.reconnect_most_s),
        )
    return V4l2Options(
        c.device,
        model.width,
        model.height,
        rate_hz=c.rate_hz,
        format=c.format,
        controls=controls(c.controls),
        latency_s=c.latency_s,
        latency_sigma_s=c.latency_sigma_s,
        exposure_s=c.exposure_s,
        timeouts=SourceTimeouts(c.silence_s, c.reconnect_first_s, c.reconnect_most_s),
    )


def controls(text: str) -> dict[str, int | bool | str]:
    """`name=value, name=value` as a mapping: whole numbers, true or false, or an entry of the control's menu by its label.

    Raises:
        BadInput: a part that is not of that form.
    """
    out: dict[str, int | bool | str] = {}
    for part in text.split(",") if text.strip() else ():
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not (name and equals and value) or name in out:
            raise BadInput(f"camera.controls: {part.strip()!r} is not name=value, or its name is there twice")
        try:
            out[name] = {"true": True, "false": False}[value] if value in ("true", "false") else int(value)
        except ValueError:
            out[name] = value
    return out


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


def with_camera(open_vehicle: OpenLink, options: CameraOptions, clock: Clock) -> OpenLink:
    """Opens both. A camera that goes away comes back by itself, and the vehicle hears nothing of it."""

    @asynccontextmanager
    async def both() -> AsyncIterator[VehicleLink]:
        async with open_vehicle() as vehicle, open_camera(options, clock) as camera:
            yield LinkWithCamera(vehicle, camera)

    def open_link() -> AbstractAsyncContextManager[VehicleLink]:
        return both()

    return open_link
