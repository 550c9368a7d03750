"""The ports of the service: a vehicle as its driver offers it, and a part that joins while the service is put together.

`companion.service.parts` has the table of the parts, `companion.settings.capabilities` those of the capabilities.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeAlias

from companion.base.containment import Body
from companion.base.health import Health
from companion.base.observer import Observer
from companion.guidance.pilot import Pilot
from companion.settings.model import Settings
from drivers.mailbox import Latest, Line
from estimator.contracts.commands import Command
from estimator.contracts.samples import Frame, Sample
from estimator.contracts.time import Clock

if TYPE_CHECKING:  # the dialect is large, and so is a server; not every service has them
    from companion.base.http_server import HttpServer
    from drivers.mavlink.autopilot import Autopilot
    from drivers.mavlink.links import Tap

_REPORTS_MAX = 64
"""Reports of the ship that may wait; the oldest is dropped."""


class VehicleLink(Protocol):
    """A vehicle with a camera, as a driver offers it while its context is open."""

    @property
    def frames(self) -> Latest[Frame]: ...

    @property
    def samples(self) -> Line[Sample]: ...

    def command(self, command: Command) -> None: ...

    def release(self) -> None:
        """Leave the vehicle to a person on closing, instead of holding it for a successor."""
        ...


OpenLink = Callable[[], AbstractAsyncContextManager[VehicleLink]]


class CountedPart(Protocol):
    """A part that runs beside the flight and counts for health."""

    async def run(self) -> None: ...
    def counted(self) -> Mapping[str, float]: ...


class StreamedPicture(Protocol):
    """A picture that is streamed to a ground station."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        ...

    @property
    def flows(self) -> bool:
        """True if pictures are sent."""
        ...


@dataclass(frozen=True, slots=True)
class VehicleParts:
    """The parts of a vehicle that the service needs."""

    open_link: OpenLink
    observers: tuple[Observer, ...] = ()
    autopilot: Callable[[], Autopilot | None] = lambda: None
    """Returns the autopilot whose links are open; None while they are not, or if the vehicle has none."""


@dataclass(slots=True)
class Assembly:
    """A service that is put together: what parts are made from, and what they add."""

    settings: Settings
    pilot: Pilot
    health: Health
    clock: Clock
    settings_file: Path | None = None
    """The file that the settings were read from; None if there is none."""
    observers: list[Observer] = field(default_factory=list)
    extras: dict[str, Body] = field(default_factory=dict)
    """Tasks that are supervised beside the flight, by name."""
    recording: Callable[[bool], str | None] | None = None
    """Switches the recorder and returns why it cannot; None if there is no recorder."""
    tap: Tap | None = None
    """Receives every message of a MAVLink link; None if nobody listens."""
    video: StreamedPicture | None = None
    """The picture that is streamed; None if none is."""
    vehicle: VehicleParts | None = None
    server: HttpServer | None = None
    """The HTTP port; None if there is none."""
    reports: Line[Sample] | None = None
    """The ship's reports from other sources than the vehicle's link; None where there are none."""

    def add(self, name: str, part: CountedPart) -> None:
        """Supervise a part beside the flight, and count it for health."""
        self.extras[name] = part.run
        self.health.counters(name, part.counted)

    def ship_reports(self) -> Line[Sample]:
        """Return where a source puts the ship's reports."""
        self.reports = self.reports or Line(_REPORTS_MAX)
        return self.reports


Join: TypeAlias = "Callable[[Assembly], None]"
"""Makes a part and adds it. Raises `BadInput`: a secret, certificate or file that it needs cannot be read or used."""
MakeVehicle: TypeAlias = "Callable[[Assembly], VehicleParts]"
"""Makes the vehicle of the settings. Raises `BadInput` as `Join`."""
