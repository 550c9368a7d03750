"""The interfaces through which packages use one another."""

from typing import Protocol

from estimator.contracts.time import MonoNs

SAMPLE_QUEUE_ITEMS = 4096
"""Samples that wait for the reader of a link unless a setting names another number; the oldest is dropped and counted."""


class Clock(Protocol):
    """The only source of time in the service; replay and simulation pass another one."""

    def now(self) -> MonoNs: ...

    async def sleep(self, seconds: float) -> None: ...
