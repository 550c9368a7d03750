"""The controller `follow_deck`: keep over the pad and follow the deck's heave, down to contact (docs/guidance.md).

Horizontally a disturbance observer (`disturbance`) and a regulator over tilt and commands under way (`tilt_law`), one axis at a
time (`axis`); vertically a predictor with the deck's forecast (`climb_law`, `heave`). Everything horizontal is kept in axes that
do not turn with the nose.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from msgspec import Struct, field
from msgspec.structs import replace

from companion.guidance import climb_law, deck_turn, disturbance, own_part
from companion.guidance.axis import AxisMeasured, TiltAxis, begun, command, commanded, observed, reference
from companion.guidance.controller import Knowledge, Target
from companion.guidance.deck_turn import DeckTurn
from companion.guidance.disturbance import ObserverNoise
from companion.guidance.heave import STILL, DeckAhead, deck_ahead
from companion.guidance.own_part import OwnPart
from companion.guidance.pid import Pid
from companion.guidance.pid_controller import PidController
from companion.guidance.response import Response
from companion.guidance.response_watch import DELAY_MAX_S
from companion.guidance.tilt_law import TiltGains, TiltWeights
from companion.guidance.tuning import AS_GIVEN, SOFTER_LONGER_S, TiltTuning, TuningChoice, chosen_tuning, tuned
from companion.guidance.view import FieldOfView, lean_in_view
from estimator.contracts.commands import Command, Hover, Lean
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import fixed_pair, fixed_vector, wrap_pi
from estimator.contracts.motion import G_M_S2, BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs, seconds_between

_GAP_MAX_S = 0.5
"""A silence longer than this makes the observer begin again at what is measured; what it has learned of the wind it keeps."""
_TURN_MAX_RAD_S = 0.6
_HEADING_GAIN_1_S = 0.8
_BLEND_S = 1.0
"""Time in which the command goes over from one set of gains to another, s."""


class FollowDeckMemory(Struct, frozen=True):
    """The controller's memory. Its axes are north and east by the filter's heading."""

    at: MonoNs | None = None
    axes: tuple[TiltAxis, TiltAxis] | None = None
    pushed_down_m_s2: float = 0.0
    """What accelerates the body beside its answer to climb commands."""
    climbs: tuple[float, ...] = ()
    """Commanded vertical speeds, newest first, m/s down."""
    tuning: TuningChoice = AS_GIVEN
    """The gains that are flown by."""
    tuning_before: TuningChoice = AS_GIVEN
    """Those before them, from which the command goes over."""
    share: float = 1.0
    """Share of the former, 0 to 1."""
    plain: Pid = field(default_factory=Pid.start)
    """The memory of the fallback."""
    own: tuple[OwnPart, OwnPart] | None = None
    """What a vehicle with a velocity loop of its own adds to the lean; None for one without."""
    turn: DeckTurn | None = None
    """The deck's turn; None while no heading against the arrow is known."""


class _Frame(Struct, frozen=True):
    """The heading of `level`: between it and the axes of the memory."""

    c: float
    s: float

    def ned(self, forward: float, right: float) -> tuple[float, float]:
        return self.c * forward - self.s * right, self.s * forward + self.c * right

    def level(self, north: float, east: float) -> tuple[float, float]:
        return self.c * north + self.s * east, self.c * east - self.s * north


class FollowDeck:
    """The controller. Gains are solved once for each response that is flown by: those of the file here, others when they are.

    Args:
        response: how the vehicle answers.
        period_s: the guidance period.
        view: the camera's field of view; None for no limit by it.
        weights: of the regulator.
        noise: of the observer.
        forecast: whether the deck's motion is known ahead; without it the deck is followed from behind.
        delay_line: whether commands under way are known; without it the vehicle is taken to answer at once.
        fallback: flies where the estimator path knows nothing of the body's motion.
        over_ground: whether the vehicle takes velocities over the ground with an acceleration, and cancels wind by itself.

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
        over_ground: bool = False,
    ) -> None:
        self._fallback, self._over_ground = fallback, over_ground
        self.response, self.period_s, self.view = response, period_s, view
        self._weights, self._delay_line = weights or TiltWeights(), delay_line
        self._tunings: dict[TuningChoice, TiltTuning] = {}
        for soft in (False, True):
            self._tuning(TuningChoice(0.0, soft)).solve()
        self.observers = disturbance.observer_gains(noise or ObserverNoise(), period_s)
        self._forecast = forecast
        longest_s = max(DELAY_MAX_S, response.tilt.delay_s, response.climb.delay_s)
        self._remembered = math.ceil((longest_s + SOFTER_LONGER_S) / period_s) + 1

    @property
    def climb_max_m_s(self) -> float:
        """The fastest climb that it asks for, m/s."""
        return self.response.climb.max_m_s

    def start(self) -> FollowDeckMemory:
        """Return the memory before the first cycle."""
        return FollowDeckMemory(climbs=(0.0,) * self._remembered)

    def _tuning(self, choice: TuningChoice) -> TiltTuning:
        """Return the gains of a choice, kept once they are made."""
        if choice not in self._tunings:
            response, weights = tuned(self.response.tilt, self._weights, choice)
            self._tunings[choice] = TiltTuning(response, weights, self.period_s, delay_line=self._delay_line)
        return self._tunings[choice]

    def _retuned(self, memory: FollowDeckMemory, now: MonoNs, wanted: TuningChoice) -> FollowDeckMemory:
        """Return the memory with the gains that are wanted: at once before the first cycle, otherwise little by little."""
        if memory.at is None:
            return replace(memory, tuning=wanted, tuning_before=wanted, share=1.0)
        share = min(1.0, memory.share + max(0.0, seconds_between(memory.at, now)) / _BLEND_S)
        if share == 1.0 and wanted != memory.tuning:
            return replace(memory, tuning=wanted, tuning_before=memory.tuning, share=0.0)
        return memory if share == memory.share else replace(memory, share=share)

    def _blended(self, memory: FollowDeckMemory, of: Callable[[TuningChoice], float]) -> float:
        """Return a number of the gains that are flown by: while they change, one between the earlier and the later."""
        after = of(memory.tuning)
        return after if memory.share == 1.0 else memory.share * after + (1.0 - memory.share) * of(memory.tuning_before)

    def _slowness_s(self, choice: TuningChoice) -> float:
        return self._tuning(choice).response.slowness_s

    def _climbs(self, memory: FollowDeckMemory, choice: TuningChoice) -> tuple[float, ...]:
        """Return the climb commands under way: what delays the tilt longer than its file says delays the climb as well."""
        delay_s = self.response.climb.delay_s + choice.longer_s
        return memory.climbs[: max(1, min(self._remembered, round(delay_s / self.period_s)))]

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
        frame = _Frame(math.cos(body.heading_rad), math.sin(body.heading_rad))
        memory = self._retuned(memory, now, chosen_tuning(knowledge.response))
        here = self._deck_ahead(deck, knowledge, 0.0)
        axes = self._axes(memory, now, relative, body, here, frame)
        v_down = (0.0 if deck is None else deck.v_level.item(2)) - relative.v_pad_level.item(2)
        if memory.share == 1.0:
            arrived = self._climbs(memory, memory.tuning)[-1]
        else:
            arrived = self._blended(memory, lambda choice: self._climbs(memory, choice)[-1])
        pushed = climb_law.pushed(
            memory.pushed_down_m_s2, body.a_level.item(2), v_down, arrived, self.period_s, self.response.climb
        )
        own = self._own(memory, now, axes, steers=target is not None) if self._over_ground else None
        turn = _deck_turn(memory, now, relative, body)
        memory = replace(memory, at=now, axes=axes, pushed_down_m_s2=pushed, own=own, turn=turn)
        if target is None:
            return self._noted(memory, (axes[0].lean, axes[1].lean), v_down), Hover()
        soon = self._blended(memory, self._slowness_s)
        then = self._deck_ahead(deck, knowledge, soon)
        forward, right, trim = self._lean(memory, relative, target, (here, then), frame)
        if memory.share == 1.0:
            down = self._down(memory, memory.tuning, relative, knowledge, target, v_down)
        else:
            down = self._blended(memory, lambda choice: self._down(memory, choice, relative, knowledge, target, v_down))
        memory = self._noted(memory, frame.ned(forward, right), down)
        if own is not None:
            # A velocity loop of its own gets its own velocity, so that only its integral adds to the acceleration.
            soon, trim = 0.0, frame.level(own[0].own, own[1].own)
        v, a = relative.v_pad_level.tolist(), (forward - trim[0], right - trim[1])
        along = (0.0, 0.0)
        if deck is not None:
            v_deck = deck.v_level.tolist()
            along = v_deck[0] + soon * a[0] - v[0], v_deck[1] + soon * a[1] - v[1]
        return memory, Lean(fixed_pair(*a), fixed_pair(*trim), fixed_vector(*along, down), _turn(relative, target, turn))

    def _own(
        self, memory: FollowDeckMemory, now: MonoNs, axes: tuple[TiltAxis, TiltAxis], *, steers: bool
    ) -> tuple[OwnPart, OwnPart]:
        dt = 0.0 if memory.at is None else seconds_between(memory.at, now)
        if memory.own is None or not 0.0 < dt <= _GAP_MAX_S:
            return own_part.begun(axes[0].lean), own_part.begun(axes[1].lean)
        north, east = memory.own
        if not steers:
            return own_part.hovered(north, axes[0].lean, dt), own_part.hovered(east, axes[1].lean, dt)
        tilt = self.response.tilt
        return own_part.flown(north, axes[0].lean, axes[0].lag, dt, tilt), own_part.flown(
            east, axes[1].lean, axes[1].lag, dt, tilt
        )

    def _deck_ahead(self, deck: DeckMotion | None, knowledge: Knowledge, ahead_s: float) -> DeckAhead:
        return deck_ahead(deck, knowledge.forecast, knowledge.at, ahead_s) if self._forecast else STILL

    def _axes(
        self, memory: FollowDeckMemory, now: MonoNs, relative: RelativeState, body: BodyMotion, here: DeckAhead, frame: _Frame
    ) -> tuple[TiltAxis, TiltAxis]:
        """Observe: return the memory of both axes with this cycle's measurement."""
        d, v, a = relative.d_body_pad_level.tolist(), relative.v_pad_level.tolist(), body.a_level.tolist()
        roll_rate, pitch_rate, _ = body.w_body.tolist()
        ned, lean = frame.ned, body.lean_m_s2
        (pn, pe), (wn, we), (ln, le) = ned(d[0], d[1]), ned(v[0], v[1]), ned(lean[0], lean[1])
        rn, re = ned(-G_M_S2 * pitch_rate, G_M_S2 * roll_rate)
        (an, ae), (dn, de) = ned(a[0], a[1]), ned(here.a_m_s2[0], here.a_m_s2[1])
        north, east = AxisMeasured(pn, wn, ln, rn, an, dn), AxisMeasured(pe, we, le, re, ae, de)
        dt = 0.0 if memory.at is None else seconds_between(memory.at, now)
        if memory.axes is None or not 0.0 < dt <= _GAP_MAX_S:
            x, y = (None, None) if memory.axes is None else memory.axes
            return begun(north, self._remembered, x), begun(east, self._remembered, y)
        gains = disturbance.chosen(self.observers, _sigma_m(relative))
        tilt, newest = self.response.tilt, self._tuning(memory.tuning).under_way

        def after(axis: TiltAxis, z: AxisMeasured) -> TiltAxis:
            arrived = axis.under_way[newest - 1]
            if memory.share < 1.0:
                earlier = axis.under_way[self._tuning(memory.tuning_before).under_way - 1]
                arrived = memory.share * arrived + (1.0 - memory.share) * earlier
            return observed(axis, z, dt, gains, tilt, arrived)

        return after(memory.axes[0], north), after(memory.axes[1], east)

    def _lean(
        self,
        memory: FollowDeckMemory,
        relative: RelativeState,
        target: Target,
        deck: tuple[DeckAhead, DeckAhead],
        frame: _Frame,
    ) -> tuple[float, float, tuple[float, float]]:
        """Return the lean to command, m/s^2 forward and right, and the part of it that is trim.

        Args:
            deck: the deck now, and when the command has taken effect.
        """
        axes, sigma_m = memory.axes, _sigma_m(relative)
        assert axes is not None
        ahead = frame.ned(*deck[0].a_m_s2[:2]), frame.ned(*deck[1].a_m_s2[:2])
        want = target.d_body_pad_level.tolist()
        offset = frame.ned(want[0], want[1])
        far = axes[0].seen.p - offset[0], axes[1].seen.p - offset[1]
        u = _regulated(axes, self._tuning(memory.tuning).gains(sigma_m), far, target.speed_max_m_s, *ahead)
        if memory.share < 1.0:
            before = _regulated(axes, self._tuning(memory.tuning_before).gains(sigma_m), far, target.speed_max_m_s, *ahead)
            u = tuple(memory.share * x + (1.0 - memory.share) * y for x, y in zip(u, before, strict=True))
        trim = frame.level(reference(axes[0], 0.0), reference(axes[1], 0.0))
        forward, right = frame.level(*u)
        if self.view is not None:
            forward, right = lean_in_view(self.view, (forward, right), trim, relative.d_body_pad_level.tolist())
        most = self.response.tilt.max_m_s2
        if target.lean_max_rad is not None:
            most = min(most, G_M_S2 * math.tan(target.lean_max_rad))
        size = math.hypot(forward, right)
        cut = most / size if size > most else 1.0
        return cut * forward, cut * right, trim

    def _down(
        self,
        memory: FollowDeckMemory,
        choice: TuningChoice,
        relative: RelativeState,
        knowledge: Knowledge,
        target: Target,
        v_down: float,
    ) -> float:
        """Return the vertical speed to command by one choice, m/s down."""
        climb, pushed, under_way = self.response.climb, memory.pushed_down_m_s2, self._climbs(memory, choice)
        v_then, way = climb_law.predicted(v_down, pushed, under_way, self.period_s, climb)
        then = self._deck_ahead(knowledge.deck, knowledge, len(under_way) * self.period_s)
        height_then = relative.height_m + then.moved_m[2] - way
        down = climb_law.climb_command(
            climb, v_then, pushed, then.v_m_s[2], then.a_m_s2[2],
            height_then - target.d_body_pad_level.item(2), target.descent_rate_m_s, target.vertical_rate_max_m_s,
        )  # fmt: skip
        return min(climb.max_m_s, max(-climb.max_m_s, down))

    @staticmethod
    def _noted(memory: FollowDeckMemory, u: tuple[float, float], down: float) -> FollowDeckMemory:
        """Note what was commanded; while somebody else commands, what the vehicle does."""
        assert memory.axes is not None
        north, east = memory.axes
        axes = (commanded(north, u[0]), commanded(east, u[1]))
        return replace(memory, axes=axes, climbs=(down, *memory.climbs[:-1]))


def _regulated(
    axes: tuple[TiltAxis, TiltAxis],
    gains: TiltGains,
    far_m: tuple[float, float],
    speed_max_m_s: float,
    a_deck: tuple[float, float],
    a_deck_then: tuple[float, float],
) -> tuple[float, ...]:
    """Return the tilt that one set of gains commands north and east, m/s^2, not limited yet."""
    # A place far off asks for no more than the speed that is allowed.
    size, reach = math.hypot(*far_m), speed_max_m_s * gains.w / gains.p
    shrink = reach / size if size > reach else 1.0
    return (
        command(axes[0], gains, shrink * far_m[0], a_deck[0], a_deck_then[0]),
        command(axes[1], gains, shrink * far_m[1], a_deck[1], a_deck_then[1]),
    )


def _sigma_m(relative: RelativeState) -> float:
    return math.sqrt(max(relative.cov.item(0, 0), relative.cov.item(1, 1), 0.0))


def _deck_turn(memory: FollowDeckMemory, now: MonoNs, relative: RelativeState, body: BodyMotion) -> DeckTurn | None:
    if relative.yaw_rad is None:
        return None
    dt = 0.0 if memory.at is None else seconds_between(memory.at, now)
    known = memory.turn if 0.0 < dt <= _GAP_MAX_S else None
    return deck_turn.observed(known, relative.yaw_rad, body.w_body.item(2), dt)


def _turn(relative: RelativeState, target: Target, deck: DeckTurn | None) -> float:
    if target.yaw_rad is None or relative.yaw_rad is None or deck is None:
        return 0.0
    turn = deck.rate_rad_s + _HEADING_GAIN_1_S * wrap_pi(target.yaw_rad - relative.yaw_rad)
    return min(_TURN_MAX_RAD_S, max(-_TURN_MAX_RAD_S, turn))
