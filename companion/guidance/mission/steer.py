"""Say where to be in each state of the mission: a target for the controller, or a command where no estimate will do."""

import math

import numpy as np
from msgspec.structs import replace

from companion.base.mission import ENDED, GROUND, State
from companion.guidance.controller import Knowledge, Target
from companion.guidance.mission import cone, contact, limits, out_of_reach, rendezvous
from companion.guidance.mission.clearance import WAITING_SIGMAS, rise_beyond_climb_m
from companion.guidance.mission.cycle import GuidanceCycle, fit_to_steer, unfit
from companion.guidance.mission.limits import sigma_m
from companion.guidance.mission.progress import Progress, heading_to_arrow_rad
from companion.guidance.mission.watch import off_deck
from companion.settings.guidance import GuidanceOptions
from companion.settings.mission import TryOptions
from estimator.contracts.commands import Command, Hover, Land, Lean, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import seconds_between


def usable(s: GuidanceCycle, options: TryOptions, stale_after_s: float) -> RelativeState | None:
    """Return the estimate if it may be flown by without sight, else None."""
    estimate = s.estimate
    if estimate is None or abs(seconds_between(estimate.at, s.at)) > stale_after_s:
        return None
    # A ship that swings her pad away makes the last sightings disagree.
    if not estimate.consistent and (estimate.alerts or not estimate.adrift):
        return None
    sigma_max_m = _ADRIFT * options.blind_sigma_m if estimate.adrift else options.blind_sigma_m
    return estimate if sigma_m(estimate) <= sigma_max_m else None


def without_estimate(climb_m_s: float, *, over_ground: bool) -> Command:
    """Return the command that stays with the deck, or climbs from it, where no estimate of the pad will do.

    Args:
        climb_m_s: rate upward; 0 to stay.
        over_ground: whether the vehicle's own hover holds over the ground. Its driver adds the deck's velocity to a velocity, so
            a velocity of zero stays with the deck. The hover of a vehicle that measures by optical flow stays with it by itself.
    """
    return Velocity(np.array([0.0, 0.0, -climb_m_s]), 0.0) if over_ground or climb_m_s != 0.0 else Hover()


def rising_m_s(knowledge: Knowledge) -> float:
    """Return how fast the deck rises, 0 where it falls or nothing is known of it."""
    return 0.0 if knowledge.deck is None else max(0.0, -float(knowledge.deck.v_level[2]))


def _falling_m_s(knowledge: Knowledge) -> float:
    """Return how fast the deck falls at least, with two standard deviations; 0 where it may rise."""
    deck = knowledge.deck
    return 0.0 if deck is None else max(0.0, deck.v_level.item(2) - 2.0 * math.sqrt(deck.cov_level.item(2, 2)))


def never_lower(command: Command, knowledge: Knowledge, *, fit: bool, over_ground: bool) -> Command:
    """Return the command without any descent beyond the deck's own as far as it is certain, and none if the estimate is unfit.

    Args:
        over_ground: whether the vehicle's driver adds the deck's velocity to a velocity.
    """
    if not isinstance(command, Velocity | Lean):
        return command
    added_later = over_ground and isinstance(command, Velocity)
    deck_m_s = 0.0 if not fit or added_later else _falling_m_s(knowledge)
    v = np.array(command.v_level)
    if v[2] <= deck_m_s:
        return command
    v[2] = deck_m_s
    return replace(command, v_level=v)


def climbing(command: Command, climb_m_s: float) -> Command:
    """Return the command with at least this climb: without sight an estimate that has risen by itself requests none."""
    if not isinstance(command, Velocity | Lean) or command.v_level[2] <= -climb_m_s:
        return command
    v = np.array(command.v_level)
    v[2] = -climb_m_s
    return replace(command, v_level=v)


def pressing(command: Command, knowledge: Knowledge, rate_m_s: float) -> Command:
    """Return the command with at least this rate against the deck: an estimate that sinks into it is no reason to press less."""
    if not isinstance(command, Lean):
        return command
    deck_m_s = 0.0 if knowledge.deck is None else knowledge.deck.v_level.item(2)
    v = np.array(command.v_level)
    v[2] = max(v[2], rate_m_s + deck_m_s)
    return replace(command, v_level=v)


Aim = Target | Command | None
"""Target, finished command, or None: guidance leaves the vehicle alone."""

_LIFT_M = 0.3
"""Height of the feet below which a go-around only climbs, m."""
_BRAKES_M, _LEAN_LEAST_RAD = 0.1, math.radians(5.0)
"""Height of the lowest foot from which on a go-around leans further than it does, m, and the least lean that it may have."""
_HOLD_SPEED_M_S = 0.5
_SURELY = 0.5
"""Standard deviations of its vertical speed by which a drone may sink without being kept up: errors lift it by 3 cm/s."""
_FREE_M = 1.0
"""Height over the held one from which a held vehicle climbs no more with its deck, m."""
_CLIMBS_WHERE_HELD = frozenset({State.COMMIT, State.ANOTHER_PAD})
"""States that hold a place and may climb from it."""
_REFUSED = (State.REFUSED, State.GAVE_UP)
_ADRIFT = 5.0
"""Factor on the deviation up to which it flies by an estimate whose pad the ship swung out of sight."""
_LOOK_M_S, _LEG_S = 0.4, 35.0
"""Speed upwind and to lee of a search in wind, m/s, and the time of each way, s."""
_STEPS_M = (2.0, -4.0, 6.0, -8.0, 4.0)
"""Steps aside of its ways back, in turn, m: each time farther to the other side, and then to the middle again."""
_TURN_1_S, _TURN_MOST_RAD_S = 0.8, 0.5
"""Rate of a turn for each radian that is left, 1/s, and the most of it, rad/s."""
_AWAY_M_S = 5.0
"""Largest rate against the deck with which the drone goes up before a deck that will rise faster than it can climb: no limit."""


def aim(p: Progress, s: GuidanceCycle, o: GuidanceOptions, *, over_ground: bool) -> tuple[Progress, Aim]:
    """Return the memory and the aim of this guidance cycle.

    Args:
        over_ground: whether the vehicle's own hover holds over the ground, and its driver adds the deck's velocity to a velocity.
    """
    if p.state in GROUND:
        return p, None
    if not p.begun or p.state is State.TAKEN or (p.stood and p.state in ENDED):
        # A velocity would take an autopilot from whoever flies it; a hover takes nothing.
        return p, Hover()
    estimate, p = s.estimate, replace(p, climbs_m_s=0.0)
    match p.state:
        case State.REFUSED | State.GAVE_UP if (
            s.battery is not None and s.battery <= o.last_charge and ends_here(p, o, over_ground)
        ):
            return p, Land()
        case State.PAUSED | State.REFUSED | State.GAVE_UP | State.ABORTED if s.off_orders is not None:
            # Its own hover holds over the ground's level, and a deck may come up to it; orders may be turned round.
            if not out_of_reach.out_of_reach(p, s, o):
                return _climbs(p, s, out_of_reach.fastest_climb_m_s(s, o), over_ground=over_ground)
            return p, Hover()
        case State.COMMIT if not asks_to_descend(p, s, o):
            # So low that a climb would come too late: it awaits the contact without going lower.
            return _still(p, s, o, over_ground=over_ground)
        case State.INTERCEPT | State.DESCEND | State.GATE | State.COMMIT if estimate is not None:
            return p, _way_down(p, s, o, estimate)
        # Sightings of the last decimetre are wrong often, and what was known before them still holds for so short a time.
        case State.PRESS if estimate is not None and not estimate.alerts and not s.unflown:
            level = np.array(estimate.d_body_pad_level)
            # Level in wind, it would be dragged to lee for as long as its rotors carry a part of the weight.
            level_off = None if s.wind is not None and s.wind.drags else 0.0
            return p, Target(level, descent_rate_m_s=o.cone.commit_rate_m_s, lean_max_rad=level_off)
        case State.PRESS | State.DOWN:
            # The thesis' way ends in the air; every other one comes here by a contact. A vehicle of which nothing fit is known is
            # not held on a deck that falls: it lands by itself, and no motor is stopped by force before it has pressed.
            pressed = p.state is State.DOWN or estimate is None
            return p, Land(on_deck=o.mission != "thesis" and pressed and _felt(p, s, o))
        case State.RENDEZVOUS | State.SEARCH if out_of_reach.low(p, s, o):
            return _climbs(p, s, out_of_reach.climb_m_s(p, s, o), over_ground=over_ground)
        case State.RENDEZVOUS if s.place is not None:
            return p, rendezvous.to_hold_off(s.place, o.rendezvous, o.tries.climb_m_s, over_ground=over_ground)
        case State.SEARCH if s.place is not None:
            return p, rendezvous.along_pattern(p.search_leg, s.place, o.rendezvous, o.tries.climb_m_s, over_ground=over_ground)
        case State.GO_AROUND:
            return _climb(p, s, o, over_ground=over_ground)
        case State.REFUSED | State.GAVE_UP if o.refused != "hold" and out_of_reach.out_of_reach(p, s, o):
            return p, Hover(returns=True) if o.refused == "return" else Hover(elsewhere=o.elsewhere.landing_place)
    return _still(p, s, o, over_ground=over_ground)


def ends_here(p: Progress, o: GuidanceOptions, over_ground: bool, /) -> bool:
    """Return whether a drone that refused comes down where it is before it falls; an AR.Drone has no other place to fly to."""
    return p.state in _REFUSED and not p.stood and o.last_charge > 0.0 and (o.refused == "hold" or not over_ground)


def _climbs(p: Progress, s: GuidanceCycle, climb_m_s: float, *, over_ground: bool) -> tuple[Progress, Command]:
    """Climb against the deck and stay with it otherwise, which a driver that adds the deck's velocity does by itself."""
    rate = climb_m_s + (0.0 if over_ground or climb_m_s == 0.0 else rising_m_s(s.knowledge))
    flown = _with_deck(rate, s.knowledge) if over_ground else rate
    return replace(p, climbs_m_s=flown), without_estimate(rate, over_ground=over_ground)


def _with_deck(climb_m_s: float, knowledge: Knowledge) -> float:
    """Return the climb over the ground of a vehicle that follows the deck and climbs from it, m/s."""
    return climb_m_s - (0.0 if knowledge.deck is None else knowledge.deck.v_level.item(2))


def _felt(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether the deck was felt and another witness finds it there: only then do the motors stop by force.

    That is a range, or the newest height by sight less the way that the commit has made since. Without one the vehicle lands by
    itself, and finds the deck with its own sensors.
    """
    felt = s.knowledge.impact
    if (p.reckoned is not None and (felt is None or felt.at < p.reckoned)) or off_deck(p, s, o) is not None:
        return False
    if s.range_m is not None and s.range_m - o.cone.feet_below_m <= contact.NEAR_M:
        return True
    if p.seen is None:
        return False
    way_m = o.cone.commit_rate_m_s * min(o.limits.commit_sighting_age_s, seconds_between(p.seen, s.at))
    return p.seen_height_m - way_m - o.cone.feet_below_m <= contact.NEAR_M


def _way_down(p: Progress, s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> Target:
    yaw = _yaw_rad(s, o, estimate)
    if o.mission == "thesis":
        way = o.thesis
        height_m = way.approach_height_m if p.state is State.INTERCEPT else way.final_height_m
        over = np.array([way.pad_ahead_m, 0.0, height_m])
        return Target(over, vertical_rate_max_m_s=way.speed_m_s, speed_max_m_s=way.speed_m_s, yaw_rad=yaw)
    height_m, error_m, fast = estimate.height_m, limits.beside_m(estimate, s.knowledge), o.cone.intercept_speed_m_s
    x_m, y_m = s.knowledge.aim_level
    least_m = _waits_m(s, o)
    match p.state:
        case State.INTERCEPT:
            # A cone that is wide enough for the error is higher up; and higher up the pad stays in view.
            wide_m = min(o.tries.safe_height_m, error_m / o.cone.slope)
            over = np.array([x_m, y_m, max(min(height_m, p.entered_height_m), wide_m, least_m)])
            return Target(over, vertical_rate_max_m_s=o.tries.climb_m_s, speed_max_m_s=fast, yaw_rad=yaw)
        case State.DESCEND:
            rate = cone.descent_rate_m_s(error_m, height_m, o.cone, least_m)
            return Target(np.array([x_m, y_m, least_m]), descent_rate_m_s=rate, speed_max_m_s=fast, yaw_rad=yaw)
        case State.COMMIT:
            return Target(np.array([x_m, y_m, 0.0]), descent_rate_m_s=o.cone.commit_rate_m_s, yaw_rad=yaw)
    rate_max = o.tries.climb_m_s if least_m == o.cone.gate_m or height_m > least_m else _AWAY_M_S
    return Target(np.array([x_m, y_m, least_m]), vertical_rate_max_m_s=rate_max, yaw_rad=yaw)


def _yaw_rad(s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> float | None:
    """Return the heading against the arrow to turn to; None to keep the present one."""
    if o.tries.heading == "align":
        return heading_to_arrow_rad(estimate)
    turns = o.tries.heading == "across" and s.wind is not None and s.wind.leans_far
    return estimate.yaw_rad + s.wind.across_rad if turns and s.wind is not None and estimate.yaw_rad is not None else None


def _climb(p: Progress, s: GuidanceCycle, o: GuidanceOptions, *, over_ground: bool) -> tuple[Progress, Aim]:
    """Climb from the pad on the side where nothing stands."""
    estimate = usable(s, o.tries, o.stale_after_s)
    fastest = out_of_reach.fastest_climb_m_s(s, o)
    counted = replace(p, climbs_m_s=_with_deck(o.tries.climb_m_s, s.knowledge))
    # Where the pad was swung aside it comes back to a drone that goes on as the ship did.
    flown_s = o.tries.blind_s if estimate is not None and estimate.adrift else o.tries.climb_after_s
    old = estimate is not None and estimate.age_s(s.at) > flown_s
    if estimate is None or old or (p.track is not None and estimate.track != p.track):
        climb_m_s = max(o.tries.climb_m_s, out_of_reach.climb_m_s(p, s, o))
        return _climbs(p, s, climb_m_s, over_ground=over_ground)
    if estimate.height_m - o.cone.feet_below_m < _LIFT_M:
        # It climbs at its place and moves with the deck: feet that are dragged before they leave the deck turn the vehicle over.
        here = np.array([*estimate.d_body_pad_level[:2], o.tries.safe_height_m])
        # A speed that it took off with is braked higher up: leaning further lowers a foot by more than it has climbed.
        body, most_rad = s.knowledge.body, None
        if body is not None and estimate.height_m - o.cone.feet_below_m - limits.lower_foot_m(s.knowledge, o.cone) < _BRAKES_M:
            most_rad = max(_LEAN_LEAST_RAD, math.atan(math.hypot(*body.lean_m_s2) / G_M_S2))
        return counted, Target(here, descent_rate_m_s=-fastest, speed_max_m_s=o.cone.intercept_speed_m_s, lean_max_rad=most_rad)
    # Aside in proportion to the height, so that the pad stays in view.
    aside_m = o.tries.clear_side_m * min(1.0, max(0.0, estimate.height_m) / o.tries.safe_height_m)
    d = np.array([0.0, 0.0, o.tries.safe_height_m])
    if estimate.yaw_rad is not None:
        bearing = math.radians(o.tries.clear_side_deg) - estimate.yaw_rad
        d[:2] = -aside_m * np.array([math.cos(bearing), math.sin(bearing)])
    return counted, Target(d, descent_rate_m_s=-o.tries.climb_m_s, speed_max_m_s=o.cone.intercept_speed_m_s)


def _still(p: Progress, s: GuidanceCycle, o: GuidanceOptions, *, over_ground: bool) -> tuple[Progress, Aim]:
    """Stay where the drone is against the deck, and never lower; or climb from there, where it is low without sight."""
    estimate = usable(s, o.tries, o.stale_after_s)
    climb_m_s = out_of_reach.climb_m_s(p, s, o)
    # A pad that nobody has agreed to land on is not followed either: its deck may fall away.
    if estimate is None or (p.track is not None and estimate.track != p.track):
        searches = p.state in (State.SEARCH, State.HOLD_BLIND) and not out_of_reach.low(p, s, o)
        looks = _looks_upwind(p, s, o) if searches else None
        return (replace(p, held=None), looks) if looks else _climbs(replace(p, held=None), s, climb_m_s, over_ground=over_ground)
    # A sight so short ago comes back as likely; a question about another pad is best asked from higher up.
    waits = p.state is not State.ANOTHER_PAD and estimate.age_s(s.at) <= o.tries.climb_after_s
    if waits or (estimate.height_m >= o.tries.safe_height_m and not out_of_reach.near(p, s, o)):
        climb_m_s = 0.0
    held = estimate.d_body_pad_level if p.held is None else _turned_with_the_body(p.held, p.held_yaw_rad, estimate)
    speed = _HOLD_SPEED_M_S
    if p.state is State.HOLD_BLIND and p.seen is not None and seconds_between(p.seen, s.at) <= o.tries.blind_s:
        held, speed = np.array([0.0, 0.0, held[2]]), o.cone.intercept_speed_m_s
    p = replace(p, held=held, held_yaw_rad=estimate.yaw_rad, climbs_m_s=_with_deck(climb_m_s, s.knowledge))
    # A drone that was lifted stays up: nothing commands it down again, only a deck that rises comes nearer (`_following_less`).
    wanted = np.array([held[0], held[1], max(estimate.height_m, _held_height_m(p, held, s, o))])
    rate = -climb_m_s if climb_m_s > 0.0 else None
    turns = _yaw_rad(s, o, estimate) if p.state is State.HOLD_BLIND and o.tries.heading == "across" else None
    return p, Target(wanted, descent_rate_m_s=rate, vertical_rate_max_m_s=o.tries.climb_m_s, speed_max_m_s=speed, yaw_rad=turns)


def _looks_upwind(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Velocity | None:
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


def allowed(command: Command, p: Progress, s: GuidanceCycle, o: GuidanceOptions, *, over_ground: bool) -> Command:
    """Return the controller's command as far as what is known of the pad allows it: no lower without need and sight.

    Args:
        over_ground: whether the vehicle's driver adds the deck's velocity to a velocity.
    """
    if p.state is State.GO_AROUND and not p.in_sight:
        return climbing(command, o.tries.climb_m_s)
    if p.state is State.PRESS:
        return pressing(command, s.knowledge, o.cone.commit_rate_m_s)
    if asks_to_descend(p, s, o):
        return command
    fit = fit_to_steer(s.estimate, s.at, o.stale_after_s) and _agreed(s, o)
    command = never_lower(command, s.knowledge, fit=fit, over_ground=over_ground)
    estimate = usable(s, o.tries, o.stale_after_s)
    if estimate is None:
        return command
    if p.state is State.INTERCEPT and o.mission != "thesis":
        needs_m = _clear_m(s, o)
    elif p.held is None or p.state in _CLIMBS_WHERE_HELD:
        return command
    else:
        needs_m = _held_height_m(p, p.held, s, o)
    # Out of sight only a height that is surely there counts.
    sure_m = estimate.height_m - (0.0 if fit else 2.0 * math.sqrt(estimate.cov.item(2, 2)))
    # A deck that falls need not be followed where a swell is known to come up again.
    return _following_less(command, sure_m - needs_m, sure_m - min(needs_m, o.tries.safe_height_m), over_ground=over_ground)


def kept_up(command: Command, p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Command:
    """Return the command with a climb against what the drone sinks over the ground beyond its order, in a hold without sight.

    Commands that arrive changed sink a drone that is to hold its height, and a height without sight is too uncertain to fly by.
    The gain is 1: with that a loop stands commands that come however late.
    """
    estimate, deck = s.estimate, s.knowledge.deck
    if p.state is not State.HOLD_BLIND or not isinstance(command, Velocity | Lean) or estimate is None or deck is None:
        return command
    # Without a velocity a climb is flown by the tilt that the wind asked for, which the wrong velocity has falsified.
    if not s.knowledge.trusts_velocity or estimate.alerts or estimate.age_s(s.at) <= o.stale_after_s:
        return command
    v = np.array(command.v_level)
    # Out of sight the errors of the speeds of drone and deck over the ground are the same.
    over_ground_m_s = deck.v_level.item(2) - estimate.v_pad_level.item(2)
    v[2] -= max(0.0, over_ground_m_s - _SURELY * math.sqrt(deck.cov_level.item(2, 2)) - max(0.0, v[2]))
    return replace(command, v_level=v)


def _waits_m(s: GuidanceCycle, o: GuidanceOptions) -> float:
    """Return the height over the deck at which it may wait for the forecast waves, m."""
    # A forecast of more than any swell that was watched is one of which nothing is known: no reason to climb without end.
    return min(o.cone.gate_m + rise_beyond_climb_m(s.knowledge, WAITING_SIGMAS), max(o.cone.gate_m, _clear_m(s, o)))


def _clear_m(s: GuidanceCycle, o: GuidanceOptions) -> float:
    """Return the height over the deck that no swell takes from a drone which climbs before it, m."""
    return o.tries.safe_height_m + s.knowledge.outrun_m


def _held_height_m(p: Progress, held: F64, s: GuidanceCycle, o: GuidanceOptions) -> float:
    """Return the height over the deck up to which a held vehicle follows it, m."""
    if p.state in _REFUSED:
        return _clear_m(s, o)
    return min(_clear_m(s, o), max(float(held[2]), min(o.tries.safe_height_m, _waits_m(s, o))))


def _following_less(command: Command, over_m: float, falling_over_m: float, *, over_ground: bool) -> Command:
    """Return the command with less of its vertical rate, the higher the vehicle is over the height that it needs.

    A deck that falls is followed less far than one that rises, and out of sight it moves only in the forecast. Without this a
    vehicle goes up with each wave, without end.

    Args:
        over_m: height over the needed one, m.
        falling_over_m: height over the one from which a falling deck is not followed, m.
        over_ground: whether the vehicle's driver adds the deck's velocity to a velocity, which then stays as it is.
    """
    if not isinstance(command, Velocity | Lean) or (over_ground and isinstance(command, Velocity)):
        return command
    v = np.array(command.v_level)
    beyond_m = falling_over_m if v[2] > 0.0 else over_m
    if beyond_m <= 0.0 or v[2] == 0.0:
        return command
    v[2] *= max(0.0, 1.0 - beyond_m / _FREE_M)
    return replace(command, v_level=v)


def _agreed(s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether the sightings are as recent and as consistent as the gate requires; by others no deck is followed down."""
    return s.estimate is not None and limits.agreed(s.at, s.estimate, s.quality, o.limits)


def asks_to_descend(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether this cycle may request a way nearer to the deck: its state does, and its estimate is fit for it."""
    # An intercept keeps its height over the deck until it is in the cone; only the thesis' flies to a height of its own.
    lower = p.state in (State.DESCEND, State.GATE, State.COMMIT, State.PRESS)
    if not (lower or (p.state is State.INTERCEPT and o.mission == "thesis")):
        return False
    if p.state is State.GATE and not _agreed(s, o):
        return False
    stale_s = o.stale_after_s if p.state not in (State.COMMIT, State.PRESS) else o.limits.commit_sighting_age_s
    return p.state is State.PRESS or unfit(s.estimate, s.at, stale_s) is None


def _turned_with_the_body(held: F64, yaw_rad: float | None, estimate: RelativeState) -> F64:
    """Return the held vector in the present level axes, so that it keeps its place over the deck while the body turns."""
    if yaw_rad is None or estimate.yaw_rad is None:
        return held
    turned = wrap_pi(estimate.yaw_rad - yaw_rad)
    c, s = math.cos(turned), math.sin(turned)
    x, y, z = held
    return np.array([c * x + s * y, -s * x + c * y, z])
