"""A clock for servers under test that stands still when the machine does."""

import asyncio
import time

from estimator.contracts.time import MonoNs, after, seconds_between

STEP_MAX_NS = 20_000_000
"""A server under test looks at its clock every 5 ms; it never sees more than this pass at once."""
POLL_MAX_S = 0.01


class PatientClock:
    """This host's monotonic time, less what passed while the process did not run.

    A simulated drone that follows it neither loses its client for silence nor skips physics because others took the processor.
    """

    def __init__(self) -> None:
        self._read = self._now = time.monotonic_ns()

    def now(self) -> MonoNs:
        read = time.monotonic_ns()
        self._now += min(read - self._read, STEP_MAX_NS)
        self._read = read
        return MonoNs(self._now)

    async def sleep(self, seconds: float) -> None:
        """Sleep by this clock: a pause between two flights is as long as the drone and its client see it."""
        until = after(self.now(), seconds)
        while True:
            left_s = seconds_between(self.now(), until)
            if left_s <= 0.0:
                return
            await asyncio.sleep(min(left_s, POLL_MAX_S))
