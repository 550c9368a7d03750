"""The ends of each state: one table of limits, a row for each, on either side of its figure; and what each state remembers."""

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.mission import ENDED, FLOWN, Event, Reason, ReasonCause, State, StateChange
from companion.guidance.controller import HORIZONS_S, Impact, Knowledge
from companion.guidance.mission.another_pad import OtherPad
from companion.guidance.mission.commit import Commit
from companion.guidance.mission.gate import Gate, gate_of
from companion.guidance.mission.machine import MISSIONS, PHASES, TABLES, account
from companion.guidance.mission.progress import NEAR_DECK_M, Attempt, GuidanceCycle, InputQuality, Progress, arrow_turned, entered
from companion.guidance.mission.search import Search
from companion.guidance.mission.wind import WindOverDrone
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.estimates import IntegrityAlert, Verdict
from tests.companion.test_limits import forecast
from tests.companion.test_mission_flights import guided
from tests.make import estimate, ns

NOW = 100.0
OPTIONS = GuidanceOptions()
TRIES, CONE = OPTIONS.tries, OPTIONS.cone
WHY = Reason(ReasonCause.LOSSES, 9.0, 8.0)
WAY = (State.INTERCEPT, State.DESCEND, State.GATE, State.HOLD_BLIND)
STRONG = WindOverDrone(9.0, 1.5, 8.0, (1.0, 0.0), 0.3, spent=False)
"""A wind beyond what the vehicle's tilt can fly, though not beyond all of it."""
LATE = Counter({Verdict.GATED: 20})


def memory(state: State, since_s: float = 1.0, **more: Any) -> Progress:
    """Return an attempt in sight of pad 1 at a metre, whose state began a second ago."""
    fields: dict[str, Any] = {
        "automatic": True, "since": ns(NOW - since_s), "seen": ns(NOW), "seen_height_m": 1.0, "in_sight": True, "track": 1,
        "entered_height_m": 1.0, "begun": True, "stood": False,
    }  # fmt: skip
    return Progress(state, **{**fields, **more})


def blind(state: State, since_s: float = 1.0, **more: Any) -> Progress:
    return memory(state, since_s, **{"in_sight": False, "seen": None, "seen_height_m": 0.0, "silent_m": 0.0, **more})


def sees(d: tuple[float, float, float] = (0.0, 0.0, 1.0), **more: Any) -> Any:
    return estimate(NOW, d, **more)


def cycle(relative: Any = None, *, impact: Impact | None = None, **more: Any) -> GuidanceCycle:
    return GuidanceCycle(ns(NOW), Knowledge(ns(NOW), relative, impact=impact), **more)


def first(p: Progress, s: GuidanceCycle, o: GuidanceOptions = OPTIONS) -> tuple[Event, Reason] | None:
    """Return the event that changes the state, with its reason."""
    happens, leads = MISSIONS[o.mission][p.state].events(p, s, o), TABLES[o.mission][p.state]
    return next(((event, why) for event, why in happens if leads[event] is not p.state), None)


def of(event: Event, p: Progress, s: GuidanceCycle, o: GuidanceOptions = OPTIONS) -> Reason | None:
    return next((why for kind, why in MISSIONS[o.mission][p.state].events(p, s, o) if kind is event), None)


AGO = [
    # state, event, cause, the memory and the inputs before the limit and beyond it
    (State.SEARCH, Event.TIMEOUT, ReasonCause.NOT_FOUND, lambda s: (blind(State.SEARCH, TRIES.search_s + s), cycle())),
    (State.SEARCH, Event.TIMEOUT, ReasonCause.FRAMES, lambda s: (blind(State.SEARCH, TRIES.search_s + s), cycle(frames=LATE))),
    (State.RENDEZVOUS, Event.TIMEOUT, ReasonCause.STATE_TIME,
     lambda s: (blind(State.RENDEZVOUS, OPTIONS.rendezvous.time_s + s), cycle())),
    (State.INTERCEPT, Event.TIMEOUT, ReasonCause.STATE_TIME,
     lambda s: (memory(State.INTERCEPT, attempt=Attempt(spent_s={State.INTERCEPT: TRIES.leg_s + s})), cycle(sees((1, 0, 1.0))))),
    (State.DESCEND, Event.TIMEOUT, ReasonCause.STATE_TIME,
     lambda s: (memory(State.DESCEND, attempt=Attempt(spent_s={State.DESCEND: TRIES.leg_s + s})), cycle(sees()))),
    (State.GATE, Event.TIMEOUT, ReasonCause.LOSSES,
     lambda s: (memory(State.GATE, attempt=Attempt(spent_s={State.GATE: CONE.gate_s + s}), kept=Gate(blocked=WHY)),
                cycle(sees((0, 0, 0.3))))),
    (State.COMMIT, Event.TIMEOUT, ReasonCause.NO_CONTACT, lambda s: (memory(State.COMMIT, CONE.commit_s + s), cycle(sees()))),
    (State.PRESS, Event.TIMEOUT, ReasonCause.STATE_TIME,
     lambda s: (memory(State.PRESS, CONE.press_s + CONE.commit_s + s), cycle(sees((0, 0, 0.1), v=(0, 0, -0.4))))),
    (State.DOWN, Event.TIMEOUT, ReasonCause.NO_LANDING,
     lambda s: (memory(State.DOWN, OPTIONS.land_timeout_s + s), cycle(sees((0, 0, 0.1))))),
    (State.HOLD_BLIND, Event.TIMEOUT, ReasonCause.NOT_FOUND_AGAIN,
     lambda s: (blind(State.HOLD_BLIND, attempt=Attempt(without_sight_s=TRIES.give_up_after_s + s)), cycle())),
    (State.HOLD_BLIND, Event.TIMEOUT, ReasonCause.INCONSISTENT,
     lambda s: (blind(State.HOLD_BLIND, attempt=Attempt(without_sight_s=TRIES.give_up_after_s + s),
                      reason=Reason(ReasonCause.INCONSISTENT)), cycle())),
    (State.GO_AROUND, Event.TIMEOUT, ReasonCause.NOT_CLIMBING, lambda s: (blind(State.GO_AROUND, 16.0 + s), cycle())),
    (State.ANOTHER_PAD, Event.TIMEOUT, ReasonCause.NOBODY_DECIDED,
     lambda s: (memory(State.ANOTHER_PAD, TRIES.operator_wait_s + s), cycle(sees()))),
    (State.SEARCH, Event.NO_CONDITIONS, ReasonCause.BATTERY, lambda s: (blind(State.SEARCH, 10.0 + s), cycle(battery=0.09))),
    (State.RENDEZVOUS, Event.NO_CONDITIONS, ReasonCause.VESSEL_SILENT,
     lambda s: (blind(State.RENDEZVOUS, 30.0, kept=Search(ns(NOW - OPTIONS.rendezvous.lost_s - s))),
                cycle(vessel=Reason(ReasonCause.VESSEL_SILENT)))),
    (State.DESCEND, Event.NO_CONDITIONS, ReasonCause.WIND,
     lambda s: (memory(State.DESCEND, windy_since=ns(NOW - OPTIONS.limits.wind_wait_s - s)), cycle(sees(), wind=STRONG))),
    (State.HOLD_BLIND, Event.NO_CONDITIONS, ReasonCause.WIND,
     lambda s: (memory(State.HOLD_BLIND, in_sight=False, windy_since=ns(NOW - 12.0), seen=ns(NOW - 8.0 - s), seen_height_m=3.0),
                cycle(wind=STRONG._replace(spent=True)))),
    (State.GATE, Event.LIMIT, ReasonCause.WIND,
     lambda s: (memory(State.GATE, windy_since=ns(NOW - 2.0 - s)), cycle(sees((0, 0, 0.3)), wind=STRONG))),
    (State.GATE, Event.LIMIT, ReasonCause.LANDING_TIME,
     lambda s: (memory(State.GATE, landing_began=ns(NOW - TRIES.landing_s - s)), cycle(sees((0, 0, 0.3))))),
    (State.GATE, Event.LIMIT, ReasonCause.LOW_TIME, lambda s: (memory(State.GATE, low_s=110.0 + s), cycle(sees((0, 0, 0.3))))),
    (State.DESCEND, Event.LIMIT, ReasonCause.SWEPT,
     lambda s: (memory(State.DESCEND, attempt=Attempt(sweeps=5 + (s > 0.0))), cycle(sees()))),
    (State.GO_AROUND, Event.NO_CONDITIONS, ReasonCause.SWEPT,
     lambda s: (memory(State.GO_AROUND, sweeps=15 + (s > 0.0), fault=Reason(ReasonCause.SWEPT),
                       seen_height_m=1.8 if s > 0.0 else 1.7), cycle(sees()))),
    (State.DESCEND, Event.LIMIT, ReasonCause.TRY_TIME,
     lambda s: (memory(State.DESCEND, attempt=Attempt(began=ns(NOW - TRIES.try_s - s))), cycle(sees()))),
    (State.HOLD_BLIND, Event.LIMIT, ReasonCause.LOST_LOW,
     lambda s: (memory(State.HOLD_BLIND, in_sight=False, seen=ns(NOW - TRIES.climb_after_s - s)), cycle())),
    (State.COMMIT, Event.LIMIT, ReasonCause.SIGHTING_AGE,
     lambda s: (memory(State.COMMIT, 0.1), cycle(sees(age=OPTIONS.limits.commit_sighting_age_s + s)))),
    (State.COMMIT, Event.SIGHT_LOST, ReasonCause.NO_ESTIMATE,
     lambda s: (memory(State.COMMIT, 0.1, kept=Commit(ns(NOW - s))), cycle())),
    (State.GATE, Event.SIGHT_LOST, ReasonCause.STALE,
     lambda s: (memory(State.GATE), cycle(sees((0, 0, 0.3), age=OPTIONS.stale_after_s + s)))),
    (State.PRESS, Event.PRESSED, ReasonCause.PRESSED,
     lambda s: (memory(State.PRESS, CONE.press_s + s), cycle(sees((0, 0, 0.1))))),
    (State.GATE, Event.GATE_OPEN, ReasonCause.ALL_LIMITS_HOLD,
     lambda s: (memory(State.GATE, kept=Gate(ns(NOW - CONE.gate_dwell_s - s))), cycle(sees((0, 0, 0.3))))),
    (State.INTERCEPT, Event.IN_CONE, ReasonCause.ARRIVED,
     lambda s: (memory(State.INTERCEPT), cycle(sees((0.0, math.sqrt(1.2) * 0.44 - s, 2.0))))),
    (State.DESCEND, Event.OUT_OF_CONE, ReasonCause.OUT_OF_CONE,
     lambda s: (memory(State.DESCEND), cycle(sees((math.sqrt(2.0) * 0.44 + s, 0.0, 2.0))))),
    (State.DESCEND, Event.AT_GATE, ReasonCause.LOW_ENOUGH,
     lambda s: (memory(State.DESCEND), cycle(sees((0.0, 0.0, CONE.gate_m + 0.08 - s))))),
    (State.GATE, Event.OUT_OF_CONE, ReasonCause.OUT_OF_CONE,
     lambda s: (memory(State.GATE), cycle(sees((0.0, 0.0, CONE.gate_m + 0.3 + s))))),
    (State.GO_AROUND, Event.CLEAR, ReasonCause.HIGH_ENOUGH,
     lambda s: (memory(State.GO_AROUND, seen_height_m=TRIES.safe_height_m - 0.25 + s), cycle(sees()))),
    (State.GO_AROUND, Event.CLEAR, ReasonCause.HIGH_ENOUGH,
     lambda s: (blind(State.GO_AROUND, climbed_m=TRIES.safe_height_m + s), cycle())),
    (State.REFUSED, Event.BATTERY_ENDS, ReasonCause.BATTERY_ENDS,
     lambda s: (memory(State.REFUSED, 2.0 + s), cycle(sees(), battery=0.09))),
]  # fmt: skip


@pytest.mark.parametrize(("state", "event", "cause", "at"), AGO, ids=[f"{s.name}-{c.name}" for s, _, c, _ in AGO])
def test_a_limit_holds_on_its_near_side_and_ends_the_state_beyond_it(state, event, cause, at):
    """The sides are a millisecond or a millimetre apart; the reason says what."""
    assert first(*at(-0.001)) is None
    found = first(*at(0.001))
    assert (found[0], found[1].cause) == (event, cause)


@pytest.mark.parametrize("state", sorted({s for s in FLOWN if TABLES["cone"][s][Event.OTHER_PAD] is not s}, key=str))
def test_an_estimate_of_another_track_is_another_pad_and_comes_first(state: State) -> None:
    """Before any contact, limit or time."""
    struck = Impact(ns(NOW), "accelerometer", 9.0)
    assert first(memory(state, 1e4, track=2), cycle(sees((0, 0, 0.1)), impact=struck)) == (
        Event.OTHER_PAD,
        Reason(ReasonCause.ANOTHER_PAD),
    )
    for p, relative in ((memory(state, track=None), sees()), (memory(state, track=2), None)):
        assert of(Event.OTHER_PAD, p, cycle(relative)) is None


# Contact


@pytest.mark.parametrize(("by", "cause"), [("accelerometer", ReasonCause.FELT), ("velocity", ReasonCause.HELD_UP)])
def test_a_contact_of_this_commit_counts_and_says_by_what(by: str, cause: ReasonCause) -> None:
    low = sees((0.0, 0.0, 0.1))
    for ago_s, counts in ((0.2, True), (0.201, False)):
        found = first(memory(State.COMMIT, 0.2), cycle(low, impact=Impact(ns(NOW - ago_s), by, 4.0, 0.6)))
        assert (found is not None and found[1].cause is cause) is counts, "one from before the commit is another"
    struck = cycle(low, impact=Impact(ns(NOW), by, 4.0, 0.6))
    assert of(Event.CONTACT, memory(State.COMMIT, since=None), struck) is None


@pytest.mark.parametrize(("ago_s", "since_s", "counts"), [(0.3, 1.0, True), (0.31, 1.0, False), (0.2, 0.1, False)])
def test_one_foot_s_push_counts_at_the_deck_for_three_tenths_of_the_commit(ago_s: float, since_s: float, counts: bool) -> None:
    pushed = Impact(ns(NOW - ago_s), "accelerometer", 5.0, doubtful=True)
    s = cycle(sees((0.0, 0.0, CONE.feet_below_m + 0.04), v=(0.0, 0.0, -0.4)), touch=pushed)
    assert (of(Event.CONTACT, memory(State.COMMIT, since_s), s) is not None) is counts


def test_being_held_up_is_a_contact_near_the_deck_alone_and_while_it_lasts() -> None:
    """An updraft holds up too; a step that no flight makes is a contact at any height."""
    for height_m, ago_s, counts in (
        (0.2, 0.25, True),
        (0.3, 0.25, False),
        (0.2, 0.26, False),
        (None, 0.1, True),
        (None, 0.3, False),
    ):
        relative = None if height_m is None else sees((0.0, 0.0, height_m))
        by_speed, by_step = (Impact(ns(NOW - ago_s), by, 4.0, 0.6) for by in ("velocity", "accelerometer"))
        assert (of(Event.CONTACT, memory(State.COMMIT), cycle(relative, impact=by_speed)) is not None) is counts
        assert of(Event.CONTACT, memory(State.COMMIT), cycle(relative, impact=by_step)) is not None


@pytest.mark.hazard("H4")
def test_a_contact_that_the_height_contradicts_is_pressed_for_as_long_as_the_way_to_the_deck_takes() -> None:
    """WHY: a jolt of 40 ms in a commit whose picture was 0.3 s old stopped the motors 14 cm above the deck."""
    felt, feet = Impact(ns(NOW), "accelerometer", 6.0), CONE.feet_below_m
    above = cycle(sees((0.0, 0.0, feet + 0.3), age=1.0, v=(0.0, 0.0, -0.4)), impact=felt)
    assert of(Event.CONTACT, memory(State.COMMIT), above) is None
    # The jolt took the estimated speed away as well.
    above = cycle(sees((0.0, 0.0, feet + 0.3), age=1.0), impact=felt)
    assert of(Event.CONTACT, memory(State.COMMIT), replace(above, at=ns(NOW + 0.15))) is not None
    p = account(memory(State.PRESS, 0.0), above, OPTIONS)
    for since_s, pressed in ((0.41, False), (0.74, False), (0.76, True)):
        assert (of(Event.PRESSED, replace(p, since=ns(NOW - since_s)), above) is not None) is pressed
    fast = cycle(sees((0.0, 0.0, feet), v=(0.0, 0.0, -0.35), age=1.0), impact=felt)
    assert of(Event.PRESSED, memory(State.PRESS, 1.0), fast) is None, "the descent that the push should have ended goes on"
    assert of(Event.PRESSED, memory(State.PRESS, 1.0), replace(fast, feels=False)) is not None
    # A frame that was exposed after the contact shows it as high as before; what no frame shows any more is no way that is left.
    for feet_m, age_s, pressed in ((0.2, 0.0, False), (0.2, 0.21, True), (0.14, 0.0, True)):
        later = account(replace(p, since=ns(NOW - 0.7)), cycle(sees((0.0, 0.0, feet + feet_m), age=age_s)), OPTIONS)
        assert (of(Event.PRESSED, replace(later, since=ns(NOW - 0.8)), cycle(sees())) is not None) is pressed


def test_a_drone_that_goes_up_from_the_deck_is_pressed_for_longer_and_its_motors_stay_on() -> None:
    rises = cycle(sees((0.0, 0.0, 0.1), v=(0.0, 0.0, 0.11)))
    for since_s, pressed in ((CONE.press_s + 0.1, False), (2.0 * CONE.press_s + 0.01, True)):
        assert (of(Event.PRESSED, memory(State.PRESS, since_s), rises) is not None) is pressed


# Conditions


@pytest.mark.parametrize(("spent", "height_m", "bars"), [(True, 1.9, True), (True, 2.1, False), (False, 1.0, False)])
def test_wind_bars_the_way_down_only_near_the_deck_and_where_it_takes_the_whole_tilt(spent, height_m, bars):
    """WHY: at 7 m it took 27 degrees of tilt and at the gate 13, and a drone that held over the pad was refused up there."""
    p = memory(State.INTERCEPT, windy_since=ns(NOW - 10.0), seen_height_m=height_m)
    s = cycle(sees((0.0, 0.0, height_m)), wind=STRONG._replace(spent=spent))
    assert (of(Event.IN_CONE, p, s) is None) is bars, "it waits over the pad"
    assert (of(Event.LIMIT, replace(p, state=State.DESCEND), s) is not None) is bars


def test_wind_refuses_no_drone_whose_battery_ends_over_the_pad() -> None:
    p = memory(State.INTERCEPT, windy_since=ns(NOW - 30.0))
    for battery, relative, refuses in ((0.5, sees(), True), (0.09, sees(), False), (0.09, None, True)):
        assert (of(Event.NO_CONDITIONS, p, cycle(relative, wind=STRONG, battery=battery)) is not None) is refuses


def test_the_vehicle_s_own_speed_is_no_wind() -> None:
    for speed_m_s, on_way_s, windy in ((8.1, None, True), (8.0, None, False), (8.1, 9.0, False), (8.1, 11.0, True)):
        p = memory(State.DESCEND, on_way=None if on_way_s is None else ns(NOW - on_way_s))
        noted = account(p, cycle(sees(), wind=STRONG._replace(speed_m_s=speed_m_s)), OPTIONS)
        assert (noted.windy_since is not None) is windy


def test_a_low_battery_ends_nothing_that_has_begun_or_is_in_sight() -> None:
    """WHY: with 9 % and the pad in sight the only way down was refused for good."""
    for state in FLOWN - {State.ANOTHER_PAD}:
        assert of(Event.NO_CONDITIONS, memory(state, 60.0), cycle(sees(), battery=0.09)) is None
        ends = of(Event.NO_CONDITIONS, blind(state, 60.0), cycle(battery=0.09)) is not None
        assert ends is (state in (State.SEARCH, State.RENDEZVOUS))
    for changed, s in (
        ({"stood": True}, cycle(sees(), battery=0.09)), ({}, cycle(sees(), battery=0.2)), ({}, cycle(battery=0.09)),
        ({}, cycle(sees(), battery=0.04)), ({}, cycle(sees())),
    ):  # fmt: skip
        assert of(Event.BATTERY_ENDS, memory(State.GAVE_UP, 9.0, **changed), s) is None
    for held in (State.PAUSED, State.ABORTED, State.READY):
        assert of(Event.BATTERY_ENDS, memory(held, 9.0), cycle(sees(), battery=0.09)) is None, "a person has it"


def test_late_answers_and_a_late_imu_end_every_try_whatever_the_battery() -> None:
    late = sees()
    late = replace(late, alerts=(IntegrityAlert.IMU_LATE,))
    for state in (*WAY, State.SEARCH, State.RENDEZVOUS):
        for s in (cycle(sees(), late_s=0.45, battery=0.05), cycle(late, battery=0.05)):
            assert of(Event.NO_CONDITIONS, memory(state), s) is not None
    for state in (State.COMMIT, State.PRESS, State.DOWN):
        assert of(Event.NO_CONDITIONS, memory(state), cycle(late, late_s=0.45)) is None, "the nearest way is down"


@pytest.mark.hazard("H12")
def test_a_lens_elsewhere_ends_every_try_unless_the_pad_is_the_nearest_way_down() -> None:
    off = replace(sees(), lens_off_m=(0.3, -0.1))
    for state in (*WAY, State.SEARCH, State.RENDEZVOUS):
        ended = of(Event.NO_CONDITIONS, memory(state), cycle(off))
        assert "the lens is 32 cm from where the camera's file has it: +0.30 m forward, -0.10 m right" in ended.text
    for state in WAY:
        assert of(Event.NO_CONDITIONS, memory(state), cycle(off, battery=0.05)) is None
    high = replace(off, d_body_pad_level=np.array([0.0, 0.0, 1.0]))
    assert of(Event.LIMIT, memory(State.COMMIT), cycle(high)) is not None


@pytest.mark.parametrize(
    ("changed", "event"),
    [
        ({}, Event.CLEAR),
        ({"refusing": True}, Event.NO_CONDITIONS),
        ({"go_arounds": 9}, Event.NO_CONDITIONS),
        ({"go_arounds": 9, "fault": WHY}, Event.HOPELESS),
        ({"landing_began": ns(NOW - 1e4), "fault": WHY}, Event.HOPELESS),
        ({"seen_height_m": 1.0, "go_arounds": 9, "refusing": True}, None),
    ],
)
def test_a_go_around_ends_the_tries_once_it_is_high_enough(changed: dict[str, Any], event: Event | None) -> None:
    gust = Reason(ReasonCause.WIND, 16.0, 15.0)
    found = first(memory(State.GO_AROUND, **{"seen_height_m": 2.0, "fault": gust, "go_arounds": 1, **changed}), cycle(sees()))
    assert (None if found is None else found[0]) is event


@pytest.mark.parametrize("state", WAY)
def test_what_ends_an_attempt_ends_it_in_every_state_of_its_way(state: State) -> None:
    """A turn of the arrow ends it only where the nose follows the arrow."""
    align, fit = guided(tries={"heading": "align"}), cycle(sees((0.0, 0.0, 0.3)))
    turned = Reason(ReasonCause.HEADING_TURNED, 120.0, 90.0)
    assert of(Event.LIMIT, memory(state, turned=turned), fit, align) == turned
    assert of(Event.LIMIT, memory(state, turned=turned), fit) is None
    assert of(Event.LIMIT, memory(state), replace(fit, off_orders=WHY)) == WHY
    things = of(Event.LIMIT, memory(state), replace(fit, thing=WHY))
    assert (things == WHY) is (state in (State.DESCEND, State.GATE)), "over the pad it waits until the thing is gone"


# The attempt's budget, and the sight of the pad


def test_an_attempt_inherits_the_time_without_sight_and_unbroken_sight_gives_it_back() -> None:
    one = Attempt().seen(ns(3), 0.1).unseen(0.75).lost().descended(0.25).descended(-1.0)
    assert (one.losses, one.blind_descent_m, one.again()) == (1, 0.25, Attempt(without_sight_s=0.75))
    for k in range(5):
        assert one.without_sight_s == 0.75
        one = one.seen(ns(10 + k), 1.0)
    assert one.without_sight_s == 0.0


@pytest.mark.parametrize(
    ("used", "cause"),
    [
        (Attempt(losses=TRIES.losses_max).lost(), ReasonCause.LOSSES),
        (Attempt().cycle(1.0).cycle(1.5), ReasonCause.STARVED),
        (Attempt(blind_descent_m=TRIES.blind_descent_max_m).descended(0.25), ReasonCause.BLIND_DESCENT),
    ],
)
def test_a_budget_is_used_up_beyond_its_limit(used: Attempt, cause: ReasonCause) -> None:
    found = used.used_up(TRIES, ns(NOW))
    assert found.cause is cause
    assert Attempt(losses=TRIES.losses_max, blind_descent_m=TRIES.blind_descent_max_m).used_up(TRIES, ns(NOW)) is None


def test_more_than_a_quarter_turn_within_a_cycle_is_a_reason_across_the_half_turn_too() -> None:
    for last_deg, yaw_deg, turns in (
        (0, 91, True), (0, -91, True), (135, -120, True), (-60, 120, True), (0, 89, False), (170, -170, False),
        (-135, 140, False),
    ):  # fmt: skip
        assert (arrow_turned(math.radians(last_deg), sees(yaw=math.radians(yaw_deg))) is not None) is turns
    assert arrow_turned(None, sees(yaw=3.0)) is arrow_turned(1.0, sees(yaw=None)) is None


def test_a_loss_of_sight_low_down_counts_and_height_lost_without_it_too() -> None:
    for state, height_m, losses in ((State.DESCEND, 1.0, 1), (State.DESCEND, 2.0, 0), (State.COMMIT, 0.2, 0)):
        assert account(memory(state, seen_height_m=height_m), cycle(), OPTIONS).attempt.losses == losses
    for state, lost_m in ((State.HOLD_BLIND, 0.25), (State.GO_AROUND, 0.0)):
        found = account(memory(state, in_sight=False, seen_height_m=1.25), cycle(sees()), OPTIONS)
        assert (found.attempt.blind_descent_m, found.in_sight, found.seen_height_m) == (lost_m, True, 1.0)


def test_a_sweep_near_the_deck_counts_by_the_height_of_the_feet() -> None:
    feet_m = OPTIONS.cone.feet_below_m
    for height_m, sweeps in ((NEAR_DECK_M + feet_m - 0.01, 1), (NEAR_DECK_M + feet_m + 0.01, 0)):
        p = account(memory(State.DESCEND), cycle(sees((0, 0, height_m))), OPTIONS)
        p = entered(p, StateChange(ns(NOW), State.DESCEND, Event.OUT_OF_CONE, State.GO_AROUND, WHY))
        assert (p.sweeps, p.attempt.sweeps) == (sweeps, sweeps)


# What a state remembers


@pytest.mark.parametrize("kept", [Gate(ns(99.0)), Commit(ns(99.0)), Search(leg=3), OtherPad(5)])
def test_a_state_begins_with_nothing_of_the_state_before(kept: Any) -> None:
    p = memory(State.DESCEND, kept=kept, held=np.ones(3), held_yaw_rad=0.3, go_arounds=2)
    p = entered(p, StateChange(ns(NOW), State.DESCEND, Event.AT_GATE, State.GATE, WHY))
    assert (p.kept, p.held, p.held_yaw_rad, p.since, p.reason, p.go_arounds) == (None, None, None, ns(NOW), WHY, 2)


def after(state: State, event: Event, target: State, why: Reason = WHY, **more: Any) -> Progress:
    used = {"go_arounds": 2, "questions": 1, "landing_began": ns(2), "attempt": Attempt(losses=2, without_sight_s=3.0)}
    return entered(memory(state, **{**used, **more}), StateChange(ns(NOW), state, event, target, why))


def test_an_order_gives_the_tries_back_and_what_begins_by_itself_does_not() -> None:
    for cause, kept in ((ReasonCause.AUTOMATIC, (2, 1, ns(2))), (ReasonCause.OPERATOR, (0, 0, None))):
        p = after(State.ANOTHER_PAD, Event.BEGIN, State.SEARCH, Reason(cause))
        assert (p.go_arounds, p.questions, p.landing_began) == kept
        assert (p.attempt, p.track, p.seen) == (Attempt(), None, None)
    p = after(State.LANDED, Event.TAKEN_OFF, State.READY, stood=True, refusing=True, ordered=True)
    assert (p.begun, p.stood, p.ordered, p.refusing, p.go_arounds) == (False, False, False, False, 0)


def test_conditions_that_refuse_are_remembered_through_the_go_around_and_a_limit_is_not() -> None:
    for event, refusing in ((Event.NO_CONDITIONS, True), (Event.LIMIT, False)):
        p = after(State.GATE, event, State.GO_AROUND)
        assert (p.refusing, p.go_arounds, p.fault) == (refusing, 3, WHY)
    p = after(State.GO_AROUND, Event.CLEAR, State.INTERCEPT, Reason(ReasonCause.HIGH_ENOUGH, 2.5))
    assert (p.seen_height_m, p.attempt) == (2.5, Attempt(without_sight_s=3.0))


def test_what_goes_for_the_deck_is_our_order_and_only_what_landed_stands() -> None:
    for state in (State.COMMIT, State.DOWN):
        assert after(State.GATE, Event.GATE_OPEN, state).ordered
    assert not after(State.DESCEND, Event.AT_GATE, State.GATE).ordered
    for state in ENDED:
        assert after(State.DOWN, Event.GROUNDED, state).stood is (state in (State.LANDED, State.LANDED_BY_OTHERS))


@pytest.mark.parametrize(
    ("height_m", "off_m", "sigma_m_s", "rate_m_s"),
    [(0.4, 0.0, 0.05, 0.4), (0.4, 0.0, None, 0.105), (0.4, 0.085, 0.05, 0.105), (0.2, 0.0, 0.05, -0.095), (2.0, 0.0, 0.05, 0.7),
     (0.4, 0.0, 0.2, 0.105)],
)  # fmt: skip
def test_a_gate_is_passed_that_is_surely_open(height_m: float, off_m: float, sigma_m_s: float | None, rate_m_s: float) -> None:
    ahead = forecast(np.full(len(HORIZONS_S), -0.3), NOW, sigma_m_s or 0.05)
    known = Knowledge(ns(NOW), sees((off_m, 0.0, height_m)), forecast=ahead, confirmed=sigma_m_s is not None)
    _, aim = PHASES[State.DESCEND].aim(memory(State.DESCEND), GuidanceCycle(ns(NOW), known), OPTIONS)
    assert aim.descent_rate_m_s == pytest.approx(rate_m_s)


def test_what_keeps_the_gate_shut_is_noted_and_the_operator_sees_one_cause_for_two_seconds() -> None:
    open_since = account(memory(State.GATE), cycle(sees((0.0, 0.0, 0.3))), OPTIONS)
    assert gate_of(open_since).good_since == ns(NOW)
    for relative, quality, cause in (
        (sees((0.3, 0.0, 0.3)), InputQuality(), ReasonCause.ERROR),
        (sees((0.0, 0.0, 0.3)), InputQuality(normalized_nis=9.0), ReasonCause.NIS),
        (None, InputQuality(), ReasonCause.NO_ESTIMATE),
    ):
        gate = gate_of(account(open_since, cycle(relative, quality=quality), OPTIONS))
        assert (gate.blocked.cause, gate.good_since, gate.waits_for) == (cause, None, gate.blocked)
    for stood_s, stands in ((1.9, True), (2.1, False)):
        old = Gate(waits_for=WHY, waits_since=ns(NOW - stood_s))
        gate = gate_of(account(memory(State.GATE, kept=old), cycle(sees((0.3, 0.0, 0.3))), OPTIONS))
        assert (gate.waits_for == WHY) is stands


def test_just_over_the_deck_the_contact_is_awaited_without_sight_for_a_moment() -> None:
    for height_m, awaited in ((0.1, True), (0.3, False)):
        p = account(memory(State.COMMIT), cycle(sees((0.0, 0.0, height_m))), OPTIONS)
        assert (of(Event.SIGHT_LOST, p, cycle()) is None) is awaited
        later = replace(cycle(), at=ns(NOW + CONE.no_return_s + 0.01))
        assert of(Event.SIGHT_LOST, p, later) is not None


@pytest.mark.parametrize(
    ("changed", "height_m", "held_s", "begins"),
    [
        ({}, 1.8, 5.0, True), ({}, 1.7, 5.0, False), ({}, 1.8, 4.9, False), ({"questions": 1}, 2.0, 5.0, True),
        ({"questions": 2}, 2.0, 5.0, False), ({"entered_height_m": 1.7}, 2.0, 5.0, False), ({}, 2.0, None, False),
    ],
)  # fmt: skip
def test_by_itself_it_begins_again_once_a_flight_from_above_and_after_a_steady_sight(changed, height_m, held_s, begins):
    kept = OtherPad(5, None if held_s is None else ns(NOW - held_s))
    p = memory(State.ANOTHER_PAD, **{"track": None, "kept": kept, "entered_height_m": 2.0, **changed})
    s, o = cycle(sees((0.0, 0.0, height_m), track=5)), guided(tries={"another_pad": "automatic"})
    assert (first(p, s, o) == (Event.BEGIN, Reason(ReasonCause.AUTOMATIC))) is begins
    assert first(p, s) is None, "the operator decides"
    assert first(account(p, cycle(sees((0.0, 0.0, height_m), track=6)), o), s, o) is None, "another track is another pad"
