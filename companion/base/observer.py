"""The interface of observers: recorders, pages and reports. Observers must return quickly and must not raise."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from enum import Enum
from typing import NamedTuple, Protocol

from msgspec import Struct

from companion.base.mission import StateChange
from companion.base.orders import HandledOrder
from estimator.contracts.commands import Command
from estimator.contracts.estimates import FusionResult, RelativeState, Verdict
from estimator.contracts.samples import Attitude, Frame, Sample
from estimator.contracts.time import MonoNs
from estimator.ekf import Forecast
from estimator.vision.camera.camera import Camera
from estimator.vision.detection import Detection


class ResponseState(Enum):
    """Source of the vehicle's response."""

    ASSUMED = "assumed"
    """Neither the file nor the flight gives the uncertainty of the delay."""
    KNOWN = "known"
    """The delay of its file holds, by the file's own word or by the flight's."""
    IDENTIFIED = "identified"
    """The flight contradicts the delay of its file and takes its place."""


class TiltShape(NamedTuple):
    """Difference of a vehicle's tilt from its file, beside the delay: factors, and how much less the place weighs for it."""

    frequency: float = 1.0
    damping: float = 1.0
    softer: float = 1.0
    """Factor by which the place weighs less, so that the margins are kept for all that this may be."""
    sigma: float = 0.0
    """Standard deviation of the frequency's logarithm."""

    @property
    def slow(self) -> float:
        """The factor on the frequency that gains are made for: one standard deviation slower, and never faster than the file.

        The slow side takes phase. Gains for a faster vehicle than there is have no margin; those of the file stand it.
        """
        return min(1.0, self.frequency * math.exp(-self.sigma))

    @property
    def text(self) -> str:
        """The difference for the operator."""
        by, damped = 100.0 * abs(1.0 - self.frequency), 100.0 * abs(1.0 - self.damping)
        how = "as fast as" if self.frequency == 1.0 else f"{by:.0f} % {'slower' if self.frequency < 1.0 else 'faster'} than"
        less = f", damped {damped:.0f} % {'less' if self.damping < 1.0 else 'more'}" if self.damping != 1.0 else ""
        return f"this vehicle answers {how} its file (sigma {100.0 * self.sigma:.0f} %){less}"


AS_FILED = TiltShape()


class ResponseInUse(Struct, frozen=True):
    """The response that the control law flies by."""

    state: ResponseState
    delay_s: float
    """Delay of the tilt that is flown with."""
    sigma_s: float | None
    """Standard deviation of the delay; None if nothing states it."""
    longer_s: float = 0.0
    """Excess of the delay over its file, s."""
    shape: TiltShape = AS_FILED

    @property
    def contradicts(self) -> bool:
        """True if the flight contradicts its file to a landing's cost. A faster vehicle is flown with more margin."""
        return self.state is ResponseState.IDENTIFIED or self.shape.frequency < 1.0 or self.shape.softer > 1.0

    @property
    def text(self) -> str:
        """The state for the operator."""
        return self._delay if self.shape == AS_FILED else f"{self.shape.text}; {self._delay}"

    @property
    def _delay(self) -> str:
        ms = f"{1e3 * self.delay_s:.0f} ms (sigma {1e3 * (self.sigma_s or 0.0):.0f})"
        if self.state is ResponseState.IDENTIFIED:
            return f"the vehicle answers {1e3 * self.longer_s:.0f} ms longer than its response file says: {ms} is flown with"
        if self.state is ResponseState.KNOWN:
            return f"the vehicle's response is known: delay {ms}"
        return f"the vehicle's response is assumed: delay {1e3 * self.delay_s:.0f} ms, softer gains"


class FrameTimes(Struct, frozen=True):
    """Duration of each stage of one frame, from the arrival of its last byte until the estimate knew it."""

    decode_s: float
    """Time until the decoded frame reached the service."""
    wait_s: float
    """Waiting for an attitude and for the thread of vision, before and after the look."""
    look_s: float
    filter_s: float
    """Time from the detection to the estimate of every path."""

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
    camera: Camera | None = None
    """The camera as its gimbal held it at the exposure; None for a camera that is fixed on the body, or if that is not known."""


class DeckOutlook(Struct, frozen=True):
    """The deck at instants ahead of `at`, with standard deviations, as guidance used it."""

    at: MonoNs
    horizons_s: tuple[float, ...]
    height_m: tuple[float, ...]
    """Height of the pad's centre above its mean level, positive up."""
    sigma_height_m: tuple[float, ...]
    roll_rad: tuple[float, ...]
    """Roll of the deck about the arrow, starboard down positive."""
    sigma_roll_rad: tuple[float, ...]
    pitch_rad: tuple[float, ...]
    """Pitch of the deck, arrow up positive."""
    sigma_pitch_rad: tuple[float, ...]

    @staticmethod
    def of(ahead: Forecast) -> DeckOutlook:
        """Return the deck's part of a forecast."""
        columns = (
            ahead.horizons_s, ahead.deck_height_m, ahead.sigma_deck_height_m, ahead.roll_rad, ahead.sigma_roll_rad,
            ahead.pitch_rad, ahead.sigma_pitch_rad,
        )  # fmt: skip
        return DeckOutlook(ahead.at, *(tuple(column.tolist()) for column in columns))

    def rows(self) -> Iterator[tuple[float, float, float, float, float, float, float]]:
        """Yield horizon, height, roll and pitch, each of the last three with its sigma."""
        return zip(
            self.horizons_s, self.height_m, self.sigma_height_m, self.roll_rad, self.sigma_roll_rad, self.pitch_rad,
            self.sigma_pitch_rad, strict=True,
        )  # fmt: skip


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
    """Reason why the vehicle does not simply descend, as text for the operator."""
    limit: str = ""
    """The limits that changed the command, or why they ended the landing; empty while there are none."""
    transitions: tuple[StateChange, ...] = ()
    """State changes since the previous decision, in order."""
    response: ResponseInUse | None = None
    """The vehicle's response, where this cycle has come to know it otherwise than before."""
    ahead: DeckOutlook | None = None
    """The deck's forecast, where this cycle made one."""
    charge: str = ""
    """The end of the charge that is near for a drone that a person left in the air or flies, in words; it is in `reason` too."""


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


class Relay(ABC):
    """An observer that hands every event on."""

    @abstractmethod
    def hand_on(self, method: str, *what: object) -> None:
        """Hand an event on: the observer's method that takes it, and its arguments."""

    def on_sample(self, sample: Sample) -> None:
        self.hand_on("on_sample", sample)

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        self.hand_on("on_fusion", at, result)

    def on_frame(self, processed: ProcessedFrame) -> None:
        self.hand_on("on_frame", processed)

    def on_decision(self, decision: Decision) -> None:
        self.hand_on("on_decision", decision)

    def on_order(self, handled: HandledOrder) -> None:
        self.hand_on("on_order", handled)


def listens(observer: Observer, method: str) -> bool:
    """Return whether an observer does anything in a method: of hundreds of samples a second most take none."""
    return getattr(type(observer), method, None) is not getattr(NullObserver, method)


def rests(observer: Observer) -> bool:
    """Return whether an observer does nothing with samples and results of measurements for now, as a recorder that is off."""
    return getattr(observer, "rests", False) is True


class ThingReport(Struct, frozen=True, kw_only=True):
    """Something on the pad or about it. Axes of the pad: x along the arrow, y to starboard of it."""

    x_m: float
    y_m: float
    width_m: float | None = None
    """Its larger extent, if it lies on the pad."""
    height_m: float | None = None
    """Height that it stands out of the deck, if it is about the pad; 0 for what moves."""

    @property
    def words(self) -> str:
        """Text on what it does where, in one line."""
        if self.width_m is not None:
            how = f"{100.0 * self.width_m:.0f} cm wide lies on the pad"
        else:
            how = f"stands {100.0 * self.height_m:.0f} cm out of the deck" if self.height_m else "moves about the pad"
        return f"something {how}, {math.hypot(self.x_m, self.y_m):.2f} m from its centre"


def things_of(detection: Detection | None) -> tuple[ThingReport, ...]:
    """Return what a frame's detection knows of things on the pad and about it."""
    check = None if detection is None else detection.on_pad
    if check is None:
        return ()
    lies, near = check.thing, check.near
    on_it = () if lies is None else (ThingReport(x_m=lies.forward_m, y_m=lies.right_m, width_m=lies.width_m),)
    return on_it if near is None else (*on_it, ThingReport(x_m=near.forward_m, y_m=near.right_m, height_m=near.height_m))
