"""The mission "targets" (`guidance.mission = "targets"`): the autopilot lands by its own landing, led by LANDING_TARGETs alone.

No velocity comes from here: an aim is the vehicle's own landing, or a hover. SEARCH waits for the pad, GATE offers it while
targets are sent, DOWN is the autopilot's own landing, GO_AROUND its own hold. The way from GATE to DOWN is the pilot's choice of
the landing mode, or, where `guidance.mode_changes` lets us, our request. What the pilot chose we never call off: the reason is
shown, and the targets go on. What we requested is called off only as high over the deck as a hold over the ground is safe.
LAND_HERE is its own landing too, but the plain one where it is. All other states are those of the other missions, with a hover
for an aim.
"""

from collections.abc import Iterator, Mapping

from msgspec.structs import replace

from companion.base.mission import CONDITIONS, Event, Reason, ReasonCause, State
from companion.guidance.mission import charge, limits, rules
from companion.guidance.mission.gate import Gate
from companion.guidance.mission.phase import CALLED_OFF, LANDING, Aimed, Phase, turn_rad, waits_m
from companion.guidance.mission.progress import GuidanceCycle, Progress
from companion.guidance.mission.rules import EventWithReason, Row
from companion.settings.guidance import GuidanceOptions
from drivers.mavlink.options import TARGET_MODES
from estimator.contracts.commands import Hover, Land
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.time import seconds_between

MODES = frozenset(TARGET_MODES)
"""The autopilot's modes that land on targets."""
LED = frozenset({State.GATE, State.DOWN, State.GO_AROUND})
"""States in which targets are sent."""
_OFFERED_S = 2.0
"""Time for which targets are sent before the landing is requested, s: ArduPilot's filter of the target needs the first second."""
_OBEYS_S = 6.0
"""Time after which an autopilot that is not in its landing has refused it, s."""
_HELD_S = 4.0
"""Time in the autopilot's hold before another try, s."""
_OVER_GATE_M = 0.5
"""Least height over the gate's from which a landing is called off, m."""
_MISSES = 2.0
"""Factor on `commit_error_m` beside which a landing below the safe height misses the pad."""

ROWS: Mapping[State, Row] = {
    State.GATE: {
        **LANDING,
        Event.OTHER_PAD: State.ANOTHER_PAD,
        Event.NO_CONDITIONS: State.REFUSED,
        Event.SIGHT_LOST: State.SEARCH,
        Event.TIMEOUT: State.GAVE_UP,
        Event.GATE_OPEN: State.DOWN,
    },
    State.DOWN: {
        **LANDING,
        **CALLED_OFF,
        Event.OTHER_PAD: State.ANOTHER_PAD,
        Event.LIMIT: State.GO_AROUND,
        Event.TIMEOUT: State.GO_AROUND,
    },
    State.GO_AROUND: {
        **LANDING,
        Event.OTHER_PAD: State.ANOTHER_PAD,
        Event.NO_CONDITIONS: State.REFUSED,
        Event.HOPELESS: State.GAVE_UP,
        Event.TIMEOUT: State.GAVE_UP,
        Event.CLEAR: State.SEARCH,
    },
}


def phases(cone: Mapping[State, Phase]) -> Mapping[State, Phase]:
    """Return the phases of this mission, by those of the one in the cone."""
    search = {event: to for event, to in cone[State.SEARCH].ways.items() if to is not State.RENDEZVOUS}
    rows = {state: phase.ways for state, phase in cone.items()}
    rows |= {State.SEARCH: {**search, Event.SIGHT: State.GATE}, **ROWS}
    # The motors are the autopilot's own to stop, after its own landing.
    ways: dict[State, Row] = {
        state: {event: to for event, to in row.items() if event is not Event.TIPPED} for state, row in rows.items()
    }
    held = {
        state: phase._replace(ways=ways[state], aim=_hover, allows=lambda command, p, s, o: command)
        for state, phase in cone.items()
    }
    return {
        **held,
        State.GATE: held[State.GATE]._replace(events=_offers, note=_note),
        State.DOWN: held[State.DOWN]._replace(events=_lands, aim=_land),
        State.GO_AROUND: held[State.GO_AROUND]._replace(events=_goes_around),
        State.LAND_HERE: held[State.LAND_HERE]._replace(events=_nothing, aim=lambda p, s, o: (p, Land(here=True))),
    }


def _nothing(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    yield from ()


def _hover(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Aimed:
    """Return the autopilot's own hover, or its return after a refusal."""
    return p, Hover(returns=o.refused == "return" and p.state in (State.REFUSED, State.GAVE_UP))


def _land(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Aimed:
    if not _ours(p):
        return p, Hover()
    wanted = None if s.estimate is None else turn_rad(s, o, s.estimate)
    if s.estimate is None or s.estimate.yaw_rad is None or wanted is None or rules.fit_estimate(p, s, o) is None:
        return p, Land()
    return p, Land(turn_rad=wrap_pi(wanted - s.estimate.yaw_rad))


def _ours(p: Progress) -> bool:
    """Return whether the present landing was requested by us."""
    return p.reason is None or p.reason.cause is ReasonCause.ALL_LIMITS_HOLD


def _bars(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return what keeps us from requesting the landing, or None."""
    sigma_m = 0.0 if s.estimate is None else limits.sigma_m(s.estimate)
    if sigma_m > o.limits.sigma_m:
        return Reason(ReasonCause.SIGMA, sigma_m, o.limits.sigma_m)
    return s.thing or s.unseen or rules.windy(p, s)


def _note(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Progress:
    waits_for = _bars(p, s, o)
    if waits_for is None and not o.mode_changes:
        waits_for = Reason(ReasonCause.AWAITS_PILOT)
    return replace(p, kept=Gate(blocked=waits_for, waits_for=waits_for))


def _offers(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    yield from rules.other_pad(p, s, o)
    if rules.fit_estimate(p, s, o) is None:
        yield from rules.sight_lost(p, s, o)
        return
    if s.mode in MODES and not p.stays:
        yield Event.GATE_OPEN, Reason(ReasonCause.PILOT_LANDS, detail=s.mode)
    yield from rules.try_ends(p, s, o)
    if charge.battery_ends(s.battery, o):
        yield Event.NO_CONDITIONS, Reason(ReasonCause.BATTERY, 100.0 * (s.battery or 0.0), 100.0 * o.limits.battery)
    offered_s = p.in_state_s(s.at)
    if o.mode_changes and not p.stays and offered_s >= _OFFERED_S and _bars(p, s, o) is None:
        yield Event.GATE_OPEN, Reason(ReasonCause.ALL_LIMITS_HOLD)
    yield from rules.time_over(offered_s, o.stay_s if p.stays else o.tries.search_s, _bars(p, s, o))


def _lands(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    yield from rules.other_pad(p, s, o)
    spent_s = p.in_state_s(s.at)
    if s.mode not in MODES and not _ours(p):
        yield Event.TAKEN, Reason(ReasonCause.TAKEN_OVER, detail=f"the pilot ended the landing: mode {s.mode}")
    if s.mode not in MODES and spent_s > _OBEYS_S:
        yield Event.LIMIT, Reason(ReasonCause.NOT_IN_MODE, spent_s, detail=s.mode)
    if (limit := _calls_off(p, s, o)) is not None:
        yield Event.LIMIT, limit
    if spent_s > o.tries.try_s:
        yield Event.TIMEOUT, Reason(ReasonCause.NO_LANDING, spent_s, o.tries.try_s)


def _calls_off(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Reason | None:
    """Return what calls the landing off, or None; near the deck nothing does."""
    if p.seen_height_m < max(waits_m(s, o), o.cone.gate_m + _OVER_GATE_M):
        return None
    estimate = rules.fit_estimate(p, s, o)
    if estimate is None:
        lost = p.seen is not None and seconds_between(p.seen, s.at) > o.tries.climb_after_s
        return Reason(ReasonCause.LOST_LOW, p.seen_height_m) if lost else None
    misses_m = _MISSES * o.limits.commit_error_m
    if estimate.height_m < o.tries.safe_height_m and estimate.lateral_m > misses_m:
        return Reason(ReasonCause.DRIFTED, estimate.lateral_m, misses_m)
    return s.thing or rules.bars_descent(p, s, o)


def _goes_around(p: Progress, s: GuidanceCycle, o: GuidanceOptions) -> Iterator[EventWithReason]:
    yield from rules.other_pad(p, s, o)
    why = p.fault or Reason(ReasonCause.NO_LANDING, 0.0, o.tries.landing_s)
    if p.go_arounds > o.tries.go_arounds_max or rules.landing_over(p, s, o) is not None:
        yield Event.NO_CONDITIONS if why.cause in CONDITIONS else Event.HOPELESS, why
    yield from rules.try_ends(p, s, o)
    if p.in_state_s(s.at) > _HELD_S:
        yield Event.CLEAR, Reason(ReasonCause.HIGH_ENOUGH, p.seen_height_m)
