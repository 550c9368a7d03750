"""Clocks for tests: none runs on while a busy machine runs something else."""

import asyncio
import time

from estimator.contracts.time import NS_PER_S, MonoNs, after, seconds_between

STEP_MAX_NS = 20_000_000
"""Most that passes between two looks at a `PatientClock`: parts under test look each 5 to 20 ms."""
POLL_MAX_S = 0.01


class SteppedClock:
    """Stands still unless a test moves it. Sleeps are the event loop's."""

    def __init__(self, at: MonoNs | None = None) -> None:
        self.t = MonoNs(time.monotonic_ns()) if at is None else at

    def now(self) -> MonoNs:
        return self.t

    def advance(self, seconds: float) -> None:
        """Move the clock ahead."""
        self.t = after(self.t, seconds)

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)


class SleepingClock(SteppedClock):
    """Time passes only by sleeping.

    Attributes:
        slept: the lengths of all sleeps, s.
    """

    def __init__(self) -> None:
        super().__init__(MonoNs(0))
        self.slept: list[float] = []

    async def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.advance(seconds)
        await asyncio.sleep(0)


class PatientClock:
    """This host's monotonic time, less what passed while the process did not run.

    Parts that follow it neither take a standstill for a silence nor skip what was due because others took the processor.
    """

    def __init__(self) -> None:
        self._read = self._now = time.monotonic_ns()

    def now(self) -> MonoNs:
        read = time.monotonic_ns()
        self._now += min(read - self._read, STEP_MAX_NS)
        self._read = read
        return MonoNs(self._now)

    def leap(self, seconds: float) -> None:
        """Put the clock ahead, where a silence is to be long."""
        self._now += round(seconds * NS_PER_S)

    async def sleep(self, seconds: float) -> None:
        """Sleep by this clock: a pause is as long as the parts under test see it."""
        until = after(self.now(), seconds)
        while (left_s := seconds_between(self.now(), until)) > 0.0:  # noqa: ASYNC110 - no event tells of time
            await asyncio.sleep(min(left_s, POLL_MAX_S))
