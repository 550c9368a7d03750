"""The person who flew the thesis' drone by hand, and a controller from outside: pilots that command in place of guidance.

The hand follows wanted poses over time in the thesis' axes. The thesis gives the drone's place over the pad in the axes of the
drone's own heading: x ahead of the pad along its nose, y to the left, z up, and the heading counter-clockwise from a nose that
points to the left of the arrow.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace

from companion.base.mission import FlightOutcome
from companion.base.observer import Decision
from companion.guidance.pilot import Pilot
from estimator.contracts.commands import Command, Hover, Land, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import MonoNs, seconds_between
from sitl.world.truth import Truth


class HeldPose(NamedTuple):
    """A place over the pad in the thesis' axes, and the heading."""

    x_m: float
    y_m: float
    z_m: float
    yaw_deg: float = 0.0


Path = Callable[[float], HeldPose]
"""The wanted pose at a time in seconds after the start."""


def thesis_axes(d_body_pad_level: F64) -> F64:
    """Return (3,) m x, y, z of the drone over the pad, from the vector to the pad (forward, right, down)."""
    return np.array([-d_body_pad_level[0], d_body_pad_level[1], d_body_pad_level[2]])


def level_axes(pose: HeldPose) -> F64:
    """Return (3,) m forward, right, down to the pad: the inverse of `thesis_axes`."""
    return np.array([-pose.x_m, pose.y_m, pose.z_m])


def thesis_yaw_rad(yaw_rad: float) -> float:
    """Return the thesis' heading of a heading against the arrow, clockwise; the same formula leads back."""
    return wrap_pi(-yaw_rad - 0.5 * math.pi)


def hold(pose: HeldPose) -> Path:
    """Return the path that stays in one place."""
    return lambda t_s: pose


def way(points: Sequence[tuple[float, HeldPose]]) -> Path:
    """Return the path through poses at times, straight and at an even speed between them."""
    times = [t for t, _ in points]
    poses = np.array([p for _, p in points])

    def at(t_s: float) -> HeldPose:
        return HeldPose(*(float(np.interp(t_s, times, poses[:, i])) for i in range(4)))

    return at


def up_and_down(low_m: float, high_m: float, speed_m_s: float, x_m: float = 0.0) -> tuple[Path, float]:
    """Return the path from a height to another and back with a rest at each end, and its duration in seconds."""
    rest_s, climb_s = 4.0, (high_m - low_m) / speed_m_s
    low, high = HeldPose(x_m, 0.0, low_m), HeldPose(x_m, 0.0, high_m)
    times = np.cumsum([0.0, rest_s, climb_s, rest_s, climb_s, rest_s])
    return way(list(zip(times.tolist(), [low, low, high, high, low, low], strict=True))), float(times[-1])


def around_the_ship(speed_m_s: float) -> tuple[Path, float]:
    """Return the path of section 5.1.5: from over the pad ahead, around the ship and back, and its duration in seconds."""
    corners = [(0.0, 0.0), (6.0, 0.0), (6.0, 4.0), (-6.0, 4.0), (-6.0, -4.0), (6.0, -4.0), (6.0, 0.0), (0.0, 0.0)]
    t_s, points = 6.0, [(0.0, HeldPose(0.0, 0.0, 1.0))]
    for before, after in zip([corners[0], *corners], corners, strict=False):
        t_s += math.dist(before, after) / speed_m_s
        points.append((t_s, HeldPose(*after, 1.0)))
    points.append((t_s + 6.0, HeldPose(0.0, 0.0, 1.0)))
    return way(points), t_s + 6.0


def full_turn(height_m: float, rate_deg_s: float) -> tuple[Path, float]:
    """Return the path that turns once counter-clockwise over the pad, and its duration in seconds."""
    turn_s = 360.0 / rate_deg_s

    def at(t_s: float) -> HeldPose:
        turned = rate_deg_s * min(max(t_s - 3.0, 0.0), turn_s)
        return HeldPose(0.0, 0.0, height_m, math.degrees(wrap_pi(math.radians(turned))))

    return at, turn_s + 6.0


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
