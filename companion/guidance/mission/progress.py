"""The mission's memory and its inputs in one guidance cycle, beside what guidance knows about pad and deck.

The memory is the state and what the attempt, the flight and the newest guidance cycles have left behind.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple, TypeGuard

import numpy as np
from msgspec import Struct, field, structs

from companion.base.mission import CONTACT_INTENDED, DESCENDS, FLOWN, Event, Reason, ReasonCause, State, StateChange
from companion.guidance.controller import Impact, Knowledge
from companion.guidance.mission.held_course import HeldCourse
from companion.guidance.mission.wind import WindOverDrone
from companion.settings.mission import TryOptions
from estimator.contracts.commands import Command, Hover, Lean, Velocity
from estimator.contracts.estimates import RelativeState, Verdict
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import MonoNs, seconds_between

_FRAMES_LEAST = 10  # frames from which on their verdicts give a reason
_UNFLOWN_S = 0.15
"""Age of the vehicle's newest sample, s, from which on its own hover is expected: an AR.Drone hovers at .25 s."""
_LANDS_M_S = 0.3
"""Speed of a deck that falls up to which the vehicle's own landing, at 0.4 m/s, presses on it."""
SIGHT_HOLDS_S = 5.0
"""Unbroken sight for this long resets the time without sight, seconds."""
STARVED_S = 0.25
"""Gap between two guidance cycles in which a vehicle has flown blindly on."""
_STARVED_MOST_S = 2.0  # how much of it an attempt may have
_SWEEPS_MOST = 5
"""Sweeps out of the cone near the deck that a try may have: wind and waves do not let it settle, and it swings beside the pad."""
_GAP_MAX_S = 1.0
"""Longest time that one guidance cycle adds, seconds, even if the machine was not called for longer."""
JUMP_RAD = math.radians(90.0)
"""Change of the estimated heading within one guidance cycle that no vehicle makes."""
NEAR_DECK_M = 1.0
"""Height of the feet below which a rotor reaches a person who kneels on the deck, or an object that stands there, m."""
BOUNCES_MOST = 2
"""Number of bounces after which it stays down: it lands by the vehicle's own landing, off the deck again or not."""


class InputQuality(Struct, frozen=True):
    """Quality of the service's inputs, beside the estimate."""

    normalized_nis: float | None = None
    """Recent mean of the sightings' NIS over the number of components; None before the first comparison."""
    time_sigma_s: float | None = None
    """Standard deviation of the newest sighting's time stamp; None before the first."""
    delay_s: float = 0.0
    """The camera's constant delay: how old a sighting is at least when it is fused."""


class VesselPosition(Struct, frozen=True, eq=False):
    """The pad's place and motion by the reports of ship and vehicle, without the camera."""

    at: MonoNs
    d_body_pad_level: F64
    """Vector from the body to the pad, (2,) m forward and right."""
    sigma_m: float
    """Horizontal standard deviation."""
    v_level: F64
    """Velocity of the ship over the ground, (2,) m/s forward and right."""
    axis_rad: float
    """Direction of the bow in `level`, clockwise from forward; that of north if nothing says where the bow points."""
    bow_known: bool
    height_m: float | None
    """Height of the body over the pad; None if one of the two does not know its own."""

    @property
    def distance_m(self) -> float:
        """Horizontal distance, metres."""
        return math.hypot(float(self.d_body_pad_level[0]), float(self.d_body_pad_level[1]))


class VehicleHold(Struct, frozen=True):
    """The hold that a vehicle has by itself, which decides what a command of guidance means to it."""

    over_ground: bool
    """True for an autopilot: its own hover holds over the ground, and its driver adds the deck's velocity to a `Velocity`, so one
    of zero stays with the deck. False for an AR.Drone: it holds against the deck by optical flow, and ranges a near surface."""

    def staying(self, climb_m_s: float) -> Command:
        """Return the command that stays with the deck, or climbs from it, where no estimate of the pad will do."""
        return Velocity(np.array([0.0, 0.0, -climb_m_s]), 0.0) if self.over_ground or climb_m_s != 0.0 else Hover()

    def climbing(self, climb_m_s: float, knowledge: Knowledge) -> tuple[float, Command]:
        """Return the climb over the ground, m/s, and the command that climbs so fast against the deck and else stays with it."""
        if self.over_ground:
            return with_deck_m_s(climb_m_s, knowledge), self.staying(climb_m_s)
        rate_m_s = climb_m_s + (0.0 if climb_m_s == 0.0 else max(0.0, with_deck_m_s(0.0, knowledge)))
        return rate_m_s, self.staying(rate_m_s)

    def with_ship(self, v_level: F64, v_ship_level: F64) -> Velocity:
        """Return the command that flies a velocity to the ship, (3,) m/s, whose own is (2,) m/s over the ground."""
        v = np.array(v_level)
        if not self.over_ground:
            v[:2] += v_ship_level
        return Velocity(v, 0.0)

    def moves(self, command: Command) -> TypeGuard[Velocity | Lean]:
        """Return whether a command has a vertical speed over the ground, to which no driver adds the deck's."""
        return isinstance(command, Lean) or (isinstance(command, Velocity) and not self.over_ground)


def with_deck_m_s(climb_m_s: float, knowledge: Knowledge) -> float:
    """Return the climb over the ground of a vehicle that follows the deck and climbs from it, m/s."""
    return climb_m_s - (0.0 if knowledge.deck is None else knowledge.deck.v_level.item(2))


class GuidanceCycle(Struct, frozen=True, eq=False):
    """One guidance cycle."""

    at: MonoNs
    knowledge: Knowledge
    battery: float | None = None
    """Charge from 0 to 1; None if the vehicle does not report it."""
    wind: WindOverDrone | None = None
    """The wind over the drone; None before it was watched for some seconds."""
    quality: InputQuality = field(default_factory=InputQuality)
    frames: Mapping[Verdict, int] = field(default_factory=Counter)
    """Number of frames by verdict since the newest that was fused."""
    vessel: VesselPosition | Reason | None = None
    """The ship's place by reports, or why it is not known; None where the drone does not fly to it."""
    silent_s: float = 0.0
    """Time since the newest sample of the vehicle: while it is silent, it may not obey."""
    feels: bool = True
    """True if the accelerometer is alive, so that its silence means no contact."""
    late_s: float | None = None
    """Delay of the vehicle's answer, if that is too late to fly; None otherwise."""
    touch: Impact | None = None
    """The newest push that one foot alone may have made; None before one."""
    range_m: float | None = None
    """The newest range to the surface below; None without a fresh one."""
    hold: VehicleHold = VehicleHold(over_ground=False)
    thing: Reason | None = None
    """Objects on the pad; None if nothing was seen lately, or if the operator says that it is clear."""
    unseen: Reason | None = None
    """Glare that hides a part of the pad; None if there is none, or if the operator says that it is clear."""
    off_orders: Reason | None = None
    """Height to which the vehicle went against what is ordered; None while it flies as ordered."""
    age_s: float = 0.0
    """Age of the newest measurement of the vehicle: where samples come late, its driver flies by none of them."""

    mode: str = ""
    """The vehicle's own name for its mode; empty before it reports one."""
    tipped: Reason | None = None
    """Evidence that it lies on the deck; None while it does not."""
    unconfirmed: Reason | None = None
    """The monitor's reason to fly nothing by the velocity out of sight; None while the sight or a check may help."""

    by_hand: bool = False
    """True while a person flies it by our sticks."""

    @property
    def unflown(self) -> bool:
        """True if its own landing is better than to press on: its motion is so old that its driver is about to let it hover.

        A deck that falls faster than the vehicle lands by itself would drag it along, and leaves a hover behind.
        """
        deck = self.knowledge.deck
        falls = deck is not None and deck.v_level.item(2) > _LANDS_M_S
        return self.silent_s > _UNFLOWN_S or (self.age_s > _UNFLOWN_S and not falls)

    @property
    def place(self) -> VesselPosition | None:
        """The ship's place by reports; None if it is not known."""
        return self.vessel if isinstance(self.vessel, VesselPosition) else None

    @property
    def estimate(self) -> RelativeState | None:
        """The estimate of the pad, fit to steer by or not."""
        return self.knowledge.relative


def fit_to_steer(estimate: RelativeState | None, now: MonoNs, stale_after_s: float) -> bool:
    """Return whether there is a consistent estimate, computed recently from a recent sighting."""
    return unfit(estimate, now, stale_after_s) is None


def unfit(estimate: RelativeState | None, now: MonoNs, stale_after_s: float) -> Reason | None:
    """Return why an estimate is not fit to steer by, or None if it is.

    Args:
        stale_after_s: age of the newest sighting, or of the estimate itself, beyond which it is not, seconds.
    """
    if estimate is None:
        return Reason(ReasonCause.NO_ESTIMATE)
    if estimate.alerts:
        return Reason(ReasonCause.ALERT, detail=estimate.alerts[0])
    age_s = max(abs(estimate.age_s(now)), abs(seconds_between(estimate.at, now)))
    if age_s > stale_after_s:
        return Reason(ReasonCause.STALE, age_s, stale_after_s)
    return None if estimate.consistent else Reason(ReasonCause.INCONSISTENT)


_SEARCHED = frozenset(Verdict) - {Verdict.REPLACED, Verdict.SKIPPED}


def of_frames(frames: Mapping[Verdict, int]) -> Reason | None:
    """Return what became of most frames without sight; None if there are too few to say, or they simply show no pad."""
    total = sum(frames.values())
    if total < _FRAMES_LEAST:
        return None
    verdict = max(frames, key=lambda each: frames[each])
    share = frames[verdict] / total
    if verdict is Verdict.NO_PAD or share < 0.5:
        return None
    empty, searched = (sum(n for each, n in frames.items() if each in some) for some in ((Verdict.NO_PAD,), _SEARCHED))
    if 2 * empty > searched:
        return Reason(ReasonCause.FRAMES_UNSEEN, 100.0 * share, 100.0 * empty / searched, verdict)
    return Reason(ReasonCause.FRAMES, 100.0 * share, 50.0, verdict)


class Attempt(Struct, frozen=True):
    """Time and retries that a landing attempt has used so far. A go-around or an order begins another."""

    began: MonoNs | None = None
    """Time of the first sight of the pad."""
    losses: int = 0
    """Number of losses of sight below the safe height."""
    sweeps: int = 0
    """Number of times that it was swept out of the cone near the deck."""
    blind_descent_m: float = 0.0
    without_sight_s: float = 0.0
    spent_s: Mapping[State, float] = field(default_factory=dict)
    """Time in each state whose visits share one time budget."""
    with_sight_s: float = 0.0
    """Time of unbroken sight, seconds."""
    starved_s: float = 0.0
    """Time in gaps between guidance cycles, seconds: of a computer that is too slow, or that stood still."""

    def seen(self, now: MonoNs, since_last_s: float) -> Attempt:
        """Add one guidance cycle with sight of the pad."""
        held = self.with_sight_s + _counted_s(since_last_s)
        without = 0.0 if held >= SIGHT_HOLDS_S else self.without_sight_s
        return structs.replace(self, began=now if self.began is None else self.began, with_sight_s=held, without_sight_s=without)

    def unseen(self, since_last_s: float) -> Attempt:
        """Add one guidance cycle without sight of the pad."""
        return structs.replace(self, with_sight_s=0.0, without_sight_s=self.without_sight_s + _counted_s(since_last_s))

    def spend(self, state: State, since_last_s: float) -> Attempt:
        """Add one guidance cycle in a state: a gust that takes the drone out of it, and a loss of sight, give it no more time."""
        return structs.replace(self, spent_s={**self.spent_s, state: self.spent_s.get(state, 0.0) + _counted_s(since_last_s)})

    def cycle(self, since_last_s: float) -> Attempt:
        """Add one guidance cycle as late as it comes."""
        return self if since_last_s <= STARVED_S else structs.replace(self, starved_s=self.starved_s + since_last_s)

    def lost(self) -> Attempt:
        """Add one loss of sight."""
        return structs.replace(self, losses=self.losses + 1)

    def swept(self) -> Attempt:
        """Add one sweep out of the cone near the deck."""
        return structs.replace(self, sweeps=self.sweeps + 1)

    def descended(self, metres: float) -> Attempt:
        """Add the height lost between two sights, metres; climbing gives nothing back."""
        return structs.replace(self, blind_descent_m=self.blind_descent_m + max(0.0, metres))

    def again(self) -> Attempt:
        """Return the budget of the next attempt: the remaining time without sight carries over."""
        stayed_s: dict[State, float] = {state: s for state, s in self.spent_s.items() if state is State.STAY}
        return Attempt(without_sight_s=self.without_sight_s, spent_s=stayed_s)

    def stayed(self, now: MonoNs) -> Attempt:
        """Return the budget after a cycle over the pad in unbroken sight: a wait there costs a landing nothing."""
        spent_s: dict[State, float] = {State.STAY: self.spent_s.get(State.STAY, 0.0)}
        return Attempt(now, without_sight_s=self.without_sight_s, spent_s=spent_s, with_sight_s=self.with_sight_s)

    def used_up(self, options: TryOptions, now: MonoNs) -> Reason | None:
        """Return what is used up, or None while nothing is."""
        if self.began is not None and seconds_between(self.began, now) > options.try_s:
            return Reason(ReasonCause.TRY_TIME, seconds_between(self.began, now), options.try_s)
        if self.losses > options.losses_max:
            return Reason(ReasonCause.LOSSES, float(self.losses), float(options.losses_max))
        if self.sweeps > _SWEEPS_MOST:
            return Reason(ReasonCause.SWEPT, float(self.sweeps), float(_SWEEPS_MOST))
        if self.starved_s > _STARVED_MOST_S:
            return Reason(ReasonCause.STARVED, self.starved_s, _STARVED_MOST_S)
        if self.blind_descent_m > options.blind_descent_max_m:
            return Reason(ReasonCause.BLIND_DESCENT, self.blind_descent_m, options.blind_descent_max_m)
        return None


def _counted_s(since_last_s: float) -> float:
    """Return the time that a guidance cycle adds, s."""
    return min(max(0.0, since_last_s), _GAP_MAX_S)


def arrow_turned(last_rad: float | None, estimate: RelativeState) -> Reason | None:
    """Return the reason if the arrow turned since the last known heading, rad, by more than any vehicle turns; None if not."""
    if estimate.yaw_rad is None or last_rad is None:
        return None
    jump = abs(wrap_pi(estimate.yaw_rad - last_rad))
    return Reason(ReasonCause.HEADING_TURNED, math.degrees(jump), math.degrees(JUMP_RAD)) if jump > JUMP_RAD else None


class Here(Struct, frozen=True):
    """A landing where the vehicle is: by a person's order, or with the last charge."""

    at_pad: tuple[float, float] | None = None
    """Place on the deck that it comes down to, from the pad's centre, m along the arrow and to starboard of it; (0, 0) is the
    pad. None while no pad is known."""
    felt: frozenset[str] = frozenset()
    """The sources of the contacts that were felt since the way down began."""
    after: State | None = None
    """The refusal after which the last charge was reached; None by a person's order."""


class EarlyTouch(NamedTuple):
    """A touch that was felt in a commit, higher than the deck is."""

    commit: MonoNs
    """The time at which that commit began."""
    feet_m: float
    """Height of the lowest foot over the deck, by what the settings say of the feet."""


class Progress(Struct, frozen=True, eq=False):
    """The memory of one service; a flight and an attempt renew their parts of it."""

    state: State
    automatic: bool
    """True if the settings order a landing at each take-off."""
    since: MonoNs | None = None
    """Time at which the state was entered; None until the first guidance cycle in it."""
    reason: Reason | None = None
    """Reason why the state was entered."""
    taken_from: State | None = None
    """State in which the vehicle was taken over; None while it is not."""
    fault: Reason | None = None
    """Reason why the newest attempt ended or was interrupted."""
    refusing: bool = False
    """The conditions are such that there is no other try."""
    last: MonoNs | None = None
    since_last_s: float = 0.0

    stood: bool = True
    """The vehicle has stood on the ground since the flight ended."""
    begun: bool = False
    """A landing was requested in this flight."""
    stays: bool = False
    """The newest order of a person to fly to the pad was to stay over it: nothing goes down the cone."""
    ordered: bool = False
    """This flight has gone for the deck by our order."""

    end_begun: bool = False
    """The end that the settings have for a held drone was begun in this flight: an order that called it off stands."""

    here: Here | None = None
    """The landing where it is, until another way is flown; None of any other landing."""

    attempt: Attempt = field(default_factory=Attempt)
    asked_at: MonoNs | None = None
    """Time of the order to land; None before it. What the machine does by itself requests no other landing."""
    landing_began: MonoNs | None = None
    """Time of the first sight of the pad since the landing was requested; None before it."""
    low_s: float = 0.0
    """Time near the deck since the landing was requested, s, all tries together."""
    near_deck: bool = False
    """True if the feet are lower than `NEAR_DECK_M`, by the newest sight and what it has climbed since."""
    sweeps: int = 0
    """Number of sweeps out of the cone near the deck since then."""
    go_arounds: int = 0
    bounces: int = 0
    """Number of times that it left the deck again after a contact, or touched it in a go-around."""
    reckoned: MonoNs | None = None
    """Time of a contact that nothing felt; None of one that was felt."""
    touches: tuple[EarlyTouch, ...] = ()
    """The newest touches that were felt in commits, one of each, and were no contact by the height."""
    course: HeldCourse = HeldCourse()
    """Height against the ordered descent."""
    questions: int = 0
    seen: MonoNs | None = None
    """Time of the newest estimate that was fit to steer by."""
    seen_height_m: float = math.inf
    """Height at that time."""
    silent_m: float | None = None
    """Height ordered while the vehicle was silent since the newest sight, m: it may have flown down. None if it never was."""
    in_sight: bool = False
    deck_rise_m: float = 0.0
    """Rise of the deck since the newest sight, m, as far as it is estimated."""
    climbs_m_s: float = 0.0
    """Climb over the ground that is ordered without sight, m/s."""
    climbed_m: float = 0.0
    """Height that such orders have made since the newest sight, m."""
    track: int | None = None
    """Track of the pad that this attempt flies to."""
    heading_rad: float | None = None
    """Heading against the arrow in the newest estimate that knew it."""
    turned: Reason | None = None
    """The arrow turned in the estimate by itself."""

    entered_height_m: float = math.inf
    """Height at which the state was entered, by the newest fit estimate."""
    held: F64 | None = None
    """The vector from body to pad that is held, (3,) m in the level axes of `held_yaw_rad`; None while nothing is held."""
    held_yaw_rad: float | None = None
    kept: Struct | None = None
    """Memory of the present state alone; None when it is entered. Its file has the type."""
    windy_since: MonoNs | None = None
    """Time since which the wind has been beyond what the vehicle can fly; None while it is not."""
    on_way: MonoNs | None = None
    """Time of the newest cycle on the way to the ship, where the drone tilts for its own speed."""

    @staticmethod
    def start(*, automatic: bool) -> Progress:
        """Return the memory of a service that knows of no vehicle yet."""
        return Progress(State.WAIT if automatic else State.STANDBY, automatic)

    @property
    def lands_here(self) -> bool:
        """True while the vehicle lands where it is: nothing but a person, a pilot or a failsafe ends that."""
        return self.here is not None and self.state in CONTACT_INTENDED

    def in_state_s(self, now: MonoNs) -> float:
        """Return the time since the state was entered, s; 0 before the first guidance cycle in it."""
        return 0.0 if self.since is None else seconds_between(self.since, now)


HELD_BY_PERSON = frozenset({State.READY, State.PAUSED, State.ABORTED})
"""States in which a person left the vehicle in the air, and it waits for an order."""
_KEEP_HERE = CONTACT_INTENDED | {State.LANDED, State.TAKEN}


def entered(p: Progress, change: StateChange) -> Progress:
    """Return the memory after a transition."""
    p = structs.replace(
        p, state=change.target, since=change.at, reason=change.reason, kept=None, held=None, held_yaw_rad=None,
        entered_height_m=p.seen_height_m, taken_from=change.source if change.target is State.TAKEN else None,
        begun=change.target in FLOWN or (p.begun and change.event is not Event.TAKEN_OFF),
    )  # fmt: skip
    if change.source in HELD_BY_PERSON and change.reason.cause in (ReasonCause.BATTERY_ENDS, ReasonCause.LANDS_HERE):
        p = structs.replace(p, end_begun=True)
    p = _after_event(p, change)
    if change.target not in _KEEP_HERE:
        p = structs.replace(p, here=None)
    match change.target:
        case State.GO_AROUND:
            touched = change.reason.cause is ReasonCause.OFF_DECK
            p = structs.replace(
                p, fault=change.reason, go_arounds=p.go_arounds + 1, turned=None, bounces=p.bounces + touched, course=HeldCourse()
            )
        case State.COMMIT | State.DOWN | State.LAND_HERE:
            p = structs.replace(p, ordered=True)
        case State.REFUSED | State.GAVE_UP:
            p = structs.replace(p, fault=change.reason)
    return structs.replace(p, stood=change.target in (State.LANDED, State.LANDED_BY_OTHERS))


def _after_event(p: Progress, change: StateChange) -> Progress:
    """Return the memory after what the event of a transition changes, whatever state it leads to."""
    match change.event:
        case Event.TAKEN_OFF:
            p = structs.replace(_fresh(p), stood=False, ordered=False, stays=False, end_begun=False)
            p = _asked(p, change.at)
        case Event.BATTERY_ENDS:
            p = _asked(structs.replace(_fresh(p), stays=False), change.at)
        case Event.LAND:
            if p.here is not None and change.source in (State.PRESS, State.DOWN):
                off_deck = change.reason.cause is ReasonCause.OFF_DECK
                p = structs.replace(p, here=structs.replace(p.here, felt=frozenset()), bounces=p.bounces + off_deck)
            else:
                here = Here(after=change.source if change.reason.cause is ReasonCause.LANDS_HERE else None)
                p = _asked(structs.replace(p, here=here, track=None), change.at)
        case Event.STAY if change.source in DESCENDS:
            p = _asked(structs.replace(p, attempt=p.attempt.again()), change.at)
        case Event.BEGIN | Event.STAY:
            p = _fresh(p)
            if change.reason.cause is not ReasonCause.AUTOMATIC:
                p = _asked(p, change.at)
            elif p.asked_at is None:
                p = structs.replace(p, asked_at=change.at)
        case Event.CONTACT:
            felt = change.reason.cause is not ReasonCause.REACHED
            again = change.source not in (State.COMMIT, State.LAND_HERE)
            p = structs.replace(p, reckoned=None if felt else change.at, bounces=p.bounces + again)
        case Event.OTHER_PAD:
            p = structs.replace(p, fault=change.reason, questions=p.questions + 1, in_sight=False)
        case Event.OUT_OF_CONE if change.source is State.DESCEND and p.near_deck:
            p = structs.replace(p, attempt=p.attempt.swept(), sweeps=p.sweeps + 1)
        case Event.NO_CONDITIONS:
            p = structs.replace(p, refusing=True)
        case Event.CLEAR:
            climbed_to_m = p.seen_height_m if change.reason.measured is None else change.reason.measured
            higher_m = max(p.seen_height_m, climbed_to_m)
            p = structs.replace(
                p, attempt=p.attempt.again(), seen_height_m=higher_m, climbed_m=0.0, silent_m=None, course=HeldCourse()
            )
    return p


def _asked(p: Progress, at: MonoNs) -> Progress:
    """Return the memory after an order of a person, or the take-off that stands for one: all budgets begin again."""
    return structs.replace(
        p, asked_at=at, go_arounds=0, questions=0, landing_began=None, low_s=0.0, sweeps=0, bounces=0, reckoned=None
    )


def _fresh(p: Progress) -> Progress:
    """Return the memory without anything of earlier tries."""
    return structs.replace(
        p, fault=None, refusing=False, touches=(), attempt=Attempt(), seen=None, seen_height_m=math.inf, in_sight=False,
        track=None, heading_rad=None, turned=None, silent_m=None, course=HeldCourse(), climbed_m=0.0, deck_rise_m=0.0,
    )  # fmt: skip
