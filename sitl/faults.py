"""The faults of a simulated flight as data: what goes wrong, when it begins and how long it lasts.

A scenario file lists them under `[[faults]]`. Each has a `kind`, exactly one beginning (`at_s`, `below_height_m`,
`above_height_m` or `in_phase`) and a duration `for_s`; without one it lasts for the rest of the flight.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, TypeVar, get_args

from msgspec import Struct

from companion.guidance.planner import Phase as GuidancePhase
from estimator.contracts.keys import choice, number, text

PHASES = tuple(phase.value for phase in GuidancePhase)
"""The phases of guidance that a fault may begin in."""
_BEGINNINGS = ("at_s", "below_height_m", "above_height_m", "in_phase")


class Fault(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"):
    """Something that goes wrong, and when."""

    at_s: Annotated[float, number("begins this long after the start of the flight", "s", 0.0, 36000.0)] | None = None
    below_height_m: (
        Annotated[float, number("begins when the vehicle first comes down to this height over the deck", "m", 0.05, 60.0)] | None
    ) = None
    above_height_m: (
        Annotated[float, number("begins when the vehicle is first higher than this over the deck", "m", 0.05, 60.0)] | None
    ) = None
    in_phase: (
        Annotated[str, text(f"begins when guidance first enters this phase: {', '.join(PHASES)}; in virtual time only", 40)]
        | None
    ) = None
    for_s: Annotated[float, number("how long it lasts; without it, for the rest of the flight", "s", 0.001, 36000.0)] | None = (
        None
    )

    def __post_init__(self) -> None:
        given = [name for name in _BEGINNINGS if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) if given else "none of them"
            raise ValueError(f"exactly one of {', '.join(_BEGINNINGS)} must say when it begins, found {found}")
        if self.in_phase is not None and self.in_phase not in PHASES:
            raise ValueError(f"in_phase must be one of {', '.join(PHASES)}, found {self.in_phase!r}")
        self.check()

    def check(self) -> None:
        """Refuse values that contradict each other; raises ValueError."""

    @property
    def kind(self) -> str:
        """The word that names this kind of fault in a scenario file."""
        return str(self.__struct_config__.tag)


class LensCovered(Fault, frozen=True, tag="lens_covered"):
    """The camera's frames are black."""


class FramesFrozen(Fault, frozen=True, tag="frames_frozen"):
    """Every frame holds the image of the last one before, with a stamp of its own."""


class FramesShifted(Fault, frozen=True, tag="frames_shifted"):
    """Frames show everything, the pad included, beside its true place."""

    forward_m: Annotated[float, number("along the pad's arrow", "m", -20.0, 20.0)] = 0.0
    right_m: Annotated[float, number("to starboard of the pad's arrow", "m", -20.0, 20.0)] = 0.0
    share: Annotated[float, number("of the frames that are shifted, drawn by the seed", "1", 0.01, 1.0)] = 1.0

    def check(self) -> None:
        if self.forward_m == 0.0 and self.right_m == 0.0:
            raise ValueError("forward_m or right_m must say how far the frames are shifted")


class FramesDelayed(Fault, frozen=True, tag="frames_delayed"):
    """Frames arrive later than usual; their stamps stay true."""

    by_s: Annotated[float, number("on top of the usual delay", "s", 0.001, 10.0)]


class FramesMisstamped(Fault, frozen=True, tag="frames_misstamped"):
    """Frames carry a wrong stamp: with a negative error they claim to be older than they are."""

    by_s: Annotated[float, number("stamp less the true instant of exposure", "s", -3600.0, 3600.0)]


class FramesDropped(Fault, frozen=True, tag="frames_dropped"):
    """Frames are lost on the way."""

    share: Annotated[float, number("of the frames that are lost, drawn by the seed", "1", 0.01, 1.0)] = 1.0


class ImuFrozen(Fault, frozen=True, tag="imu_frozen"):
    """Accelerometer and gyro repeat their last reading with new stamps."""


class AccelOffset(Fault, frozen=True, tag="accel_offset"):
    """An axis of the accelerometer reads too much; a spike where it lasts for milliseconds."""

    by_m_s2: Annotated[float, number("reading less the true value", "m/s^2", -1e6, 1e6)]
    axis: Annotated[Literal["x", "y", "z"], choice("of the body: forward, right, down")] = "x"


class GyroOffset(Fault, frozen=True, tag="gyro_offset"):
    """An axis of the gyro reads too much."""

    by_deg_s: Annotated[float, number("reading less the true value", "deg/s", -1e5, 1e5)]
    axis: Annotated[Literal["x", "y", "z"], choice("of the body: forward, right, down")] = "z"


class HeadingOffset(Fault, frozen=True, tag="heading_offset"):
    """The reported heading is wrong: an offset, a drift, or both."""

    by_deg: Annotated[float, number("clockwise, at once", "deg", -180.0, 180.0)] = 0.0
    drift_deg_s: Annotated[float, number("clockwise, growing from the beginning on", "deg/s", -90.0, 90.0)] = 0.0

    def check(self) -> None:
        if self.by_deg == 0.0 and self.drift_deg_s == 0.0:
            raise ValueError("by_deg or drift_deg_s must say how wrong the heading is")


class AttitudeOffset(Fault, frozen=True, tag="attitude_offset"):
    """The reported roll and pitch are wrong; the vehicle's own loops go on with the right ones."""

    roll_deg: Annotated[float, number("right side down", "deg", -45.0, 45.0)] = 0.0
    pitch_deg: Annotated[float, number("nose up", "deg", -45.0, 45.0)] = 0.0

    def check(self) -> None:
        if self.roll_deg == 0.0 and self.pitch_deg == 0.0:
            raise ValueError("roll_deg or pitch_deg must say how wrong the attitude is")


class NavdataSilent(Fault, frozen=True, tag="navdata_silent"):
    """The vehicle sends no samples."""


class NavdataMisstamped(Fault, frozen=True, tag="navdata_misstamped"):
    """Samples carry a wrong stamp: with a negative error they claim to be older than they are."""

    by_s: Annotated[float, number("stamp less the true instant of the sample", "s", -3600.0, 3600.0)]


class UltrasoundSilent(Fault, frozen=True, tag="ultrasound_silent"):
    """The ultrasound hears nothing."""


class UltrasoundFrozen(Fault, frozen=True, tag="ultrasound_frozen"):
    """The ultrasound repeats its last reading."""


class UltrasoundOffset(Fault, frozen=True, tag="ultrasound_offset"):
    """The ultrasound reads too much."""

    by_m: Annotated[float, number("reading less the true distance", "m", -6.0, 6.0)]


class PressureOffset(Fault, frozen=True, tag="pressure_offset"):
    """The barometer reads too much; 12 Pa more are one metre less of height."""

    by_pa: Annotated[float, number("reading less the true pressure", "Pa", -2000.0, 2000.0)]


class MagnetometerSilent(Fault, frozen=True, tag="magnetometer_silent"):
    """The magnetometer gives no reading."""


class FlowBlind(Fault, frozen=True, tag="flow_blind"):
    """The vehicle's own optical flow finds nothing: it believes that it stands still."""


class LowBattery(Fault, frozen=True, tag="low_battery"):
    """The battery's charge falls at once to a fraction."""

    fraction: Annotated[float, number("of a full battery that is left", "1", 0.0, 1.0)] = 0.1


class Gust(Fault, frozen=True, tag="gust"):
    """A single gust: the wind rises and falls as one minus a cosine over `for_s`."""

    speed_m_s: Annotated[float, number("added wind at its height, half way through", "m/s", 0.0, 25.0)] = 5.0
    from_deg: Annotated[float, number("where it blows from, clockwise from north", "deg", -360.0, 360.0)] = 0.0

    def check(self) -> None:
        if self.for_s is None:
            raise ValueError("for_s must say how long the gust takes to pass")


class WeakRotor(Fault, frozen=True, tag="weak_rotor"):
    """A rotor gives a share of its thrust."""

    rotor: Annotated[Literal["front_left", "front_right", "rear_right", "rear_left"], choice("which")] = "front_left"
    thrust_share: Annotated[float, number("thrust it still gives", "1", 0.0, 1.0)] = 0.8


class LinkLost(Fault, frozen=True, tag="link_lost"):
    """Nothing passes between the vehicle and the service: no samples, no frames, no commands."""


class ServiceKilled(Fault, frozen=True, tag="service_killed"):
    """The service's process is gone; after `for_s` a new one runs that remembers nothing. In virtual time only."""


AnyFault = (
    LensCovered
    | FramesFrozen
    | FramesShifted
    | FramesDelayed
    | FramesMisstamped
    | FramesDropped
    | ImuFrozen
    | AccelOffset
    | GyroOffset
    | HeadingOffset
    | AttitudeOffset
    | NavdataSilent
    | NavdataMisstamped
    | UltrasoundSilent
    | UltrasoundFrozen
    | UltrasoundOffset
    | PressureOffset
    | MagnetometerSilent
    | FlowBlind
    | LowBattery
    | Gust
    | WeakRotor
    | LinkLost
    | ServiceKilled
)
KINDS: dict[str, type[Fault]] = {str(kind.__struct_config__.tag): kind for kind in get_args(AnyFault)}
"""Every kind of fault by its word."""

_F = TypeVar("_F", bound=Fault)


class FaultTimer:
    """Which of a flight's faults are on, and since when.

    Args:
        faults: the scenario's faults, in any order.
    """

    def __init__(self, faults: tuple[Fault, ...]) -> None:
        self._faults = faults
        self._began: list[float | None] = [None] * len(faults)
        self._was_above = [False] * len(faults)
        self._on: list[tuple[Fault, float]] = []
        self._kinds: frozenset[str] = frozenset()

    def __bool__(self) -> bool:
        """Whether the scenario has any fault at all."""
        return bool(self._faults)

    def update(self, t_s: float, height_m: float, phase: str | None) -> list[Fault]:
        """Move on to an instant and return the faults that begin now.

        Args:
            t_s: seconds since the start of the flight.
            height_m: height of the vehicle over the deck's plane.
            phase: phase of guidance, None if not known.
        """
        begun = []
        for i, fault in enumerate(self._faults):
            if self._began[i] is None and self._begins(i, fault, t_s, height_m, phase):
                self._began[i] = t_s
                begun.append(fault)
        # A tolerance far below a step keeps "for 0.5 s" from ending a step late by the rounding of a sum.
        self._on = [
            (fault, t_s - began)
            for fault, began in zip(self._faults, self._began, strict=True)
            if began is not None and t_s - began < (math.inf if fault.for_s is None else fault.for_s - 1e-9)
        ]
        self._kinds = frozenset(fault.kind for fault, _ in self._on)
        return begun

    def active(self, kind: str) -> bool:
        """Whether a fault of this kind is on now."""
        return kind in self._kinds

    def on(self, kind: type[_F]) -> list[tuple[_F, float]]:
        """The faults of one kind that are on now, each with the seconds since it began."""
        return [(fault, since_s) for fault, since_s in self._on if isinstance(fault, kind)]

    @property
    def active_kinds(self) -> frozenset[str]:
        """The words of all that is on now."""
        return self._kinds

    @property
    def begun(self) -> tuple[tuple[Fault, float], ...]:
        """Every fault that has begun so far, and when in seconds after the start."""
        return tuple((f, b) for f, b in zip(self._faults, self._began, strict=True) if b is not None)

    def _begins(self, i: int, fault: Fault, t_s: float, height_m: float, phase: str | None) -> bool:
        if fault.at_s is not None:
            return t_s >= fault.at_s - 1e-9
        if fault.below_height_m is not None:
            # Only a descent counts: a vehicle that takes off from the deck was low before it was ever up.
            self._was_above[i] = self._was_above[i] or height_m >= fault.below_height_m
            return self._was_above[i] and height_m < fault.below_height_m
        if fault.above_height_m is not None:
            return height_m > fault.above_height_m
        return phase is not None and phase == fault.in_phase
