"""Low over the deck without sight: in every state it climbs, moves nowhere else, and not for ever.

The flight to the ship by her reports: to the hold-off point, over the pattern, never down, refused in time.
"""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.base.mission import CONTACT_INTENDED, ENDED, FLOWN, GROUND, Reason, ReasonCause, State, StateChange
from companion.guidance.controller import Impact, Knowledge, Target
from companion.guidance.mission import search
from companion.guidance.mission.machine import mission_step, take_status
from companion.guidance.mission.progress import GuidanceCycle, Progress, VehicleHold, VesselPosition
from companion.guidance.mission.wind import WindOverDrone
from companion.settings.guidance import GuidanceOptions
from companion.settings.vessel import RendezvousOptions
from estimator.contracts.commands import Hover, Velocity
from estimator.contracts.estimates import IntegrityAlert
from estimator.contracts.geometry import F64
from tests.companion.test_mission_flights import holding
from tests.make import deck, estimate, ns, status, vessel_position

NOW, DT = 100.0, 0.05
OPTIONS = GuidanceOptions()
SAFE_M = OPTIONS.tries.safe_height_m
WINDY = WindOverDrone(9.0, 1.0, 12.0, (0.6, 0.8), 0.3, False, 0.4)
BY_ITSELF = sorted(FLOWN - CONTACT_INTENDED | {State.REFUSED, State.GAVE_UP}, key=str)
HELD = [State.PAUSED, State.ABORTED]

heights = st.one_of(st.just(math.inf), st.floats(0.0, 6.0))
memories = st.fixed_dictionaries(
    {
        "seen_height_m": heights, "silent_m": st.one_of(st.none(), st.floats(0.0, 5.0)), "climbed_m": st.floats(0.0, 5.0),
        "deck_rise_m": st.floats(-2.0, 2.0), "in_sight": st.just(False),
        "seen": st.sampled_from([None, ns(NOW - 0.3)]), "go_arounds": st.integers(0, 2),
    }
)  # fmt: skip


def waiting(state: State, **memory: Any) -> Progress:
    return Progress(state, automatic=True, begun=True, stood=False, since=ns(NOW - 1.0), last=ns(NOW - DT), **memory)


@pytest.mark.hazard("H3")
@settings(max_examples=300)
@given(
    state=st.sampled_from(BY_ITSELF + HELD),
    memory=memories,
    range_m=st.one_of(st.none(), st.floats(0.02, 6.0)),
    rises_m_s=st.one_of(st.none(), st.floats(-1.0, 1.0)),
    ship=st.one_of(st.none(), st.builds(lambda h: vessel_position(NOW, height_m=h), st.one_of(st.none(), st.floats(-1.0, 9.0)))),
    over_ground=st.booleans(),
)
def test_no_order_moves_a_drone_along_a_deck_that_may_be_within_reach(state, memory, range_m, rises_m_s, ship, over_ground):
    moved = None if rises_m_s is None else deck(NOW, (0.5, 0.0, -rises_m_s))
    s = GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None, deck=moved), wind=WINDY, vessel=ship, range_m=range_m)
    p, found, _ = mission_step(waiting(state, **memory), holding(s, over_ground), OPTIONS)
    if p.state in GROUND or p.state in ENDED - {State.REFUSED, State.GAVE_UP, State.ABORTED}:
        return
    assert isinstance(found, Velocity | Hover)
    v = found.v_level if isinstance(found, Velocity) else np.zeros(3)
    assert v[2] <= 0.0, "without sight it never goes lower"
    from_m = 0.0 if math.isinf(memory["seen_height_m"]) or memory["silent_m"] is not None else memory["seen_height_m"]
    near = range_m is not None and range_m < SAFE_M - 0.25
    if near and memory["climbed_m"] + from_m < 2.0 * SAFE_M:
        assert v[2] <= -OPTIONS.tries.climb_m_s, "the range sensor finds the deck"
        assert v[:2].tolist() == [0.0, 0.0]
    if v[2] < 0.0 and not (p.state in (State.RENDEZVOUS, State.SEARCH) and ship is not None):
        assert v[:2].tolist() == [0.0, 0.0]


class Sea:
    """A drone that flies as it is ordered, with a lag, over a deck in a swell, and sees nothing."""

    reports_each_s = DT

    def __init__(
        self, state: State, height_m: float, *, ranged: float | bool | None, over_ground: bool = False, swell_m: float = 0.0
    ) -> None:
        self.p = waiting(state)
        self.o = replace(OPTIONS, tries=replace(OPTIONS.tries, search_s=3600.0, give_up_after_s=600.0, operator_wait_s=3600.0))
        self.height_m, self.v_up, self.t = height_m, 0.0, 0.0
        self.ranged, self.over_ground, self.swell_m = ranged, over_ground, swell_m
        self.low_moves, self.climbed_m = 0.0, 0.0

    def fly(self, seconds: float) -> "Sea":
        for _ in range(round(seconds / DT)):
            deck_up = self.swell_m * math.cos(math.tau * self.t / 9.0) * math.tau / 9.0
            read = self.height_m if self.ranged is True else self.ranged
            knowledge, silent_s = Knowledge(ns(NOW + self.t), None, climb_max_m_s=1.0), self.t % self.reports_each_s
            s = GuidanceCycle(ns(NOW + self.t), knowledge, wind=WINDY, range_m=read or None, silent_s=silent_s)
            self.p, found, _ = mission_step(self.p, holding(s, self.over_ground), self.o)
            v = found.v_level if isinstance(found, Velocity) else np.zeros(3)
            self.v_up += (-float(v[2]) - self.v_up) * DT / 0.4
            self.climbed_m += DT * self.v_up
            if self.height_m < 1.0:
                self.low_moves = max(self.low_moves, math.hypot(*v[:2]))
            self.height_m = max(0.0, self.height_m + DT * (self.v_up - deck_up))
            self.t += DT
        return self


@pytest.mark.parametrize(("over_ground", "ranged"), [(False, True), (True, True), (True, False)])
@pytest.mark.parametrize("state", BY_ITSELF)
def test_from_the_deck_it_comes_out_of_reach_in_every_state(state: State, ranged: bool, over_ground: bool) -> None:
    sea = Sea(state, 0.3, ranged=ranged, over_ground=over_ground).fly(9.0)
    assert sea.height_m > SAFE_M - 0.3
    assert sea.low_moves == 0.0
    flown = sea.fly(60.0)
    assert flown.climbed_m < 2.0 * SAFE_M + 0.5, "and stays there"


@pytest.mark.parametrize("reports_each_s", [1.0, 1e9])
def test_a_silent_vehicle_is_sent_out_of_reach_and_not_for_ever(reports_each_s: float) -> None:
    """WHY: one whose streams had ended, and whose HEARTBEAT came each second, was sent up by 6.6 m."""
    sea = Sea(State.SEARCH, 0.3, ranged=None, over_ground=True)
    sea.reports_each_s = reports_each_s
    assert SAFE_M - 0.3 < sea.fly(60.0).climbed_m < 2.0 * SAFE_M + 0.3
    sea.reports_each_s, before_m = DT, sea.climbed_m
    assert sea.fly(60.0).climbed_m - before_m > (SAFE_M - 0.3 if reports_each_s > 1.0 else -0.1), "it may have stayed below"


@pytest.mark.parametrize("state", [State.SEARCH, State.HOLD_BLIND, State.REFUSED, State.PAUSED])
def test_over_a_swell_a_range_sensor_keeps_it_clear_of_the_crests(state: State) -> None:
    sea = Sea(state, 0.5, ranged=True, swell_m=1.2).fly(12.0)
    lowest = min(sea.fly(DT).height_m for _ in range(1200))
    assert lowest > 1.0
    assert sea.low_moves == 0.0


@pytest.mark.parametrize("state", [State.SEARCH, State.REFUSED, State.PAUSED, State.RENDEZVOUS])
def test_a_range_sensor_that_lies_ends_neither_the_search_nor_the_hold(state: State) -> None:
    sea = Sea(state, 3.0, ranged=0.3).fly(60.0)
    assert sea.climbed_m == pytest.approx(2.0 * SAFE_M, abs=0.3)
    s = GuidanceCycle(ns(NOW + 60.0), Knowledge(ns(NOW + 60.0), None), wind=WINDY, range_m=0.3)
    found = mission_step(sea.p, s, sea.o)[1]
    assert (isinstance(found, Velocity) and bool(found.v_level[:2].any())) is (state is State.SEARCH), "it looks upwind"


@pytest.mark.parametrize("over_ground", [True, False])
def test_where_an_ultrasound_would_find_the_deck_its_silence_begins_the_search(over_ground: bool) -> None:
    s = GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None), wind=WINDY, hold=VehicleHold(over_ground))
    found = mission_step(waiting(State.SEARCH), s, OPTIONS)[1]
    assert (isinstance(found, Velocity) and bool(found.v_level[:2].any())) is not over_ground


@pytest.mark.parametrize(("ago_s", "doubtful", "climbs"), [(3.0, False, True), (3.0, True, False), (40.0, False, False)])
@pytest.mark.parametrize("state", [State.SEARCH, State.HOLD_BLIND])
def test_a_drone_that_is_given_back_where_it_has_felt_the_deck_climbs_at_once(state, ago_s, doubtful, climbs) -> None:
    """WHY: given back on the deck it hovered there for 3 s first, was dragged and leaned by 24 degrees (sea_state_4, 894501)."""
    felt = Impact(ns(NOW - ago_s), "accelerometer", 5.0, doubtful=doubtful)
    s = GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None, impact=felt, climb_max_m_s=1.0), hold=VehicleHold(True))
    found = mission_step(waiting(state), s, OPTIONS)[1]
    assert isinstance(found, Velocity)
    assert found.v_level.tolist() == [0.0, 0.0, -1.0 if climbs else 0.0 if state is State.SEARCH else -OPTIONS.tries.climb_m_s]


@pytest.mark.parametrize("state", [State.SEARCH, State.REFUSED, State.PAUSED])
def test_a_drone_that_is_given_back_low_climbs_by_the_height_that_is_reckoned(state: State) -> None:
    """WHY: given back on the deck without a range it stayed there for 4.5 s with turning motors (weather_3, 894245)."""
    for height_m, alerts, climbs in ((0.2, (), True), (0.2, (IntegrityAlert.UNFELT,), False), (SAFE_M * 2.1, (), False)):
        reckoned = replace(estimate(NOW, (0.0, 3.0, height_m), age=3.0), alerts=alerts)
        s = GuidanceCycle(ns(NOW), Knowledge(ns(NOW), reckoned, climb_max_m_s=1.0))
        found = mission_step(waiting(state), s, OPTIONS)[1]
        rate = found.descent_rate_m_s if isinstance(found, Target) else None
        up_m_s = -found.v_level.item(2) if isinstance(found, Velocity) else -(rate or 0.0)
        assert (up_m_s == 1.0) is (climbs and state is not State.PAUSED), "whom a person holds moves by a witness alone"


def test_a_nearer_range_is_believed_while_the_unseen_deck_is_thought_to_fall() -> None:
    """WHY: a filter that has just begun takes a deck for one that falls from its crest, and the deck came up."""
    for range_m, climbs in ((1.0, True), (None, False), (1.9, False)):
        s = GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None, deck=deck(NOW, (0.5, 0.0, 0.8))), range_m=range_m)
        found = mission_step(waiting(State.HOLD_BLIND, seen_height_m=2.5, deck_rise_m=-1.0), s, OPTIONS)[1]
        assert isinstance(found, Velocity) is climbs


@pytest.mark.parametrize("state", HELD)
def test_what_a_person_holds_moves_by_a_witness_alone(state: State) -> None:
    """A person who pauses it high up without a range sensor does not want to see it climb."""
    for memory, range_m, climbs in (
        ({}, None, False), ({}, 0.4, True), ({}, 3.0, False), ({"seen_height_m": 0.4}, None, True),
        ({"seen_height_m": 5.0}, 0.4, True),
    ):  # fmt: skip
        s = GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None), range_m=range_m)
        found = mission_step(waiting(state, **memory), s, OPTIONS)[1]
        assert isinstance(found, Velocity) is climbs
        stands = mission_step(replace(waiting(state, **memory), stood=True), s, OPTIONS)[1]
        assert state is State.PAUSED or stands == Hover(), "what was landed since is not taken off"


@pytest.mark.parametrize(
    ("age_s", "range_m", "height_m", "alerts", "climbs"),
    [
        (20.0, 5.0, 5.1, (), False), (20.0, 5.0, 3.9, (), True), (20.0, 6.0, 4.5, (), True), (20.0, None, 5.1, (), True),
        (0.0, None, 5.1, (), False), (20.0, 5.0, 5.1, (IntegrityAlert.RANGE,), True),
    ],
)  # fmt: skip
def test_a_refused_drone_climbs_no_further_where_range_and_estimate_agree_it_is_high(age_s, range_m, height_m, alerts, climbs):
    """WHY: each wave lifted it a little without counting, and after it gave up it climbed by 3 m more, to 8.6 m."""
    seen = replace(estimate(NOW, (0.0, 0.0, height_m), age=age_s, sigma=0.2), alerts=alerts)
    p = waiting(State.GAVE_UP, seen_height_m=0.4, climbed_m=1.5)
    p, _, _ = mission_step(p, GuidanceCycle(ns(NOW), Knowledge(ns(NOW), seen), range_m=range_m), OPTIONS)
    lost = GuidanceCycle(ns(NOW + DT), Knowledge(ns(NOW + DT), None))
    _, found, _ = mission_step(p, lost, OPTIONS)
    assert (isinstance(found, Velocity) and bool(found.v_level[2] < 0.0)) is climbs


RENDEZVOUS = RendezvousOptions(enabled=True)
CYCLE_S = 0.1


def fly_to_ship(
    d, *, v=(0.0, 0.0), axis=0.0, bow=True, height=10.0, seconds=120.0, known=lambda t: True, seen=lambda t, d: False
):
    """Fly a point by the machine; return its states, its ways from body to pad, and its heights."""
    o = GuidanceOptions(rendezvous=RENDEZVOUS)
    p, _ = take_status(Progress.start(automatic=True), status(0.0, True), o)
    d, own = np.array(d, float), np.zeros(2)
    states: list[State] = []
    ways, heights, changes = [], [], list[StateChange]()
    for n in range(round(seconds / CYCLE_S)):
        t = n * CYCLE_S
        vessel = (
            vessel_position(t, d, v=v, axis_rad=axis, bow=bow, height_m=height) if known(t) else Reason(ReasonCause.VESSEL_SILENT)
        )
        sight = estimate(t, [*d, height]) if seen(t, d) else None
        s = GuidanceCycle(ns(t), Knowledge(ns(t), sight), vessel=vessel)
        p, aim, made = mission_step(p, s, o)
        changes += made
        states.append(p.state)
        ways.append(d.copy())
        heights.append(height)
        if p.state in (State.INTERCEPT, State.REFUSED, State.GAVE_UP):
            break
        wanted = aim.v_level if isinstance(aim, Velocity) else np.zeros(3)
        assert wanted[2] <= 0.0
        own = own + (wanted[:2] - own) * CYCLE_S / 0.5
        d = d + (np.array(v) - own) * CYCLE_S
        height -= wanted[2] * CYCLE_S
    return states, ways, heights, changes


@pytest.mark.parametrize(("north", "east"), [(60.0, 0.0), (-60.0, 5.0), (0.0, 60.0), (40.0, -40.0)])
@pytest.mark.parametrize("axis", [0.0, 2.0, -1.0])
def test_from_every_side_it_comes_behind_a_moving_ship_and_not_over_her(north: float, east: float, axis: float) -> None:
    v = 1.5 * np.array([math.cos(axis), math.sin(axis)])
    states, ways, *_ = fly_to_ship([north, east], v=v, axis=axis)
    arrival = next(n for n, state in enumerate(states) if state is State.SEARCH and n > states.index(State.RENDEZVOUS))
    behind = ways[arrival] @ np.array([math.cos(axis), math.sin(axis)])
    assert behind == pytest.approx(RENDEZVOUS.range_m, abs=RENDEZVOUS.reached_m)
    on_the_way = [math.hypot(*way) for way, state in zip(ways, states, strict=True) if state is State.RENDEZVOUS]
    assert min(on_the_way) > 0.6 * RENDEZVOUS.range_m
    nearest = min(math.hypot(*way) for way in ways[arrival:])
    assert nearest < 1.0, "the search begins over the pad's reported place"
    assert max(math.hypot(*way) for way in ways[arrival:]) < math.sqrt(2.0) * RENDEZVOUS.extent_m + 2.0


def test_a_source_that_stops_is_waited_for_and_then_refused_with_its_reason() -> None:
    states, _, _, changes = fly_to_ship([60.0, 0.0], known=lambda t: t < 5.0)
    assert states[-1] is State.REFUSED
    assert changes[-1].reason.cause is ReasonCause.VESSEL_SILENT
    assert len(states) * CYCLE_S == pytest.approx(5.0 + RENDEZVOUS.lost_s, abs=0.3)
    states, _, _, _ = fly_to_ship([60.0, 0.0], known=lambda t: not 5.0 < t < 12.0)
    assert State.REFUSED not in states, "a gap shorter than that is bridged"


ANY = st.floats(-300, 300)


@given(ANY, ANY, ANY, ANY, st.floats(-10, 10), st.one_of(st.none(), st.floats(-50, 300)), st.integers(0, 40), st.booleans())
def test_no_place_of_the_ship_brings_it_down_or_makes_it_too_fast(x, y, vx, vy, axis, height, leg, over_ground):
    at = vessel_position(1.0, (x, y), v=(vx, vy), axis_rad=axis, height_m=height)
    for command, most in (
        (search.to_hold_off(at, RENDEZVOUS, 0.5, VehicleHold(over_ground)), RENDEZVOUS.speed_m_s),
        (search.along_pattern(leg, at, RENDEZVOUS, 0.5, VehicleHold(over_ground)), RENDEZVOUS.search_speed_m_s),
    ):
        assert command.v_level[2] <= 0.0
        relative = command.v_level[:2] - (0.0 if over_ground else at.v_level)
        assert math.hypot(*relative) <= most + 1e-9


# The way at each edge

EDGES = RendezvousOptions(
    enabled=True, bearing_deg=180.0, range_m=8.0, height_m=6.0, reached_m=2.0, speed_m_s=3.0, search_speed_m_s=1.0,
    spacing_m=2.5, extent_m=10.0,
)  # fmt: skip
AXIS = 0.7


def hers(d: object, **more: Any) -> VesselPosition:
    """Return the position of a ship under way by her reports."""
    return vessel_position(1.0, d, **{"v": (0.3, -0.2), "axis_rad": AXIS, "sigma_m": 0.5, **more})


def towards(bearing_rad: float) -> F64:
    return np.array([math.cos(bearing_rad), math.sin(bearing_rad)])


def test_the_hold_off_point_is_on_its_bearing_from_the_bow_or_on_the_drones_side() -> None:
    aside = RendezvousOptions(bearing_deg=60.0, range_m=8.0)
    assert search.hold_off(hers([5.0, 3.0]), aside) == pytest.approx(np.array([5.0, 3.0]) + 8.0 * towards(AXIS + math.pi / 3.0))
    assert search.hold_off(hers([30.0, 40.0], bow=False), aside) == pytest.approx([30.0 - 4.8, 40.0 - 6.4])


@pytest.mark.parametrize(("range_m", "limit_m"), [(8.0, 14.5), (20.0, 24.5)])
def test_far_is_beyond_point_and_pattern_by_twice_the_reach_and_the_doubt(range_m: float, limit_m: float) -> None:
    o = RendezvousOptions(range_m=range_m, extent_m=10.0, reached_m=2.0)
    assert [search.far(hers([0.6 * at, -0.8 * at]), o) for at in (limit_m - 0.01, limit_m + 0.01)] == [False, True]
    assert not search.far(hers([limit_m, 0.0]), o)


def test_it_is_there_within_the_reach_of_the_point_and_not_below_its_height() -> None:
    there = [8.0, 0.0]
    assert search.arrived(hers([6.0, 0.0], axis_rad=0.0, sigma_m=9.0), EDGES)
    assert not search.arrived(hers([5.99, 0.0], axis_rad=0.0), EDGES)
    for height_m, arrives in ((5.49, False), (5.5, True), (30.0, True), (None, True)):
        assert search.arrived(hers(there, axis_rad=0.0, height_m=height_m), EDGES) is arrives


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("at_goal_deg", "at_body_deg", "goes_round"),
    [
        (5.0, 0.5, True),  # across
        (52.5, 5.0, True),  # near
        (53.7, 5.0, False),  # past
        (46.0, 84.5, False),  # within fifty degrees
        (45.5, 84.0, True),  # beyond
        (40.0, 89.0, True),  # she is just ahead
        (30.0, 91.0, False),  # just behind
        (120.0, 5.0, False),  # before her
        (178.0, 1.0, False),  # this side
    ],
)
def test_it_goes_round_the_ship_where_the_straight_way_crosses_her(at_goal_deg, at_body_deg, goes_round, side):
    """The triangle of body, pad and hold-off point is given by its angles."""
    at_goal, at_body = math.radians(at_goal_deg), math.radians(at_body_deg)
    behind = AXIS + math.pi
    bearing = behind + side * (math.pi - at_goal - at_body)
    pad = -8.0 * math.sin(at_goal) / math.sin(at_body) * towards(bearing)
    goal = pad + 8.0 * towards(behind)
    around = pad + 1.3 * 8.0 * towards(bearing - side * math.radians(50.0))
    wanted = around if goes_round else goal
    v = search.to_hold_off(hers(pad), EDGES, 0.8, VehicleHold(True)).v_level
    assert v[:2] == pytest.approx(wanted / math.hypot(*wanted) * min(3.0, 0.4 * math.hypot(*wanted)))


def test_it_slows_before_the_point_and_moves_with_the_ship() -> None:
    at = np.array([8.0, 0.0])  # over the hold-off point of a ship that heads forward
    for off, v in (([1.0, 0.0], (0.4, 0.0)), ([0.0, -2.0], (0.0, -0.8)), ([30.0, 0.0], (3.0, 0.0)), ([0.0, 0.0], (0.0, 0.0))):
        by_driver = search.to_hold_off(hers(at + off, axis_rad=0.0), EDGES, 0.8, VehicleHold(True))
        assert by_driver.v_level == pytest.approx([*v, 0.0])
        assert by_driver.yaw_rate_rad_s == 0.0
        by_itself = search.to_hold_off(hers(at + off, axis_rad=0.0), EDGES, 0.8, VehicleHold(False))
        assert by_itself.v_level == pytest.approx([v[0] + 0.3, v[1] - 0.2, 0.0])


@pytest.mark.parametrize(("height", "rate"), [(5.49, -0.8), (5.5, 0.0), (60.0, 0.0), (None, 0.0), (-1.0, -0.8)])
def test_it_climbs_while_it_is_low_and_never_descends(height: float | None, rate: float) -> None:
    low = hers([20.0, 1.0], height_m=height)
    assert search.to_hold_off(low, EDGES, 0.8, VehicleHold(True)).v_level[2] == rate
    assert search.along_pattern(3, low, EDGES, 0.8, VehicleHold(False)).v_level[2] == rate


@pytest.mark.parametrize("leg", [0, 1, 4, 6, 9])
def test_the_pattern_lies_along_the_ship_and_is_flown_at_its_own_speed(leg: int) -> None:
    forward, right = 2.5 * search.expanding_square(leg)
    corner = np.array([30.0, 40.0]) + forward * towards(AXIS) + right * towards(AXIS + math.pi / 2.0)
    v = search.along_pattern(leg, hers([30.0, 40.0]), EDGES, 0.8, VehicleHold(True)).v_level
    assert v[:2] == pytest.approx(corner / math.hypot(*corner))
    over = hers(-(corner - np.array([30.0, 40.0])) + [0.5, 0.0])
    assert search.along_pattern(leg, over, EDGES, 0.8, VehicleHold(True)).v_level[:2] == pytest.approx([0.2, 0.0])


def test_the_next_corner_is_flown_to_at_this_one_and_the_first_after_the_last() -> None:
    def over(leg: int, off_m: float) -> VesselPosition:
        return hers(-2.5 * search.expanding_square(leg) + [0.0, off_m], axis_rad=0.0)

    assert [search.next_leg(3, over(3, off_m), EDGES) for off_m in (0.69, 0.71)] == [4, 3]
    assert [search.next_leg(0, over(0, off_m), EDGES) for off_m in (0.0, 0.7, 0.71)] == [1, 1, 0]
    last = next(n for n in range(99) if math.hypot(*(2.5 * search.expanding_square(n + 1))) > 10.0 * math.sqrt(2.0))
    assert last == 16
    assert [search.next_leg(leg, over(leg, 0.0), EDGES) for leg in (last - 1, last)] == [last, 0]
