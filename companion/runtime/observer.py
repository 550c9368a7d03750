"""What the service tells whoever wants to know: recorders, pages, reports. Observers must be quick and must not raise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from estimator.contracts.commands import Command
from estimator.contracts.estimates import RelativeState, Verdict
from estimator.contracts.fusion import FusionResult
from estimator.contracts.samples import Attitude, Frame, Sample
from estimator.contracts.time import MonoNs
from estimator.vision.thesis.detection import Detection


@dataclass(frozen=True, slots=True, eq=False)
class ProcessedFrame:
    """One frame and what became of it."""

    frame: Frame
    attitude: Attitude | None
    """At the exposure."""
    detection: Detection | None
    """What vision saw; None where it was not asked."""
    verdict: Verdict
    began: MonoNs
    """When vision took it up."""
    done: MonoNs
    results: tuple[FusionResult, ...] = ()
    """What each path of the estimator made of the sighting; empty without one."""


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """One round of guidance."""

    at: MonoNs
    phase: str
    command: Command | None
    """None while guidance leaves the vehicle to itself."""
    belief: RelativeState | None
    shadows: tuple[RelativeState, ...] = ()
    """Beliefs of the paths that do not steer."""
    reason: str = ""
    """Why it is not simply on its way down, as text for the operator."""


class Observer(Protocol):
    """Called on the service's own thread, in the order of events."""

    def on_sample(self, sample: Sample) -> None: ...

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        """Take what one path made of one measurement, after the sample or frame that it came from.

        Args:
            at: the instant at which the service met the measurement.
        """
        ...

    def on_frame(self, processed: ProcessedFrame) -> None: ...

    def on_decision(self, decision: Decision) -> None: ...


class NullObserver:
    """An observer that does nothing: a base for those that want only some of it."""

    def on_sample(self, sample: Sample) -> None:
        return None

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        return None

    def on_frame(self, processed: ProcessedFrame) -> None:
        return None

    def on_decision(self, decision: Decision) -> None:
        return None
