"""The table of the service's parts, and the loop that lets those join which the settings want.

A part is a `companion.cycle.ports.Join`, imported when it is wanted. The table is in the order in which they join: recorder and
streamed picture are there before the vehicle, whose links use them, and the HTTP port before those who serve on it.
"""

from collections.abc import Callable

from msgspec import Struct

from companion.cycle.ports import Assembly, Join
from companion.settings.capabilities import CAPABILITIES
from companion.settings.model import Settings
from estimator.contracts.tables import imported


class ServicePart(Struct, frozen=True):
    """A part of the service."""

    join: str
    """Its function, as module:object."""
    wanted: Callable[[Settings], object] = lambda settings: True


PARTS = (
    ServicePart(
        "companion.parts.recorder.setup:join",
        lambda s: s.recorder.enabled or s.vehicle.orders_recordings or any(table.orders_recordings for table in s.part_tables()),
    ),
    ServicePart("companion.parts.video.part:join", lambda s: s.video_stream.to),
    ServicePart("companion.service.vehicle_parts:join"),
    ServicePart("companion.service.flight_keeper:join"),
    ServicePart("companion.parts.operator.local_socket:join"),
    ServicePart("companion.parts.metrics.endpoint:join", lambda s: s.http.endpoint != "off"),
    ServicePart("companion.parts.page.make:join", lambda s: s.http.endpoint != "off" and s.http.page),
    *(ServicePart(capability.join, capability.wanted_by) for capability in CAPABILITIES if capability.join),
    ServicePart("companion.service.watchdogs:join"),
)


def join_all(service: Assembly) -> None:
    """Let every part join that the settings want.

    Raises:
        BadInput: as `companion.cycle.ports.Join`.
    """
    for part in PARTS:
        if part.wanted(service.settings):
            join: Join = imported(part.join)
            join(service)
