"""Contact with the deck: an upward push that no rotor gives, and the vote of all sensors that can notice one.

A deck that is met at v m/s takes away v m/s of velocity within some hundredths of a second; rotors need tenths. So the specific
force upward beyond its own recent mean is summed over short times, and the sum is the velocity that something took away.
An accelerometer that repeats itself feels nothing, and one with spikes feels decks in the air. So a push is one witness among
several (`votes`): being held up, the vertical speed, the range, a push along the deck, and the height that sight and deck
forecast lead to. A healthy witness decides alone unless another contradicts it; one in doubt needs a second. Height alone never
makes a contact while a healthy accelerometer is silent: blind on the deck a filter's height drifts.

A jolt also moves the filter's speed, so a descent that seems to have ended is no second witness of it. Where the height still
contradicts, at the contact or in a later sight, the drone presses on for the time that the rest of the way takes (`way_s`): it is
at the deck then, jolt or not. And no deck was met for as long as the descent goes on (`descends`).

A deck may also be met softly, so that something holds the vehicle up against every velocity that was commanded lately (`HeldUp`).
A vehicle that tilts against the wind meets the deck with one foot. It turns about that foot, its middle is slowed down over some
tenths of a second, and no step of the accelerometer shows it. A real PX4 stood on a deck like this for two seconds, with its
thrust falling and its tilt growing. What it does then no flight does: it goes up faster than any of the newest commands requests,
and goes on doing so. Commands are remembered for longer than a vehicle takes to answer them, and the least of them counts, so
that neither a delay nor a step of the commands is a contact. It is for velocities over the ground, an autopilot's, and for the
same ones to the deck (`to_deck`): a deck that falls faster and faster carries a vehicle down past the least one over the ground.
"""

import math
from collections.abc import Iterator

from msgspec import Struct, structs

from companion.base.mission import Event, Reason, ReasonCause
from companion.guidance.controller import Impact
from companion.guidance.mission import limits
from companion.guidance.mission.held_up import HELD_S
from companion.guidance.mission.progress import BOUNCES_MOST, EarlyTouch, GuidanceCycle, Progress
from companion.settings.guidance import GuidanceOptions
from companion.settings.mission import ConeOptions
from estimator.contracts.estimates import RelativeState
from estimator.contracts.samples import Imu
from estimator.contracts.time import MonoNs, seconds_between

MEAN_S = 0.15
"""Time constant of the mean that stands for flight without contact, s."""
LEAST_M_S2 = 3.0
"""Push beyond the mean that counts, m/s^2; gusts and commanded climbs stay below."""
LEAST_M_S = 0.1
"""Velocity that the push must have taken away, m/s."""
TOUCH_M_S = 0.035
"""Velocity that the push of one foot takes away that touches before the others, m/s: the vehicle pivots about it
(docs/decisions/wind.md)."""
TOUCH_M_S2 = 4.5
"""Peak of such a push, m/s^2 (docs/decisions/wind.md)."""
TURNED_RAD_S = 0.3
"""Change of the turn rate beyond its mean, rad/s: it turns about a foot that the deck holds. Gusts make a third of it."""
WITHIN_S = 0.08
"""Longest time over which one push is summed, s."""
QUIET_S = 0.3
"""Time after a contact in which its own rebounds make no further event, s."""
FROZEN_S = 0.15
"""Time for which the upward force repeats one value, to the last bit, after which the accelerometer feels nothing, s."""
MOST_M_S = 1.2
"""Velocity that no landing's contact takes away at its first push, m/s: more is a spike of the sensor."""
_QUICK_S = 0.01
"""Time between samples up to which a contact lasts for several of them; of these one alone is in doubt, s."""
_AGAIN_S = 3.0
"""Time after a push within which another one is in doubt, s."""

ENOUGH = 1.0
"""Votes that are a contact."""
NEAR_M = 0.12
"""Height of the feet up to which a push may be the deck, m; doubtful above."""
_BENEATH_M = -0.08  # height of the feet beneath which nothing can be
_WRONG_M = -0.3  # height of the feet beneath which the height is wrong
SIGMA_MOST_M = 0.15
"""Standard deviation of the height beyond which it is not used, m."""
_STILL_M_S = 0.15
"""Vertical speed against the deck that counts as zero, m/s; the commit commands more than twice as much."""
_GOES_ON = 0.75
"""Share of the commit's rate from which on a descent goes on as ordered."""
_ORDERED_S = 0.3  # time in the commit before standing still differs from not having begun to move
_AFTER_S = 0.1  # the same after a push
_HELD_UP_BELOW = 0.75
"""Share of the gate's height below which being held up is a contact."""
_TOUCH_S = 0.3
"""Time for which the push of one foot counts, s."""
_TOUCHES_MOST = 4
"""Number of bounces after which a contact in a state that none belongs to no longer makes it press on."""
_TOUCHES_SAME = 2  # number of commits whose touches at the same height are no jolts
_SAME_M = 0.06  # how far their heights may differ
_RANGE_NEAR_M = 0.08  # range beyond the feet's own up to which the deck is there
_RANGE_FAR_M = 0.3  # range beyond the feet's own from which on it is not


class ContactWatch(Struct, frozen=True):
    """The detector's memory."""

    at: MonoNs | None = None
    mean_m_s2: float = 0.0
    """Mean of the upward specific force, m/s^2."""
    since: MonoNs | None = None
    """Start of the push under way."""
    taken_m_s: float = 0.0
    """Velocity that it has taken away so far, m/s."""
    peak_m_s2: float = 0.0
    newest: Impact | None = None
    touch: Impact | None = None
    """The newest push, or turn, that one foot may have made; in doubt by itself."""
    turn_rad_s: float = 0.0
    """Mean of the turn rate, rad/s."""
    up_m_s2: float = math.nan
    """The newest upward specific force."""
    same_since: MonoNs | None = None
    """Time since which the value has been the same to the last bit."""

    @property
    def feels(self) -> bool:
        """True if the accelerometer is alive: a live one does not repeat a value for long in flight."""
        if self.at is None or self.same_since is None:
            return True
        return seconds_between(self.same_since, self.at) < FROZEN_S


def watched(watch: ContactWatch, imu: Imu) -> ContactWatch:
    """Return the memory after one IMU sample; `newest` is the newest contact."""
    now, up, before = imu.stamp.measured_at, -imu.f_body.item(2), watch.at
    dt = 0.0 if before is None else seconds_between(before, now)
    same = (watch.same_since or before) if up == watch.up_m_s2 else None
    turn_rad_s = imu.w_body.item(2)
    fresh = ContactWatch(now, up, newest=watch.newest, touch=watch.touch, turn_rad_s=turn_rad_s, up_m_s2=up, same_since=same)
    if not 0.0 < dt <= MEAN_S:
        return fresh
    turned_rad_s = abs(turn_rad_s - watch.turn_rad_s)
    turn_rad_s = watch.turn_rad_s + (1.0 - math.exp(-dt / MEAN_S)) * (turn_rad_s - watch.turn_rad_s)
    touch = watch.touch if turned_rad_s < TURNED_RAD_S else Impact(now, "gyro", turned_rad_s=turned_rad_s, doubtful=True)
    return _pushed(watch, structs.replace(fresh, turn_rad_s=turn_rad_s, touch=touch), now, dt)


def _pushed(watch: ContactWatch, fresh: ContactWatch, now: MonoNs, dt: float) -> ContactWatch:
    """Return the memory after the upward force of a sample.

    Args:
        watch: the memory before the sample.
        fresh: the memory without a push, and with the sample's turn rate.
        dt: the time since the sample before, s.
    """
    up = fresh.up_m_s2
    push = up - watch.mean_m_s2
    last_s = math.inf if watch.newest is None else seconds_between(watch.newest.at, now)
    if push <= LEAST_M_S2:
        if watch.since is not None and watch.since == watch.at and watch.taken_m_s >= LEAST_M_S and last_s > QUIET_S:
            # It was gone with the next sample: feet on a deck push for longer.
            fresh = structs.replace(fresh, newest=Impact(watch.at, "accelerometer", watch.peak_m_s2, doubtful=True))
        return structs.replace(fresh, mean_m_s2=watch.mean_m_s2 + (1.0 - math.exp(-dt / MEAN_S)) * push)
    # The mean waits while something pushes: it stands for flight.
    since = now if watch.since is None else watch.since
    if seconds_between(since, now) > WITHIN_S:
        # A push that lasts is no contact: the weight or the sensor changed.
        return fresh
    taken, peak = watch.taken_m_s + push * dt, max(watch.peak_m_s2, push)
    watch = structs.replace(fresh, mean_m_s2=watch.mean_m_s2, since=since, taken_m_s=taken, peak_m_s2=peak)
    if taken >= TOUCH_M_S and peak >= TOUCH_M_S2:
        watch = structs.replace(watch, touch=Impact(now, "accelerometer", peak, doubtful=True))
    alone = since == now and dt <= _QUICK_S
    if taken >= LEAST_M_S and last_s > QUIET_S and not alone:
        return structs.replace(watch, newest=Impact(now, "accelerometer", peak, doubtful=taken > MOST_M_S or last_s <= _AGAIN_S))
    return watch


def feet_m(s: GuidanceCycle, cone: ConeOptions) -> float | None:
    """Return the height of the feet over the deck by sight and dead reckoning since, m; None if it has no vote."""
    estimate = s.estimate
    if estimate is None or not estimate.consistent or _sigma_m(s) > SIGMA_MOST_M:
        return None
    height_m = estimate.height_m - cone.feet_below_m
    return height_m if height_m >= _WRONG_M else None


def votes(s: GuidanceCycle, felt: Impact | None, o: GuidanceOptions, ordered_s: float) -> float:
    """Return the votes for a contact in the commit; `ENOUGH` or more are one.

    Args:
        felt: what was felt in this commit; None if nothing was.
        ordered_s: time for which the descent to the deck has been ordered.
    """
    cone = o.cone
    count = _of_impact(felt, feels=s.feels)
    feet, estimate = feet_m(s, cone), s.estimate
    if feet is not None and estimate is not None:
        if feet <= _BENEATH_M:
            count += 1.0
        elif limits.reached(estimate, s.knowledge, cone):
            # A tilted vehicle that does not move as it tilts: at the deck that is no gust, feet that stand make it.
            count += 1.0 if s.wind is not None and s.wind.begins else 0.5
        elif feet - 3.0 * _sigma_m(s) > NEAR_M and estimate.age_s(s.at) <= o.limits.commit_sighting_age_s:
            count -= 0.5
        moved_s = math.inf if felt is None else seconds_between(felt.at, s.at)
        if abs(estimate.v_pad_level.item(2)) < _STILL_M_S and ordered_s >= _ORDERED_S and moved_s >= _AFTER_S:
            count += 0.5
    return count + (0.0 if s.range_m is None else _of_range(s.range_m - cone.feet_below_m))


def _of_range(over_m: float) -> float:
    return 0.5 if over_m <= _RANGE_NEAR_M else -0.5 if over_m >= _RANGE_FAR_M else 0.0


def descends(s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether the descent that was ordered goes on: what was felt did not end it.

    An estimate that refuses its sightings counts as well: a jolt makes it do so.
    """
    estimate = s.estimate
    if estimate is None or estimate.alerts or s.knowledge.unfelt or not s.feels:
        return False
    if estimate.age_s(s.at) > o.limits.commit_sighting_age_s:
        return False
    surely_m_s = -estimate.v_pad_level.item(2) - math.sqrt(max(0.0, estimate.cov.item(5, 5)))
    return surely_m_s > _GOES_ON * o.cone.commit_rate_m_s


def way_s(s: GuidanceCycle, o: GuidanceOptions, near_m: float = 0.0) -> float:
    """Return the time that the way to the deck still takes by a height that surely contradicts a contact, s; 0 without one.

    An estimate that refuses its sightings counts as well, as in `descends`.

    Args:
        near_m: height of the feet that it has to exceed, m.
    """
    estimate, sigma_m = s.estimate, _sigma_m(s)
    if estimate is None or sigma_m > SIGMA_MOST_M or estimate.age_s(s.at) > o.limits.commit_sighting_age_s:
        return 0.0
    feet = estimate.height_m - o.cone.feet_below_m
    if s.range_m is not None and s.range_m - o.cone.feet_below_m <= _RANGE_NEAR_M:
        return 0.0
    return feet / o.cone.commit_rate_m_s if feet - 3.0 * sigma_m > near_m else 0.0


def felt(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Impact | None:
    """Return the contact that was felt in the present state, or None.

    An updraft holds up too, so being held up counts near the deck alone and while it lasts.
    """
    impact = s.knowledge.impact
    if impact is None or p.since is None or impact.at < p.since:
        return None
    if impact.by != "velocity":
        return impact
    least_m = 0.0 if s.estimate is None else least_height_m(s, o, s.estimate)
    low = least_m < o.cone.feet_below_m + _HELD_UP_BELOW * o.cone.gate_height_m
    return impact if low and seconds_between(impact.at, s.at) <= HELD_S else None


def touched(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    """Return the memory of a commit with the first touch that was felt in it, higher than the deck is, in sight of the pad."""
    impact, height_m = felt(p, s, o), feet_m(s, o.cone)
    if impact is None or impact.doubtful or p.since is None or height_m is None or s.estimate is None:
        return p
    over_m = height_m - limits.lower_foot_m(s.knowledge, o.cone)
    seen = s.estimate.age_s(s.at) <= o.limits.commit_sighting_age_s
    if not seen or over_m <= NEAR_M or (p.touches and p.touches[-1].commit == p.since):
        return p
    return structs.replace(p, touches=(*p.touches[1 - _TOUCHES_SAME :], EarlyTouch(p.since, over_m)))


def feet_elsewhere(p: Progress) -> Reason | None:
    """Return that the feet touch the deck at another height than the settings say, by touches of several commits; else None."""
    heights_m = [touch.feet_m for touch in p.touches]
    if len(heights_m) < _TOUCHES_SAME or max(heights_m) - min(heights_m) > _SAME_M:
        return None
    return Reason(ReasonCause.FEET, 100.0 * sum(heights_m) / len(heights_m), len(heights_m))


def least_height_m(s: GuidanceCycle, o: GuidanceOptions, estimate: RelativeState) -> float:
    """Return the least height that the body may have, m; a height that is seen counts as it is."""
    seen = estimate.age_s(s.at) <= o.limits.commit_sighting_age_s
    sigmas_m = 0.0 if seen else 3.0 * math.sqrt(max(0.0, estimate.cov.item(2, 2)))
    return estimate.height_m - sigmas_m


def meets_deck(p: Progress, s: GuidanceCycle, o: GuidanceOptions, ordered_s: float) -> tuple[float, Impact | None]:
    """Return the votes for a contact on a way down to the deck, and what was felt on it.

    Args:
        ordered_s: time for which the descent to the deck has been ordered.
    """
    if p.since is None:
        return 0.0, None
    impact = felt(p, s, o)
    if impact is None and s.touch is not None and p.since <= s.touch.at and seconds_between(s.touch.at, s.at) <= _TOUCH_S:
        impact = s.touch
    return votes(s, impact, o, ordered_s) + (0.5 if p.bounces >= BOUNCES_MOST else 0.0), impact


def stands_on_pad(s: GuidanceCycle, o: GuidanceOptions) -> bool:
    """Return whether a vehicle whose feet touch the deck now comes to stand on the pad."""
    height_m = feet_m(s, o.cone)
    if s.estimate is None or height_m is None or height_m > NEAR_M:
        return False
    return limits.stop_m(s.estimate) <= limits.ON_PAD * o.limits.commit_error_m


def stays(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[tuple[Event, Reason]]:
    """Yield a contact in a state that none belongs to: near the pad's centre it is taken as the landing all the same."""
    impact = felt(p, s, o)
    if impact is not None and p.bounces < _TOUCHES_MOST and stands_on_pad(s, o):
        yield Event.CONTACT, reason_of(impact)


def is_own_thrust(impact: Impact | None, s: GuidanceCycle) -> bool:
    """Return whether a push in a climb is no more than what the climb needs to begin, beyond the least of a contact."""
    climb, fastest = s.knowledge.climb, s.knowledge.climb_max_m_s
    if impact is None or impact.by != "accelerometer" or climb is None or fastest is None:
        return False
    return impact.size_m_s2 <= LEAST_M_S2 + fastest / climb.lag_s


def reason_of(impact: Impact) -> Reason:
    """Return a contact as a reason."""
    if impact.by == "accelerometer":
        return Reason(ReasonCause.FELT, impact.size_m_s2)
    if impact.by == "gyro":
        return Reason(ReasonCause.TURNED_ABOUT, math.degrees(impact.turned_rad_s))
    return Reason(ReasonCause.HELD_UP, impact.held_m_s)


def _of_impact(felt: Impact | None, *, feels: bool) -> float:
    """Return the votes of what was felt; a healthy accelerometer that feels nothing votes against a contact."""
    if felt is None:
        return -0.5 if feels else 0.0
    in_doubt = felt.doubtful or (felt.by == "accelerometer" and not feels)
    return 0.5 if in_doubt else 1.0


def _sigma_m(s: GuidanceCycle) -> float:
    return math.inf if s.estimate is None else math.sqrt(max(0.0, s.estimate.cov.item(2, 2)))
