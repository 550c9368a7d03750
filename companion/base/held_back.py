"""Tell an observer of a flight only once it has begun: of one that never does, nothing is to be kept."""

from collections.abc import Callable
from functools import partial

from companion.base.observer import Decision, Observer, ProcessedFrame
from companion.base.orders import HandledOrder
from estimator.contracts.fusion import FusionResult
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs


class HeldBack:
    """An observer that passes everything on, in order, from `begin` on.

    Args:
        observer: gets what is passed on.
    """

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._waiting: list[Callable[[], None]] | None = []

    def begin(self) -> None:
        """Pass on what came until now; do nothing when called again."""
        waiting, self._waiting = self._waiting, None
        for tell in waiting or ():
            tell()

    def on_sample(self, sample: Sample) -> None:
        self._tell(partial(self._observer.on_sample, sample))

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        self._tell(partial(self._observer.on_fusion, at, result))

    def on_frame(self, processed: ProcessedFrame) -> None:
        self._tell(partial(self._observer.on_frame, processed))

    def on_decision(self, decision: Decision) -> None:
        self._tell(partial(self._observer.on_decision, decision))

    def on_order(self, handled: HandledOrder) -> None:
        self._tell(partial(self._observer.on_order, handled))

    def _tell(self, tell: Callable[[], None]) -> None:
        if self._waiting is None:
            tell()
        else:
            self._waiting.append(tell)
