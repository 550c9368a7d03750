"""The interfaces through which packages use one another."""

from typing import Protocol

from estimator.contracts.time import MonoNs


class Clock(Protocol):
    """The only source of time in the service; replay and simulation pass another one."""

    def now(self) -> MonoNs: ...

    async def sleep(self, seconds: float) -> None: ...
