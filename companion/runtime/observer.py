"""The interface of observers: recorders, pages and reports. Observers must return quickly and must not raise."""

from __future__ import annotations

from typing import Protocol

from msgspec import Struct

from companion.guidance.mission import StateChange
from companion.guidance.response_watch import ResponseInUse
from companion.operator.orders import HandledOrder
from estimator.contracts.commands import Command
from estimator.contracts.estimates import RelativeState, Verdict
from estimator.contracts.fusion import FusionResult
from estimator.contracts.samples import Attitude, Frame, Sample
from estimator.contracts.time import MonoNs
from estimator.vision.thesis.detection import Detection


class FrameTimes(Struct, frozen=True):
    """How long each stage of one frame took, from the arrival of its last byte until the estimate knew it."""

    decode_s: float
    """Until the decoded frame reached the service."""
    wait_s: float
    """Waiting for an attitude and for the thread of vision, before and after the look."""
    look_s: float
    filter_s: float
    """From the detection to the estimate of every path."""

    def by_stage(self) -> tuple[tuple[str, float], ...]:
        """Return each stage's name and duration, in order."""
        return ("decode", self.decode_s), ("wait", self.wait_s), ("look", self.look_s), ("filter", self.filter_s)


class ProcessedFrame(Struct, frozen=True, eq=False):
    """One frame, its attitude, and the results of its processing."""

    frame: Frame
    attitude: Attitude | None
    """The vehicle's attitude at the exposure; None if no sample covers it."""
    detection: Detection | None
    """The result of vision; None if vision did not search the frame."""
    verdict: Verdict
    began: MonoNs
    """Instant at which vision began with the frame."""
    done: MonoNs
    results: tuple[FusionResult, ...] = ()
    """The fusion result of each path of the estimator; empty without a sighting."""
    times: FrameTimes | None = None
    """None if vision did not search the frame, or in virtual time."""


class Decision(Struct, frozen=True, eq=False):
    """The result of one guidance cycle."""

    at: MonoNs
    phase: str
    command: Command | None
    """The command to the vehicle; None while guidance leaves the vehicle alone."""
    belief: RelativeState | None
    shadows: tuple[RelativeState, ...] = ()
    """Beliefs of the paths that do not steer."""
    reason: str = ""
    """Why the vehicle is not simply descending, as text for the operator."""
    limit: str = ""
    """The limits that changed the command, or why they ended the landing; empty while there are none."""
    transitions: tuple[StateChange, ...] = ()
    """What changed since the previous decision, in order."""
    response: ResponseInUse | None = None
    """The vehicle's response, where this cycle has come to know it otherwise than before."""


class Observer(Protocol):
    """An observer of the service. Its methods are called on the service's own thread, in the order of events."""

    def on_sample(self, sample: Sample) -> None: ...

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        """Take the result of one measurement on one path, after the sample or frame that it belongs to.

        Args:
            at: the time at which the service processed the measurement.
        """
        ...

    def on_frame(self, processed: ProcessedFrame) -> None: ...

    def on_decision(self, decision: Decision) -> None: ...

    def on_order(self, handled: HandledOrder) -> None:
        """Take an order of a person with its answer."""
        ...


class NullObserver:
    """An observer that does nothing; the base of observers that need only some of the calls."""

    def on_sample(self, sample: Sample) -> None:
        return None

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        return None

    def on_frame(self, processed: ProcessedFrame) -> None:
        return None

    def on_decision(self, decision: Decision) -> None:
        return None

    def on_order(self, handled: HandledOrder) -> None:
        return None
