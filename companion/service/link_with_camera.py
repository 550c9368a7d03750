"""A camera beside the vehicle: one link of the vehicle's samples and commands and the camera's frames."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager

from companion.service.daemon import OpenLink, VehicleLink
from drivers.camera.exposure_drive import ExposureDrive
from drivers.camera.options import CameraOptions, Size
from drivers.camera.source import VideoSource
from drivers.camera.video_source import open_camera
from drivers.mailbox import Latest, Line
from estimator.contracts.commands import Command
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Frame, Sample


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
) -> OpenLink:
    """Return what opens both. A camera that goes away comes back by itself, and the vehicle is not told of it.

    Args:
        size: the width and height of the camera's frames, px.
        attach: receives the exposure of each camera that was opened; None if it is not driven.
    """

    @asynccontextmanager
    async def both() -> AsyncIterator[VehicleLink]:
        async with open_vehicle() as vehicle, open_camera(options, size, clock) as camera:
            attach(camera.exposure)
            yield LinkWithCamera(vehicle, camera)

    def open_link() -> AbstractAsyncContextManager[VehicleLink]:
        return both()

    return open_link
