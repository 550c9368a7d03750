"""What one package asks of another without knowing which one answers."""

from __future__ import annotations

from typing import Protocol

from estimator.contracts.commands import Command
from estimator.contracts.time import MonoNs


class Clock(Protocol):
    """The only source of time in the service; replay and simulation pass another one."""

    def now(self) -> MonoNs: ...

    async def sleep(self, seconds: float) -> None: ...


class Vehicle(Protocol):
    """Where commands go. The newest command holds until the next; silence ends in the vehicle's own hold."""

    def command(self, command: Command) -> None:
        """Take the newest command; never blocks.

        Raises:
            Recoverable: the link is down.
        """
        ...
