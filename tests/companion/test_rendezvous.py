"""The flight to the ship by her reports: to the hold-off point, over the pattern, never down, refused in time."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.base.mission import Reason, ReasonCause, State, StateChange
from companion.guidance.controller import Knowledge
from companion.guidance.mission import search
from companion.guidance.mission.machine import mission_step, take_status
from companion.guidance.mission.progress import GuidanceCycle, Progress, VehicleHold, VesselPosition
from companion.settings.guidance import GuidanceOptions
from companion.settings.vessel import RendezvousOptions
from estimator.contracts.commands import Velocity
from estimator.contracts.geometry import F64
from tests.make import estimate, ns, status, vessel_position

OPTIONS = RendezvousOptions(enabled=True)
DT = 0.1


def fly_to_ship(
    d, *, v=(0.0, 0.0), axis=0.0, bow=True, height=10.0, seconds=120.0, known=lambda t: True, seen=lambda t, d: False
):
    """Fly a point by the machine; return its states, its ways from body to pad, and its heights."""
    o = GuidanceOptions(rendezvous=OPTIONS)
    p, _ = take_status(Progress.start(automatic=True), status(0.0, True), o)
    d, own = np.array(d, float), np.zeros(2)
    states: list[State] = []
    ways, heights, changes = [], [], list[StateChange]()
    for n in range(round(seconds / DT)):
        t = n * DT
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
        own = own + (wanted[:2] - own) * DT / 0.5
        d = d + (np.array(v) - own) * DT
        height -= wanted[2] * DT
    return states, ways, heights, changes


@pytest.mark.parametrize(("north", "east"), [(60.0, 0.0), (-60.0, 5.0), (0.0, 60.0), (40.0, -40.0)])
@pytest.mark.parametrize("axis", [0.0, 2.0, -1.0])
def test_from_every_side_it_comes_behind_a_moving_ship_and_not_over_her(north: float, east: float, axis: float) -> None:
    v = 1.5 * np.array([math.cos(axis), math.sin(axis)])
    states, ways, *_ = fly_to_ship([north, east], v=v, axis=axis)
    assert State.RENDEZVOUS in states
    arrival = next(n for n, state in enumerate(states) if state is State.SEARCH and n > states.index(State.RENDEZVOUS))
    behind = ways[arrival] @ np.array([math.cos(axis), math.sin(axis)])
    assert behind == pytest.approx(OPTIONS.range_m, abs=OPTIONS.reached_m)
    on_the_way = [math.hypot(*way) for way, state in zip(ways, states, strict=True) if state is State.RENDEZVOUS]
    assert min(on_the_way) > 0.6 * OPTIONS.range_m
    nearest = min(math.hypot(*way) for way in ways[arrival:])
    assert nearest < 1.0, "the search begins over the pad's reported place"
    assert max(math.hypot(*way) for way in ways[arrival:]) < math.sqrt(2.0) * OPTIONS.extent_m + 2.0


def test_a_source_that_stops_is_waited_for_and_then_refused_with_its_reason() -> None:
    states, _, _, changes = fly_to_ship([60.0, 0.0], known=lambda t: t < 5.0)
    assert states[-1] is State.REFUSED
    assert changes[-1].reason.cause is ReasonCause.VESSEL_SILENT
    assert len(states) * DT == pytest.approx(5.0 + OPTIONS.lost_s, abs=0.3)
    states, _, _, _ = fly_to_ship([60.0, 0.0], known=lambda t: not 5.0 < t < 12.0)
    assert State.REFUSED not in states, "a gap shorter than that is bridged"


ANY = st.floats(-300, 300)


@given(ANY, ANY, ANY, ANY, st.floats(-10, 10), st.one_of(st.none(), st.floats(-50, 300)), st.integers(0, 40), st.booleans())
def test_no_place_of_the_ship_brings_it_down_or_makes_it_too_fast(x, y, vx, vy, axis, height, leg, over_ground):
    at = vessel_position(1.0, (x, y), v=(vx, vy), axis_rad=axis, height_m=height)
    for command, most in (
        (search.to_hold_off(at, OPTIONS, 0.5, VehicleHold(over_ground)), OPTIONS.speed_m_s),
        (search.along_pattern(leg, at, OPTIONS, 0.5, VehicleHold(over_ground)), OPTIONS.search_speed_m_s),
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
