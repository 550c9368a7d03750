"""The controller `follow_deck`: keep over the pad and follow the deck's heave, down to contact (docs/guidance.md).

Horizontally a disturbance observer (`disturbance`) and a regulator over tilt and commands under way (`tilt_law`), one axis at a
time (`axis`); vertically a predictor with the deck's forecast (`climb_law`, `heave`). Everything horizontal is kept in axes that
do not turn with the nose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from companion.guidance import climb_law, disturbance
from companion.guidance.axis import AxisMeasured, TiltAxis, begun, command, commanded, observed, reference
from companion.guidance.controller import Knowledge, Target
from companion.guidance.disturbance import ObserverNoise
from companion.guidance.heave import STILL, DeckAhead, deck_ahead
from companion.guidance.pid import Pid
from companion.guidance.pid_controller import PidController
from companion.guidance.response import Response
from companion.guidance.tilt_law import TiltWeights, tilt_gains
from companion.guidance.view import FieldOfView, lean_in_view
from estimator.contracts.commands import Command, Hover, Lean
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.motion import G_M_S2, BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs, seconds_between

_GAP_MAX_S = 0.5
"""A silence longer than this makes the observer begin again at what is measured; what it has learned of the wind it keeps."""
_TURN_MAX_RAD_S = 0.6
_HEADING_GAIN_1_S = 0.8
_STIFF_M = 0.01
"""Standard deviation of the place up to which the regulator is as stiff as its weights say, m."""


@dataclass(frozen=True, slots=True)
class FollowDeckMemory:
    """The controller's memory. Its axes are north and east by the filter's heading."""

    at: MonoNs | None = None
    axes: tuple[TiltAxis, TiltAxis] | None = None
    pushed_down_m_s2: float = 0.0
    """What accelerates the body beside its answer to climb commands."""
    climbs: tuple[float, ...] = ()
    """Commanded vertical speeds, newest first, m/s down."""
    plain: Pid = field(default_factory=Pid.start)
    """The memory of the fallback."""


@dataclass(frozen=True, slots=True)
class _Frame:
    """The heading of `level`: between it and the axes of the memory."""

    c: float
    s: float

    @staticmethod
    def of(body: BodyMotion) -> _Frame:
        return _Frame(math.cos(body.heading_rad), math.sin(body.heading_rad))

    def ned(self, forward: float, right: float) -> tuple[float, float]:
        return self.c * forward - self.s * right, self.s * forward + self.c * right

    def level(self, north: float, east: float) -> tuple[float, float]:
        return self.c * north + self.s * east, self.c * east - self.s * north


class FollowDeck:
    """The controller. Gains are solved once, here.

    Args:
        response: how the vehicle answers.
        period_s: the guidance period.
        view: the camera's field of view; None for no limit by it.
        weights: of the regulator.
        noise: of the observer.
        forecast: whether the deck's motion is known ahead; without it the deck is followed from behind.
        delay_line: whether commands under way are known; without it the vehicle is taken to answer at once.
        fallback: flies where the estimator path knows nothing of the body's motion.

    Raises:
        ValueError: there are no gains that stabilise such a vehicle.
    """

    name = "follow_deck"

    def __init__(
        self,
        response: Response,
        period_s: float,
        view: FieldOfView | None = None,
        *,
        weights: TiltWeights | None = None,
        noise: ObserverNoise | None = None,
        forecast: bool = True,
        delay_line: bool = True,
        fallback: PidController | None = None,
    ) -> None:
        self._fallback = fallback
        self.response, self.period_s, self.view = response, period_s, view
        least = weights or TiltWeights()
        # Higher up the place is known to decimetres, and a stiff loop would only fly after its errors.
        scaled = [least._replace(p_m=least.p_m * max(1.0, sigma / _STIFF_M)) for sigma in disturbance.SIGMAS_P_M]
        self.gains = tuple(tilt_gains(response.tilt, each, period_s, delay_line=delay_line) for each in scaled)
        self.observers = disturbance.observer_gains(noise or ObserverNoise(), period_s)
        self._forecast = forecast
        self._under_way = max(1, math.ceil(response.tilt.delay_s / period_s - 1e-9))
        self._climbs = max(1, round(response.climb.delay_s / period_s))

    def start(self) -> FollowDeckMemory:
        """Return the memory before the first cycle."""
        return FollowDeckMemory(climbs=(0.0,) * self._climbs)

    def step(
        self, memory: FollowDeckMemory, now: MonoNs, knowledge: Knowledge, target: Target | None
    ) -> tuple[FollowDeckMemory, Command]:
        """Run one guidance cycle; `Hover` without a target, or without an estimate."""
        body, relative, deck = knowledge.body, knowledge.relative, knowledge.deck
        if relative is None or (body is None and self._fallback is None):
            return memory, Hover()
        if body is None:
            assert self._fallback is not None
            plain, given = self._fallback.step(memory.plain, now, knowledge, target)
            return replace(memory, plain=plain), given
        frame = _Frame.of(body)
        here = self._deck_ahead(deck, knowledge, 0.0)
        axes = self._axes(memory, now, relative, body, here, frame)
        v_down = (0.0 if deck is None else float(deck.v_level[2])) - float(relative.v_pad_level[2])
        pushed = climb_law.pushed(
            memory.pushed_down_m_s2, float(body.a_level[2]), v_down, memory.climbs[-1], self.period_s, self.response.climb
        )
        memory = FollowDeckMemory(now, axes, pushed, memory.climbs, memory.plain)
        if target is None:
            return self._noted(memory, (axes[0].lean, axes[1].lean), v_down), Hover()
        forward, right, trim = self._lean(axes, relative, knowledge, target, here, frame)
        down = self._down(memory, relative, knowledge, target, v_down)
        memory = self._noted(memory, frame.ned(forward, right), down)
        v, a = relative.v_pad_level.tolist(), np.array([forward - trim[0], right - trim[1]])
        # A vehicle that takes velocities gets the one that it will have: it goes that way even where it ignores accelerations.
        soon = self.response.tilt.slowness_s
        along = [0.0, 0.0] if deck is None else [float(deck.v_level[k] + soon * a[k]) - v[k] for k in range(2)]
        return memory, Lean(a, np.array(trim), np.array([*along, down]), _turn(relative, target))

    def _deck_ahead(self, deck: DeckMotion | None, knowledge: Knowledge, ahead_s: float) -> DeckAhead:
        return deck_ahead(deck, knowledge.forecast, knowledge.at, ahead_s) if self._forecast else STILL

    def _axes(
        self, memory: FollowDeckMemory, now: MonoNs, relative: RelativeState, body: BodyMotion, here: DeckAhead, frame: _Frame
    ) -> tuple[TiltAxis, TiltAxis]:
        """Observe: return the memory of both axes with this cycle's measurement."""
        d, v, a = relative.d_body_pad_level.tolist(), relative.v_pad_level.tolist(), body.a_level.tolist()
        roll_rate, pitch_rate, _ = body.w_body.tolist()
        measured = (d, v, body.lean_m_s2, (-G_M_S2 * pitch_rate, G_M_S2 * roll_rate), a, here.a_m_s2)
        north, east = (AxisMeasured(*of) for of in zip(*(frame.ned(m[0], m[1]) for m in measured), strict=True))
        dt = 0.0 if memory.at is None else seconds_between(memory.at, now)
        if memory.axes is None or not 0.0 < dt <= _GAP_MAX_S:
            x, y = (None, None) if memory.axes is None else memory.axes
            return begun(north, self._under_way, x), begun(east, self._under_way, y)
        gains = disturbance.chosen(self.observers, _sigma_m(relative))
        x, y = memory.axes
        tilt = self.response.tilt
        return observed(x, north, dt, gains, tilt), observed(y, east, dt, gains, tilt)

    def _lean(
        self,
        axes: tuple[TiltAxis, TiltAxis],
        relative: RelativeState,
        knowledge: Knowledge,
        target: Target,
        here: DeckAhead,
        frame: _Frame,
    ) -> tuple[float, float, tuple[float, float]]:
        """Return the lean to command, m/s^2 forward and right, and the part of it that is trim."""
        g, tilt = disturbance.chosen(self.gains, _sigma_m(relative)), self.response.tilt
        then = self._deck_ahead(knowledge.deck, knowledge, tilt.slowness_s)
        a_now, a_then = frame.ned(*here.a_m_s2[:2]), frame.ned(*then.a_m_s2[:2])
        want = target.d_body_pad_level.tolist()
        offset = frame.ned(want[0], want[1])
        far = [axes[k].seen.p - offset[k] for k in range(2)]
        # A place far off asks for no more than the speed that is allowed.
        size, reach = math.hypot(*far), target.speed_max_m_s * g.w / g.p
        shrink = reach / size if size > reach else 1.0
        u = [command(axes[k], g, shrink * far[k], a_now[k], a_then[k]) for k in range(2)]
        trim = frame.level(*(reference(axes[k], 0.0) for k in range(2)))
        forward, right = frame.level(*u)
        if self.view is not None:
            forward, right = lean_in_view(self.view, (forward, right), trim, relative.d_body_pad_level.tolist())
        most = tilt.max_m_s2
        if target.lean_max_rad is not None:
            most = min(most, G_M_S2 * math.tan(target.lean_max_rad))
        size = math.hypot(forward, right)
        cut = most / size if size > most else 1.0
        return cut * forward, cut * right, trim

    def _down(
        self, memory: FollowDeckMemory, relative: RelativeState, knowledge: Knowledge, target: Target, v_down: float
    ) -> float:
        """Return the vertical speed to command, m/s down."""
        climb, pushed = self.response.climb, memory.pushed_down_m_s2
        v_then, way = climb_law.predicted(v_down, pushed, memory.climbs, self.period_s, climb)
        then = self._deck_ahead(knowledge.deck, knowledge, self._climbs * self.period_s)
        height_then = relative.height_m + then.moved_m[2] - way
        down = climb_law.climb_command(
            climb, v_then, pushed, then.v_m_s[2], then.a_m_s2[2],
            height_then - float(target.d_body_pad_level[2]), target.descent_rate_m_s, target.vertical_rate_max_m_s,
        )  # fmt: skip
        return min(climb.max_m_s, max(-climb.max_m_s, down))

    @staticmethod
    def _noted(memory: FollowDeckMemory, u: tuple[float, float], down: float) -> FollowDeckMemory:
        """Note what was commanded; while somebody else commands, what the vehicle does."""
        assert memory.axes is not None
        north, east = memory.axes
        axes = (commanded(north, u[0]), commanded(east, u[1]))
        return replace(memory, axes=axes, climbs=(down, *memory.climbs[:-1]))


def _sigma_m(relative: RelativeState) -> float:
    return math.sqrt(max(float(relative.cov[0, 0]), float(relative.cov[1, 1]), 0.0))


def _turn(relative: RelativeState, target: Target) -> float:
    if target.yaw_rad is None or relative.yaw_rad is None:
        return 0.0
    turn = _HEADING_GAIN_1_S * wrap_pi(target.yaw_rad - relative.yaw_rad)
    return min(_TURN_MAX_RAD_S, max(-_TURN_MAX_RAD_S, turn))
