"""Faults of a simulated flight: when one begins, how long it lasts, where it acts, and which are active.

A fault has a `kind`, exactly one beginning (`at_s`, `below_height_m`, `above_height_m`, `in_phase` or `per_minute`) and a
duration `for_s`; without one it lasts for the rest of the flight. The seed may put the beginning off (`drawn_within_s`).

Vehicle, streams, sensors and camera each hand a record to every active fault, which writes into it what it does there
(`sitl.faults.acts`). What only one kind does, a part looks for by that kind (`FaultTimer.on`): the ship's motion and reports, and
the person.
"""

import math
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
from msgspec import Struct

from companion.base.mission import State
from estimator.contracts.keys import number, text
from sitl.faults.acts import OnFrame, OnSight, OnVehicle, Passage, Stream, Vehicles

PHASES = tuple(state.value for state in State)
"""The phases of guidance that a fault may begin in."""
_BEGINNINGS = ("at_s", "below_height_m", "above_height_m", "in_phase", "per_minute")


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
    per_minute: (
        Annotated[float, number("average rate of a recurring fault, at times drawn by the seed", "per min", 0.01, 6000.0)] | None
    ) = None
    drawn_within_s: (
        Annotated[float, number("begins later by a time that the seed draws, up to this", "s", 0.001, 60.0)] | None
    ) = None
    for_s: Annotated[float, number("duration; without it, the rest of the flight", "s", 0.001, 36000.0)] | None = None

    def __post_init__(self) -> None:
        given = [name for name in _BEGINNINGS if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) if given else "none of them"
            raise ValueError(f"exactly one of {', '.join(_BEGINNINGS)} must say when it begins, found {found}")
        if self.in_phase is not None and self.in_phase not in PHASES:
            raise ValueError(f"in_phase must be one of {', '.join(PHASES)}, found {self.in_phase!r}")
        if self.per_minute is not None and self.for_s is None:
            raise ValueError("for_s must say how long the fault lasts each time")
        if self.per_minute is not None and self.drawn_within_s is not None:
            raise ValueError("drawn_within_s does not go with per_minute, whose times are drawn already")
        self.check()

    def check(self) -> None:
        """Refuse values that contradict each other; raises ValueError."""

    @property
    def kind(self) -> str:
        """The word that names this kind of fault in a scenario file."""
        return str(self.__struct_config__.tag)

    @property
    def words(self) -> str:
        """The fault in words, for people."""
        return self.kind

    # Its acts: a part of the flight calls its own for every active fault; by default it does nothing there.

    CARRIED: ClassVar[frozenset[Vehicles]] = frozenset({"ardrone", "stand-in", "program", "own physics"})
    """The vehicles on which it can act."""
    KILLS_SERVICE: ClassVar[bool] = False
    """True if no service runs while it lasts."""
    CUTS_LINK: ClassVar[bool] = False
    """True if nothing passes between vehicle and service while it lasts."""

    def carried_by(self, vehicle: Vehicles) -> bool:
        """Return whether it can act on a vehicle."""
        return vehicle in self.CARRIED

    def on_begin(self, world: Any) -> None:
        """Act once on a `sitl.world.world.World`, as it begins."""

    def on_vehicle(self, vehicle: OnVehicle, since_s: float) -> None:
        """Act on the vehicle's body at a step."""

    def on_stream(self, stream: Stream) -> Passage | None:
        """Return how a packet of a stream passes that is sent now; None for as ever."""

    def on_frame(self, frame: OnFrame) -> None:
        """Act on a frame at its exposure."""

    def on_sight(self, sight: OnSight) -> None:
        """Act on what a drawn detection is drawn from."""


_F = TypeVar("_F", bound=Fault)


class FaultTimer:
    """The active faults of a flight, and their begin.

    Args:
        faults: the scenario's faults, in any order.
        seed: seed of the times at which recurring faults begin.
    """

    def __init__(self, faults: tuple[Fault, ...], seed: int = 0) -> None:
        self._faults = faults
        self._began: list[float | None] = [None] * len(faults)
        self._was_above = [False] * len(faults)
        self._rngs = [np.random.default_rng([seed, 0xFA17, i]) for i in range(len(faults))]
        self._due_s = [self._rest_s(i, fault) for i, fault in enumerate(faults)]
        """Time at which each recurring fault begins next, or one that is put off begins, s."""
        self.now: list[tuple[Fault, float]] = []
        """The active faults, each with the seconds since it began."""
        self._begun: list[tuple[Fault, float]] = []

    def __bool__(self) -> bool:
        """Return whether the scenario has any fault at all."""
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
            began = self._began[i]
            if fault.per_minute is not None and began is not None and not _lasts(fault, t_s - began):
                self._began[i], self._due_s[i] = None, t_s + self._rest_s(i, fault)
            if self._began[i] is None and self._begins_by_now(i, fault, t_s, height_m, phase):
                self._began[i] = t_s
                begun.append(fault)
        self._begun += [(fault, t_s) for fault in begun]
        self.now = [
            (fault, t_s - began)
            for fault, began in zip(self._faults, self._began, strict=True)
            if began is not None and _lasts(fault, t_s - began)
        ]
        return begun

    @property
    def service_gone(self) -> bool:
        """True if no service runs."""
        return any(fault.KILLS_SERVICE for fault, _ in self.now)

    @property
    def left_alone(self) -> bool:
        """True if no service runs, or nothing passes between it and the vehicle."""
        return any(fault.KILLS_SERVICE or fault.CUTS_LINK for fault, _ in self.now)

    def on(self, kind: type[_F]) -> list[tuple[_F, float]]:
        """Return the faults of one kind that are active now, each with the seconds since it began."""
        return [(fault, since_s) for fault, since_s in self.now if isinstance(fault, kind)]

    def listed(self, kind: type[_F]) -> list[_F]:
        """Return all faults of one kind that the scenario lists, whether they are active or not."""
        return [fault for fault in self._faults if isinstance(fault, kind)]

    @property
    def begun(self) -> tuple[tuple[Fault, float], ...]:
        """Every beginning so far, in order, and when in seconds after the start."""
        return tuple(self._begun)

    def _rest_s(self, i: int, fault: Fault) -> float:
        """Return the time until a recurring fault begins again: exponential, so that beginnings are a Poisson process."""
        return float(self._rngs[i].exponential(60.0 / fault.per_minute)) if fault.per_minute is not None else math.inf

    def _begins_by_now(self, i: int, fault: Fault, t_s: float, height_m: float, phase: str | None) -> bool:
        """Return whether a fault begins now, or was put off until now."""
        if fault.drawn_within_s is None:
            return self._begins(i, fault, t_s, height_m, phase)
        if math.isinf(self._due_s[i]) and self._begins(i, fault, t_s, height_m, phase):
            self._due_s[i] = t_s + float(self._rngs[i].uniform(0.0, fault.drawn_within_s))
        return t_s >= self._due_s[i]

    def _begins(self, i: int, fault: Fault, t_s: float, height_m: float, phase: str | None) -> bool:
        if fault.at_s is not None:
            return t_s >= fault.at_s - 1e-9
        if fault.below_height_m is not None:
            # Only a descent counts: a vehicle that takes off from the deck was low before it was ever up.
            self._was_above[i] = self._was_above[i] or height_m >= fault.below_height_m
            return self._was_above[i] and height_m < fault.below_height_m
        if fault.above_height_m is not None:
            return height_m > fault.above_height_m
        if fault.per_minute is not None:
            return t_s >= self._due_s[i]
        return phase is not None and phase == fault.in_phase


def _lasts(fault: Fault, since_s: float) -> bool:
    # A tolerance far below a step keeps "for 0.5 s" from ending a step late by the rounding of a sum.
    return since_s < (math.inf if fault.for_s is None else fault.for_s - 1e-9)
