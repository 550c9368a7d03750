"""The daemon's clock in lock step: the physics advances it.

However slow the machine is, every part sees the same time as the autopilot.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools

from estimator.contracts.time import MonoNs, after

_START = MonoNs(1_000_000_000_000)
_ROUNDS = 4
"""Passes of the event loop after a step, enough for a message to go from socket to link to reader to part."""


class LockStepClock:
    """A `Clock` that stands still until it is advanced.

    Args:
        start: its first instant; it is not zero, so that it differs from the autopilot's time since boot.
    """

    def __init__(self, start: MonoNs = _START) -> None:
        self.started = self._now = start
        self._sleepers: list[tuple[int, int, asyncio.Future[None]]] = []
        self._order = itertools.count()

    def now(self) -> MonoNs:
        return self._now

    async def sleep(self, seconds: float) -> None:
        sleeper = asyncio.get_running_loop().create_future()
        heapq.heappush(self._sleepers, (after(self._now, max(seconds, 1e-6)), next(self._order), sleeper))
        await sleeper

    def advance(self, seconds: float) -> None:
        """Advance the time and wake the tasks whose time has come."""
        self._now = after(self._now, seconds)
        while self._sleepers and self._sleepers[0][0] <= self._now:
            sleeper = heapq.heappop(self._sleepers)[2]
            if not sleeper.done():
                sleeper.set_result(None)

    @staticmethod
    async def settle() -> None:
        """Let the woken tasks run."""
        for _ in range(_ROUNDS):
            await asyncio.sleep(0)
