"""Ways through a guidance cycle: the time of each state, the way up, the ways down, and another pad."""

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.mission import Event, State
from companion.base.reason import Reason, ReasonCause
from companion.guidance.mission.cycle import VesselPosition
from companion.guidance.mission.progress import Attempt
from companion.guidance.mission.watch import clear, near
from estimator.contracts.estimates import IntegrityAlert
from tests.companion.mission_flights import guided, ns
from tests.companion.test_mission_events import BLIND, NOW, OPTIONS, WHY, cycle, figures, happens, memory, of, seen

# Time


@pytest.mark.parametrize(
    ("state", "limit_s", "cause"),
    [
        (State.RENDEZVOUS, 180.0, ReasonCause.STATE_TIME), (State.SEARCH, 300.0, ReasonCause.NOT_FOUND),
        (State.COMMIT, 3.0, ReasonCause.NO_CONTACT), (State.PRESS, 3.4, ReasonCause.STATE_TIME),
        (State.DOWN, 6.0, ReasonCause.NO_LANDING), (State.GO_AROUND, 10.0 + 3.0 * 1.0 / 0.5, ReasonCause.NOT_CLIMBING),
    ],
)  # fmt: skip
def test_every_state_has_its_time(state: State, limit_s: float, cause: ReasonCause) -> None:
    for more_s, over in ((0.0, False), (0.001, True)):
        p = memory(state, limit_s + more_s, seen=None, seen_height_m=0.0, was_silent=True, in_sight=False)
        found = figures(of(Event.TIMEOUT, p, cycle()))
        assert found == ((cause, pytest.approx(limit_s + more_s), pytest.approx(limit_s)) if over else None)
    assert of(Event.TIMEOUT, memory(state, since=None), cycle()) is None


def test_a_go_around_has_no_less_time_from_above_the_safe_height() -> None:
    p = memory(State.GO_AROUND, 10.001, entered_height_m=5.0)
    assert figures(of(Event.TIMEOUT, p, cycle(seen()))) == (ReasonCause.NOT_CLIMBING, pytest.approx(10.001), 10.0)
    assert of(Event.TIMEOUT, memory(State.GO_AROUND, 10.0, entered_height_m=5.0), cycle(seen())) is None


@pytest.mark.parametrize(("state", "name"), [(State.INTERCEPT, "over_pad_s"), (State.DESCEND, "in_descent_s")])
def test_all_visits_to_a_leg_share_its_time(state: State, name: str) -> None:
    for spent_s, over in ((45.0, False), (45.001, True)):
        p = memory(state, 1.0, attempt=Attempt(**{name: spent_s}))
        found = figures(of(Event.TIMEOUT, p, cycle(seen())))
        assert found == ((ReasonCause.STATE_TIME, spent_s, 45.0) if over else None)


def test_all_visits_to_the_gate_share_one_wait_and_what_kept_it_shut_is_reported() -> None:
    for waited_s, over in ((20.0, False), (20.001, True)):
        p = memory(State.GATE, 1.0, attempt=Attempt(at_gate_s=waited_s))
        found = figures(of(Event.TIMEOUT, p, cycle(seen())))
        assert found == ((ReasonCause.STATE_TIME, waited_s, 20.0) if over else None)
        assert of(Event.TIMEOUT, replace(p, blocked=WHY), cycle(seen())) == (WHY if over else None)


def test_the_patience_without_sight_is_that_of_all_holds_together_and_says_what_is_known() -> None:
    for spent_s, over in ((20.0, False), (20.001, True)):
        p = memory(State.HOLD_BLIND, 1.0, attempt=Attempt(without_sight_s=spent_s), seen_height_m=3.0)
        found = figures(of(Event.TIMEOUT, p, cycle()))
        assert found == ((ReasonCause.NOT_FOUND_AGAIN, spent_s, 20.0) if over else None)
    alert = Reason(ReasonCause.ALERT, detail=IntegrityAlert.CAMERA_FROZEN)
    stale = Reason(ReasonCause.STALE, 0.6, 0.5)
    for reason, reported in ((alert, alert), (Reason(ReasonCause.INCONSISTENT), Reason(ReasonCause.INCONSISTENT)), (stale, None)):
        assert of(Event.TIMEOUT, replace(p, reason=reason), cycle()) == (reported or of(Event.TIMEOUT, p, cycle()))
    searched = memory(State.SEARCH, 300.1, reason=alert)
    assert figures(of(Event.TIMEOUT, searched, cycle())) == (ReasonCause.NOT_FOUND, pytest.approx(300.1), 300.0)
    reported = of(Event.TIMEOUT, searched, cycle(frames=BLIND))
    assert reported is not None
    assert reported.cause is ReasonCause.FRAMES


# The ship


def ship(north_m: float, height_m: float | None = 6.0) -> VesselPosition:
    return VesselPosition(ns(NOW), np.array([north_m, 0.0]), 1.0, np.zeros(2), 0.0, True, height_m)


@pytest.mark.parametrize(
    ("place", "event"), [(ship(60.0), Event.VESSEL_FAR), (ship(8.0), Event.ARRIVED), (ship(12.0), None), (None, None)]
)
def test_the_ship_is_far_or_her_hold_off_point_is_reached(place: VesselPosition | None, event: Event | None) -> None:
    """The point lies 8 m behind her pad."""
    found = happens(memory(State.RENDEZVOUS), cycle(vessel=place))
    ours = [(kind, reason.measured) for kind, reason in found if kind in (Event.VESSEL_FAR, Event.ARRIVED)]
    assert ours == ([] if event is None or place is None else [(event, place.distance_m)])


# Up


def test_a_go_around_is_high_enough_by_sight() -> None:
    for height_m, high in ((1.75, True), (1.749, False)):
        p = memory(State.GO_AROUND, seen_height_m=height_m)
        found = figures(of(Event.CLEAR, p, cycle(seen((0.0, 0.0, height_m)))))
        assert found == ((ReasonCause.HIGH_ENOUGH, height_m, 2.0) if high else None)
        assert of(Event.CLEAR, replace(p, state=State.DESCEND), cycle(seen())) is None


@pytest.mark.parametrize(
    ("fields", "needs_m"),
    [
        ({"seen_height_m": 1.0}, 1.0), ({"seen_height_m": 0.2}, 1.8), ({"seen_height_m": 1.0, "was_silent": True}, 2.0),
        ({"seen_height_m": 9.0}, 0.0), ({"seen_height_m": math.inf}, 2.0),
    ],
)  # fmt: skip
def test_without_sight_it_is_high_enough_by_what_it_has_climbed(fields: dict[str, Any], needs_m: float) -> None:
    """It climbs from where it was seen last, unless it was silent and may have come to the deck; a nearer range is believed."""
    for more_m in (0.001, -0.001):
        p = memory(State.GO_AROUND, in_sight=False, climbed_m=needs_m + more_m, **fields)
        assert clear(p, cycle(), OPTIONS) is (more_m > 0.0)
    known = of(Event.CLEAR, memory(State.GO_AROUND, in_sight=False, climbed_m=needs_m + 1.0, **fields), cycle())
    assert known is not None
    assert known.measured == pytest.approx(3.0)
    nearer = replace(cycle(), range_m=1.0)
    assert clear(memory(State.GO_AROUND, in_sight=False, climbed_m=1.5, seen_height_m=1.0), nearer, OPTIONS) is False
    assert clear(memory(State.GO_AROUND, in_sight=False, climbed_m=3.1, seen_height_m=1.0), nearer, OPTIONS), "not for ever"


# The way down in the cone


@pytest.mark.parametrize(
    ("state", "d", "event"),
    [
        (State.INTERCEPT, (0.0, 0.0, 2.0), Event.IN_CONE), (State.INTERCEPT, (0.0, 0.485, 2.0), None),
        (State.INTERCEPT, (0.63, 0.0, 2.0), Event.OUT_OF_CONE), (State.DESCEND, (0.63, 0.0, 2.0), Event.OUT_OF_CONE),
        (State.DESCEND, (0.0, 0.0, 2.0), None), (State.DESCEND, (0.0, 0.0, 0.374), Event.AT_GATE),
        (State.DESCEND, (0.0, 0.0, 0.376), None), (State.INTERCEPT, (0.05, 0.0, 0.2), None),
        (State.GATE, (0.0, 0.0, 0.594), None), (State.GATE, (0.0, 0.0, 0.596), Event.OUT_OF_CONE),
        (State.DESCEND, (0.0, 0.0, 0.596), None),
    ],
)  # fmt: skip
def test_the_way_down_in_the_cone(state: State, d: tuple[float, float, float], event: Event | None) -> None:
    way = (Event.IN_CONE, Event.OUT_OF_CONE, Event.AT_GATE, Event.GATE_OPEN)
    found = [(kind, reason) for kind, reason in happens(memory(state), cycle(seen(d))) if kind in way]
    assert [kind for kind, _ in found] == ([] if event is None else [event])
    for kind, reason in found:
        if kind is Event.AT_GATE:
            assert figures(reason) == (ReasonCause.LOW_ENOUGH, d[2], 0.295)
        else:
            cause = ReasonCause.ARRIVED if kind is Event.IN_CONE else ReasonCause.OUT_OF_CONE
            assert figures(reason) == (cause, pytest.approx(math.hypot(d[0], d[1])), pytest.approx(0.22 * d[2]))
    assert not [kind for kind, _ in happens(memory(state), cycle(seen(d, age=0.6))) if kind in way], "by sight alone"


@pytest.mark.parametrize(("mission", "dwell_s"), [("cone", 0.1), ("thesis", 0.2)])
def test_the_gate_opens_after_every_limit_has_held_for_its_time(mission: str, dwell_s: float) -> None:
    o, s = guided(mission), cycle(seen((0.0, 0.0, 0.3)))
    for good_s, opens in ((dwell_s, True), (dwell_s - 0.001, False)):
        p = memory(State.GATE, good_since=ns(NOW - good_s))
        assert of(Event.GATE_OPEN, p, s, o) == (Reason(ReasonCause.ALL_LIMITS_HOLD) if opens else None)
        assert of(Event.GATE_OPEN, replace(p, state=State.DESCEND), s, o) is None
    assert of(Event.GATE_OPEN, memory(State.GATE), s, o) is None


# The way points of the thesis


@pytest.mark.parametrize(
    ("d", "reached"),
    [((0.35, 0.0, 1.0), True), ((0.601, 0.0, 1.0), False), ((0.099, 0.0, 1.0), False), ((0.35, 0.251, 1.0), False),
     ((0.35, 0.249, 1.0), True), ((0.35, 0.0, 1.251), False), ((0.35, 0.0, 0.749), False), ((0.35, 0.0, 1.249), True)],
)  # fmt: skip
def test_a_way_point_is_reached_within_a_distance_aside_and_in_height(d: tuple[float, float, float], reached: bool) -> None:
    assert near(seen(d), 0.35, 1.0, 0.25) is reached


@pytest.mark.parametrize(
    ("state", "d", "event", "reason"),
    [
        (State.INTERCEPT, (0.1, 0.2, 2.1), Event.IN_CONE, (ReasonCause.ARRIVED, math.hypot(0.1, 0.2), 0.25)),
        (State.INTERCEPT, (0.1, 0.3, 2.1), None, None),
        (State.DESCEND, (0.1, 0.0, 0.35), Event.AT_GATE, (ReasonCause.LOW_ENOUGH, 0.35, 0.3)),
        (State.DESCEND, (0.1, 0.13, 0.35), None, None), (State.DESCEND, (0.1, 0.0, 2.0), None, None),
        (State.GATE, (0.1, 0.23, 0.3), None, None), (State.INTERCEPT, (0.1, 0.0, 0.3), None, None),
        (State.GATE, (0.1, 0.25, 0.3), Event.OUT_OF_CONE, (ReasonCause.OUT_OF_CONE, math.hypot(0.1, 0.25), 0.12)),
    ],
)  # fmt: skip
def test_the_way_points_of_the_thesis(
    state: State, d: tuple[float, float, float], event: Event | None, reason: Any
) -> None:  # fmt: skip
    o = guided("thesis", thesis={"pad_ahead_m": 0.1})
    way = (Event.IN_CONE, Event.OUT_OF_CONE, Event.AT_GATE, Event.GATE_OPEN)
    found = [(kind, figures(why)) for kind, why in happens(memory(state), cycle(seen(d)), o) if kind in way]
    assert found == ([] if event is None else [(event, reason)])


# Another pad


@pytest.mark.parametrize(("waited_s", "over"), [(60.0, False), (60.001, True)])
def test_somebody_has_a_minute_to_decide_about_another_pad(waited_s: float, over: bool) -> None:
    p = memory(State.ANOTHER_PAD, waited_s, track=None)
    found = [(kind, figures(why)) for kind, why in happens(p, cycle(seen()))]
    assert found == ([(Event.TIMEOUT, (ReasonCause.NOBODY_DECIDED, pytest.approx(waited_s), 60.0))] if over else [])
    assert happens(replace(p, since=None), cycle(seen())) == []


@pytest.mark.parametrize(
    ("changed", "height_m", "held_s", "begins"),
    [
        ({}, 1.75, 5.0, True), ({}, 1.749, 5.0, False), ({}, 1.75, 4.999, False), ({"questions": 1}, 2.0, 5.0, True),
        ({"questions": 2}, 2.0, 5.0, False), ({"entered_height_m": 1.749}, 2.0, 5.0, False), ({}, 2.0, None, False),
    ],
)  # fmt: skip
def test_by_itself_it_begins_again_once_a_flight_from_above_and_after_a_steady_sight(changed, height_m, held_s, begins):
    good = None if held_s is None else ns(NOW - held_s)
    p = memory(State.ANOTHER_PAD, track=None, good_since=good, **{"entered_height_m": 2.0, **changed})
    s, o = cycle(seen((0.0, 0.0, height_m))), guided(tries={"another_pad": "automatic"})
    assert happens(p, s, o) == ([(Event.BEGIN, Reason(ReasonCause.AUTOMATIC))] if begins else [])
    assert happens(p, s) == [], "the operator decides"
    assert happens(p, cycle(), o) == []
