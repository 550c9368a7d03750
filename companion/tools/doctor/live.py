"""Examine the setup from inside the running service: over the links that it has open, on the ground alone.

The links of a service cannot be opened twice, and requests to the autopilot share them with the flight. An examination
therefore needs a vehicle that stands, and a take-off ends it at once.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from msgspec import structs

from companion.base.health import Health, HealthSnapshot
from companion.base.worker import Worker
from companion.settings.model import Settings
from companion.tools.doctor.snapshot import LinkSnapshot, Snapshot
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.ports import Clock

if TYPE_CHECKING:  # the dialect is large, and a service without an autopilot does not need it before the first request
    from companion.tools.doctor.finding import Finding
    from drivers.mavlink.autopilot import Autopilot

LISTENING_S = 4.0
"""Time for which messages are counted."""
_LOOKS_S = 0.1
TOOK_OFF = "the vehicle took off, which ends the examination"


@dataclass(frozen=True, slots=True)
class Examination:
    """A snapshot of the setup and what was found in it."""

    snapshot: Snapshot
    findings: tuple[Finding, ...]
    """The most severe first."""
    known: int
    """The number of faults that were looked for."""


class TookOff(Exception):
    """The vehicle took off during an examination."""


class LiveExaminer:
    """See the module's docstring.

    Args:
        autopilot: returns the autopilot whose links are open; None while they are not.
        flying: whether the vehicle flies now.
    """

    def __init__(
        self,
        settings: Settings,
        health: Health,
        clock: Clock,
        autopilot: Callable[[], Autopilot | None],
        flying: Callable[[], bool],
    ) -> None:
        self._settings = settings
        self._health = health
        self._clock = clock
        self._autopilot = autopilot
        self._flying = flying

    async def examine(self) -> Examination:
        """Examine the setup, which takes some seconds.

        Raises:
            TookOff: the vehicle took off meanwhile.
        """
        worker = Worker("doctor")
        try:
            async with asyncio.TaskGroup() as group:
                examining = group.create_task(self._examined(worker))
                while not examining.done() and not self._flying():
                    await asyncio.wait([examining], timeout=_LOOKS_S)
                examining.cancel()
            if examining.cancelled():
                raise TookOff(TOOK_OFF)
            return examining.result()
        finally:
            worker.close()

    async def _examined(self, worker: Worker) -> Examination:
        snapshot = Snapshot(0.0)
        autopilot, vehicle = self._autopilot(), self._settings.vehicle
        if autopilot is not None and isinstance(vehicle, AutopilotOptions):
            from companion.tools.doctor.gather import examine_open

            snapshot = await examine_open(autopilot, vehicle.system_id, self._clock, LISTENING_S)
        elif isinstance(vehicle, AutopilotOptions):
            part = self._health.snapshot().parts.get("vehicle")
            why = "" if part is None else part.last_error
            snapshot = Snapshot(0.0, (LinkSnapshot(vehicle.links, down=why or "is not open yet"),))
        return await worker.run(_judged, snapshot, self._settings, self._health.snapshot())


def _judged(snapshot: Snapshot, settings: Settings, health: HealthSnapshot) -> Examination:
    from companion.tools.doctor.diagnose import RULES, diagnose
    from companion.tools.doctor.gather_service import running_service

    complete = structs.replace(snapshot, service=running_service(settings, health))
    return Examination(complete, diagnose(complete), len(RULES))
