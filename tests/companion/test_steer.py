"""Target in each state, for one guidance cycle."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.controller import Impact, Knowledge, Target
from companion.guidance.mission.hold_blind import keep_up
from companion.guidance.mission.machine import PHASES, TABLES, account, aim, allowed
from companion.guidance.mission.phase import Aim, never_lower, usable
from companion.guidance.mission.progress import GuidanceCycle, InputQuality, Progress, VehicleHold
from companion.guidance.mission.wind import WindOverDrone
from companion.settings.guidance import ClimbResponse, ElsewhereOptions, GuidanceOptions
from estimator.contracts.commands import Command, Hover, Land, Lean, Velocity
from estimator.contracts.estimates import IntegrityAlert, RelativeState
from estimator.contracts.geometry import F64, wrap_pi
from tests.companion.test_limits import leaning
from tests.companion.test_mission_flights import guided, holding
from tests.make import deck, estimate, ns, same_bits

NOW = 100.0
WAY_DOWN = (State.DESCEND, State.GATE, State.COMMIT, State.PRESS, State.DOWN)
ABOVE = (0.2, -0.1, 1.0)
LOW = {"seen": ns(NOW), "seen_height_m": 0.1}
"""Memory of a sight of the deck just below the feet."""


def known(d: tuple[float, float, float] = ABOVE, **fields: Any) -> Knowledge:
    return Knowledge(ns(NOW), estimate(NOW, d, **fields))


def asked(state: State, knowledge: Knowledge, o: GuidanceOptions | None = None, **memory: Any) -> tuple[Progress, Aim]:
    p = Progress(state, automatic=True, begun=True, stood=False, **memory)
    return aim(p, GuidanceCycle(knowledge.at, knowledge), o or guided())


def target(state: State, knowledge: Knowledge, o: GuidanceOptions | None = None, **memory: Any) -> Target:
    _, found = asked(state, knowledge, o, **memory)
    assert isinstance(found, Target)
    return found


def over_the_pad(d: F64, yaw_rad: float) -> tuple[float, float]:
    """Return the place of the body over the pad, m along and beside its arrow."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return -(c * d[0] - s * d[1]), -(s * d[0] + c * d[1])


def may_descend(age_s: float, o: GuidanceOptions) -> set[State]:
    """Return the states that allow a descent by a sighting of that age."""
    down, s = Lean(np.ones(2), np.zeros(2), np.array([0.0, 0.0, 0.5]), 0.0), GuidanceCycle(ns(NOW), known(age=age_s))
    given = {state: allowed(down, Progress(state, automatic=True, begun=True, in_sight=True), s, o) for state in State}
    return {state for state, command in given.items() if isinstance(command, Lean) and command.v_level[2] > 0.0}


def test_what_may_descend_is_named_and_nothing_else_does_however_good_the_sight() -> None:
    assert may_descend(0.0, guided()) == {State.STAY, State.LAND_HERE, *WAY_DOWN}
    assert may_descend(9.0, guided()) == {State.PRESS, State.DOWN, State.LAND_HERE}


@pytest.mark.parametrize(
    ("age_s", "nis", "follows"),
    [(0.0, None, True), (0.29, 4.0, True), (0.31, None, False), (0.0, 4.1, False), (0.0, math.nan, False)],
)
def test_at_the_gate_no_deck_is_followed_down_by_sightings_that_would_keep_the_gate_shut(age_s, nis, follows):
    falls = deck(NOW, (0.0, 0.0, 0.4), var=1e-6)
    s = GuidanceCycle(ns(NOW), replace(known(age=age_s), deck=falls), quality=InputQuality(nis))
    down, up = (Lean(np.ones(2), np.zeros(2), np.array([0.0, 0.0, v]), 0.0) for v in (0.7, -0.7))
    for state, rate in ((State.GATE, 0.7 if follows else 0.0), (State.DESCEND, 0.7), (State.INTERCEPT, 0.4 if follows else 0.0)):
        p = Progress(state, automatic=True, begun=True, in_sight=True)
        given = allowed(down, p, s, guided())
        assert isinstance(given, Lean)
        assert given.v_level[2] == pytest.approx(rate, abs=0.01)
        assert allowed(up, p, s, guided()) is up


def test_a_commit_without_sight_waits_as_high_as_it_is() -> None:
    found = target(State.COMMIT, known(age=9.0))
    assert (found.descent_rate_m_s, found.d_body_pad_level.tolist()) == (None, list(ABOVE))
    assert target(State.COMMIT, known()).descent_rate_m_s == guided().cone.commit_rate_m_s


def test_pressing_tilts_nowhere_and_stays_where_it_touched() -> None:
    found = target(State.PRESS, known())
    assert (found.lean_max_rad, found.descent_rate_m_s) == (0.0, guided().cone.commit_rate_m_s)
    assert found.d_body_pad_level.tolist() == list(ABOVE)
    assert asked(State.DOWN, known((0.0, 0.0, 0.1)), guided(), **LOW)[1] == Land(on_deck=True)
    p = Progress(State.PRESS, automatic=True, begun=True)
    wrong = known(consistent=False)
    assert wrong.relative is not None
    doubted = replace(wrong, relative=replace(wrong.relative, alerts=(IntegrityAlert.DECK,)))
    for relative, silent_s, age_s, lands in (
        (known(), 0.15, 0.15, False), (known(), 0.16, 0.16, True), (known(), 0.0, 0.16, True), (wrong, 0.0, 0.0, False),
        (doubted, 0.0, 0.0, True),
    ):  # fmt: skip
        pressed = aim(p, GuidanceCycle(ns(NOW), relative, silent_s=silent_s, age_s=age_s), guided())[1]
        assert (pressed == Land(on_deck=False)) is lands, "held by its own hover it would stay behind a deck that falls"
    for falls_m_s, age_s, lands in ((0.29, 0.16, True), (0.31, 0.16, False), (0.31, 0.0, False)):
        falls = deck(NOW, (0.0, 0.0, falls_m_s))
        s = GuidanceCycle(ns(NOW), replace(known(), deck=falls), age_s=age_s)
        pressed = aim(p, s, guided())[1]
        assert isinstance(pressed, Land) is lands, "its own landing would be dragged along"


@pytest.mark.parametrize(
    ("heading", "sigma", "yaw_rad"), [("align", 0.01, 0.0), ("align", 0.5, None), ("keep", 0.01, None), ("across", 0.01, None)]
)
def test_the_nose_turns_to_the_arrow_where_set_so_and_the_arrow_is_known(heading, sigma, yaw_rad):
    for state in (State.INTERCEPT, State.DESCEND, State.GATE, State.COMMIT):
        found = asked(state, known(yaw=0.7, sigma=sigma), guided(tries={"heading": heading}))[1]
        assert found.yaw_rad == yaw_rad


@pytest.mark.parametrize(
    ("height_m", "entered_m", "error_m", "wanted_m"),
    [(0.5, 0.5, 0.33, 1.5), (0.5, 0.5, 5.0, 2.0), (3.0, 2.5, 0.1, 2.5), (2.5, 3.0, 0.1, 2.5), (0.1, 0.1, 0.0, 0.295)],
)
def test_it_comes_over_the_pad_so_high_that_the_cone_is_as_wide_as_the_error(height_m, entered_m, error_m, wanted_m):
    found = target(State.INTERCEPT, known((0.0, error_m, height_m)), entered_height_m=entered_m)
    np.testing.assert_allclose(found.d_body_pad_level, [0.0, 0.0, wanted_m])


@pytest.mark.parametrize("yaw", [0.0, 0.4, -2.5])
@pytest.mark.parametrize(("height_m", "aside_m"), [(4.0, 0.3), (0.5, 0.075), (0.35, 0.0525)])
def test_a_go_around_climbs_on_the_clear_side_whatever_the_heading(yaw: float, height_m: float, aside_m: float) -> None:
    found = target(State.GO_AROUND, known((0.1, 0.1, height_m), yaw=yaw), guided(tries={"clear_side_deg": 110.0}))
    assert (found.descent_rate_m_s, found.d_body_pad_level[2]) == (-0.5, 2.0)
    along, beside = over_the_pad(found.d_body_pad_level, yaw)
    assert math.hypot(along, beside) == pytest.approx(aside_m)
    if aside_m > 0.0:
        assert math.degrees(math.atan2(beside, along)) == pytest.approx(110.0)


@pytest.mark.parametrize("seen_m", [1.0, 2.4, 7.0])
def test_a_blind_hold_over_waves_ends_at_the_crest_s_height_and_climbs_no_step_with_each_wave(seen_m: float) -> None:
    o, p, climbed_m = guided(), Progress(State.HOLD_BLIND, automatic=True, begun=True, seen=ns(NOW), seen_height_m=seen_m), 0.0
    for i in range(2000):
        at, up_m_s = NOW + 0.02 * i, 0.8 * math.cos(0.02 * i * math.tau / 8.0)
        s = GuidanceCycle(ns(at), Knowledge(ns(at), None, deck=deck(at, (0.0, 0.0, -up_m_s))))
        p, found = aim(account(p, s, o), s, o)
        climbed_m -= 0.02 * float(found.v_level[2]) if isinstance(found, Velocity) else 0.0
    crest_m = 0.8 * 8.0 / math.tau
    assert climbed_m == pytest.approx(max(0.0, crest_m + o.tries.safe_height_m - seen_m), abs=0.05), "five crests are one"


@pytest.mark.parametrize("state", [State.GO_AROUND, State.PAUSED])
def test_a_pad_that_was_not_agreed_on_and_an_estimate_too_vague_are_not_flown_by(state: State) -> None:
    for knowledge in (known(track=2), known(sigma=3.0), known(consistent=False)):
        p, found = asked(state, knowledge, track=1, held=np.zeros(3))
        if state is State.PAUSED:
            assert (found, p.held) == (Hover(), None)
        else:
            assert isinstance(found, Velocity)
            assert found.v_level.tolist() == [0.0, 0.0, -0.5]
    assert isinstance(asked(state, known(track=1), track=1)[1], Target)


def test_what_is_held_keeps_its_place_over_the_deck_while_the_body_turns() -> None:
    p, _ = asked(State.PAUSED, known(yaw=0.3))
    held = over_the_pad(np.array(ABOVE), 0.3)
    for yaw in (1.1, 2.9, -2.8):
        p, found = asked(State.PAUSED, known((0.5, 0.5, 0.9), yaw=yaw), held=p.held, held_yaw_rad=p.held_yaw_rad)
        assert over_the_pad(found.d_body_pad_level, yaw) == pytest.approx(held)
        assert found.d_body_pad_level[2] == 1.0, "and never lower"
        assert (found.descent_rate_m_s, found.speed_max_m_s) == (None, 0.5)
        assert wrap_pi(yaw - 0.3) != 0.0
    _, found = asked(State.PAUSED, known((0.5, 0.5, 1.4), yaw=None), held=np.array(ABOVE), held_yaw_rad=0.3)
    assert found.d_body_pad_level.tolist() == [*ABOVE[:2], 1.4]


@pytest.mark.parametrize(
    ("state", "age_s"), [(State.INTERCEPT, 0.1), (State.HOLD_BLIND, 4.0), (State.REFUSED, 0.1), (State.ABORTED, 2.0)]
)
def test_waves_lift_no_vehicle_that_waits_high_up(state: State, age_s: float) -> None:
    """The deck heaves by 1 m in 8 s, and the law follows it: seeds 7601 and 7617 of weather_4 went up by 3 m."""
    p, altitude_m = Progress(state, automatic=True, begun=True, stood=False, entered_height_m=7.0), 7.0
    for k in range(1200):
        t = 0.05 * k
        deck_m, down_m_s = math.sin(0.785 * t), -0.785 * math.cos(0.785 * t)
        moves = deck(t, (0.0, 0.0, down_m_s))
        knows = Knowledge(ns(t), estimate(t, (0.0, 0.0, altitude_m - deck_m), age=age_s, sigma=0.1), deck=moves)
        p, _ = aim(p, GuidanceCycle(ns(t), knows), guided())
        law = Lean(np.zeros(2), np.zeros(2), np.array([0.0, 0.0, down_m_s]), 0.0)
        found = allowed(law, p, GuidanceCycle(ns(t), knows), guided())
        assert isinstance(found, Lean)
        altitude_m -= 0.05 * found.v_level[2]
    assert altitude_m == pytest.approx(7.0, abs=0.2)


@pytest.mark.parametrize(("sigma_m_s", "loses_m_s"), [(0.0, 0.1), (0.2, 0.15), (0.4, 0.2)])
def test_commands_that_arrive_changed_hardly_sink_a_drone_that_holds_without_sight(sigma_m_s: float, loses_m_s: float) -> None:
    """The drone sinks by 0.2 m/s more than it is ordered, and answers 0.6 s late: it loses half of that, if that is sure."""
    p, sinks_m_s = Progress(State.HOLD_BLIND, automatic=True, begun=True, stood=False), [0.2] * 12
    moves = deck(NOW, var=sigma_m_s**2)
    law = Lean(np.zeros(2), np.zeros(2), np.zeros(3), 0.0)
    for _ in range(400):
        knows = replace(known((0.0, 0.0, 5.0), v=(0.0, 0.0, -sinks_m_s[-1]), age=4.0), deck=moves)
        p, _ = aim(p, GuidanceCycle(ns(NOW), knows), guided())
        flown = keep_up(law, p, GuidanceCycle(ns(NOW), knows), guided())
        assert isinstance(flown, Lean)
        sinks_m_s.append(0.2 + flown.v_level.item(2) if len(sinks_m_s) % 12 == 0 else sinks_m_s[-1])
    assert np.mean(sinks_m_s[-24:]) == pytest.approx(loses_m_s, abs=0.02)
    fresh = replace(known((0.0, 0.0, 5.0), v=(0.0, 0.0, -0.2)), deck=moves)
    assert keep_up(law, p, GuidanceCycle(ns(NOW), fresh), guided()) is law
    refused = replace(known((0.0, 0.0, 5.0), v=(0.0, 0.0, -0.2), age=4.0), deck=moves, trusts_velocity=False)
    assert keep_up(law, p, GuidanceCycle(ns(NOW), refused), guided()) is law, "its own hover keeps its height"


@pytest.mark.parametrize(("ago_s", "over"), [(9.9, True), (10.0, True), (10.1, False), (None, False)])
def test_a_pad_lost_lately_is_flown_over_by_dead_reckoning(ago_s: float | None, over: bool) -> None:
    found = target(State.HOLD_BLIND, known(), seen=None if ago_s is None else ns(NOW - ago_s))
    assert found.d_body_pad_level.tolist() == ([0.0, 0.0, 1.0] if over else list(ABOVE))
    assert found.speed_max_m_s == (1.5 if over else 0.5)


def test_a_go_around_first_lifts_where_it_is_at_the_fastest_rate() -> None:
    """Feet that are dragged along the deck turn a vehicle over, so it moves aside from 0.3 m on."""
    for height_m, rate, here in ((0.34, -1.0, True), (0.35, -0.5, False)):
        fast = replace(known((0.1, 0.2, height_m)), climb_max_m_s=1.0)
        found = target(State.GO_AROUND, fast)
        assert found.descent_rate_m_s == rate
        assert (found.d_body_pad_level.tolist()[:2] == [0.1, 0.2]) is here
    blind = replace(known((0.1, 0.2, 0.1), consistent=False), climb_max_m_s=1.0)
    for climbed_m, rate in ((0.0, -1.0), (0.2, -1.0), (0.3, -0.5)):
        for unknown in (blind, replace(known((0.1, 0.2, 0.1), age=1.51), climb_max_m_s=1.0)):
            _, up = asked(State.GO_AROUND, unknown, seen_height_m=0.1, climbed_m=climbed_m)
            assert isinstance(up, Velocity)
            assert up.v_level[2] == rate


@pytest.mark.parametrize(("lean_deg", "height_m", "most_deg"), [(12.0, 0.12, 12.0), (2.0, 0.12, 5.0), (12.0, 0.19, None)])
def test_feet_near_the_deck_are_not_lowered_by_a_further_lean(lean_deg: float, height_m: float, most_deg: float | None) -> None:
    """WHY: in weather_4 drones that went around braked with 13 degrees more at once, and a foot that it lowered met the pad."""
    leans = replace(known((0.1, 0.2, height_m)), body=leaning(lean_deg))
    found = target(State.GO_AROUND, leans).lean_max_rad
    assert found == (None if most_deg is None else pytest.approx(math.radians(most_deg)))


def test_motors_stop_by_force_only_on_a_deck_that_was_felt_and_that_another_witness_finds() -> None:
    high, low = known((0.0, 0.0, 0.6)), known((0.0, 0.0, 0.05))
    struck = Impact(ns(NOW), "accelerometer", 9.0)

    def stops(knowledge: Knowledge, range_m: float | None = None, **memory: Any) -> bool:
        p = Progress(State.DOWN, automatic=True, begun=True, stood=False, **{**LOW, **memory})
        land = aim(p, GuidanceCycle(ns(NOW), knowledge, range_m=range_m), guided())[1]
        return land.on_deck

    assert stops(low)
    assert not stops(low, reckoned=ns(NOW - 0.1))
    assert stops(replace(low, impact=struck), reckoned=ns(NOW - 0.1))
    for bounces in (0, 2):
        assert not stops(high, bounces=bounces, track=1), "it lands by the vehicle's own landing"
        assert stops(low, bounces=bounces, track=1)
    blind = replace(known(age=9.0), impact=struck)
    for seen_m, ago_s, range_m, found in (
        (0.16, 0.0, None, True), (0.17, 0.0, None, False), (0.6, 1.0, None, False), (0.6, 1.2, None, True),
        (2.0, 60.0, None, False), (2.0, 60.0, 0.16, True), (2.0, 60.0, 0.17, False),
    ):  # fmt: skip
        assert stops(blind, range_m, seen=ns(NOW - ago_s), seen_height_m=seen_m) is found
    assert not stops(blind, seen=None), "a jolt alone stops no motor"


@pytest.mark.parametrize("yaw_rad", [-0.3, 0.05, None])
def test_an_autopilot_stands_level_on_a_deck_that_is_felt_with_its_weight_on_and_turns_back(yaw_rad: float | None) -> None:
    """WHY: leaning on one foot the wind turned it by 10 to 38 degrees, while its rotors carried the weight."""
    gust, o = WindOverDrone(9.0, 1.0, 12.0, (0.0, 1.0), 0.3, False, 0.4, push_rad=0.2), guided()
    o = replace(o, tries=replace(o.tries, heading="align"))
    struck = replace(known((0.0, 0.0, 0.05), yaw=yaw_rad), impact=Impact(ns(NOW), "accelerometer", 9.0))
    p = Progress(State.PRESS, automatic=True, begun=True, stood=False, since=ns(NOW - 0.1), **LOW)
    s = GuidanceCycle(ns(NOW), struck, wind=gust, hold=VehicleHold(over_ground=True))
    reckoned, drone = replace(p, reckoned=ns(NOW + 0.1)), replace(s, hold=VehicleHold(over_ground=False))
    for memory, cycle, felt in ((p, s, True), (reckoned, s, False), (p, drone, False)):
        found = aim(memory, cycle, o)[1]
        assert (found.lean_max_rad == 0.0) is felt
        assert (found.descent_rate_m_s or 0.0) > 2.0 * o.cone.commit_rate_m_s or not felt
        flown = allowed(Lean(np.zeros(2), np.zeros(2), np.array([0.0, 0.0, 0.4]), 0.02), memory, cycle, o)
        assert (flown.on_deck_turn_rad is not None) is felt
        if not felt or yaw_rad is None:
            assert flown.yaw_rate_rad_s in (0.02, 0.0)
        else:
            assert flown.yaw_rate_rad_s * yaw_rad < 0.0, "back to the arrow"
            assert flown.on_deck_turn_rad == pytest.approx(-yaw_rad, abs=0.06)
            assert 0.2 < abs(flown.yaw_rate_rad_s) < 2.0


@given(
    state=st.sampled_from([State.PRESS, State.DOWN]), feet_m=st.floats(-0.1, 0.6), seen_ago_s=st.floats(0.0, 3.0),
    impact_ago_s=st.none() | st.floats(0.0, 2.0), reckoned=st.booleans(), alerts=st.booleans(), blind=st.booleans(),
    age_s=st.floats(0.0, 0.4), range_m=st.none() | st.floats(0.05, 0.6),
)  # fmt: skip
def test_an_autopilot_is_left_to_its_own_landing_by_no_contact_but_pressed_on_with_the_deck_until_it_feels_it(
    state, feet_m, seen_ago_s, impact_ago_s, reckoned, alerts, blind, age_s, range_m
):
    """WHY: a contact that was reckoned ended in LAND, which holds over the ground: the deck slid on, 29 to 38 cm."""
    o = guided()
    doubts: dict[str, Any] = {"consistent": False, "alerts": (IntegrityAlert.DECK,)} if alerts else {}
    impact = None if impact_ago_s is None else Impact(ns(NOW - impact_ago_s), "accelerometer", 9.0)
    seen = replace(known((0.0, 0.0, o.cone.feet_below_m + feet_m), **doubts), impact=impact)
    seen = replace(seen, relative=None) if blind else seen
    p = Progress(
        state, automatic=True, begun=True, stood=False, since=ns(NOW - 1.0), track=1, seen=ns(NOW - seen_ago_s),
        seen_height_m=o.cone.feet_below_m + feet_m, reckoned=ns(NOW - 1.0) if reckoned else None,
    )  # fmt: skip
    s = GuidanceCycle(ns(NOW), seen, age_s=age_s, range_m=range_m, hold=VehicleHold(over_ground=True))
    found = aim(p, s, o)[1]
    assert found == Land(on_deck=True) or isinstance(found, Target | Velocity)
    if isinstance(found, Velocity):
        assert found.v_level.tolist() == [0.0, 0.0, o.cone.commit_rate_m_s], "its driver adds the deck's own"
    own = aim(p, replace(s, hold=VehicleHold(over_ground=False)), o)[1]
    assert (own == Land(on_deck=True)) is (found == Land(on_deck=True)), "the motors stop by one rule"
    presses = PHASES[State.PRESS].events(replace(p, state=State.PRESS), s, o)
    if Event.PRESSED in [event for event, _ in presses]:
        assert aim(replace(p, state=State.DOWN), s, o)[1] == Land(on_deck=True), "else it goes around in time"


def test_in_wind_the_nose_turns_across_it_and_a_lost_pad_is_looked_for_upwind_and_to_lee() -> None:
    o, strong = guided(), WindOverDrone(9.0, 1.0, 12.0, (0.0, 1.0), 0.3, False, 0.4)
    for wind, turn in ((strong, 0.1 + 0.4), (strong._replace(lean_rad=0.05), None)):
        found = aim(Progress(State.DESCEND, automatic=True, begun=True), GuidanceCycle(ns(NOW), known(yaw=0.1), wind=wind), o)[1]
        assert found.yaw_rad == (None if turn is None else pytest.approx(turn))
    for push_rad, lean in ((0.05, 0.0), (0.2, None)):
        gust = strong._replace(lean_rad=0.05, push_rad=push_rad)
        found = aim(Progress(State.PRESS, automatic=True, begun=True), GuidanceCycle(ns(NOW), known(), wind=gust), o)[1]
        assert found.lean_max_rad == lean, "level, a gust would drag it over the deck"
    place, found_at = np.zeros(2), []
    for since_s in range(1, 1401):
        p = Progress(State.SEARCH, automatic=True, begun=True, since=ns(NOW - since_s), climbed_m=2.0)
        found = aim(p, GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None), wind=strong), o)[1]
        assert isinstance(found, Velocity)
        assert math.hypot(*found.v_level[:2]) < 0.5
        assert found.v_level[2] == 0.0
        assert found.yaw_rate_rad_s == pytest.approx(0.32)
        place = place + found.v_level[:2]
        found_at.append(place)
    flown = np.array(found_at)
    for upwind_m, aside_m in ((12.0, 0.0), (6.0, 2.0), (6.0, -2.0), (1.0, 2.0), (1.0, -2.0)):
        off_m = np.hypot(flown[:, 1] - upwind_m, flown[:, 0] - aside_m)
        assert off_m.min() < 2.0, "seen from 5 m by a camera of 64 degrees"
    assert np.abs(flown).max() < 15.0
    for seen_m, searches in ((2.0, True), (1.99, False)):
        p = Progress(State.HOLD_BLIND, automatic=True, begun=True, since=ns(NOW - 1.0), seen=ns(NOW - 1.0), seen_height_m=seen_m)
        found = aim(p, GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None), wind=strong), o)[1]
        assert (isinstance(found, Velocity) and bool(found.v_level[1])) is searches, (
            "low, feet would drag over a deck that comes up"
        )


@pytest.mark.parametrize("state", [State.REFUSED, State.GAVE_UP, State.PAUSED, State.ABORTED])
@pytest.mark.parametrize("how", ["higher", "lower"])
def test_a_drone_that_flies_otherwise_than_ordered_goes_out_of_reach_as_far_as_it_may_and_hovers_by_itself(state, how):
    """WHY: its own hover holds over the ground; 1.8 m over a deck in waves the deck came up to it."""
    off, safe_m = Reason(ReasonCause.OFF_ORDERS, 1.3, 1.2, how), guided().tries.safe_height_m
    for height_m, age_s, spent_s, climbed_m, climbs in (
        (safe_m - 0.26, 0.1, 7.9, 0.0, True), (safe_m - 0.26, 0.1, 8.1, 0.0, False), (safe_m - 0.24, 0.1, 1.0, 0.0, False),
        (1.0, 9.0, 1.0, 0.0, True), (1.0, 9.0, 30.0, 2.0 * safe_m, False),
    ):  # fmt: skip
        p = Progress(
            state, automatic=True, begun=True, stood=False, since=ns(NOW - spent_s), seen_height_m=1.0, climbed_m=climbed_m
        )
        _, found = aim(p, GuidanceCycle(ns(NOW), known((0.0, 0.0, height_m), age=age_s), off_orders=off), guided())
        assert isinstance(found, Velocity) is climbs
        assert climbs or found == Hover()


def test_a_refused_drone_goes_out_of_reach_and_then_holds_or_returns() -> None:
    there = ElsewhereOptions(63.4, 10.4, 20.0)
    blind = holding(GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None)), True)
    stays = Velocity(np.zeros(3), 0.0)
    after = {"hold": stays, "return": Hover(returns=True), "land elsewhere": Hover(elsewhere=there.landing_place)}
    with pytest.raises(ValueError, match="needs a place"):
        GuidanceOptions(refused="land elsewhere")
    p = Progress(State.REFUSED, automatic=True, begun=True, stood=False)
    for refused, ends in after.items():
        o = replace(guided(), refused=refused, elsewhere=there)
        low, high = (aim(replace(p, climbed_m=climbed_m), blind, o)[1] for climbed_m in (1.9, 2.0))
        assert isinstance(low, Velocity)
        assert low.v_level.tolist() == [0.0, 0.0, -o.tries.climb_m_s]
        assert same_bits(high, ends) or (isinstance(high, Velocity) and not high.v_level.any() and refused == "hold")
    for seen_m, silent, needs_m in ((1.5, False, 2.5), (3.0, False, 1.0), (8.0, False, 0.0), (8.0, True, 2.0)):
        for climbed_m in (0.0, 0.9, 1.1, 1.9, 2.1, 2.6):
            known_high = replace(p, seen_height_m=seen_m, silent_m=0.0 if silent else None, climbed_m=climbed_m)
            found = aim(known_high, blind, guided())[1]
            assert isinstance(found, Velocity)
            assert bool(found.v_level[2] < 0.0) is (climbed_m < needs_m), "it is high enough where it was seen high up"
            assert aim(replace(known_high, stood=True), blind, guided())[1] == Hover(), "what stands since is not taken off"
    found = target(State.REFUSED, replace(known(), outrun_m=0.7))
    assert found.d_body_pad_level[2] == pytest.approx(guided().tries.safe_height_m + 0.7)


@pytest.mark.parametrize("state", [State.GATE, State.HOLD_BLIND, State.GO_AROUND, State.INTERCEPT, State.DESCEND])
def test_a_soft_contact_near_the_centre_is_the_landing_in_every_state_of_the_way(state: State) -> None:
    """WHY: gusts opened and shut the gate several times a second, and it left the pad again after ten touches (894251)."""
    p = Progress(state, automatic=True, begun=True, since=ns(NOW - 1.0), seen=ns(NOW), in_sight=True, track=1)
    for aside_m, height_m, sigma_m, bounces, taken in (
        (0.1, 0.05, 0.01, 3, True), (0.5, 0.05, 0.01, 0, False), (0.1, 0.3, 0.01, 0, False), (0.1, 0.05, 0.2, 0, False),
        (0.1, 0.05, 0.01, 4, False),
    ):  # fmt: skip
        p = replace(p, bounces=bounces)
        knows = replace(known((aside_m, 0.0, height_m), sigma=sigma_m), impact=Impact(ns(NOW - 0.01), "accelerometer", 6.0))
        happens = PHASES[p.state].events(p, GuidanceCycle(ns(NOW), knows), guided())
        found = [event for event, _ in happens if event is Event.CONTACT]
        assert bool(found) is taken
        assert not found or TABLES["cone"][state][Event.CONTACT] is State.PRESS


def test_a_climb_s_own_thrust_is_no_contact_and_whatever_else_is_felt_is_one() -> None:
    climb = ClimbResponse(0.1, 0.2, 1.0)
    for size_m_s2, by, response, taken in (
        (7.9, "accelerometer", climb, False), (8.1, "accelerometer", climb, True), (7.9, "velocity", climb, True),
        (7.9, "accelerometer", None, True),
    ):  # fmt: skip
        knows = replace(known((0.1, 0.0, 0.05)), impact=Impact(ns(NOW), by, size_m_s2, 0.5), climb=response, climb_max_m_s=1.0)
        p = Progress(State.GO_AROUND, automatic=True, begun=True, since=ns(NOW - 1.0), seen=ns(NOW), in_sight=True, track=1)
        happens = PHASES[p.state].events(p, GuidanceCycle(ns(NOW), knows), guided())
        assert any(event is Event.CONTACT for event, _ in happens) is taken


def test_a_held_drone_follows_its_deck_up_the_less_the_higher_it_is_over_what_it_needs() -> None:
    up, p = Lean(np.zeros(2), np.zeros(2), np.array([0.0, 0.0, -0.4]), 0.0), Progress(State.PAUSED, automatic=True, begun=True)
    for height_m, rate in ((2.0, -0.4), (2.5, -0.2), (3.0, 0.0)):
        s = GuidanceCycle(ns(NOW), known((0.0, 0.0, height_m)))
        given = allowed(up, replace(p, held=np.array([0.0, 0.0, 2.0])), s, guided())
        assert isinstance(given, Lean)
        assert given.v_level[2] == pytest.approx(rate)


# Flight without sight of the pad


def falling(down_m_s: float | None, sigma_m_s: float = 0.0, *, over_ground: bool = False) -> GuidanceCycle:
    var = (1.0, 1.0, sigma_m_s**2, 1.0, 1.0, 1.0)
    moves = None if down_m_s is None else deck(NOW, (3.0, 0.0, down_m_s), var=var)
    return GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None, deck=moves), hold=VehicleHold(over_ground))


def commands(down_m_s: float) -> tuple[Velocity, Lean]:
    v = np.array([0.4, -0.3, down_m_s])
    return Velocity(v, 0.1), Lean(np.ones(2), np.zeros(2), v, 0.1)


@pytest.mark.hazard("H1")
@pytest.mark.parametrize(
    ("deck_m_s", "fit", "over_ground", "velocity_m_s", "lean_m_s"),
    [
        (0.2, True, False, 0.2, 0.2), (0.2, True, True, 0.0, 0.2), (0.2, False, False, 0.0, 0.0),
        (0.9, True, False, 0.5, 0.5), (-0.3, True, False, 0.0, 0.0), (None, True, False, 0.0, 0.0),
    ],
)  # fmt: skip
def test_nothing_goes_down_but_with_a_deck_that_is_known_to_fall(deck_m_s, fit, over_ground, velocity_m_s, lean_m_s):
    s = falling(deck_m_s, over_ground=over_ground)
    for command, rate in zip(commands(0.5), (velocity_m_s, lean_m_s), strict=True):
        slower = never_lower(command, s, fit=fit)
        assert type(slower) is type(command)
        assert (slower.v_level.tolist(), slower.yaw_rate_rad_s) == ([0.4, -0.3, rate], 0.1)
    unsure = never_lower(commands(0.5)[1], falling(0.3, 0.1), fit=True)
    assert isinstance(unsure, Lean)
    assert unsure.v_level[2] == pytest.approx(0.1), "as far as it is certain"
    others: list[Command] = [*commands(-0.4), *commands(0.0), Hover(), Land(on_deck=True)]
    assert all(never_lower(each, s, fit=False) is each for each in others)


def allowed_in(state: State, command: Command, s: GuidanceCycle) -> Command:
    return allowed(command, Progress(state, automatic=True, begun=True), s, GuidanceOptions())


def test_a_climb_without_sight_and_a_press_have_their_least_rate() -> None:
    """WHY: an accelerometer that was wrong at the contact made the estimate sink into the deck, and the drone floated off."""
    o, s = GuidanceOptions(), falling(0.2)
    for asked_m_s in (0.4, 0.0, -0.2, -1.5):
        for command in commands(asked_m_s):
            climbs = allowed_in(State.GO_AROUND, command, s)
            assert isinstance(climbs, Velocity | Lean)
            assert climbs.v_level.tolist() == [0.4, -0.3, min(asked_m_s, -o.tries.climb_m_s)]
    for asked_m_s in (0.1, 1.0):
        pressed = allowed_in(State.PRESS, commands(asked_m_s)[1], s)
        assert isinstance(pressed, Lean)
        assert pressed.v_level[2] == pytest.approx(max(asked_m_s, o.cone.commit_rate_m_s + 0.2))
    for own in (Hover(), Land(on_deck=True)):
        assert allowed_in(State.GO_AROUND, own, s) is allowed_in(State.PRESS, own, s) is own


def is_usable(one: RelativeState | None, **tries: float) -> bool:
    found = usable(GuidanceCycle(ns(NOW), Knowledge(ns(NOW), one)), guided(tries=tries))
    assert found is None or found is one
    return found is not None


def test_an_estimate_carries_on_while_it_is_new_consistent_and_known_well_enough() -> None:
    for late_s, sigma_m, consistent, expected in (
        (0.0, 0.5, True, True), (0.5, 0.1, True, True), (-0.4, 0.1, True, True),
        (0.6, 0.1, True, False), (-0.6, 0.1, True, False), (0.0, 0.51, True, False), (0.0, 0.1, False, False),
    ):  # fmt: skip
        one = estimate(NOW + late_s, (0.0, 0.0, 1.0), sigma=sigma_m, consistent=consistent, age=9.0)
        assert is_usable(one, blind_sigma_m=0.5) is expected
    assert not is_usable(None)
    # WHY: a ship that turned hard made the last sightings disagree, and a drone that climbed blind did not find her again.
    for sigma_m, alerts, expected in ((2.4, (), True), (2.6, (), False), (0.1, (IntegrityAlert.DECK,), False)):
        swung = replace(estimate(NOW, (0.0, 0.0, 1.0), sigma=sigma_m, consistent=False), adrift=True, alerts=alerts)
        assert is_usable(swung, blind_sigma_m=0.5) is expected
