"""The mission as one machine: one total table of states and events, assembled from the states' files, and a step of it.

**Phases.** A landing is a way down a chain of states. SEARCH and RENDEZVOUS find the pad (`search`). INTERCEPT brings the drone
over it and DESCEND down the cone (`descend`), or STAY waits there by a person's order (`stay`). GATE follows the deck until every
limit holds (`gate`). COMMIT goes down to the deck (`commit`), PRESS and DOWN keep it there and stop the motors (`press`).
HOLD_BLIND waits for a lost sight (`hold_blind`), GO_AROUND climbs to begin again (`go_around`), ANOTHER_PAD asks
(`another_pad`). LAND_HERE lands where the drone is (`land_here`). In all others no landing is flown (`waiting`). `targets` and
the capabilities' missions have what differs in theirs.

**A file is a state.** It says what the state watches and where each event leads, what it aims at, its time budget, its
constants, and the memory that only it needs (`Progress.kept`, empty on entry). What several states watch or fly is in `rules`
and `phase`, what all remember in `progress`. A guidance cycle is a pure step from memory and inputs to memory, aim and
changes of state.

**What holds in every state.**
- Of the events of a cycle the first one that leads elsewhere is taken. The vehicle's own reports and a person's orders come
  before all of them, as soon as they arrive. At most `_MOST` changes happen in a cycle.
- The table is total and checked where it is made: an event that a state does not name changes nothing.
- Nothing descends without a fresh, consistent estimate of the pad, but by a person's order to land here, or with the last
  charge. `allows` of each state cuts the controller's command to that, whatever the target was. Else, low without sight, the
  drone only climbs (`out_of_reach`).
- A state that waits has a time, and when that is over the drone goes up or stays: to a go-around, a hold or a refusal.
- Motors stop only in DOWN, which is entered by a contact and a press (in the other missions by the vehicle's own landing).
- On the ground, before the first order, and while somebody else has the vehicle, guidance sends nothing but a hover.

**What a go-around costs.** A new budget for the attempt, and one of the allowed go-arounds; the time without sight and the time
of the landing go on. Each one widens the limits of place and tilt a little. It is the way out of every doubt above the height of
no return, below which a climb would touch the deck.

**Why a refusal is no failure.** Deck, wind or late answers make some landings impossible. REFUSED names the condition with its
number, GAVE_UP says that the pad was not found or the attempts are used up. Both hold the drone until a person begins again or
takes it. Where its battery ends a landing is the last one (`charge.last_landing`): a bad contact is better than to fall.
"""

from collections.abc import Mapping
from types import MappingProxyType

from msgspec.structs import replace

from companion.base.mission import ENDED, FLOWN, GROUND, ORDERED, Event, Reason, ReasonCause, State, StateChange
from companion.guidance import targets
from companion.guidance.controller import Target
from companion.guidance.mission import (
    another_pad,
    commit,
    descend,
    gate,
    go_around,
    hold_blind,
    land_here,
    out_of_reach,
    press,
    search,
    stay,
    waiting,
)
from companion.guidance.mission.charge import battery_ends, last_landing
from companion.guidance.mission.held_course import HeldCourse
from companion.guidance.mission.limits import of_try
from companion.guidance.mission.out_of_reach import NEAR_SAFE_M
from companion.guidance.mission.phase import Aim, Aimed, Phase
from companion.guidance.mission.progress import NEAR_DECK_M, GuidanceCycle, Here, Progress, arrow_turned, entered, unfit
from companion.guidance.mission.rules import Row
from companion.settings.capabilities import of_installed, require_key
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Command, Hover
from estimator.contracts.estimates import RelativeState
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.tables import total
from estimator.contracts.time import MonoNs, seconds_between

_STATES = (waiting, search, descend, stay, gate, commit, press, hold_blind, go_around, another_pad, land_here)
PHASES: Mapping[State, Phase] = {state: phase for file in _STATES for state, phase in file.PHASES.items()}
_OFFERED = {name: phases(PHASES) for name, phases in of_installed("missions").items()}
MISSIONS: Mapping[str, Mapping[State, Phase]] = MappingProxyType({"cone": PHASES, **_OFFERED, "targets": targets.phases(PHASES)})
TABLES: Mapping[str, Mapping[State, Row]] = MappingProxyType(
    {name: total({state: phase.ways for state, phase in phases.items()}, Event) for name, phases in MISSIONS.items()}
)

Transitions = tuple[StateChange, ...]

_MOST = 4
"""Most transitions in one cycle; what is left is taken in the next."""
_HEIGHT_IS_ORDERED = (State.INTERCEPT, State.DESCEND, State.GATE, State.COMMIT, State.GO_AROUND)
"""States in which the height must follow the ordered rate (`HeldCourse`)."""
_AGREES_WITHIN = 0.2
"""Share of the range by which the estimated height may differ from it, out of sight, for both to count as one."""
_FASTEST_M_S = 1.0
"""Vertical speed of a vehicle whose law does not say, m/s."""
_LEAN_SETTLES_S = 10.0
"""Time after the flight to the ship until the mean lean is the wind's alone: twice the time of the mean."""


def require_mission(o: GuidanceOptions) -> None:
    """Refuse a mission whose capability is not installed.

    Raises:
        BadInput: it is not; the message says what to install.
    """
    require_key(f"guidance.mission={o.mission}", f'guidance.mission = "{o.mission}"')


def phase_of(state: State, o: GuidanceOptions) -> Phase:
    """Return the phase of a state in the mission that the settings choose."""
    return MISSIONS[o.mission][state]


def mission_step(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> tuple[Progress, Aim, Transitions]:
    """Run one guidance cycle; return the memory, the aim and what changed."""
    o = of_try(last_landing(o) if battery_ends(s.battery, o) else o, p.go_arounds)
    p = account(p, s, o)
    changes: list[StateChange] = []
    if s.tipped is not None:
        p, over = take(p, Event.TIPPED, s.tipped, s.at, o)
        changes += over
    while len(changes) < _MOST:
        moved, change = _first(p, s, o)
        if change is None:
            break
        changes.append(change)
        p = moved
    p, wanted = aim(p, s, o)
    if p.in_sight and p.state in _HEIGHT_IS_ORDERED:
        rate = wanted.descent_rate_m_s if isinstance(wanted, Target) else None
        p = replace(p, course=p.course.ordered(rate))
    return p, wanted, tuple(changes)


def aim(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Aimed:
    """Return the memory and the aim of this guidance cycle."""
    if p.state in GROUND:
        return p, waiting.on_ground(p, s)
    if not p.begun or p.state is State.TAKEN or (p.stood and p.state in ENDED):
        # A velocity would take an autopilot from its pilot; a hover takes nothing.
        return p, Hover()
    return phase_of(p.state, o).aim(replace(p, climbs_m_s=0.0), s, o)


def allowed(command: Command, p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Command:
    """Return the controller's command for a target as far as the state allows it."""
    return phase_of(p.state, o).allows(command, p, s, o)


def take(p: Progress, event: Event, reason: Reason, at: MonoNs, o: GuidanceOptions) -> tuple[Progress, Transitions]:
    """Take an event: return the memory after it, and the change of state if it leads elsewhere."""
    target = TABLES[o.mission][p.state][event]
    if target is p.state:
        return p, ()
    change = StateChange(at, p.state, event, target, reason)
    return entered(p, change), (change,)


def take_order(p: Progress, event: Event, at: MonoNs, o: GuidanceOptions, why: Reason = ORDERED) -> tuple[Progress, Transitions]:
    """Take an order: LAND, BEGIN, STAY, HOLD or ABORT; the newest one gives a hold its reason."""
    touched = p.state in (State.PRESS, State.DOWN) and o.mission == "cone"
    if event is Event.LAND and (touched or p.state is State.LAND_HERE):
        # On the deck the order decides what follows a bounce.
        return replace(p, here=replace(p.here or Here(), after=None)), ()
    if event is Event.BEGIN and touched:
        return replace(p, here=None), ()
    if event in (Event.HOLD, Event.ABORT) and p.stood and p.state in ENDED:
        # What stands is held by nothing, and its flight ended as it did.
        return p, ()
    if event in (Event.HOLD, Event.ABORT) and isinstance(p.kept, waiting.Returning):
        p = replace(p, kept=None, end_begun=True)
    if event in (Event.BEGIN, Event.STAY) and p.stays != (event is Event.STAY):
        # On the way to the pad the order alone decides what follows there.
        p = replace(p, stays=event is Event.STAY)
    p, changes = take(p, event, why, at, o)
    return (replace(p, reason=why) if event is Event.HOLD and p.state is State.PAUSED else p), changes


def _taken(p: Progress, reason: Reason, at: MonoNs, o: GuidanceOptions) -> tuple[Progress, Transitions]:
    """Take that others have the vehicle, or a further reason of theirs."""
    p, changes = take(p, Event.TAKEN, reason, at, o)
    if changes or p.state is not State.TAKEN or p.reason is None or p.reason == reason:
        return p, changes
    if p.reason.cause is not ReasonCause.TAKEN_OVER:
        return p, changes
    # ArduCopter reports its mode before its words for it.
    return replace(p, reason=reason), (StateChange(at, State.TAKEN, Event.TAKEN, State.TAKEN, reason),)


def take_status(p: Progress, status: VehicleStatus, o: GuidanceOptions, *, resumes: bool = False) -> tuple[Progress, Transitions]:
    """Take the vehicle's report about itself.

    Args:
        resumes: whether a landing that a person took over goes on when the vehicle is not taken any more.
    """
    at = status.stamp.received_at
    if status.emergency:
        return take(p, Event.CUT, Reason(ReasonCause.MOTORS_CUT), at, o)
    if status.flying is False:
        if p.state in ENDED:
            return replace(p, stood=True), ()
        by_us = Event.GROUNDED if p.ordered else Event.GROUNDED_BY_OTHERS
        return take(p, by_us, Reason(ReasonCause.VEHICLE_STANDS), at, o)
    # A report from before the order to begin belongs to the flight before.
    lifted = p.stood and p.state in ENDED
    if status.taken is not None and not lifted and (p.asked_at is None or at > p.asked_at):
        p, changes = _taken(p, Reason(ReasonCause.TAKEN_OVER, detail=status.taken), at, o)
        if changes:
            return p, changes
    if resumes and status.taken is None and p.taken_from in FLOWN and p.here is None and not p.stood:
        return take(p, Event.BEGIN, Reason(ReasonCause.GIVEN_BACK), at, o)
    if status.flying is None or (p.state in ENDED and not p.stood):
        return p, ()
    return _flies(p, at, o, next_one=p.state in ENDED and status.taken is None)


def _flies(p: Progress, at: MonoNs, o: GuidanceOptions, *, next_one: bool) -> tuple[Progress, Transitions]:
    """Take that the vehicle flies.

    Args:
        next_one: whether it is a flight after a landing, which guidance may have for itself.
    """
    p, changes = take(p, Event.TAKEN_OFF, Reason(ReasonCause.VEHICLE_FLIES), at, o)
    if next_one and p.automatic and changes:
        p, more = take(p, Event.BEGIN, Reason(ReasonCause.AUTOMATIC), at, o)
        changes = (*changes, *more)
    return p, changes


def _first(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> tuple[Progress, StateChange | None]:
    """Take the first event of the cycle that leads to another state."""
    for event, reason in phase_of(p.state, o).events(p, s, o):
        moved, changes = take(p, event, reason, s.at, o)
        if changes:
            return moved, changes[0]
    return p, None


def account(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    """Charge the guidance cycle to the attempt, and note what was seen."""
    since_last_s = 0.0 if p.last is None else max(0.0, seconds_between(p.last, s.at))
    p = replace(p, last=s.at, since_last_s=since_last_s, since=s.at if p.since is None else p.since)
    p = out_of_reach.climbed(p, s, since_last_s)
    if p.state not in FLOWN:
        return _seen_from(p, s, o)
    p = _in_wind(replace(p, attempt=p.attempt.cycle(since_last_s)), s)
    # A question leaves the sight of the pad that was flown to as it was.
    p = p if p.state is State.ANOTHER_PAD else _in_sight(p, s, o)
    near_deck = p.seen_height_m + p.climbed_m - o.cone.feet_below_m < NEAR_DECK_M
    # A person chose the height at which it stays.
    low_s = p.low_s + since_last_s if near_deck and p.state is not State.STAY else p.low_s
    p = replace(p, near_deck=near_deck, low_s=low_s)
    return phase_of(p.state, o).note(p, s, o)


def _in_sight(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    """Note a sight of the pad, or that there is none."""
    estimate, attempt = s.estimate, p.attempt
    other = estimate is not None and p.track is not None and estimate.track != p.track
    if estimate is None or other or unfit(estimate, s.at, o.stale_after_s) is not None:
        if p.in_sight and p.seen_height_m < o.tries.safe_height_m - NEAR_SAFE_M and p.state is not State.COMMIT:
            attempt = attempt.lost()
        if p.seen is not None:
            attempt = attempt.unseen(p.since_last_s)
        return replace(p, attempt=attempt, in_sight=False)
    if not p.in_sight and p.seen is not None and p.state is not State.GO_AROUND:
        attempt = attempt.descended(p.seen_height_m - estimate.height_m)
    return replace(
        p,
        attempt=attempt.seen(s.at, p.since_last_s),
        landing_began=s.at if p.landing_began is None else p.landing_began,
        course=_course(p, s, estimate),
        in_sight=True,
        seen=s.at,
        silent_m=None,
        deck_rise_m=0.0,
        climbed_m=0.0,
        seen_height_m=estimate.height_m,
        track=estimate.track,
        heading_rad=p.heading_rad if estimate.yaw_rad is None else estimate.yaw_rad,
        turned=arrow_turned(p.heading_rad, estimate) or p.turned,
    )


def _seen_from(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    """Note the height that is seen while no landing is flown, or found by a range that the estimate agrees with."""
    if s.estimate is None:
        return p
    height_m, range_m = s.estimate.height_m, s.range_m
    if unfit(s.estimate, s.at, o.stale_after_s) is not None:
        if range_m is None or s.estimate.alerts or abs(range_m - height_m) >= _AGREES_WITHIN * range_m:
            return p
        height_m = min(height_m, range_m)
    return replace(p, seen_height_m=height_m, silent_m=None, deck_rise_m=0.0, climbed_m=0.0)


def _in_wind(p: Progress, s: GuidanceCycle) -> Progress:
    """Note since when the wind has been beyond what the vehicle can fly; its own speed on the way to the ship is no wind."""
    if p.state is State.RENDEZVOUS:
        p = replace(p, on_way=s.at)
    slow = p.on_way is None or seconds_between(p.on_way, s.at) > _LEAN_SETTLES_S
    if s.wind is None or not slow or not s.wind.too_strong:
        return p if p.windy_since is None else replace(p, windy_since=None)
    return p if p.windy_since is not None else replace(p, windy_since=s.at)


def _course(p: Progress, s: GuidanceCycle, estimate: RelativeState) -> HeldCourse:
    """Return the height against what was ordered, after a cycle with sight."""
    if p.course.sign < 0 and not p.in_sight:
        return HeldCourse(p.course.sign).at_height(s.at, estimate.height_m, explained=False)
    deck, fastest = s.knowledge.deck, s.knowledge.climb_max_m_s or _FASTEST_M_S
    away = deck is not None and p.course.sign * deck.v_level.item(2) > fastest
    return p.course.at_height(s.at, estimate.height_m, explained=away)
