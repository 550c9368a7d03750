"""Events of a guidance cycle, state by state, with each figure at its limit and beside it."""

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.mission import FLOWN, Event, State, StateChange
from companion.base.reason import Reason, ReasonCause
from companion.guidance.controller import Impact, Knowledge
from companion.guidance.mission.cycle import GuidanceCycle
from companion.guidance.mission.held_course import OFF_M, ClimbWatch, HeldCourse
from companion.guidance.mission.machine import TABLES
from companion.guidance.mission.progress import Attempt, Progress, entered
from companion.guidance.mission.watch import account, events, fit_in
from companion.guidance.mission.wind import WindOverDrone
from companion.settings.guidance import GuidanceOptions
from companion.settings.response import ClimbResponse
from estimator.contracts.estimates import IntegrityAlert, Verdict
from estimator.contracts.motion import DeckMotion
from estimator.contracts.samples import Baro
from estimator.contracts.time import Stamp
from tests.companion.mission_flights import estimate, guided, ns

NOW = 100.0
OPTIONS = GuidanceOptions()
WHY = Reason(ReasonCause.LOSSES, 9.0, 8.0)
BLIND = Counter({Verdict.GATED: 20})
DESCENT = (State.INTERCEPT, State.DESCEND, State.GATE, State.HOLD_BLIND)


def memory(state: State, since_s: float = 1.0, **more: Any) -> Progress:
    """Return an attempt that began a second ago, in sight of pad 1 at a metre."""
    fields: dict[str, Any] = {
        "automatic": True, "since": ns(NOW - since_s), "seen": ns(NOW), "seen_height_m": 1.0, "in_sight": True, "track": 1,
        "entered_height_m": 1.0, "begun": True,
    }  # fmt: skip
    return Progress(state, **{**fields, **more})


def seen(d: tuple[float, float, float] = (0.0, 0.0, 1.0), **more: Any):
    return estimate(NOW, d, **more)


def cycle(relative: Any = None, *, impact: Impact | None = None, **more: Any) -> GuidanceCycle:
    return GuidanceCycle(ns(NOW), Knowledge(ns(NOW), relative, impact=impact), **more)


def happens(p: Progress, s: GuidanceCycle, o: GuidanceOptions = OPTIONS) -> list[tuple[Event, Reason]]:
    return list(events(p, s, o))


def of(event: Event, p: Progress, s: GuidanceCycle, o: GuidanceOptions = OPTIONS) -> Reason | None:
    found = [reason for kind, reason in events(p, s, o) if kind is event]
    assert len(found) <= 1
    return found[0] if found else None


def figures(reason: Reason | None) -> tuple[ReasonCause, float | None, float | None] | None:
    return None if reason is None else (reason.cause, reason.measured, reason.limit)


def test_nothing_happens_where_nobody_flies_a_landing() -> None:
    for state in set(State) - FLOWN:
        assert happens(memory(state, 1e6, track=2), cycle(seen(), impact=Impact(ns(NOW), "vehicle"))) == []


# Sight


def test_in_the_commit_a_sighting_may_be_older() -> None:
    for age_s, commit in ((0.5, True), (0.51, True), (1.5, True), (1.51, False)):
        s = cycle(seen(age=age_s))
        assert (fit_in(State.COMMIT, s, OPTIONS) is None) is commit
        assert (fit_in(State.GATE, s, OPTIONS) is None) is (age_s <= 0.5)
    patient = replace(OPTIONS, stale_after_s=4.0)
    assert fit_in(State.COMMIT, cycle(seen(age=3.9)), patient) is None


@pytest.mark.parametrize("state", sorted(FLOWN - {State.ANOTHER_PAD}, key=str))
def test_sight_comes_with_an_estimate_that_is_fit_and_is_lost_without(state: State) -> None:
    assert figures(of(Event.SIGHT, memory(state), cycle(seen()))) == (ReasonCause.PAD_SEEN, 1.0, None)
    assert of(Event.SIGHT_LOST, memory(state), cycle(seen())) is None
    for relative in (None, seen(age=9.0), seen(consistent=False)):
        assert of(Event.SIGHT, memory(state), cycle(relative)) is None
        assert of(Event.SIGHT_LOST, memory(state), cycle(relative)) is not None


@pytest.mark.parametrize(("until_s", "lost"), [(0.0, False), (0.001, False), (-0.001, True), (None, True)])
def test_just_over_the_deck_the_contact_is_awaited_without_sight(until_s: float | None, lost: bool) -> None:
    p = memory(State.COMMIT, no_return_until=None if until_s is None else ns(NOW + until_s))
    assert (of(Event.SIGHT_LOST, p, cycle()) is not None) is lost
    assert of(Event.SIGHT, p, cycle()) is None


@pytest.mark.parametrize(("track", "other"), [(1, False), (2, True), (None, False)])
def test_an_estimate_of_another_track_is_another_pad_and_comes_first(track: int | None, other: bool) -> None:
    for state in (State.DESCEND, State.ANOTHER_PAD):
        found = happens(memory(state, track=track), cycle(seen()))
        assert (bool(found) and found[0] == (Event.OTHER_PAD, Reason(ReasonCause.ANOTHER_PAD))) is other
    assert of(Event.OTHER_PAD, memory(State.DESCEND, track=2), cycle()) is None


# Contact


def struck(by: str, ago_s: float = 0.0) -> Impact:
    return Impact(ns(NOW - ago_s), by, size_m_s2=4.0, held_m_s=0.6)


@pytest.mark.parametrize(
    ("by", "reason"),
    [
        ("accelerometer", (ReasonCause.FELT, 4.0, None)),
        ("velocity", (ReasonCause.HELD_UP, 0.6, None)),
        ("vehicle", (ReasonCause.REPORTED, None, None)),
    ],
)
def test_a_contact_of_this_commit_counts_and_says_by_what(by: str, reason: object) -> None:
    low = seen((0.0, 0.0, 0.1))
    assert figures(of(Event.CONTACT, memory(State.COMMIT, 0.2), cycle(low, impact=struck(by, 0.2)))) == reason
    assert of(Event.CONTACT, memory(State.COMMIT, 0.2), cycle(low, impact=struck(by, 0.201))) is None, "before the commit"
    assert of(Event.CONTACT, memory(State.DESCEND), cycle(low, impact=struck(by))) is None
    assert of(Event.CONTACT, memory(State.COMMIT, since=None), cycle(low, impact=struck(by))) is None
    assert of(Event.CONTACT, memory(State.COMMIT), cycle(low)) is None


@pytest.mark.parametrize(
    ("height_m", "ago_s", "counts"),
    [(0.232, 0.25, True), (0.233, 0.25, False), (0.232, 0.251, False), (None, 0.1, True), (None, 0.3, False)],
)
def test_being_held_up_is_a_contact_near_the_deck_alone_and_while_it_lasts(height_m, ago_s, counts):
    """The feet within three quarters of the gate's 0.25 m; a step that no flight makes is a contact at any height."""
    relative = None if height_m is None else seen((0.0, 0.0, height_m))
    found = of(Event.CONTACT, memory(State.COMMIT), cycle(relative, impact=struck("velocity", ago_s)))
    assert (found is not None) is counts
    assert of(Event.CONTACT, memory(State.COMMIT), cycle(relative, impact=struck("accelerometer", ago_s))) is not None


@pytest.mark.parametrize(("since_s", "pressed"), [(0.4, True), (0.399, False)])
def test_it_presses_on_for_its_time(since_s: float, pressed: bool) -> None:
    found = figures(of(Event.PRESSED, memory(State.PRESS, since_s), cycle(seen())))
    assert found == ((ReasonCause.PRESSED, pytest.approx(since_s), 0.4) if pressed else None)
    # Where it goes up its own landing would begin in the air.
    rises = cycle(seen(v=(0.0, 0.0, 0.11)))
    assert (of(Event.PRESSED, memory(State.PRESS, 0.4 + since_s), rises) is not None) is pressed
    assert of(Event.PRESSED, memory(State.COMMIT, 2.0), cycle(seen())) is None
    assert of(Event.PRESSED, memory(State.PRESS, since=None), cycle(seen())) is None


@pytest.mark.hazard("H4")
def test_a_contact_that_the_height_contradicts_is_pressed_for_as_long_as_the_way_to_the_deck_takes() -> None:
    """WHY: a jolt of 40 ms in a commit whose picture was 0.3 s old stopped the motors 14 cm above the deck."""
    felt, feet = Impact(ns(NOW), "accelerometer", 6.0), OPTIONS.cone.feet_below_m
    above = cycle(seen((0.0, 0.0, feet + 0.3), age=1.0, v=(0.0, 0.0, -0.4)), impact=felt)
    assert of(Event.CONTACT, memory(State.COMMIT), above) is None
    # The jolt took the estimated speed away as well.
    above = cycle(seen((0.0, 0.0, feet + 0.3), age=1.0), impact=felt)
    assert of(Event.CONTACT, memory(State.COMMIT), replace(above, at=ns(NOW + 0.15))) is not None
    p = account(memory(State.PRESS, 0.0), above, OPTIONS)
    for since_s, pressed in ((0.41, False), (0.74, False), (0.76, True)):
        assert (of(Event.PRESSED, replace(p, since=ns(NOW - since_s)), above) is not None) is pressed
    fast = cycle(seen((0.0, 0.0, feet), v=(0.0, 0.0, -0.35), age=1.0), impact=felt)
    assert of(Event.PRESSED, memory(State.PRESS, 1.0), fast) is None, "the descent that the push should have ended goes on"
    assert of(Event.PRESSED, memory(State.PRESS, 1.0), replace(fast, feels=False)) is not None
    # A frame that was exposed after the contact shows it as high as before. What no frame shows any more is no way that is left.
    for feet_m, age_s, way_s in ((0.2, 0.0, 0.7 + 0.5), (0.14, 0.0, p.way_s), (0.2, 0.2, 0.7 + 0.5), (0.2, 0.21, p.way_s)):
        later = cycle(seen((0.0, 0.0, feet + feet_m), age=age_s))
        assert account(replace(p, since=ns(NOW - 0.7)), later, OPTIONS).way_s == pytest.approx(way_s)
    down = entered(p, StateChange(ns(NOW), State.PRESS, Event.PRESSED, State.DOWN, WHY))
    assert down.way_s is None


# What ends the flight's tries


STRONG = WindOverDrone(9.0, 1.5, 8.0, (1.0, 0.0), 0.3, spent=False)
"""A wind beyond what the vehicle's tilt can fly, though not beyond all of it."""


@pytest.mark.parametrize(
    ("windy_s", "spent", "blind_s", "up", "refuses"),
    [(1.99, True, 0.0, False, False), (2.0, False, 0.0, True, False), (2.0, True, 0.0, True, False),
     (8.01, True, 0.0, True, False), (12.0, True, 8.0, True, False), (12.0, True, 8.01, True, True),
     (12.0, False, 8.01, True, False), (8.0, True, math.inf, True, False), (8.01, True, math.inf, True, True),
     (20.0, True, 0.0, True, False), (20.01, True, 0.0, True, True), (20.01, False, 0.0, True, True)],
)  # fmt: skip
def test_wind_goes_up_first_and_refuses_later(windy_s: float, spent: bool, blind_s: float, up: bool, refuses: bool) -> None:
    """WHY: one gust must not end a flight, and a wind that leaves no tilt must, the sooner where it has blown the drone off."""
    last = None if blind_s == math.inf else ns(NOW - blind_s)
    p = memory(State.GATE, windy_since=ns(NOW - windy_s), in_sight=blind_s == 0.0, seen=last)
    s = cycle(seen(), wind=STRONG._replace(spent=spent))
    expected = (ReasonCause.WIND, 9.0, 8.0)
    assert figures(of(Event.LIMIT, p, s)) == (expected if up else None)
    assert figures(of(Event.NO_CONDITIONS, p, s)) == (expected if refuses else None)
    assert of(Event.NO_CONDITIONS, p, cycle(seen())) is None


@pytest.mark.parametrize(("spent", "height_m", "bars"), [(True, 1.99, True), (True, 2.01, False), (False, 1.0, False)])
def test_wind_bars_the_way_down_only_near_the_deck_and_where_it_takes_the_whole_tilt(spent, height_m, bars):
    """WHY: at 7 m it took 27 degrees of tilt and at the gate 13, and a drone that held over the pad was refused up there."""
    p = memory(State.INTERCEPT, windy_since=ns(NOW - 10.0), seen_height_m=height_m)
    s = cycle(seen((0.0, 0.0, height_m)), wind=STRONG._replace(spent=spent))
    assert (of(Event.IN_CONE, p, s) is None) is bars, "it waits over the pad"
    assert (of(Event.LIMIT, replace(p, state=State.DESCEND), s) is not None) is bars


@pytest.mark.parametrize(
    ("speed_m_s", "on_way_s", "windy"), [(8.1, None, True), (8.0, None, False), (8.1, 10.0, False), (8.1, 10.01, True)]
)
def test_the_vehicle_s_own_speed_is_no_wind(speed_m_s: float, on_way_s: float | None, windy: bool) -> None:
    p = memory(State.DESCEND, on_way=None if on_way_s is None else ns(NOW - on_way_s))
    noted = account(p, cycle(seen(), wind=STRONG._replace(speed_m_s=speed_m_s)), GuidanceOptions())
    assert (noted.windy_since is not None) is windy


@pytest.mark.parametrize(("battery", "low"), [(0.09, True), (0.1, False), (None, False)])
def test_a_low_battery_ends_what_has_not_begun(battery: float | None, low: bool) -> None:
    """WHY: with 9 % and the pad in sight the only way down was refused for good; the first frame comes after the first cycle."""
    for state in FLOWN - {State.ANOTHER_PAD}:
        assert of(Event.NO_CONDITIONS, memory(state, 60.0), cycle(seen(), battery=battery)) is None, "the pad is in sight"
        for waited_s in (10.0, 10.001):
            found = figures(of(Event.NO_CONDITIONS, memory(state, waited_s), cycle(battery=battery)))
            ends = low and waited_s > 10.0 and state in (State.SEARCH, State.RENDEZVOUS)
            assert found == ((ReasonCause.BATTERY, pytest.approx(9.0), pytest.approx(10.0)) if ends else None)


@pytest.mark.parametrize("state", [State.REFUSED, State.GAVE_UP])
def test_a_battery_that_ends_lands_a_refused_drone_on_the_pad_that_it_sees(state: State) -> None:
    for battery, relative, since_s, stood, lands in (
        (0.09, seen(), 2.0, False, True), (0.09, seen(), 1.9, False, False), (0.1, seen(), 2.0, False, False),
        (0.09, None, 2.0, False, False), (0.049, seen(), 2.0, False, False), (0.09, seen(), 2.0, True, False),
        (None, seen(), 2.0, False, False),
    ):  # fmt: skip
        p = replace(memory(state, since_s), stood=stood)
        assert (of(Event.BATTERY_ENDS, p, cycle(relative, battery=battery)) is not None) is lands
    assert TABLES["cone"][state][Event.BATTERY_ENDS] is State.SEARCH
    for held in (State.PAUSED, State.ABORTED, State.READY):
        assert of(Event.BATTERY_ENDS, memory(held, 9.0), cycle(seen(), battery=0.09)) is None, "a person has it"


def test_wind_refuses_no_drone_whose_battery_ends_over_the_pad() -> None:
    p = memory(State.INTERCEPT, windy_since=ns(NOW - 30.0))
    for battery, relative, refuses in ((0.5, seen(), True), (0.09, seen(), False), (0.09, None, True)):
        assert (of(Event.NO_CONDITIONS, p, cycle(relative, wind=STRONG, battery=battery)) is not None) is refuses


@pytest.mark.parametrize("state", [State.SEARCH, State.RENDEZVOUS])
def test_without_sight_and_without_the_ship_s_place_it_refuses_after_a_while(state: State) -> None:
    silent = Reason(ReasonCause.VESSEL_SILENT)
    cases = ((10.0, None, False), (10.001, None, True), (30.0, 10.0, False), (30.0, 10.001, True), (5.0, 30.0, False))
    for since_s, known_s, refuses in cases:
        p = memory(state, since_s, place_known=None if known_s is None else ns(NOW - known_s))
        assert of(Event.NO_CONDITIONS, p, cycle(vessel=silent)) == (silent if refuses else None)
        assert of(Event.NO_CONDITIONS, p, cycle(seen(), vessel=silent)) is None, "the pad is in sight"
        assert of(Event.NO_CONDITIONS, replace(p, state=State.HOLD_BLIND), cycle(vessel=silent)) is None
    assert of(Event.NO_CONDITIONS, memory(state, since=None), cycle(vessel=silent)) is None
    assert of(Event.NO_CONDITIONS, memory(state, 99.0), cycle(vessel=None)) is None


def test_a_go_around_ends_the_tries_once_it_is_high_enough() -> None:
    wind = Reason(ReasonCause.WIND, 16.0, 15.0)

    def after(
        height_m: float, fault: Reason | None, go_arounds: int = 1, *, refusing: bool = False, **s: Any
    ) -> list[tuple[Event, Reason]]:
        p = memory(State.GO_AROUND, seen_height_m=height_m, fault=fault, go_arounds=go_arounds, refusing=refusing)
        ends = (Event.NO_CONDITIONS, Event.HOPELESS)
        return [found for found in happens(p, cycle(seen((0.0, 0.0, height_m)), **s)) if found[0] in ends]

    last, over = OPTIONS.tries.go_arounds_max, OPTIONS.tries.go_arounds_max + 1
    assert after(2.0, WHY, last) == after(2.0, None, over) == after(1.7, WHY, over, refusing=True) == []
    assert after(2.0, WHY, over) == [(Event.HOPELESS, WHY)]
    assert after(2.0, wind, over) == [(Event.NO_CONDITIONS, wind), (Event.HOPELESS, wind)]
    assert after(2.0, wind, last) == []
    assert after(2.0, wind, last, refusing=True) == [(Event.NO_CONDITIONS, wind)]
    assert after(2.0, WHY, last, late_s=0.5)[0][0] is Event.NO_CONDITIONS
    assert after(1.7, WHY, last, late_s=0.5) == [], "up first"
    assert of(Event.HOPELESS, memory(State.HOLD_BLIND, fault=WHY, go_arounds=9), cycle(seen())) is None


def test_what_the_frames_show_is_reported_where_nothing_else_is_seen() -> None:
    over = OPTIONS.tries.go_arounds_max + 1
    p = memory(State.GO_AROUND, 60.0, seen=ns(NOW - 60.0), in_sight=False, climbed_m=2.0, fault=WHY, go_arounds=over)
    assert of(Event.HOPELESS, p, cycle()) == WHY
    reported = of(Event.HOPELESS, p, cycle(frames=BLIND))
    assert reported is not None
    assert reported.cause is ReasonCause.FRAMES
    assert of(Event.HOPELESS, replace(p, in_sight=True, seen_height_m=2.0), cycle(seen(), frames=BLIND)) == WHY


# Limits of an attempt


def test_a_limit_ends_the_commit_but_not_without_an_estimate() -> None:
    off = seen((0.3, 0.0, 0.2))
    assert figures(of(Event.LIMIT, memory(State.COMMIT), cycle(off))) == (ReasonCause.ERROR, pytest.approx(0.3), 0.25)
    assert of(Event.LIMIT, memory(State.COMMIT), cycle(seen((0.2, 0.0, 0.2)))) is None
    assert of(Event.LIMIT, memory(State.COMMIT), cycle()) is None
    assert of(Event.LIMIT, memory(State.PRESS), cycle(off)) is None


@pytest.mark.parametrize("state", sorted(FLOWN - {State.ANOTHER_PAD}, key=str))
def test_an_attempt_s_budget_and_a_turned_arrow_end_the_way_down_alone(state: State) -> None:
    sight = cycle(seen((0.0, 0.0, 0.3)))
    turned = Reason(ReasonCause.HEADING_TURNED, 170.0, 90.0)
    spent = memory(state, attempt=Attempt(losses=9))
    limited = state in DESCENT
    assert figures(of(Event.LIMIT, spent, sight)) == ((ReasonCause.LOSSES, 9.0, 8.0) if limited else None)
    assert of(Event.LIMIT, replace(spent, turned=turned), sight) != turned, "nobody keeps to the arrow"
    align = guided(tries={"heading": "align"})
    assert of(Event.LIMIT, replace(spent, turned=turned), sight, align) == (turned if limited else None)
    assert of(Event.LIMIT, memory(state), sight, align) is None


@pytest.mark.parametrize("state", sorted(FLOWN - {State.ANOTHER_PAD}, key=str))
def test_the_time_of_the_whole_landing_ends_the_way_to_the_gate_alone(state: State) -> None:
    sight = cycle(seen((0.0, 0.0, 0.3)))
    for spent_s, over in ((180.0, False), (180.001, True)):
        p = memory(state, landing_began=ns(NOW - spent_s))
        expected = (ReasonCause.LANDING_TIME, pytest.approx(spent_s), 180.0) if over and state in DESCENT else None
        assert figures(of(Event.LIMIT, p, sight)) == expected


def test_when_the_landing_s_time_is_over_a_climb_is_the_last_one() -> None:
    high = cycle(seen((0.0, 0.0, 2.0)))
    p = memory(State.GO_AROUND, seen_height_m=2.0, fault=WHY, go_arounds=1, landing_began=ns(NOW - 180.001))
    assert of(Event.HOPELESS, p, high) == WHY
    assert of(Event.NO_CONDITIONS, p, high) is None
    windy = Reason(ReasonCause.WIND, 20.0, 15.0)
    assert of(Event.NO_CONDITIONS, replace(p, fault=windy), high) == windy
    assert of(Event.HOPELESS, replace(p, landing_began=ns(NOW - 180.0)), high) is None
    assert of(Event.HOPELESS, replace(p, seen_height_m=1.0), cycle(seen())) is None, "first the climb"


@pytest.mark.parametrize(
    ("ago_s", "height_m", "lost"), [(1.51, 1.7, True), (1.5, 1.7, False), (1.51, 1.75, False), (None, 1.0, False)]
)
def test_low_and_blind_for_a_while_it_goes_around(ago_s: float | None, height_m: float, lost: bool) -> None:
    p = memory(State.HOLD_BLIND, seen=None if ago_s is None else ns(NOW - ago_s), seen_height_m=height_m, in_sight=False)
    assert figures(of(Event.LIMIT, p, cycle())) == ((ReasonCause.LOST_LOW, height_m, None) if lost else None)
    assert of(Event.LIMIT, replace(p, state=State.DESCEND), cycle()) is None


@pytest.mark.parametrize(
    ("d", "cause", "figure"),
    [
        ((0.0, 0.0, -0.59), None, None), ((0.0, 0.0, -0.61), ReasonCause.PAST_DECK, 0.61),
        ((0.0, 0.0, 0.69), None, None), ((0.0, 0.0, 0.71), ReasonCause.ROSE, 0.41),
        ((0.33, 0.24, 0.2), None, None), ((0.36, 0.24, 0.2), ReasonCause.DRIFTED, math.hypot(0.36, 0.24)),
    ],
)  # fmt: skip
def test_a_landing_that_the_vehicle_makes_is_left_to_it_as_long_as_it_goes_down_at_the_pad(d, cause, figure):
    """0.6 m past the deck, 0.4 m risen, 0.3 m beside the last way point's 0.12 m."""
    p, thesis = memory(State.DOWN, entered_height_m=0.3), guided("thesis")
    found = of(Event.LIMIT, p, cycle(seen(d)), thesis)
    assert (None if found is None else (found.cause, found.measured)) == (
        None if cause is None else (cause, pytest.approx(figure))
    )  # fmt: skip
    if cause is ReasonCause.DRIFTED:
        assert found is not None
        assert found.limit == pytest.approx(0.42)
        assert of(Event.LIMIT, p, cycle(seen(d)), guided("thesis", thesis={"pad_ahead_m": 0.05})) is None
    if cause is not ReasonCause.PAST_DECK:
        old = cycle(seen(d, age=0.51))
        assert of(Event.LIMIT, replace(p, seen_height_m=0.3), old, thesis) is None, "an old sight tells nothing"


@pytest.mark.parametrize(
    ("ago_s", "height_m", "lost"), [(0.51, 0.53, True), (0.5, 0.53, False), (0.51, 0.51, False), (None, 0.53, False)]
)
def test_a_vehicle_that_lands_by_itself_loses_the_pad_where_it_leaves_the_view(ago_s, height_m, lost):
    """The view ends below the last way point's 0.3 m and its margin, where a lost pad is no loss."""
    p = memory(State.DOWN, seen=None if ago_s is None else ns(NOW - ago_s), seen_height_m=height_m)
    assert figures(of(Event.LIMIT, p, cycle(), guided("thesis"))) == ((ReasonCause.LOST_LOW, height_m, None) if lost else None)


@pytest.mark.parametrize("state", [State.PRESS, State.DOWN])
def test_a_fresh_sight_from_above_the_gate_s_height_reports_that_it_has_left_the_deck_again(state: State) -> None:
    """0.1 m over the gate's 0.295 m by two standard deviations, from a sighting of at most 0.2 s."""
    p = memory(state, seen_height_m=0.1, entered_height_m=0.1)

    def found(height_m: float, o: GuidanceOptions = OPTIONS, **more: Any) -> Reason | None:
        return of(Event.LIMIT, p, cycle(seen((0.1, 0.2, height_m), **more)), o)

    assert figures(found(0.416)) == (ReasonCause.OFF_DECK, 0.416, pytest.approx(0.395))
    assert found(0.414) is None
    assert found(0.534, sigma=0.07) is None
    assert found(0.536, sigma=0.07) is not None
    assert found(2.0, age=0.2) is not None
    assert found(2.0, age=0.21) is None, "blind on the deck the height drifts"
    assert found(2.0, consistent=False) is None
    assert found(2.0, track=2) is None
    assert found(0.45, guided(cone={"gate_height_m": 0.5})) is None, "as high as the commit begins a vehicle may stand"
    assert of(Event.LIMIT, p, cycle()) is None
    assert TABLES["cone"][state][Event.LIMIT] is State.GO_AROUND


@pytest.mark.parametrize(("alert", "at_once"), [("UNFELT", True), ("ATTITUDE", True), ("CAMERA_FROZEN", False)])
def test_a_sensor_that_stays_lost_lets_nobody_wait_low_over_the_deck(alert: str, at_once: bool) -> None:
    p = memory(State.HOLD_BLIND, seen=ns(NOW - 0.1), seen_height_m=0.4, in_sight=False)
    suspect = replace(seen((0.0, 0.0, 0.4), consistent=False), alerts=(IntegrityAlert[alert],))
    found = of(Event.LIMIT, p, cycle(suspect), OPTIONS)
    assert (found is not None and found.cause is ReasonCause.LOST_LOW) is at_once


@pytest.mark.parametrize(
    ("height_m", "sinks_m_s", "sigma", "range_m", "climbs"),
    [
        (0.5, 0.44, 0.01, None, True), (0.5, 0.43, 0.01, None, False), (0.3, -0.3, 0.01, None, False),
        (0.3, 0.2, 0.05, None, True), (0.5, 0.2, 0.01, 0.25, True), (0.6, -0.3, 0.01, 0.34, True), (0.6, -0.3, 0.01, 0.36, False),
    ],
)  # fmt: skip
def test_a_drone_that_sinks_without_sight_climbs_while_that_still_helps(height_m, sinks_m_s, sigma, range_m, climbs) -> None:
    """Its feet would be on the deck within a second, by one deviation, or the range sensor finds it 0.25 m nearer."""
    p = memory(State.HOLD_BLIND, seen=ns(NOW - 0.1), seen_height_m=0.6, in_sight=False)
    doubted = seen((0.0, 0.0, height_m), v=(0.0, 0.0, -sinks_m_s), consistent=False, sigma=sigma)
    s = cycle(replace(doubted, alerts=(IntegrityAlert.ELSEWHERE,)), range_m=range_m)
    found = of(Event.LIMIT, p, s)
    assert (found is not None and found.cause is ReasonCause.LOST_LOW) is climbs


@pytest.mark.parametrize(
    ("height_m", "sinks_m_s", "ends"), [(0.25, 0.5, True), (0.25, 0.4, False), (0.31, 0.8, False), (1.0, 0.5, False)]
)
def test_an_intercept_that_sinks_onto_the_deck_climbs(height_m: float, sinks_m_s: float, ends: bool) -> None:
    """An accelerometer that lies made the law follow a deck down that rose (random fault): 0.205 m of room, in 0.4 s."""
    p = memory(State.INTERCEPT, since=ns(NOW - 0.2), entered_height_m=0.4)
    found = of(Event.LIMIT, p, cycle(seen((0.0, 0.0, height_m), v=(0.0, 0.0, -sinks_m_s))))
    assert (found is not None and found.cause is ReasonCause.SANK_AGAINST) is ends


@pytest.mark.parametrize("state", [State.PRESS, State.DOWN])
def test_lower_it_has_left_the_deck_where_it_would_come_down_beside_the_pad(state: State) -> None:
    """0.12 m under the feet by two standard deviations, and 1.4 of the commit's limit aside at 0.4 m/s down."""
    p = memory(state, seen_height_m=0.1, entered_height_m=0.1)

    def found(height_m: float, ahead_m: float, v_m_s: float = 0.0, **more: Any) -> Reason | None:
        return of(Event.LIMIT, p, cycle(seen((ahead_m, 0.0, height_m), v=(v_m_s, 0.0, 0.0), **more)), OPTIONS)

    beside_m = 1.4 * OPTIONS.limits.commit_error_m
    assert figures(found(0.19, beside_m + 0.01)) == (ReasonCause.OFF_DECK, 0.19, pytest.approx(0.165))
    assert found(0.19, beside_m - 0.01) is None
    assert found(0.18, beside_m + 0.01) is None, "feet that stand may be reckoned so high"
    assert found(0.245, 0.0, 2.0 * beside_m + 0.05) is not None, "half a second to the deck"
    assert found(0.245, 0.0, 2.0 * beside_m - 0.05) is None
    assert found(0.245, 0.0, 9.0, age=0.21) is None


@pytest.mark.parametrize("state", [State.PRESS, State.DOWN])
@pytest.mark.parametrize(("past_m", "bounces", "climbs"), [(0.59, 0, False), (0.61, 0, True), (0.61, 2, True)])
def test_a_drone_below_the_deck_climbs(state: State, past_m: float, bounces: int, climbs: bool) -> None:
    """WHY: one that a turning ship swept off the pad pressed on beside the deck, into the water."""
    found = of(Event.LIMIT, memory(state, bounces=bounces), cycle(seen((0.0, 0.0, -past_m), age=1.0)))
    assert figures(found) == ((ReasonCause.PAST_DECK, past_m, None) if climbs else None)


# Contacts of which no accelerometer tells, and those of a go-around


@pytest.mark.parametrize(
    ("height_m", "age_s", "off_m", "late_s", "falls_m_s", "pressed"),
    [
        (0.14, 1.52, 0.1, 0.0, None, True), (0.14, 1.49, 0.1, 0.0, 0.0, False), (0.15, 1.52, 0.1, 0.0, 0.0, False),
        (0.14, 1.52, 0.36, 0.0, 0.0, False), (0.14, 0.1, 0.1, 0.16, 0.29, True), (0.14, 0.1, 0.1, 0.15, 0.29, False),
        (0.15, 0.1, 0.1, 0.16, 0.29, False), (0.14, 0.1, 0.36, 0.16, 0.29, False), (0.14, 0.1, 0.1, 0.16, 0.31, False),
        (0.14, 0.1, 0.1, 0.16, None, True),
    ],
)  # fmt: skip
def test_over_the_deck_with_sight_or_samples_that_are_too_old_it_presses_on(height_m, age_s, off_m, late_s, falls_m_s, pressed):
    """A PX4 stood on the pad at night, felt nothing yet, and took off again: its sight was 1.52 s old.

    An AR.Drone whose samples come late hovers on the deck, which moves on beneath it.
    """
    sighted = seen((off_m, 0.0, height_m), v=(0.0, 0.0, -0.4), age=age_s)
    v = np.array([0.0, 0.0, falls_m_s or 0.0])
    deck = None if falls_m_s is None else DeckMotion(ns(NOW), v, np.zeros(3), np.eye(6), 0.0, 0.0, 0.0, 0.0, np.eye(4))
    late = GuidanceCycle(ns(NOW), Knowledge(ns(NOW), sighted, deck=deck), age_s=late_s)
    found = happens(memory(State.COMMIT), late)
    assert (bool(found) and found[0][0] is Event.CONTACT) is pressed
    assert not pressed or figures(found[0][1]) == (ReasonCause.REACHED, pytest.approx(height_m - 0.045), None)


@pytest.mark.parametrize(
    ("height_m", "off_m", "speed_m_s", "ago_s", "bounces", "pressed"),
    [
        (0.08, 0.1, 0.0, 0.5, 0, True), (0.09, 0.1, 0.0, 0.5, 0, False), (0.08, 0.36, 0.0, 0.5, 0, False),
        (0.08, 0.26, 1.0, 0.5, 0, False), (0.08, 0.24, 1.0, 0.5, 0, True), (0.08, 0.1, 0.0, 1.1, 0, False),
        (0.08, 0.1, 0.0, 0.5, 4, False),
    ],
)  # fmt: skip
def test_a_contact_after_the_order_to_go_around_ends_in_the_press_where_it_is_on_the_pad(
    height_m: float, off_m: float, speed_m_s: float, ago_s: float, bounces: int, pressed: bool
) -> None:
    """It slides on by 0.1 m from 1 m/s; a rim of the pad remains."""
    s = cycle(seen((off_m, 0.0, height_m), v=(speed_m_s, 0.0, 0.0)), impact=struck("accelerometer", ago_s))
    found = figures(of(Event.CONTACT, memory(State.GO_AROUND, bounces=bounces), s))
    assert found == ((ReasonCause.FELT, 4.0, None) if pressed else None)


@pytest.mark.parametrize(
    ("size_m_s2", "lag_s", "pressed"), [(4.0, 0.43, False), (5.2, 0.43, False), (5.4, 0.43, True), (4.2, 1.0, True)]
)
def test_the_thrust_with_which_a_go_around_begins_is_no_contact(size_m_s2: float, lag_s: float, pressed: bool) -> None:
    """WHY: over a ship that stopped, a drone 5 mm over the deck took its own climb for it, pressed on, and slid off the pad."""
    impact = Impact(ns(NOW - 0.1), "accelerometer", size_m_s2)
    known = Knowledge(ns(NOW), seen((0.0, 0.0, 0.08)), impact=impact, climb=ClimbResponse(0.06, lag_s), climb_max_m_s=1.0)
    assert (of(Event.CONTACT, memory(State.GO_AROUND), GuidanceCycle(ns(NOW), known)) is not None) is pressed
    down = of(Event.CONTACT, memory(State.COMMIT), GuidanceCycle(ns(NOW), known))
    assert down is not None, "on the way down nothing else pushes"


@pytest.mark.parametrize(("state", "lands"), [(State.GO_AROUND, False), (State.GATE, True)])
def test_a_contact_while_it_climbs_from_a_ship_that_steers_is_no_landing(state: State, lands: bool) -> None:
    """WHY: the deck sweeps along under the feet, and a drone that pressed on slid off the pad."""
    s = cycle(replace(seen((0.1, 0.0, 0.08)), steers=True), impact=struck("accelerometer", 0.5))
    assert (of(Event.CONTACT, memory(state), s) is not None) is lands


def test_after_the_second_bounce_it_stays_down() -> None:
    off = cycle(seen((0.0, 0.0, 0.6)))
    for bounces, ends in ((0, True), (1, True), (2, False)):
        p = memory(State.PRESS, bounces=bounces)
        assert (of(Event.LIMIT, p, off) is not None) is ends
    p = entered(
        memory(State.PRESS), StateChange(ns(NOW), State.PRESS, Event.LIMIT, State.GO_AROUND, Reason(ReasonCause.OFF_DECK))
    )
    assert p.bounces == 1


# Against the orders


def test_two_seconds_against_the_order_end_an_attempt() -> None:
    down = HeldCourse(1, 1.0, ns(NOW - 2.0))
    for height_m, course, ends in ((1.3, down, True), (1.29, down, False), (1.3, replace(down, at=ns(NOW - 1.9)), False)):
        found = figures(of(Event.LIMIT, memory(State.DESCEND, course=course), cycle(seen((0.0, 0.0, height_m)))))
        assert found == ((ReasonCause.ROSE_AGAINST, pytest.approx(height_m - 1.0), 2.0) if ends else None)
    up = memory(State.GO_AROUND, course=replace(down, sign=-1), fault=WHY, go_arounds=1)
    assert figures(of(Event.TIMEOUT, up, cycle(seen((0.0, 0.0, 0.6))))) == (ReasonCause.SANK_AGAINST, pytest.approx(0.4), 2.0)
    assert of(Event.TIMEOUT, up, cycle(seen((0.0, 0.0, 1.4)))) is None


def test_a_vehicle_that_flies_another_course_than_ordered_is_not_landed() -> None:
    off = Reason(ReasonCause.OFF_ORDERS, 1.3, OFF_M, "higher")
    for state in DESCENT:
        assert of(Event.LIMIT, memory(state), cycle(seen(), off_orders=off)) == off
    around = memory(State.GO_AROUND, seen_height_m=OPTIONS.tries.safe_height_m, fault=off, go_arounds=1)
    assert of(Event.NO_CONDITIONS, around, cycle(seen(), off_orders=off)) == off, "as long as it does"
    assert of(Event.NO_CONDITIONS, around, cycle(seen())) is None, "or the drone tries again"


def reading(t: float, height_m: float) -> Baro:
    return Baro(Stamp(ns(t), ns(t), 0.0, "sim"), height_m, 0.5)


def flown_against(
    orders: float, lifts: float, waves_m: float, weather_m: float, seconds: float, every_s: float = 0.04
) -> float | None:
    """Return how far off a late vehicle is found that something lifts, m/s; waves move the pad, gusts the barometer."""
    watch, baro = ClimbWatch(), reading(0.0, 0.0)
    for k in range(round(25 * seconds)):
        t = k / 25.0
        own_m = orders * max(0.0, t - 0.5) + lifts * t
        baro_m, pad_m = own_m + weather_m * math.sin(math.tau * t / 7.0 + 1.0), own_m - waves_m * math.sin(math.tau * t / 9.0)
        if k % round(25 * every_s) == 0:
            baro = reading(t, baro_m)
        watch = watch.flown(orders, baro, pad_m, ClimbResponse(0.06, 0.3), 0.04)
    return watch.off_m


@pytest.mark.parametrize("step_m", [-300.0, -8.0, -3.5, 3.5, 8.0, 300.0])
def test_a_barometer_that_jumps_contradicts_no_order(step_m: float) -> None:
    """WHY: one that read 98 Pa more from an instant on refused a drone that climbed as ordered, out of sight of the pad."""
    watch = ClimbWatch()
    for k in range(500):
        watch = watch.flown(0.5, reading(0.04 * k, 0.02 * k + (step_m if k > 200 else 0.0)), None, ClimbResponse(0.06, 0.3), 0.04)
        assert watch.off_m is None


def test_a_barometer_that_repeats_itself_contradicts_no_order_while_the_pad_is_seen() -> None:
    """WHY: a frozen one would refuse a drone that descends by 0.8 m/s as ordered."""
    watch = ClimbWatch()
    for k in range(250):
        watch = watch.flown(-0.8, reading(0.04 * k, 7.0), 9.0 - 0.032 * k, ClimbResponse(0.06, 0.3), 0.04)
        assert watch.off_m is None


def test_a_barometer_s_first_reading_contradicts_no_order_over_a_deck_that_rises() -> None:
    """WHY: its error, with a pad that came up as fast as the drone climbed, refused two of 200 landings in sea state 6."""
    watch = ClimbWatch()
    for k in range(250):
        watch = watch.flown(
            0.5, reading(0.04 * k, 0.02 * k + (2.4 if k == 0 else 0.0)), 8.0 - 0.01 * k, ClimbResponse(0.06, 0.3), 0.04
        )
        assert watch.off_m is None


def test_a_barometer_that_is_read_once_a_second_contradicts_no_order_over_a_deck_that_falls() -> None:
    """WHY: beside PX4 its mean was a metre behind a descent of 1.4 m/s, and refused one of two landings in sea state 4."""
    watch, baro = ClimbWatch(), reading(0.0, 10.0)
    for k in range(200):
        t = 0.04 * k
        baro = baro if k % 25 else reading(t, 10.0 - 1.4 * max(0.0, t - 0.36))
        watch = watch.flown(-1.4, baro, 6.0 - 0.6 * t, ClimbResponse(0.06, 0.3), 0.04)
        assert watch.off_m is None
    assert watch.pad.off_m > OFF_M


@pytest.mark.parametrize("every_s", [0.04, 1.0])
@pytest.mark.parametrize("orders", [-0.8, 0.0, 0.5])
def test_neither_waves_nor_gusts_nor_a_late_answer_is_another_course(orders: float, every_s: float) -> None:
    assert {flown_against(orders, 0.0, 1.1, 0.8, seconds, every_s) for seconds in range(1, 30)} == {None}
    for lifts in (-0.9, 0.9):
        assert flown_against(orders, lifts, 0.5, 0.3, 1.0, every_s) is None
        for seconds in (5.0, 10.0, 20.0):
            assert math.copysign(1.0, lifts) * (flown_against(orders, lifts, 0.5, 0.3, seconds, every_s) or 0.0) >= OFF_M


@pytest.mark.parametrize(("baro_m_s", "pad_m_s", "off"), [(0.9, 0.9, True), (0.9, -0.9, False), (-0.9, 0.9, False)])
def test_two_heights_that_part_from_the_orders_on_either_side_are_no_other_course(baro_m_s, pad_m_s, off) -> None:
    """WHY: pressure that falls over a deck that rises says nothing of what the vehicle obeys."""
    watch = ClimbWatch()
    for k in range(200):
        watch = watch.flown(0.0, reading(0.04 * k, 0.04 * k * baro_m_s), 4.0 + 0.04 * k * pad_m_s, ClimbResponse(0.06, 0.3), 0.04)
    assert (watch.off_m is not None) is off


def test_a_hover_keeps_what_is_known_of_the_orders() -> None:
    response, out_of_sight = ClimbResponse(0.06, 0.3), ClimbWatch()
    for k in range(250):
        out_of_sight = out_of_sight.flown(0.0, reading(0.04 * k, 0.036 * k), None, response, 0.04)
    assert (out_of_sight.off_m or 0.0) >= 2.5 * OFF_M
    for _ in range(250):
        out_of_sight = out_of_sight.flown(None, reading(0.0, 20.0), 3.0, response, 0.04)
    assert (out_of_sight.off_m or 0.0) >= 2.5 * OFF_M


def test_a_vehicle_that_answers_too_late_ends_the_flight() -> None:
    for state in (State.SEARCH, State.DESCEND, State.GATE):
        found = figures(of(Event.NO_CONDITIONS, memory(state), cycle(seen(), late_s=0.44)))
        assert found == (ReasonCause.ANSWERS_LATE, 0.44, 0.4)
        assert TABLES["cone"][state][Event.NO_CONDITIONS] in (State.GO_AROUND, State.REFUSED)
