"""This host's monotonic clock as a port."""

import asyncio
import time

from estimator.contracts.time import MonoNs


class SystemClock:
    """CLOCK_MONOTONIC and the event loop's own sleep."""

    def now(self) -> MonoNs:
        return MonoNs(time.monotonic_ns())

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
