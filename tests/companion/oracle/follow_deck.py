"""A cycle of the controller `follow_deck`, which the core is to agree with: its memory as plain values, its steps one by one."""

from __future__ import annotations

import math
from collections.abc import Callable

from msgspec import Struct
from msgspec.structs import replace

from companion.guidance import disturbance
from companion.guidance.controller import Knowledge, Target
from companion.guidance.disturbance import ObserverNoise
from companion.guidance.follow_deck import FollowDeck
from companion.guidance.tilt_law import TiltGains
from companion.guidance.tuning import AS_GIVEN, TuningChoice
from companion.guidance.view import FieldOfView
from companion.settings.response import Response
from estimator.contracts.commands import Command, Hover, Lean
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import fixed_pair, fixed_vector, wrap_pi
from estimator.contracts.motion import G_M_S2, BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs, seconds_between
from tests.companion.oracle import climb_law, deck_turn, own_part
from tests.companion.oracle.axis import AxisMeasured, TiltAxis, begun, command, commanded, observed, reference
from tests.companion.oracle.deck_turn import DeckTurn
from tests.companion.oracle.heave import STILL, DeckAhead, deck_ahead
from tests.companion.oracle.own_part import OwnPart
from tests.companion.oracle.view import lean_in_view

_GAP_MAX_S = 0.5
"""A silence longer than this makes the observer begin again at what is measured; what it has learned of the wind it keeps."""
LEAP_M = 0.5
"""An estimate that leaps by more is another one, and the observer begins there; what it has learned of the wind it keeps."""
_TURN_MAX_RAD_S = 0.6
_HEADING_GAIN_1_S = 0.8


class OracleMemory(Struct, frozen=True):
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


class OracleLaw(FollowDeck):
    """The controller, with everything that the core does of a cycle done here."""

    def __init__(
        self,
        response: Response,
        period_s: float,
        view: FieldOfView | None = None,
        *,
        noise: ObserverNoise | None = None,
        forecast: bool = True,
        over_ground: bool = False,
    ) -> None:
        super().__init__(response, period_s, view, noise=noise, forecast=forecast, over_ground=over_ground)
        self.view, self._forecast = view, forecast
        self.observers = disturbance.observer_gains(noise or ObserverNoise(), period_s)

    def start(self) -> OracleMemory:  # type: ignore[override]
        return OracleMemory(climbs=(0.0,) * self._remembered)

    def _blended(self, memory: OracleMemory, of: Callable[[TuningChoice], float]) -> float:
        """Return a number of the gains that are flown by: while they change, one between the earlier and the later."""
        after = of(memory.tuning)
        return after if memory.share == 1.0 else memory.share * after + (1.0 - memory.share) * of(memory.tuning_before)

    def _slowness_s(self, choice: TuningChoice) -> float:
        return self._tuning(choice).response.slowness_s

    def _climbs(self, memory: OracleMemory, choice: TuningChoice) -> tuple[float, ...]:
        """Return the climb commands under way: what delays the tilt longer than its file says delays the climb as well."""
        delay_s = self.response.climb.delay_s + choice.longer_s
        return memory.climbs[: max(1, min(self._remembered, round(delay_s / self.period_s)))]

    def step(  # type: ignore[override]
        self, memory: OracleMemory, now: MonoNs, knowledge: Knowledge, target: Target | None
    ) -> tuple[OracleMemory, Command]:
        """Run one guidance cycle; `Hover` without a target, or without an estimate."""
        body, relative, deck = knowledge.body, knowledge.relative, knowledge.deck
        assert body is not None
        assert relative is not None
        frame = _Frame(math.cos(body.heading_rad), math.sin(body.heading_rad))
        wanted = self._wanted(memory, knowledge, target)  # type: ignore[arg-type]
        memory = self._retuned(memory, now, wanted)  # type: ignore[arg-type,assignment]
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
        self, memory: OracleMemory, now: MonoNs, axes: tuple[TiltAxis, TiltAxis], *, steers: bool
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
        self, memory: OracleMemory, now: MonoNs, relative: RelativeState, body: BodyMotion, here: DeckAhead, frame: _Frame
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

        off_m = (z.p - axis.seen.p - dt * axis.seen.w for axis, z in zip(memory.axes, (north, east), strict=True))
        leapt = math.hypot(*off_m) > LEAP_M

        def after(axis: TiltAxis, z: AxisMeasured) -> TiltAxis:
            if leapt:
                axis = replace(axis, seen=replace(axis.seen, p=z.p - dt * z.w, w=z.w))
            arrived = axis.under_way[newest - 1]
            if memory.share < 1.0:
                earlier = axis.under_way[self._tuning(memory.tuning_before).under_way - 1]
                arrived = memory.share * arrived + (1.0 - memory.share) * earlier
            return observed(axis, z, dt, gains, tilt, arrived)

        return after(memory.axes[0], north), after(memory.axes[1], east)

    def _lean(
        self,
        memory: OracleMemory,
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
        memory: OracleMemory,
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
    def _noted(memory: OracleMemory, u: tuple[float, float], down: float) -> OracleMemory:
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


def _deck_turn(memory: OracleMemory, now: MonoNs, relative: RelativeState, body: BodyMotion) -> DeckTurn | None:
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
