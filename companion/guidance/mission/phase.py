"""A state of the mission as its file declares it, with the rows and the aims that many states share.

An aim says where to be against the deck; `allows` says what a command for it may do there.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from companion.base.mission import Event, State
from companion.guidance.controller import Knowledge, Target
from companion.guidance.mission import limits, out_of_reach
from companion.guidance.mission.clearance import WAITING_SIGMAS, rise_beyond_climb_m
from companion.guidance.mission.progress import GuidanceCycle, Progress, fit_to_steer, unfit, with_deck_m_s
from companion.guidance.mission.rules import Events, Row
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Command, Hover, Lean, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import seconds_between

GROUNDED: Row = {Event.CUT: State.EMERGENCY, Event.GROUNDED: State.LANDED, Event.GROUNDED_BY_OTHERS: State.LANDED_BY_OTHERS}
HELD: Row = {**GROUNDED, Event.ABORT: State.ABORTED, Event.LAND: State.LAND_HERE}
FLIGHT: Row = {**HELD, Event.HOLD: State.PAUSED}
OVER: Row = {Event.TIPPED: State.DOWN}
LANDING: Row = {**FLIGHT, **OVER, Event.TAKEN: State.TAKEN}
AROUND: Row = {Event.LIMIT: State.GO_AROUND, Event.TIMEOUT: State.GO_AROUND}
TRY: Row = {
    **LANDING,
    **AROUND,
    Event.OTHER_PAD: State.ANOTHER_PAD,
    Event.NO_CONDITIONS: State.GO_AROUND,
    Event.SIGHT_LOST: State.HOLD_BLIND,
}
STAYS: Row = {Event.STAY: State.INTERCEPT}
CALLED_OFF: Row = {Event.STAY: State.GO_AROUND}
"""An order to stay climbs first where the drone is on its last way to the deck."""

Aim = Target | Command | None
"""Target, finished command, or None: guidance leaves the vehicle alone."""
Aimed = tuple[Progress, Aim]
"""The memory after a guidance cycle, and its aim."""

_HOLD_SPEED_M_S = 0.5  # speed of the way back to the place that is held
_FREE_M = 1.0
"""Height over the held one from which a held vehicle climbs no more with its deck, m."""
_CLIMBS_WHERE_HELD = frozenset({State.COMMIT, State.ANOTHER_PAD})
"""States that hold a place and may climb from it."""
_REFUSED = (State.REFUSED, State.GAVE_UP)
_ADRIFT = 5.0
"""Factor on the deviation up to which it flies by an estimate whose pad the ship swung out of sight."""
_SIGMA_MAX_RAD = math.radians(20.0)
"""Uncertainty of the heading beyond which nothing turns by it."""
_LOOK_M_S = 0.4  # speed upwind and to lee of a search in wind
_LEG_S = 35.0  # time of each way of such a search
_STEPS_M = (2.0, -4.0, 6.0, -8.0, 4.0)
"""Steps aside of its ways back, in turn, m: each time farther to the other side, and then to the middle again."""
_TURN_1_S = 0.8  # rate of a turn for each radian that is left, 1/s
_TURN_MOST_RAD_S = 0.5  # rate of a turn at most


_STOPS_S = 3.0  # time after a hold in which the place that is held goes with the drone
_STANDS_M_S = 0.1  # speed over the deck from which on it does


def usable(s: GuidanceCycle, o: GuidanceOptions) -> RelativeState | None:
    """Return the estimate if it may be flown by without sight, else None."""
    estimate = s.estimate
    if estimate is None or abs(seconds_between(estimate.at, s.at)) > o.stale_after_s:
        return None
    # A ship that swings her pad away makes the last sightings disagree.
    if not estimate.consistent and (estimate.alerts or not estimate.adrift):
        return None
    sigma_max_m = _ADRIFT * o.tries.blind_sigma_m if estimate.adrift else o.tries.blind_sigma_m
    return estimate if limits.sigma_m(estimate) <= sigma_max_m else None


def climbs(p: Progress, s: GuidanceCycle, climb_m_s: float) -> tuple[Progress, Command]:
    """Climb against the deck, and stay with it otherwise."""
    flown_m_s, command = s.hold.climbing(climb_m_s, s.knowledge)
    return replace(p, climbs_m_s=flown_m_s), command


def still(p: Progress, s: GuidanceCycle, o: GuidanceOptions, searches: Velocity | None = None) -> Aimed:
    """Stay where the drone is against the deck, and never lower; or climb from there, where it is low without sight.

    Args:
        searches: flown where no estimate will do and it is not low; None stays.
    """
    estimate = usable(s, o)
    climb_m_s = out_of_reach.climb_m_s(p, s, o)
    # A pad that is not to be landed on is not followed either: its deck may fall away.
    if estimate is None or (p.track is not None and estimate.track != p.track):
        p = replace(p, held=None)
        return (p, searches) if searches and not out_of_reach.low(p, s, o) else climbs(p, s, climb_m_s)
    # A sight so short ago comes back as likely; another pad is best judged from higher up.
    waits = p.state is not State.ANOTHER_PAD and estimate.age_s(s.at) <= o.tries.climb_after_s
    if waits or (estimate.height_m >= o.tries.safe_height_m and not out_of_reach.near(p, s, o)):
        climb_m_s = 0.0
    held = estimate.d_body_pad_level if p.held is None else _in_present_axes(p.held, p.held_yaw_rad, estimate)
    # A person who orders a hold in flight wants a stop, and no way back to where the order came.
    stops = p.state in (State.PAUSED, State.ABORTED) and p.in_state_s(s.at) < _STOPS_S
    if stops and math.hypot(*estimate.v_pad_level[:2]) > _STANDS_M_S:
        held = np.array([*estimate.d_body_pad_level[:2], held[2]])
    speed, turns = _HOLD_SPEED_M_S, None
    if p.state is State.HOLD_BLIND:
        turns = turn_rad(s, o, estimate) if o.tries.heading == "across" else None
        if p.seen is not None and seconds_between(p.seen, s.at) <= o.tries.blind_s:
            held, speed = np.array([0.0, 0.0, held[2]]), o.cone.intercept_speed_m_s
    p = replace(p, held=held, held_yaw_rad=estimate.yaw_rad, climbs_m_s=with_deck_m_s(climb_m_s, s.knowledge))
    # A drone that was lifted stays up: nothing commands it down again, only a deck that rises comes nearer (`_following_less`).
    wanted = np.array([held[0], held[1], max(estimate.height_m, _held_height_m(p, held, s, o))])
    rate = -climb_m_s if climb_m_s > 0.0 else None
    return p, Target(wanted, descent_rate_m_s=rate, vertical_rate_max_m_s=o.tries.climb_m_s, speed_max_m_s=speed, yaw_rad=turns)


def still_as_ordered(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Aimed:
    """Stay against the deck; a vehicle that does not fly as ordered climbs out of reach, and hovers by itself."""
    if s.off_orders is None:
        return still(p, s, o)
    # Its own hover holds over the ground's level, and a deck may come up to it; orders may be turned round.
    if not out_of_reach.out_of_reach(p, s, o):
        return climbs(p, s, out_of_reach.fastest_climb_m_s(s, o))
    return p, Hover()


def looks_upwind(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Velocity | None:
    """Return the way on which a drone that leans against the wind looks for the pad; None in less wind.

    The lean turns the camera to lee, and a hover drifts there, so what was below is found upwind, and some way off. The drone
    flies there, back, and so on, each time farther to the other side, and turns the wider side of the field into the wind.
    """
    if s.wind is None or not s.wind.leans_far:
        return None
    turns, back = divmod(int(p.in_state_s(s.at) // _LEG_S), 2)
    speed, across = (-_LOOK_M_S, _STEPS_M[turns % len(_STEPS_M)] / _LEG_S) if back else (_LOOK_M_S, 0.0)
    turn = _TURN_1_S * s.wind.across_rad if o.tries.heading == "across" else 0.0
    ahead, aside = s.wind.into_level
    v = np.array([speed * ahead - across * aside, speed * aside + across * ahead, 0.0])
    return Velocity(v, max(-_TURN_MOST_RAD_S, min(_TURN_MOST_RAD_S, turn)))


def over_pad(
    target: Callable[[Progress, GuidanceCycle, GuidanceOptions, RelativeState], Target],
) -> Callable[[Progress, GuidanceCycle, GuidanceOptions], Aimed]:
    """Return an aim at a target by the estimate; without one it stays."""

    def aim(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Aimed:
        if s.estimate is None:
            return still(p, s, o)
        return p, replace(target(p, s, o, s.estimate), yaw_rad=turn_rad(s, o, s.estimate))

    return aim


def turn_rad(s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> float | None:
    """Return the heading against the arrow to turn to; None to keep the present one."""
    if estimate.yaw_rad is None:
        return None
    if o.tries.heading == "align":
        return 0.0 if float(estimate.cov[6, 6]) <= _SIGMA_MAX_RAD**2 else None
    turns = o.tries.heading == "across" and s.wind is not None and s.wind.leans_far
    return estimate.yaw_rad + s.wind.across_rad if turns and s.wind is not None else None


def waits_m(s: GuidanceCycle, o: GuidanceOptions) -> float:
    """Return the height over the deck at which it may wait for the forecast waves, m."""
    # A forecast of more than any swell that was watched is one of which nothing is known: no reason to climb without end.
    return min(o.cone.gate_m + rise_beyond_climb_m(s.knowledge, WAITING_SIGMAS), max(o.cone.gate_m, clear_m(s, o)))


def agreed(s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether the sightings are as recent and as consistent as the gate requires; by others no deck is followed down."""
    return s.estimate is not None and limits.agreed(s.at, s.estimate, s.quality, o.limits)


def lower_if_agreed(command: Command, p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Command:
    """Return the controller's command where the sightings agree and are fresh, else as `not_lower` allows it."""
    lower = agreed(s, o) and unfit(s.estimate, s.at, o.stale_after_s) is None
    return command if lower else not_lower(command, p, s, o)


def not_lower(command: Command, p: Progress, s: GuidanceCycle, o: GuidanceOptions, needs_m: float | None = None) -> Command:
    """Return the controller's command as far as what is known of the pad allows it: no lower without need and sight.

    Args:
        needs_m: height over the deck that it keeps, m; None for that of the place which it holds, if it holds one.
    """
    fit = fit_to_steer(s.estimate, s.at, o.stale_after_s) and agreed(s, o)
    command = never_lower(command, s, fit=fit)
    estimate = usable(s, o)
    if estimate is None:
        return command
    if needs_m is None:
        if p.held is None or p.state in _CLIMBS_WHERE_HELD:
            return command
        needs_m = _held_height_m(p, p.held, s, o)
    # Out of sight only a height that is surely there counts.
    sure_m = estimate.height_m - (0.0 if fit else 2.0 * math.sqrt(estimate.cov.item(2, 2)))
    # A deck that falls need not be followed where a swell is known to come up again.
    return _following_less(command, s, sure_m - needs_m, sure_m - min(needs_m, o.tries.safe_height_m))


def never_lower(command: Command, s: GuidanceCycle, *, fit: bool) -> Command:
    """Return the command without any descent beyond the deck's own as far as it is certain, and none if the estimate is unfit."""
    if not isinstance(command, Velocity | Lean):
        return command
    deck_m_s = _falling_m_s(s.knowledge) if fit and s.hold.moves(command) else 0.0
    return command if command.v_level[2] <= deck_m_s else descending(command, deck_m_s)


def descending(command: Velocity | Lean, down_m_s: float) -> Command:
    """Return the command with another vertical speed, m/s down."""
    v = np.array(command.v_level)
    v[2] = down_m_s
    return replace(command, v_level=v)


def _falling_m_s(knowledge: Knowledge) -> float:
    """Return how fast the deck falls at least, with two standard deviations; 0 where it may rise."""
    deck = knowledge.deck
    return 0.0 if deck is None else max(0.0, deck.v_level.item(2) - 2.0 * math.sqrt(deck.cov_level.item(2, 2)))


def _following_less(command: Command, s: GuidanceCycle, over_m: float, falling_over_m: float) -> Command:
    """Return the command with less of its vertical rate, the higher the vehicle is over the height that it needs.

    A deck that falls is followed less far than one that rises, and out of sight it moves only in the forecast. Without this a
    vehicle goes up with each wave, without end.

    Args:
        over_m: height over the needed one, m.
        falling_over_m: height over the one from which a falling deck is not followed, m.
    """
    if not s.hold.moves(command):
        return command
    down_m_s = command.v_level.item(2)
    beyond_m = falling_over_m if down_m_s > 0.0 else over_m
    if beyond_m <= 0.0 or down_m_s == 0.0:
        return command
    return descending(command, down_m_s * max(0.0, 1.0 - beyond_m / _FREE_M))


def clear_m(s: GuidanceCycle, o: GuidanceOptions) -> float:
    """Return the height over the deck that no swell takes from a drone which climbs before it, m."""
    return o.tries.safe_height_m + s.knowledge.outrun_m


def _held_height_m(p: Progress, held: F64, s: GuidanceCycle, o: GuidanceOptions) -> float:
    """Return the height over the deck up to which a held vehicle follows it, m."""
    if p.state in _REFUSED:
        return clear_m(s, o)
    return min(clear_m(s, o), max(float(held[2]), min(o.tries.safe_height_m, waits_m(s, o))))


def _in_present_axes(held: F64, yaw_rad: float | None, estimate: RelativeState) -> F64:
    """Return the held vector in the present level axes, so that it keeps its place over the deck while the body turns."""
    if yaw_rad is None or estimate.yaw_rad is None:
        return held
    turned = wrap_pi(estimate.yaw_rad - yaw_rad)
    c, s = math.cos(turned), math.sin(turned)
    x, y, z = held
    return np.array([c * x + s * y, -s * x + c * y, z])


class Phase(NamedTuple):
    """One state: where it leads, what it watches, what it aims at, and what it remembers."""

    does: str
    """The words for people: what the drone does."""
    ways: Row
    events: Events = lambda p, s, o: iter(())
    """Events of a cycle that lead to another state."""
    aim: Callable[[Progress, GuidanceCycle, GuidanceOptions], Aimed] = still
    """The place to be: a target for the controller, or a command where no estimate will do."""
    note: Callable[[Progress, GuidanceCycle, GuidanceOptions], Progress] = lambda p, s, o: p
    """The state's own memory of a cycle, noted before its events."""
    allows: Callable[[Command, Progress, GuidanceCycle, GuidanceOptions], Command] = not_lower
    """The controller's command for the target, as far as the state allows it."""
