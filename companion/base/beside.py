"""A part that runs beside the flight: it is an observer, and it is made again for each start.

A failed part cannot be trusted: its thread may be gone and its files closed. Each restart therefore makes a new object, and
callers reach the present one through `now`.
"""

import asyncio
import logging
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from companion.base.containment import report
from companion.base.observer import Decision, ProcessedFrame
from companion.base.orders import HandledOrder
from estimator.contracts.errors import BadInput
from estimator.contracts.fusion import FusionResult
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs

log = logging.getLogger(__name__)


class Part(Protocol):
    """An observer that also has a task of its own."""

    def on_sample(self, sample: Sample) -> None: ...

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None: ...

    def on_frame(self, processed: ProcessedFrame) -> None: ...

    def on_decision(self, decision: Decision) -> None: ...

    def on_order(self, handled: HandledOrder) -> None: ...

    async def run(self) -> None: ...


Made = TypeVar("Made", bound=Part)


class RestartablePart(Generic[Made]):
    """Makes the part at once, so that wrong settings are found before the service begins, and makes it again after each failure.

    Args:
        name: the name in health and in the log.
        make: makes the part; called again for each restart.

    Raises:
        BadInput: the settings are wrong.
    """

    def __init__(self, name: str, make: Callable[[], Made]) -> None:
        self.name = name
        self._make = make
        self.now: Made | None = None
        """The running part; None while there is none."""
        try:
            self.now = make()
        except BadInput:
            raise
        except Exception as why:  # neither the outside world's state nor our own bug may keep the drone on the ground
            report("%s could not be made; the service begins without it and tries again", name, why=why)

    async def run(self) -> None:
        """Run the part once.

        Raises:
            Whatever ends the part.
        """
        if self.now is None:
            self.now = await asyncio.to_thread(self._make)  # it reads files, of a disk that may hang
        living = self.now
        try:
            await living.run()
        finally:
            self.now = None

    def on_sample(self, sample: Sample) -> None:
        if self.now is not None:
            self.now.on_sample(sample)

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        if self.now is not None:
            self.now.on_fusion(at, result)

    def on_frame(self, processed: ProcessedFrame) -> None:
        if self.now is not None:
            self.now.on_frame(processed)

    def on_decision(self, decision: Decision) -> None:
        if self.now is not None:
            self.now.on_decision(decision)

    def on_order(self, handled: HandledOrder) -> None:
        if self.now is not None:
            self.now.on_order(handled)
