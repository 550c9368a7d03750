"""Make the vehicle that the settings describe: its link, its observers, and the tasks that run beside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from companion.base.health import Health
from companion.base.observer import Observer
from companion.base.orders import OrderSender, OrderSource
from companion.base.supervise import Body
from companion.guidance.pilot import Pilot
from companion.guidance.pilot_operator import PilotOperator
from companion.service.daemon import OpenLink
from companion.service.link_with_camera import with_camera
from companion.settings.load import camera_model
from companion.settings.model import Settings, ardrone_options
from drivers.ardrone.link import open_ardrone
from drivers.camera.options import check_size
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.errors import BadInput
from estimator.contracts.ports import Clock
from estimator.uvlc import UvlcDecoder

if TYPE_CHECKING:  # the dialect is large, and an AR.Drone without a bridge does not need it
    from companion.parts.mavlink.camera_component import ShowCamera
    from drivers.mavlink.autopilot import Autopilot
    from drivers.mavlink.links import Tap


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
    from companion.parts.mavlink.bridge_part import BridgePart
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
