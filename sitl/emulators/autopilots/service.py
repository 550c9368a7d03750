"""The daemon of a flight as a process that can be killed and started again."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from estimator.contracts.samples import Frame, GeoFix, VesselReport
from sitl.emulators.autopilots.beside import FlightDaemon


class KillableService:
    """One daemon after the other; a new one knows nothing of those before it.

    What a killed daemon still sends while its tasks end must be kept from the vehicle: a killed process sends nothing.

    Args:
        make: makes a daemon with a pilot of its own, that ends with the first outcome or, if False, waits for the next flight.
    """

    def __init__(self, make: Callable[[bool], FlightDaemon]) -> None:
        self._make = make
        self.now = make(True)
        """The newest daemon, be it killed."""
        self.gone = False
        """Whether it was killed and no new one runs."""
        self._task: asyncio.Task[object] | None = None
        self._offered = self._before = self._unheard = 0

    def ended(self, ordered: bool) -> bool:
        """Return whether the newest daemon ended its flight by itself.

        A new daemon may find a vehicle that stands on the deck, which is the end of a flight but not of the one it is to fly.

        Args:
            ordered: whether it was ordered to land.
        """
        if self.gone or self._task is None:
            return False
        return self._task.done() or (ordered and self.now.pilot.outcome is not None)

    def start(self, group: asyncio.TaskGroup) -> None:
        """Run the daemon in a group of tasks."""
        self._task = group.create_task(self.now.daemon.run())

    def kill(self) -> None:
        """Let the daemon be gone from now on."""
        self.gone = True
        if self._task is not None:
            self._task.cancel()

    async def restart(self, group: asyncio.TaskGroup) -> None:
        """Run a new daemon in the place of a killed one."""
        if self._task is not None:
            await asyncio.wait({self._task})
        self.now, self.gone = self._make(False), False
        self._before, self._unheard = self._offered, 0
        self.start(group)

    async def stop(self) -> None:
        """End the daemon and wait until it has ended."""
        self.now.daemon.stop()
        if self._task is not None:
            await asyncio.wait({self._task})

    def offer(self, frame: Frame) -> None:
        """Give the daemon a frame that has arrived, if there is one that can take it."""
        self._offered += 1
        if self.gone or not self.now.open:
            self._unheard += 1
        else:
            self.now.offer(frame)

    def report(self, sample: VesselReport | GeoFix) -> None:
        """Give the daemon a report of the ship that has arrived, if there is one that can take it."""
        if not self.gone:
            self.now.report(sample)

    def concluded(self) -> int:
        """Return the number of offered frames that are done with."""
        return self._offered if self.gone else self._before + self._unheard + self.now.concluded()

    def looking(self) -> bool:
        """Return whether vision is at work on its thread."""
        return not self.gone and self.now.looking()
