"""LAND_HERE: down to the deck where the drone is, by a person's order or with its last charge, without a gate.

In sight of the pad it follows the deck to the contact: to the pad's centre from over the pad or near enough that "here" is the
pad, else to the place on the deck straight below. Without sight it does so by the estimate while its speed along the deck is
known, then straight down against what is best known: the deck by its estimated velocity, the ship by her reports, the surface
that an AR.Drone's optical flow sees, else the ground. A silent vehicle, or one that met no deck in time, lands by itself. So does
an AR.Drone whose velocity is refused: its own loops may be right, and the tilt that held against the wind is known by what lies.

No limit ends it: a person, a pilot or a failsafe does. The contact is found by the vote of all witnesses, as in the commit, and
leads to PRESS and DOWN, which come back here if the vehicle is in the air again. Without sight a height that is reckoned is a
witness as far as its covariance lets it be one. A descent that has surely ended is the deck: a second after a range close to the
feet's, or where no standard deviation makes the speed a descent. What only seems to have ended is 2 m in the air.

`touch` says where it will touch the deck. What a person reads before he orders it and what the drone then flies to are the same.
"""

import math
from collections.abc import Iterator

import numpy as np
from msgspec import Struct, structs

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.controller import Knowledge, Target
from companion.guidance.mission import contact, limits, rules
from companion.guidance.mission.descend import INSIDE
from companion.guidance.mission.phase import LANDING, Aimed, Phase, climbs, descending, turn_rad, usable
from companion.guidance.mission.progress import GuidanceCycle, Here, Progress, fit_to_steer
from companion.guidance.mission.rules import EventWithReason
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Command, Land, Lean, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, rotated, rotated_xy
from estimator.contracts.time import MonoNs, seconds_between

_SLOWEST = 0.5
"""Least rate beside the place, of the commit's: a gust must not keep it up."""
_STEADIES_S = 8.0  # longest wait at the gate's height until it is over the place and still
_LOOSER_S = 4.0  # time in which these limits double
_COMES_DOWN_S = 3.0
"""Time constant of the way down to a surface that is ranged out of sight, s."""
_SILENT_S = 1.0
"""Time without a sample of the vehicle after which it lands by itself, s."""
_UNSEEN_S = 1.5
"""Longest wait there without sight until it is still, s: its speed is measured, its place drifts away."""
_AT_GATE_M = 0.08
"""Height over the gate up to which it is there, m."""
_LANDS_BY_ITSELF_S = 10.0  # time beyond three times that of the way down after which it lands by itself
_WAY_MOST_M = 10.0  # the way down where no height is known
_STOOD_S = 1.0  # time for which an ordered descent does not go on after which it stands on the deck
_STANDS = 0.5  # share of the ordered descent that is none
_NEAR_M = 0.2
"""Height of the feet by a range from which that descent ends at the deck in this time, m; closer an ultrasound reads nothing."""
_PLACED_SIGMA_M = 0.06
"""Standard deviation of a contact in sight about the place that it is flown to, one axis, m."""
_BETTER = 0.5
"""Share of the standard deviation of a place in sight that is left at the contact."""
_WITHIN = 2.45
"""Standard deviations of one axis within which 95 % of the places on a plane lie (Rayleigh)."""
_SURGE_M_S2 = 0.1
"""Acceleration along the deck by which a ship out of sight departs from her course, m/s^2."""
_FLOW_S = 3.0  # time for which an error of a flow's speed over the deck lasts
_BLIND_SIGMA_M_S = 0.2
"""Least standard deviation of a speed without sight: the estimator's own rises to it within the first seconds (`benches.by_person
--blind`)."""
_SPEED_SIGMA_M_S = 0.5
"""Standard deviation of the speed along the deck up to which it is flown by the estimate without sight, m/s."""
_RANGE_S = 0.15
"""Time constant of range and rate, s: far below the period of a swell."""
_LEAP_M = 0.5
"""Difference from the expected range that is another surface, m."""
_LAG_S = 0.3  # lag of a climb whose vehicle's file says nothing
_GAP_S = 0.2  # longest time between two cycles
_MOST_M_S = 2.0
"""Fastest order down and up where no law says how fast the vehicle climbs, m/s. With less up than down it would meet a deck that
comes up, with less down it would never come down."""


class Touch(Struct, frozen=True):
    """The place at which a landing that is ordered now touches."""

    lateral_m: float | None = None
    """Distance from the pad's centre; None where no pad is known."""
    spread_m: float = math.inf
    """Distance from that place within which 95 % of the contacts are."""
    seconds: float | None = None
    """Time to the contact; None where no height is known."""
    unsure: str = ""
    """The reason why the pad's place is not sure; empty in sight."""
    warnings: str = ""
    """The reasons why it may touch elsewhere, in words: a lens that is not where its file has it, and wind beyond its tilt."""
    stands_m: float = math.inf
    """Distance from the pad's centre up to which the vehicle then stands on the pad."""

    @property
    def on_pad(self) -> bool:
        """True if it is flown to the pad's centre."""
        return self.lateral_m == 0.0

    @property
    def text(self) -> str:
        """The place for the operator."""
        return f"{self._where}{self.warnings and f'; {self.warnings}'}"

    @property
    def _where(self) -> str:
        if self.lateral_m is None:
            return f"where no pad is known: this may be deck, rail or water{self.unsure and f'; {self.unsure}'}"
        within = f"{100 * self.spread_m:.0f} cm" if self.spread_m < 1.0 else f"{self.spread_m:.1f} m"
        where, risk = f"on the pad, within {within} of its centre", ""
        if not self.on_pad:
            where = f"{self.lateral_m:.1f} m beside the pad, +-{within}"
        elif self.spread_m > self.stands_m:
            where, risk = f"toward the pad, up to {within} off its centre", ": this may be deck, rail or water"
        when = "" if self.seconds is None else f", in {self.seconds:.0f} s"
        return f"{where}{when}{risk}{self.unsure and f'; the place of the pad is not sure: {self.unsure}'}"


class Surface(Struct, frozen=True):
    """The surface below by the range sensor, out of sight of the pad.

    Without sight nothing knows the phase of the swell: neither a descent over the ground nor one against the forecast meets a
    heaving deck slowly. The range sensor sees the deck come and go. An alpha-beta filter (Benedict & Bordner, IRE Trans.
    AC-7, 1962) follows the range and its rate; less the drone's own descent, as ordered and answered, that is the surface's
    vertical speed. A range that leaps, as where the deck ends, begins again.
    """

    range_m: float
    rate_m_s: float
    """Rate of the range."""
    flown_m_s: float
    """The drone's own descent over the ground, as ordered and answered."""
    ordered_m_s: float
    """Descent over the ground that comes down to the surface at the wanted rate."""


class Descent(Struct, frozen=True):
    """The memory of a way down."""

    low_since: MonoNs | None = None
    """Time since which it has been as low as the gate; without sight as low as anything."""
    committed_since: MonoNs | None = None
    """Time since which it goes down from there at the commit's rate."""
    stood_since: MonoNs | None = None
    """Time since which it has not gone down all the same."""
    near: bool = False
    """True if the newest range was close to the feet's."""
    below: Surface | None = None
    """The surface below while the pad is out of sight; None in sight, and without a range."""


def _descent(p: Progress) -> Descent:
    return p.kept if isinstance(p.kept, Descent) else Descent()


def _known(s: GuidanceCycle, o: GuidanceOptions) -> RelativeState | None:
    """Return the estimate if nothing contradicts it, however vague or old it has become; else None."""
    estimate = s.estimate
    if estimate is None or estimate.alerts:
        return None
    vague = max(estimate.cov.diagonal()[:3].tolist()) > o.tries.blind_sigma_m**2
    return estimate if estimate.consistent or estimate.adrift or vague else None


def trusted(s: GuidanceCycle, o: GuidanceOptions) -> RelativeState | None:
    """Return the estimate if it is of now and nothing contradicts it, however vague it has become without sight; else None."""
    estimate = _known(s, o)
    return None if estimate is None or abs(seconds_between(estimate.at, s.at)) > o.stale_after_s else estimate


def flown_by(s: GuidanceCycle, o: GuidanceOptions) -> RelativeState | None:
    """Return the estimate that it is flown by: one that is known well enough, or whose speed along the deck is; else None."""
    estimate = trusted(s, o)
    if estimate is None or usable(s, o) is not None:
        return estimate
    sure = s.unconfirmed is None and s.knowledge.trusts_velocity
    return estimate if sure and max(_vars(estimate, 3, 4)) <= _SPEED_SIGMA_M_S**2 else None


def _vars(estimate: RelativeState, *axes: int) -> list[float]:
    return [max(0.0, estimate.cov.item(axis, axis)) for axis in axes]


def place(estimate: RelativeState, o: GuidanceOptions) -> tuple[float, float] | None:
    """Return the place on the deck that "here" means: forward along the arrow and starboard of the pad's centre, m.

    It is the centre from inside the cone over the pad. None is the place straight below without a heading to tell it by.
    """
    reach_m = limits.ON_PAD * o.limits.commit_error_m
    if estimate.lateral_m <= reach_m or not limits.outside(estimate.lateral_m, estimate.height_m, o.cone):
        return 0.0, 0.0
    return None if estimate.yaw_rad is None else rotated_xy(-estimate.d_body_pad_level[:2], estimate.yaw_rad)


def touch(s: GuidanceCycle, o: GuidanceOptions, here: Here | None = None) -> Touch:
    """Return where and when a landing here touches: one under way, or one that is ordered now."""
    found, off_m, wind = _touch(s, o, here), s.estimate and s.estimate.lens_off_m, s.wind
    warnings = [] if (lens := rules.lens_elsewhere(s)) is None else [lens.text]
    if wind is not None and wind.speed_m_s > wind.limit_m_s:
        warnings.append(Reason(ReasonCause.WIND, wind.speed_m_s, wind.limit_m_s, "carries it off").text)
    spread_m, stands_m = found.spread_m + math.hypot(*off_m or (0.0, 0.0)), limits.ON_PAD * o.limits.commit_error_m
    return structs.replace(found, spread_m=spread_m, stands_m=stands_m, warnings="; ".join(warnings))


def _touch(s: GuidanceCycle, o: GuidanceOptions, here: Here | None) -> Touch:
    estimate = _known(s, o) if s.place is None else trusted(s, o)
    if estimate is None and s.place is not None:
        return Touch(s.place.distance_m, _WITHIN * s.place.sigma_m, unsure="by the ship's reports alone")
    if estimate is None:
        return Touch(unsure="" if s.estimate is None or not s.estimate.alerts else s.estimate.alerts[0].value)
    fit, flown = fit_to_steer(estimate, s.at, o.stale_after_s), flown_by(s, o) is not None
    at = (None if here is None else here.at_pad) or place(estimate, o)
    seconds = _way_s(s, o, estimate)
    # In sight the place is known better by the contact than now.
    sight, until_s = fit and flown, seconds + max(0.0, seconds_between(estimate.at, s.at))
    then_m = math.sqrt(max(_var_then(s, estimate, axis, 0.0 if sight else until_s) for axis in (0, 1)))
    sigma_m = math.hypot(_PLACED_SIGMA_M, _BETTER * then_m if sight else then_m)
    unsure = f"last seen {estimate.age_s(s.at):.0f} s ago" if not fit else "" if flown else f"known to {sigma_m:.1f} m"
    lateral_m = math.hypot(*at) if at is not None and flown else estimate.lateral_m
    return Touch(lateral_m, _WITHIN * sigma_m, seconds, unsure)


def _var_then(s: GuidanceCycle, estimate: RelativeState, axis: int, seconds: float) -> float:
    """Return the variance of the place without sight so many seconds later, m^2.

    A flow that sees the deck goes on measuring: errors of the speed last for a while only. A speed over the ground says nothing
    new of the ship's: that is as wrong for the whole way, and she may change it.
    """
    var, cov = estimate.cov.item(axis, axis), estimate.cov.item(axis, axis + 3)
    var_v = max(_BLIND_SIGMA_M_S**2, estimate.cov.item(axis + 3, axis + 3))
    if s.hold.over_ground or not s.knowledge.trusts_velocity:
        return max(0.0, var + 2.0 * seconds * cov + seconds**2 * var_v + (0.5 * _SURGE_M_S2 * seconds**2) ** 2)
    lasts_s = _FLOW_S * -math.expm1(-seconds / _FLOW_S)
    return max(0.0, var + 2.0 * lasts_s * cov + 2.0 * _FLOW_S * (seconds - lasts_s) * var_v)


def _way_s(s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> float:
    """Return the time to the contact over the place that it comes down to, s."""
    cone, high_m = o.cone, max(0.0, estimate.height_m - o.cone.gate_m)
    low_s = min(cone.gate_height_m, max(0.0, estimate.height_m - cone.feet_below_m)) / cone.commit_rate_m_s
    fast = fit_to_steer(estimate, s.at, o.stale_after_s)
    return low_s + high_m / (cone.descent_rate_m_s if fast else cone.commit_rate_m_s)


def over(here: Here | None, knowledge: Knowledge, estimate: RelativeState) -> F64:
    """Return the wanted vector from the body to the pad over the place that it comes down to, (2,) m in `level`."""
    at = None if here is None else here.at_pad
    if at is None:
        return np.array(estimate.d_body_pad_level[:2])
    if at == (0.0, 0.0):
        return np.array(knowledge.aim_level)
    return np.array(knowledge.aim_level) - rotated(np.array(at), -(estimate.yaw_rad or 0.0))


def _rate_m_s(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> float:
    """Return the rate against the deck: as in the cone, but never none above the gate, and the commit's without sight."""
    cone, estimate, kept = o.cone, flown_by(s, o), _descent(p)
    if estimate is None or kept.committed_since is not None:
        return cone.commit_rate_m_s
    height_m, error_m = contact.least_height_m(s, o, estimate), _error_m(p, s, estimate)
    if kept.low_since is not None:
        return max(-o.tries.climb_m_s, min(cone.commit_rate_m_s, height_m - cone.gate_m))
    rate = min(cone.descent_rate_m_s, max(cone.commit_rate_m_s, height_m - cone.gate_m))
    share = INSIDE - (error_m / limits.radius_m(height_m, cone)) ** 2
    return max(_SLOWEST * cone.commit_rate_m_s, rate * min(1.0, share))


def _error_m(p: Progress, s: GuidanceCycle, estimate: RelativeState) -> float:
    return math.dist(estimate.d_body_pad_level.tolist()[:2], over(p.here, s.knowledge, estimate))


def _steady(p: Progress, s: GuidanceCycle, o: GuidanceOptions, waited_s: float, *, going: bool) -> bool:
    """Return whether it is and will be over the place and still, or whether nothing is known by which to wait for that.

    Args:
        waited_s: time since it is at the gate's height, by which the limits grow.
        going: whether it goes down already. What is to come then ends that for as long as it is not too low to climb.
    """
    estimate, knowledge = flown_by(s, o), s.knowledge
    if estimate is None or waited_s > _STEADIES_S or estimate.age_s(s.at) > _UNSEEN_S:
        return True
    looser = 1.0 + waited_s / _LOOSER_S
    ahead, most_m_s = knowledge.at_contact, looser * o.limits.relative_speed_m_s
    comes_m_s = 0.0 if ahead is None else ahead.speed_m_s
    if going:
        low = estimate.height_m <= max(limits.no_return_m(knowledge, o.cone), limits.lift_m(estimate, knowledge, o.cone))
        return low or comes_m_s <= limits.COMMIT_SPEED * most_m_s
    v, left_s = estimate.v_pad_level[:2], limits.to_contact_s(estimate, knowledge, o.cone)
    slow = max(math.hypot(*v), comes_m_s) <= most_m_s
    if not fit_to_steer(estimate, s.at, o.stale_after_s):
        return slow  # its speed is measured without sight, its place is not
    off = estimate.d_body_pad_level[:2] - over(p.here, knowledge, estimate)
    return slow and max(math.hypot(*off), math.hypot(*(off + left_s * v))) <= looser * o.limits.error_m


def _note(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    here, estimate, kept = p.here or Here(), flown_by(s, o), _descent(p)
    if here.at_pad is None and estimate is not None:
        here = structs.replace(here, at_pad=place(estimate, o))
    p = structs.replace(p, here=structs.replace(here, felt=felt_by(p, s, o, here)))
    low, committed = kept.low_since, kept.committed_since
    if low is None and (estimate is None or contact.least_height_m(s, o, estimate) <= o.cone.gate_m + _AT_GATE_M):
        low = s.at
    if low is not None:
        steady = _steady(p, s, o, seconds_between(low, s.at), going=committed is not None)
        committed = (committed or s.at) if steady else None
    near = s.range_m - o.cone.feet_below_m <= _NEAR_M if s.range_m is not None else kept.near and committed is not None
    stands = committed is not None and (near or (s.range_m is None and _stands(s, o)))
    stood = kept.stood_since or s.at if stands else None
    below = None if sees_heave(s, o) else _watched(kept.below, s, _unseen_rate_m_s(s, o), p.since_last_s)
    return structs.replace(p, kept=Descent(low, committed, stood, near, below))


def sees_heave(s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether the deck's heave is seen."""
    return fit_to_steer(s.estimate, s.at, o.limits.commit_sighting_age_s)


def _unseen_rate_m_s(s: GuidanceCycle, o: GuidanceOptions) -> float:
    """Return the rate against the surface out of sight: the commit's, and faster where a range says that it is far off."""
    faster_m_s = 0.0 if s.range_m is None else (s.range_m - o.cone.gate_m) / _COMES_DOWN_S
    return max(o.cone.commit_rate_m_s, min(o.cone.descent_rate_m_s, faster_m_s))


def _stands(s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether it surely goes down no more, by the estimate."""
    estimate = s.estimate
    if estimate is None or estimate.alerts:
        return False
    most_m_s = abs(estimate.v_pad_level.item(2)) + math.sqrt(_vars(estimate, 5)[0])
    return most_m_s < _STANDS * o.cone.commit_rate_m_s


def _watched(was: Surface | None, s: GuidanceCycle, down_m_s: float, dt_s: float) -> Surface | None:
    """Return the surface after a cycle; None without a range, or where a driver follows the deck itself.

    Args:
        down_m_s: rate at which to come down to the surface.
        dt_s: time since the cycle before.
    """
    if s.range_m is None or (s.hold.over_ground and s.knowledge.deck is not None):
        return None
    if was is None or not 0.0 < dt_s <= _GAP_S:
        return Surface(s.range_m, -down_m_s, down_m_s, down_m_s)
    off_m = s.range_m - was.range_m - dt_s * was.rate_m_s
    if abs(off_m) > _LEAP_M:
        return Surface(s.range_m, -was.flown_m_s, was.flown_m_s, down_m_s)
    kept = math.exp(-dt_s / _RANGE_S)
    range_m = s.range_m - kept**2 * off_m
    rate_m_s = was.rate_m_s + (1.0 - kept) ** 2 * off_m / dt_s
    lag_s = _LAG_S if s.knowledge.climb is None else max(dt_s, s.knowledge.climb.lag_s)
    flown_m_s = was.flown_m_s + min(1.0, dt_s / lag_s) * (was.ordered_m_s - was.flown_m_s)
    most_m_s = s.knowledge.climb_max_m_s or _MOST_M_S
    ordered_m_s = max(-most_m_s, min(most_m_s, down_m_s + rate_m_s + flown_m_s))
    return Surface(range_m, rate_m_s, flown_m_s, ordered_m_s)


def felt_by(p: Progress, s: GuidanceCycle, o: GuidanceOptions, here: Here) -> frozenset[str]:
    """Return the sources of what was felt since the way down began."""
    impact = contact.felt(p, s, o)
    return here.felt if impact is None or impact.doubtful else here.felt | {impact.by}


def _events(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    kept, estimate = _descent(p), s.estimate
    ordered_s = 0.0 if kept.committed_since is None else seconds_between(kept.committed_since, s.at)
    votes, impact = contact.meets_deck(p, s, o, ordered_s)
    lasts = kept.stood_since is not None and seconds_between(kept.stood_since, s.at) >= _STOOD_S
    if estimate is not None and not estimate.alerts:
        # So high, with all that its covariance allows, it has met no deck. What is felt outweighs a height that has become vague.
        high = contact.least_height_m(s, o, estimate) - o.cone.feet_below_m > contact.NEAR_M
        votes -= 0.5 if high and estimate.consistent and estimate.age_s(s.at) > o.limits.commit_sighting_age_s else 0.0
        lasts = lasts and (not high or kept.near)
    if votes >= contact.ENOUGH or lasts:
        reckoned = Reason(ReasonCause.REACHED, 0.0 if estimate is None else estimate.height_m - o.cone.feet_below_m)
        yield Event.CONTACT, reckoned if impact is None else contact.reason_of(impact)


def _aim(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Aimed:
    way_s = min(_WAY_MOST_M, p.entered_height_m) / o.cone.commit_rate_m_s
    if s.silent_s > _SILENT_S or p.in_state_s(s.at) > 3.0 * way_s + _LANDS_BY_ITSELF_S:
        return p, Land(here=True)
    estimate, rate = flown_by(s, o), _rate_m_s(p, s, o)
    if estimate is None and not (s.hold.over_ground or s.knowledge.trusts_velocity):
        return p, Land(here=True)
    if estimate is None:
        below = _descent(p).below
        return climbs(p, s, -(rate if below is None else below.ordered_m_s))
    deck = np.array([*over(p.here, s.knowledge, estimate), 0.0])
    # On the last way a place missed is better than feet that slide: no way back to it is flown fast.
    most_m_s = o.cone.intercept_speed_m_s if _descent(p).committed_since is None else o.limits.relative_speed_m_s
    return p, Target(deck, descent_rate_m_s=rate, speed_max_m_s=most_m_s, yaw_rad=turn_rad(s, o, estimate))


def _allows(command: Command, p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Command:
    """Return the command; where the deck's heave is not seen down to the surface that is ranged, else over the ground's level.

    By a wrong heave it meets the deck fast.
    """
    below = _descent(p).below
    if below is not None and isinstance(command, Velocity | Lean):
        return descending(command, below.ordered_m_s)
    return command if not isinstance(command, Lean) or sees_heave(s, o) else descending(command, _rate_m_s(p, s, o))


PHASES = {
    State.LAND_HERE: Phase(
        "Going down to the deck where it is, for a person or with its last charge; no limit ends it.",
        {
            **{event: to for event, to in LANDING.items() if event is not Event.LAND},
            Event.BEGIN: State.SEARCH,
            Event.STAY: State.SEARCH,
            Event.CONTACT: State.PRESS,
        },
        _events,
        _aim,
        _note,
        _allows,
    ),
}
