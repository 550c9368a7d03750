"""Run the daemon beside an autopilot with frames from outside."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Literal

import msgspec

from companion.base.health import Health
from companion.base.observer import Observer
from companion.guidance.pilot import Pilot
from companion.service.daemon import Daemon, DaemonOptions, VehicleLink
from companion.service.exposure_part import ExposurePart
from companion.service.vehicle_parts import vehicle_parts
from companion.settings.model import CameraSettings, Settings
from drivers.camera.exposure_drive import ExposureDrive
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Frame, GeoFix, VesselReport


class FlightDaemon:
    """The daemon of one flight.

    Args:
        settings: the daemon's settings, as `beside_autopilot` returns them.
        once: whether it ends with the first outcome; else it waits for the next flight.
    """

    def __init__(
        self, settings: Settings, pilot: Pilot, clock: Clock, observers: Sequence[Observer] = (), *, once: bool = True
    ) -> None:
        health = Health(clock)
        self.pilot = pilot
        self._parts = vehicle_parts(settings, pilot, health, clock)
        self._opened: list[VehicleLink] = []
        options, observers = settings.camera.exposure, (*self._parts.observers, *observers)
        self.exposure = ExposureDrive(options.settle_frames) if options.driven else None
        """The exposure that the daemon drives; None where the camera does."""
        if self.exposure is not None:
            part = ExposurePart(options, pilot)
            part.attach(self.exposure)
            health.counters("exposure", part.counted)
            observers = (*observers, part)
        self.daemon = Daemon(
            self._open,
            pilot,
            clock,
            DaemonOptions(settings.service, settings.guidance.rate_hz, threads=settings.vision.threads, once=once),
            observers=observers,
            health=health,
            extras=self._parts.extras,
        )

    @asynccontextmanager
    async def _open(self) -> AsyncIterator[VehicleLink]:
        async with self._parts.open_link() as link:
            self._opened.append(link)
            try:
                yield link
            finally:
                self._opened.remove(link)

    @property
    def open(self) -> bool:
        """Whether its link to the vehicle is open."""
        return bool(self._opened)

    @property
    def autopilot(self) -> Autopilot | None:
        """The link to the autopilot while it is open."""
        link = self._opened[-1] if self._opened else None
        return link if isinstance(link, Autopilot) else None

    def offer(self, frame: Frame) -> None:
        """Give the daemon a frame that has arrived."""
        for link in self._opened:
            link.frames.offer(frame)

    def report(self, sample: VesselReport | GeoFix) -> None:
        """Give the daemon a report of the ship that has arrived."""
        for link in self._opened:
            link.samples.offer(sample)

    def concluded(self) -> int:
        """Return the number of frames that were processed."""
        return sum(self.daemon.health.frames.values())

    def looking(self) -> bool:
        """Return whether vision is at work on its thread."""
        return self.daemon.looking


def beside_autopilot(
    settings: Settings, links: str, start: Literal["automatic", "signal"] = "signal", response: str | None = None
) -> Settings:
    """Return the settings with an autopilot at `links` as the vehicle, external frames, and the given start of the landing.

    Args:
        settings: read for an autopilot (`load` with `by_autopilot`).
        response: the shipped response of this stack, where the settings leave it to the vehicle; None for an autopilot's.
    """
    vehicle = settings.vehicle
    if isinstance(vehicle, AutopilotOptions):
        vehicle = msgspec.structs.replace(vehicle, links=links, signing_key_file="")
    else:
        vehicle = AutopilotOptions(links=links)
    follow = settings.guidance.follow_deck
    if response is not None and follow.response_by_vehicle:
        follow = msgspec.structs.replace(follow, response=response)
    return msgspec.structs.replace(
        settings,
        vehicle=vehicle,
        camera=CameraSettings(settings.camera.file, gimbal=settings.camera.gimbal, exposure=settings.camera.exposure),
        guidance=msgspec.structs.replace(settings.guidance, start=start, follow_deck=follow),
    )
