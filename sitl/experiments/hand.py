"""The person who flew the thesis' drone by hand, and a controller from outside: pilots that command in place of guidance."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from msgspec.structs import replace

from companion.base.mission import FlightOutcome
from companion.base.observer import Decision
from companion.guidance.pilot import Pilot
from estimator.contracts.commands import Command, Hover, Land, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.time import MonoNs, seconds_between
from sitl.experiments.paths import Path, level_axes, thesis_yaw_rad
from sitl.world.truth import Truth

_GAIN, _YAW_GAIN = 0.9, 1.2
_FASTEST_M_S, _FASTEST_RAD_S = 0.7, 0.8
_LAND_BELOW_M, _LAND_WITHIN_M = 0.35, 0.12


class HandPilot(Pilot):
    """Flies a path by sight of the true state, as a person beside the simulator does; the estimator only looks on.

    Attributes:
        path: the wanted pose over time.
        truth: returns the true state now.
    """

    path: Path
    truth: Callable[[], Truth]
    _began: MonoNs | None = None

    def decide(self, now: MonoNs) -> Decision:
        """Return the beliefs of guidance's cycle with the command of the hand."""
        self._began = now if self._began is None else self._began
        return replace(super().decide(now), phase="by hand", command=self._steer(seconds_between(self._began, now)))

    def _steer(self, t_s: float) -> Velocity:
        wanted, ahead, true = self.path(t_s), self.path(t_s + 0.1), self.truth()
        speed = (level_axes(ahead) - level_axes(wanted)) / 0.1
        v = _GAIN * (true.d_body_pad_level - level_axes(wanted)) - speed
        yaw = thesis_yaw_rad(math.radians(wanted.yaw_deg))
        turn = _YAW_GAIN * wrap_pi(yaw - true.yaw_rad) - wrap_pi(math.radians(ahead.yaw_deg - wanted.yaw_deg)) / 0.1
        return Velocity(np.clip(v, -_FASTEST_M_S, _FASTEST_M_S), float(np.clip(turn, -_FASTEST_RAD_S, _FASTEST_RAD_S)))


class ExternalPilot(Pilot):
    """Lands by a controller that knows nothing of how the estimate is made: it receives the estimate and returns a command.

    It stands for the network of section 5.1.8, whose weights were not published: a proportional law that turns to heading 0,
    closes in, and descends while it is over the pad.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._landing = False

    @property
    def outcome(self) -> FlightOutcome | None:
        """The outcome of the flight; on the ground it has landed if the controller had ordered that."""
        ended = super().outcome
        return FlightOutcome.LANDED if self._landing and ended is FlightOutcome.LANDED_BY_OTHERS else ended

    def decide(self, now: MonoNs) -> Decision:
        """Return the beliefs of guidance's cycle with the command of the controller."""
        decision = super().decide(now)
        if self.outcome is FlightOutcome.LANDED:
            return decision
        return replace(decision, phase="external controller", command=self._control(decision.belief))

    def _control(self, state: RelativeState | None) -> Command:
        if state is None or not state.consistent:
            return Land() if self._landing else Hover()
        d, v = state.d_body_pad_level, state.v_pad_level
        over = state.lateral_m < 0.08 + 0.08 * state.height_m
        self._landing = self._landing or (state.height_m < _LAND_BELOW_M and state.lateral_m < _LAND_WITHIN_M)
        if self._landing:
            return Land()
        along = 0.8 * d[:2] + 0.5 * v[:2]
        turn = 0.0 if state.yaw_rad is None else 0.6 * wrap_pi(thesis_yaw_rad(0.0) - state.yaw_rad)
        wanted = np.array([*np.clip(along, -0.5, 0.5), 0.3 if over else 0.0])
        return Velocity(wanted, float(np.clip(turn, -0.5, 0.5)))
