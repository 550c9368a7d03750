"""Make the vehicle that the settings describe: its link, with or without a camera beside it, its observers, and its parts."""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from companion.base.health import Health
from companion.base.observer import NullObserver, Observer
from companion.base.orders import OrderSender, OrderSource
from companion.base.supervise import Body
from companion.guidance.pilot import Pilot
from companion.guidance.pilot_operator import PilotOperator
from companion.service.daemon import OpenLink, VehicleLink
from companion.settings.load import camera_model
from companion.settings.model import Settings, ardrone_options
from companion.settings.vessel import VesselOptions
from drivers.ardrone.link import open_ardrone
from drivers.camera.exposure import ExposureDrive
from drivers.camera.open_camera import open_camera
from drivers.camera.options import CameraOptions, Size, check_size
from drivers.camera.source import VideoSource
from drivers.mailbox import Latest, Line
from drivers.mavlink.options import AutopilotOptions
from drivers.nmea.sentences import REFUSED_FOR, NmeaReader, SentenceSource, sentences_from
from estimator.contracts.commands import Command
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Frame, Sample
from estimator.contracts.time import Clock, MonoNs
from estimator.uvlc import UvlcDecoder

if TYPE_CHECKING:
    from companion.parts.mavlink.camera_component import ShowCamera
    from drivers.mavlink.autopilot import Autopilot
    from drivers.mavlink.links import Tap


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
    """Return what opens both. A camera that goes away comes back by itself, and the vehicle is not involved.

    Args:
        size: the width and height of the camera's frames, px.
        attach: receives the exposure of each camera that was opened; None if it is not driven.
    """

    @asynccontextmanager
    async def both() -> AsyncIterator[VehicleLink]:
        async with open_vehicle() as vehicle, open_camera(options, size, clock) as camera:
            attach(camera.exposure)
            yield LinkWithCamera(vehicle, camera)

    return both


log = logging.getLogger(__name__)


class SentencesPart(NullObserver):
    """The supervised task.

    Args:
        reports: where samples are put.
    """

    def __init__(self, options: VesselOptions, reports: Line[Sample], clock: Clock) -> None:
        self._options = options
        self._reports = reports
        self._clock = clock
        self._reader = NmeaReader(options.mmsi, options.nmea_simulated)
        self._source = SentenceSource(options.nmea_from, self._take)
        self._told: set[str] = set()

    def counted(self) -> Mapping[str, float]:
        """Return the counters for health: sentences taken by kind, and refused ones by reason."""
        refused = self._reader.refused + self._source.refused
        out = {f"taken_{kind}": float(n) for kind, n in self._reader.taken.items()}
        return out | {f"refused_{why}": float(n) for why, n in refused.items()}

    async def run(self) -> None:
        """Listen until cancelled.

        Raises:
            Recoverable: they cannot be listened to, or no longer.
        """
        endpoint = self._options.endpoint()
        async with sentences_from(endpoint, self._source, self._clock) as wire:
            log.info("listening for the ship's sentences on %s", self._options.nmea)
            await wire.broken()

    def _take(self, lines: bytes, received_at: MonoNs) -> None:
        for sample in self._reader.samples(lines, received_at):
            self._reports.offer(sample)
        refused = self._reader.refused + self._source.refused
        for why in refused.keys() - self._told - {"other_sentence", "wrong_sender"}:
            self._told.add(why)
            reason = REFUSED_FOR.get(why, why.replace("_", " "))
            log.warning("a sentence of the ship was refused (%s); the next ones are counted only", reason)


@dataclass(frozen=True, slots=True)
class VehicleParts:
    """The parts of the vehicle that the daemon needs."""

    open_link: OpenLink
    observers: tuple[Observer, ...] = ()
    extras: dict[str, Body] = field(default_factory=dict)
    """Tasks to be supervised, by name."""
    autopilot: Callable[[], Autopilot | None] = lambda: None
    """Returns the autopilot whose links are open; None while they are not, or if the vehicle has none."""


def vehicle_parts(
    settings: Settings,
    pilot: Pilot,
    health: Health,
    clock: Clock,
    recording: Callable[[bool], str | None] | None = None,
    tap: Tap | None = None,
    show: ShowCamera | None = None,
) -> VehicleParts:
    """Return the vehicle of the settings, with its separate camera if there is one.

    Args:
        recording: switches the recorder; None if there is none.
        tap: called with every MAVLink message, or None.
        show: makes the camera's MAVLink component; None if no picture is streamed.

    Raises:
        BadInput: a signing key or the camera file cannot be read.
    """
    vehicle = settings.vehicle
    if isinstance(vehicle, AutopilotOptions):
        from companion.parts.mavlink.make import AutopilotPart

        autopilot = AutopilotPart(settings, vehicle, pilot, health, clock, recording, tap, show)
        parts = VehicleParts(autopilot.open, (autopilot.component,), autopilot=lambda: autopilot.autopilot)
    else:
        parts = _ardrone(settings, pilot, health, clock, tap, show)
    if settings.camera.source == "vehicle":
        return parts
    camera = camera_model(settings)
    try:
        size = check_size((camera.width, camera.height))
    except ValueError as why:
        raise BadInput(f"{settings.camera.file}: {why}") from why
    if not settings.camera.exposure.driven:
        return replace(parts, open_link=with_camera(parts.open_link, settings.camera, size, clock))
    from companion.service.exposure_part import ExposurePart

    exposure = ExposurePart(settings.camera.exposure, pilot)
    health.counters("exposure", exposure.counted)
    open_link = with_camera(parts.open_link, settings.camera, size, clock, exposure.attach)
    return replace(parts, open_link=open_link, observers=(*parts.observers, exposure))


def _ardrone(
    settings: Settings, pilot: Pilot, health: Health, clock: Clock, tap: Tap | None, show: ShowCamera | None
) -> VehicleParts:
    if settings.camera.gimbal.given:
        found = settings.camera.gimbal.device_id
        raise BadInput(f"camera.gimbal.device_id must be 0, found {found}: only an autopilot's link tells of a gimbal")
    options, queue_items, decoder = ardrone_options(settings), settings.service.sample_queue_items, UvlcDecoder()
    if not settings.bridge.links:
        return VehicleParts(lambda: open_ardrone(options, clock, queue_items, decoder))
    from companion.parts.mavlink.bridge import BridgePart
    from companion.parts.mavlink.signed_links import signed_links

    bridge = BridgePart(
        settings.bridge,
        signed_links(settings.bridge),
        clock,
        order=PilotOperator(pilot, OrderSender(OrderSource.MAVLINK), clock).order,
        tap=tap,
        show=show,
    )
    health.counters("bridge", bridge.counted)

    return VehicleParts(lambda: open_ardrone(options, clock, queue_items, decoder), (bridge,), {"bridge": bridge.run})
