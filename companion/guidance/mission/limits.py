"""The limits of gate and commit: the first one that does not hold, as a reason with its numbers."""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from msgspec.structs import replace

from companion.base.mission import Reason, ReasonCause
from companion.guidance.controller import Knowledge
from companion.guidance.mission.clearance import rise_beyond_climb_m
from companion.guidance.mission.progress import InputQuality
from companion.settings.guidance import GuidanceOptions
from companion.settings.mission import ConeOptions, LandingLimits
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.keys import grown
from estimator.contracts.motion import G_M_S2, DeckMotion
from estimator.contracts.time import MonoNs, seconds_between

_MOTORS_STOP_S = 0.2
"""Time in contact after which a vehicle's own landing stops the motors, s."""
_DECK_M_S = 5.0
"""Vertical speed of a pad that no vessel reaches. Over the shipped vessels (configs/vessels) on the seas of the shipped scenarios
the largest standard deviation is 1.3 m/s (`research_vessel`, 94 m in a swell of 4 m; her record has 2.7 m/s within five minutes
30 m from the middle)."""
_DECK_M_S2 = 5.0  # vertical acceleration of a pad that no vessel reaches: 0.9 m/s^2 there, and 2.4 m/s^2 in the record
_DECK_RAD_S = math.radians(40.0)
"""Rate of a deck's tilt that no vessel reaches: 3.1 deg/s (ferry in 0.3 m waves), and room for a roll of 12 degrees in 3 s (25
deg/s)."""
_DECK_SIGMAS = 2.0
"""Standard deviations that a motion of the deck has to be beyond them."""
_FRICTION = 0.5
"""Friction between feet and deck, of its weight; wet steel has less, rubber more."""
COMMIT_SPEED = 1.5
"""Error and speed along the deck at the contact to come that end a commit while it can, over the gate's limits."""
SIGMAS_AHEAD = 2.0
"""Standard deviations of the place at the contact that count."""
_LATER_TRY = 0.25  # growth of the cone and of the limits of place and tilt with each go-around
_LATER_MOST = 1.5  # the largest growth
_REACHED_M = 0.05
"""Height of the feet at which the deck is reached, m."""
_GUST_S = 2.0
"""Time for which a gust lasts, s."""
_USUAL_SIGMA_M_S = 0.15
"""1-sigma of the speed along the deck that the filter has without an IMU, too, m/s; a ship that brakes makes it greater."""
_STEERS_M_S2 = 2.5  # docs/decisions/ship-manoeuvres.md: acceleration until the contact of a ship that is seen to brake or turn
_JOLTED_M_S2 = 10.0  # the same of one whose own sensors show its begin (docs/decisions/ship-manoeuvres.md)
_DECIDES_M = 0.05
"""Height over the least one for a climb from which on that ends the commit, m: two frames of 30 a second and more."""
LEANS_MORE_M_S2 = 2.0
"""Further lean, ahead and aside together, that a vehicle has before it follows the order to go around, m/s^2."""
_CLIMB_LEAST = 0.2
"""Least part of the climb that counts against a deck that rises."""
ON_PAD = 1.4
"""Share of the commit's limit beside the centre at which a vehicle that touches the deck may come to stand: a rim remains."""
OUT = 2.0
"""(error / radius)^2 beyond which the drone comes back over the pad before it descends further."""
_LEAST_HEIGHT_M = 0.15
"""Height up to which the cone is as wide as at this one, m."""


Comparison = tuple[ReasonCause, float | None, float]
"""The name of a limit, what is measured, and the limit."""


@lru_cache(maxsize=8)
def of_try(options: GuidanceOptions, go_arounds: int) -> GuidanceOptions:
    """Return the options of a try: after go-arounds an error that stays on the pad is better than another one.

    The cone widens with the gate's error, or a gust takes the drone out of it before the gate can open.
    """
    looser = min(_LATER_MOST, 1.0 + _LATER_TRY * go_arounds)
    limits = grown(options.limits, looser, ("error_m", "deck_tilt_gate_deg", "deck_tilt_commit_deg"))
    return replace(options, limits=limits, cone=grown(options.cone, looser, ("slope",)))


def beside_m(estimate: RelativeState, knowledge: Knowledge) -> float:
    """Return the distance from the place over the pad that the contact is wanted at, m."""
    return math.dist(estimate.d_body_pad_level.tolist()[:2], knowledge.aim_level)


def radius_m(height_m: float, options: ConeOptions) -> float:
    """Return the cone's radius at a height over the deck, m: that at which the descent would all but end."""
    return options.slope * max(_LEAST_HEIGHT_M, height_m)


def outside(error_m: float, height_m: float, options: ConeOptions) -> bool:
    """Return whether the drone has left the cone by more than a gust."""
    return error_m > math.sqrt(OUT) * radius_m(height_m, options)


def sigma_m(estimate: RelativeState) -> float:
    """Return the largest horizontal 1-sigma, metres."""
    (a, b), (_, c) = estimate.cov[:2, :2].tolist()
    return math.sqrt(0.5 * (a + c) + math.hypot(0.5 * (a - c), b))


def gate(
    now: MonoNs,
    estimate: RelativeState,
    knowledge: Knowledge,
    quality: InputQuality,
    limits: LandingLimits,
    cone: ConeOptions,
    *,
    aligned: bool,
) -> Reason | None:
    """Return the first limit that does not hold at the gate, or None.

    Args:
        estimate: a fresh, consistent estimate.
        aligned: whether the heading has to be that of the arrow.
    """
    contact_s = to_contact_s(estimate, knowledge, cone)
    v = estimate.v_pad_level
    speed = math.hypot(v[0], v[1])
    comparisons = [
        *_of_the_sightings(now, estimate, quality, limits),
        (ReasonCause.SIGMA, sigma_m(estimate), limits.sigma_m),
        (ReasonCause.TIME_LOCK, quality.time_sigma_s, limits.time_sigma_s),
        (ReasonCause.ERROR, beside_m(estimate, knowledge), min(limits.error_m, knowledge.rim_m)),
        (ReasonCause.RELATIVE_SPEED, speed, COMMIT_SPEED * limits.relative_speed_m_s),
        *_at_contact(knowledge, limits, 1.0),
        *_of_the_deck(knowledge, limits, contact_s),
        (ReasonCause.DECK_RISE, rise_beyond_climb_m(knowledge), limits.deck_rise_m),
        (ReasonCause.DECK_FALL, fall_m_s(knowledge, contact_s, cone), limits.deck_fall_m_s),
    ]
    if aligned:
        off_rad = math.pi if estimate.yaw_rad is None else abs(wrap_pi(estimate.yaw_rad))
        comparisons.append((ReasonCause.HEADING, math.degrees(off_rad), limits.heading_deg))
    return _first(comparisons)


def impossible_deck(deck: DeckMotion | None) -> bool:
    """Return whether the deck's estimated motion is impossible, beyond the uncertainty of its motion: a sensor is wrong."""
    if deck is None:
        return False
    excess = (
        (deck.v_level.item(2), deck.cov_level.item(2, 2), _DECK_M_S),
        (deck.a_level.item(2), deck.cov_level.item(5, 5), _DECK_M_S2),
        (deck.roll_rate_rad_s, deck.cov_tilt.item(2, 2), _DECK_RAD_S),
        (deck.pitch_rate_rad_s, deck.cov_tilt.item(3, 3), _DECK_RAD_S),
    )
    return any(abs(x) - _DECK_SIGMAS * math.sqrt(max(0.0, var)) > most for x, var, most in excess)


def stop_m(estimate: RelativeState) -> float:
    """Return the distance from the pad's centre at which a vehicle that touches the deck now comes to stand, m."""
    x, y, _ = estimate.d_body_pad_level.tolist()
    vx, vy, _ = estimate.v_pad_level.tolist()
    slides_s = math.hypot(vx, vy) / (2.0 * _FRICTION * G_M_S2)
    return math.hypot(x + slides_s * vx, y + slides_s * vy)


def agreed(now: MonoNs, estimate: RelativeState, quality: InputQuality, limits: LandingLimits) -> bool:
    """Return whether the sightings are as recent and as consistent as the gate requires."""
    return _first(_of_the_sightings(now, estimate, quality, limits)) is None


def no_return_m(knowledge: Knowledge, cone: ConeOptions) -> float:
    """Return the height of the body below which a climb begins after the contact, which then comes at full thrust."""
    late_s = 0.0 if knowledge.response is None else max(0.0, knowledge.response.longer_s)
    return cone.feet_below_m + (cone.no_return_s + late_s) * cone.commit_rate_m_s


def lower_foot_m(knowledge: Knowledge, cone: ConeOptions) -> float:
    """Return how much lower than a level vehicle's the lowest of four feet at the corners is, m."""
    body = knowledge.body
    return 0.0 if body is None else cone.feet_aside_m * sum(map(abs, body.lean_m_s2)) / G_M_S2


def reached(estimate: RelativeState, knowledge: Knowledge, cone: ConeOptions) -> bool:
    """Return whether the lowest foot is at the deck, as far as its height is known."""
    return estimate.height_m - cone.feet_below_m <= _REACHED_M + lower_foot_m(knowledge, cone)


def lift_m(estimate: RelativeState, knowledge: Knowledge, cone: ConeOptions) -> float:
    """Return the height of the body from which a climb that is ordered now still keeps every foot off the deck, m.

    The descent goes on for the climb's delay, and then ends as the response says, against a deck that rises meanwhile. What makes
    the speed along the deck uncertain makes the descent's uncertain as well.
    """
    down_m_s, climb = max(0.0, -estimate.v_pad_level.item(2)), knowledge.climb
    down_m_s += SIGMAS_AHEAD * max(0.0, math.sqrt(estimate.cov.item(5, 5)) - _USUAL_SIGMA_M_S)
    if climb is None:
        return no_return_m(knowledge, cone)
    delay_s = climb.delay_s + (0.0 if knowledge.response is None else max(0.0, knowledge.response.longer_s))
    rises_m_s = 0.0 if knowledge.deck is None else max(0.0, -knowledge.deck.v_level.item(2))
    up_m_s = max(_CLIMB_LEAST * climb.max_m_s, climb.max_m_s - rises_m_s)
    way_m = delay_s * down_m_s + climb.lag_s * (down_m_s - up_m_s * math.log1p(down_m_s / up_m_s))
    return cone.feet_below_m + _leans_by_m(knowledge, cone) + way_m


def _leans_by_m(knowledge: Knowledge, cone: ConeOptions) -> float:
    """Return how much lower than a level vehicle's the lowest foot will be before a climb has begun, m."""
    return lower_foot_m(knowledge, cone) + cone.feet_aside_m * LEANS_MORE_M_S2 / G_M_S2


def _speed_m_s(estimate: RelativeState, knowledge: Knowledge, cone: ConeOptions, over_m: float) -> float | None:
    """Return the speed along the deck until the contact, m/s; None where a climb would drag the feet over the deck.

    It ends a commit for as long as a climb keeps the feet off the deck: feet that slide catch and tip the vehicle over.

    Args:
        over_m: height over the least one for a climb.
    """
    # So fast, a foot that brushes the deck on the way up is better than a contact: what leaning lowers it by does not count.
    if over_m <= -_leans_by_m(knowledge, cone):
        return None
    v = estimate.v_pad_level
    speed = math.hypot(v[0], v[1])
    if over_m <= 0.0 and knowledge.at_contact is not None:
        # One that is braked until the contact is no reason to brush it.
        speed = min(speed, knowledge.at_contact.speed_m_s)
    if knowledge.deck is None:
        return speed
    sigma_m_s = math.sqrt(max(estimate.cov.item(3, 3), estimate.cov.item(4, 4)))  # the larger one along the deck
    speed += SIGMAS_AHEAD * max(0.0, sigma_m_s - _USUAL_SIGMA_M_S)
    # Higher up the next frames say what she does. A body whose acceleration is not felt seems to be a ship that brakes.
    seen = over_m < _DECIDES_M and estimate.steers and not knowledge.unfelt
    # Until all feet stand: the first that touches does not stop what she does.
    gains_m_s2 = _JOLTED_M_S2 if estimate.jolted else _STEERS_M_S2 if seen else 0.0
    return speed + gains_m_s2 * _descends_s(estimate.height_m - cone.feet_below_m, estimate, cone)


def commit(now: MonoNs, estimate: RelativeState, knowledge: Knowledge, limits: LandingLimits, cone: ConeOptions) -> Reason | None:
    """Return the limit that ends a commit, or None."""
    lift = lift_m(estimate, knowledge, cone)
    turns = estimate.height_m > max(no_return_m(knowledge, cone), lift)
    tilt_deg = _tilt_deg(knowledge.deck) if turns and knowledge.deck is not None else None
    # So low that it touches the deck in any case, a vehicle that comes to stand on the pad is better off there.
    beside = (ReasonCause.ERROR, beside_m(estimate, knowledge), min(limits.commit_error_m, knowledge.rim_m))
    lands = (ReasonCause.ERROR, stop_m(estimate), ON_PAD * limits.commit_error_m)
    over_m = estimate.height_m - lift
    lifts = over_m > 0.0
    speed = _speed_m_s(estimate, knowledge, cone, over_m)
    # Feet that the deck holds make a tilt without a motion: a gust, or a speed to come, that is not there.
    ahead = [] if reached(estimate, knowledge, cone) else _at_contact(knowledge, limits, COMMIT_SPEED)
    return _first(
        [
            *(ahead if turns else ahead[1:] if lifts else ()),
            (ReasonCause.SIGHTING_AGE, estimate.age_s(now), limits.commit_sighting_age_s),
            beside if turns else lands,
            (ReasonCause.RELATIVE_SPEED, speed, COMMIT_SPEED**2 * limits.relative_speed_m_s),
            # What was within the limit at the gate may tilt a little further until the contact.
            (ReasonCause.DECK_TILT, tilt_deg, limits.deck_tilt_gate_deg),
        ]
    )


def _at_contact(knowledge: Knowledge, limits: LandingLimits, looser: float) -> list[Comparison]:
    """Return the comparisons of what the contact will be like; none without a forecast."""
    ahead = knowledge.at_contact
    if ahead is None:
        return []
    # A later try and the commit widen the limit, but never past the place where a foot is over the rim.
    most_m = min(looser * limits.error_m, knowledge.rim_m)
    return [
        (ReasonCause.ERROR_AHEAD, math.hypot(ahead.error_m, SIGMAS_AHEAD * ahead.sigma_m), most_m),
        (ReasonCause.SPEED_AHEAD, ahead.speed_m_s, looser * limits.relative_speed_m_s),
        (ReasonCause.GUST, ahead.gust_m_s, ahead.gust_most_m_s),
    ]


def to_contact_s(estimate: RelativeState, knowledge: Knowledge, cone: ConeOptions) -> float:
    """Return the time until the lowest foot meets the deck, at the commit's rate or the present one if that is higher, s."""
    return _descends_s(estimate.height_m - cone.feet_below_m - lower_foot_m(knowledge, cone), estimate, cone)


def _descends_s(way_m: float, estimate: RelativeState, cone: ConeOptions) -> float:
    return max(0.0, way_m) / max(cone.commit_rate_m_s, -estimate.v_pad_level.item(2))


def gusts_m(gust_m_s2: float, seconds: float) -> float:
    """Return how far gusts not yet measured push the vehicle until then: standard deviation on one axis, m.

    A Gauss-Markov push that lasts for `_GUST_S` changes as its square root at first, and acts as its double integral.
    """
    t = min(seconds, _GUST_S)
    return gust_m_s2 * math.sqrt(2.0 * t / _GUST_S) * t * t / 4.0


def _of_the_sightings(now: MonoNs, estimate: RelativeState, quality: InputQuality, limits: LandingLimits) -> list[Comparison]:
    return [
        # What is constant the filter knows: it puts a late frame in at its own instant.
        (ReasonCause.SIGHTING_AGE, estimate.age_s(now) - quality.delay_s, limits.sighting_age_s),
        (ReasonCause.NIS, quality.normalized_nis, limits.normalized_nis),
    ]


def _of_the_deck(knowledge: Knowledge, limits: LandingLimits, to_contact_s: float) -> list[Comparison]:
    deck, ahead = knowledge.deck, knowledge.forecast
    out: list[Comparison] = []
    if deck is not None:
        out.append((ReasonCause.DECK_TILT, _tilt_deg(deck), limits.deck_tilt_gate_deg))
        out.append((ReasonCause.DECK_RATE, abs(float(deck.v_level[2])), limits.deck_rate_m_s))
    if ahead is not None:
        then = [float(np.interp(to_contact_s, ahead.horizons_s, course)) for course in (ahead.roll_rad, ahead.pitch_rad)]
        sigmas = [float(np.interp(to_contact_s, ahead.horizons_s, s)) for s in (ahead.sigma_roll_rad, ahead.sigma_pitch_rad)]
        out.append((ReasonCause.DECK_TILT, _surely_deg(then, sigmas), limits.deck_tilt_commit_deg))
    return out


def _tilt_deg(deck: DeckMotion) -> float:
    sigmas = [math.sqrt(max(0.0, deck.cov_tilt.item(axis, axis))) for axis in range(2)]
    return _surely_deg((deck.roll_rad, deck.pitch_rad), sigmas)


def _surely_deg(roll_pitch: Sequence[float], sigmas: Sequence[float]) -> float:
    """Return the tilt less its standard deviation: a forecast that knows it to ten degrees tells of none."""
    tilt = math.hypot(*roll_pitch)
    sigma = math.hypot(*(x * s for x, s in zip(roll_pitch, sigmas, strict=True))) / tilt if tilt > 0.0 else 0.0
    return math.degrees(max(0.0, tilt - sigma))


def fall_m_s(knowledge: Knowledge, to_contact_s: float, cone: ConeOptions, sigmas: float = 0.0) -> float | None:
    """Return the fastest fall of the deck that is forecast from the contact until the motors stand, m/s; None without one."""
    ahead = knowledge.forecast
    if ahead is None:
        return None
    then_s = seconds_between(ahead.at, knowledge.at) + to_contact_s + (cone.press_s + _MOTORS_STOP_S) * np.array([0.0, 0.5, 1.0])
    return float(np.interp(then_s, ahead.horizons_s, sigmas * ahead.sigma_rise_m_s - ahead.rise_m_s).max())


def _first(comparisons: list[Comparison]) -> Reason | None:
    """Return the first comparison that fails; a number that is not known fails none, one that is not a number fails."""
    for cause, measured, limit in comparisons:
        if measured is not None and not measured <= limit:
            return Reason(cause, measured, limit)
    return None
