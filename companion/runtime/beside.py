"""A part that runs beside the flight: made anew each time it starts, and an observer all the while.

A part that failed is in no state to be trusted: its thread may be gone, its files closed. So its next life is a new object,
and whoever wants to reach it asks for `now`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from companion.runtime.containment import report
from companion.runtime.observer import Decision, ProcessedFrame
from estimator.contracts.errors import BadInput
from estimator.contracts.fusion import FusionResult
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs

log = logging.getLogger(__name__)


class Part(Protocol):
    """An observer with a body of its own."""

    def on_sample(self, sample: Sample) -> None: ...

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None: ...

    def on_frame(self, processed: ProcessedFrame) -> None: ...

    def on_decision(self, decision: Decision) -> None: ...

    async def run(self) -> None: ...


Made = TypeVar("Made", bound=Part)


class RestartablePart(Generic[Made]):
    """Makes the part at once, so that wrong settings are found before the service begins, and again after each failure.

    Args:
        name: the name in health and in the log.
        make: makes it; called again for each life.

    Raises:
        BadInput: the settings are wrong.
    """

    def __init__(self, name: str, make: Callable[[], Made]) -> None:
        self.name = name
        self._make = make
        self.now: Made | None = None
        """The living one; None while there is none."""
        try:
            self.now = make()
        except BadInput:
            raise
        except Exception as why:  # the outside world's state, or our own bug: neither keeps the drone on the ground
            report("%s could not be made; the service begins without it and tries again", name, why=why)

    async def run(self) -> None:
        """One life.

        Raises:
            Whatever ends it.
        """
        living = self.now = self.now or self._make()
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
