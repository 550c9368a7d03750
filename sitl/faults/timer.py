"""The active faults of a flight, and their begin."""

import math
from typing import TypeVar

import numpy as np

from sitl.faults.fault import Fault
from sitl.faults.sensors import SensorFault

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
        self._on: list[tuple[Fault, float]] = []
        self.active_kinds: frozenset[str] = frozenset()
        """The kinds of all that is active now."""
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
        self._on = [
            (fault, t_s - began)
            for fault, began in zip(self._faults, self._began, strict=True)
            if began is not None and _lasts(fault, t_s - began)
        ]
        self.active_kinds = frozenset(fault.kind for fault, _ in self._on)
        return begun

    @property
    def delays(self) -> bool:
        """True if any sensor's readings are ever delayed, so that past readings are needed."""
        return any(isinstance(fault, SensorFault) and fault.delay_s > 0.0 for fault in self._faults)

    def active(self, kind: str) -> bool:
        """Return whether a fault of this kind is active now."""
        return kind in self.active_kinds

    def on(self, kind: type[_F]) -> list[tuple[_F, float]]:
        """Return the faults of one kind that are active now, each with the seconds since it began."""
        if not self._on:
            return []
        return [(fault, since_s) for fault, since_s in self._on if isinstance(fault, kind)]

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
