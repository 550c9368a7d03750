"""Clocks as ports: this host's monotonic one, and one that is set."""

import asyncio
import time

from estimator.contracts.time import Clock, MonoNs


class SystemClock:
    """CLOCK_MONOTONIC and the event loop's own sleep."""

    def now(self) -> MonoNs:
        return MonoNs(time.monotonic_ns())

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)


def wall_offset_ns(clock: Clock) -> int:
    """Return the current offset from the clock's instants to Unix time, ns, in whole microseconds."""
    return (time.time_ns() - clock.now()) // 1000 * 1000


class SetClock:
    """A clock that stands until it is set: in virtual time, and in a recording's."""

    def __init__(self, t: MonoNs) -> None:
        self.t = t

    def now(self) -> MonoNs:
        return self.t

    async def sleep(self, seconds: float) -> None:
        raise RuntimeError("nothing sleeps where the clock is set")
