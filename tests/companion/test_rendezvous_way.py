"""The way to the ship at each edge: where it goes round her, what counts as there, and the next corner of the search."""

import math

import numpy as np
import pytest

from companion.guidance.mission.cycle import VehicleHold, VesselPosition
from companion.guidance.mission.search import along_pattern, arrived, expanding_square, far, hold_off, next_leg, to_hold_off
from companion.settings.vessel import RendezvousOptions
from estimator.contracts.geometry import F64
from tests.make import ns

OPTIONS = RendezvousOptions(
    enabled=True, bearing_deg=180.0, range_m=8.0, height_m=6.0, reached_m=2.0, speed_m_s=3.0, search_speed_m_s=1.0,
    spacing_m=2.5, extent_m=10.0,
)  # fmt: skip
AXIS = 0.7


def place(d: object, *, axis: float = AXIS, bow: bool = True, height: float | None = 6.0, sigma: float = 0.5) -> VesselPosition:
    return VesselPosition(ns(1), np.array(d, float), sigma, np.array([0.3, -0.2]), axis, bow, height)


def towards(bearing_rad: float) -> F64:
    return np.array([math.cos(bearing_rad), math.sin(bearing_rad)])


def test_the_hold_off_point_is_on_its_bearing_from_the_bow_or_on_the_drones_side() -> None:
    aside = RendezvousOptions(bearing_deg=60.0, range_m=8.0)
    assert hold_off(place([5.0, 3.0]), aside) == pytest.approx(np.array([5.0, 3.0]) + 8.0 * towards(AXIS + math.pi / 3.0))
    assert hold_off(place([30.0, 40.0], bow=False), aside) == pytest.approx([30.0 - 4.8, 40.0 - 6.4])


@pytest.mark.parametrize(("range_m", "limit_m"), [(8.0, 14.5), (20.0, 24.5)])
def test_far_is_beyond_point_and_pattern_by_twice_the_reach_and_the_doubt(range_m: float, limit_m: float) -> None:
    o = RendezvousOptions(range_m=range_m, extent_m=10.0, reached_m=2.0)
    assert [far(place([0.6 * at, -0.8 * at]), o) for at in (limit_m - 0.01, limit_m + 0.01)] == [False, True]
    assert not far(place([limit_m, 0.0]), o)


def test_it_is_there_within_the_reach_of_the_point_and_not_below_its_height() -> None:
    there = [8.0, 0.0]
    assert arrived(place([6.0, 0.0], axis=0.0, sigma=9.0), OPTIONS)
    assert not arrived(place([5.99, 0.0], axis=0.0), OPTIONS)
    assert [arrived(place(there, axis=0.0, height=h), OPTIONS) for h in (5.49, 5.5, 30.0, None)] == [False, True, True, True]


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("at_goal_deg", "at_body_deg", "goes_round"),
    [
        (5.0, 0.5, True),
        (52.5, 5.0, True),
        (53.7, 5.0, False),
        (46.0, 84.5, False),
        (45.5, 84.0, True),
        (40.0, 89.0, True),
        (30.0, 91.0, False),
        (120.0, 5.0, False),
        (178.0, 1.0, False),
    ],
    ids=[
        "across",
        "near",
        "past",
        "within fifty degrees",
        "beyond",
        "she is just ahead",
        "just behind",
        "before her",
        "this side",
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
    v = to_hold_off(place(pad), OPTIONS, 0.8, VehicleHold(True)).v_level
    assert v[:2] == pytest.approx(wanted / math.hypot(*wanted) * min(3.0, 0.4 * math.hypot(*wanted)))


def test_it_slows_before_the_point_and_moves_with_the_ship() -> None:
    at = np.array([8.0, 0.0])  # over the hold-off point of a ship that heads forward
    for off, v in (([1.0, 0.0], (0.4, 0.0)), ([0.0, -2.0], (0.0, -0.8)), ([30.0, 0.0], (3.0, 0.0)), ([0.0, 0.0], (0.0, 0.0))):
        by_driver = to_hold_off(place(at + off, axis=0.0), OPTIONS, 0.8, VehicleHold(True))
        assert by_driver.v_level == pytest.approx([*v, 0.0])
        assert by_driver.yaw_rate_rad_s == 0.0
        by_itself = to_hold_off(place(at + off, axis=0.0), OPTIONS, 0.8, VehicleHold(False))
        assert by_itself.v_level == pytest.approx([v[0] + 0.3, v[1] - 0.2, 0.0])


def test_on_the_point_itself_it_stays() -> None:
    before_her = RendezvousOptions(bearing_deg=0.0, range_m=8.0)
    assert not np.any(hold_off(place([-8.0, 0.0], axis=0.0), before_her))
    assert not np.any(to_hold_off(place([-8.0, 0.0], axis=0.0), before_her, 0.8, VehicleHold(True)).v_level)


@pytest.mark.parametrize(("height", "rate"), [(5.49, -0.8), (5.5, 0.0), (60.0, 0.0), (None, 0.0), (-1.0, -0.8)])
def test_it_climbs_while_it_is_low_and_never_descends(height: float | None, rate: float) -> None:
    low = place([20.0, 1.0], height=height)
    assert to_hold_off(low, OPTIONS, 0.8, VehicleHold(True)).v_level[2] == rate
    assert along_pattern(3, low, OPTIONS, 0.8, VehicleHold(False)).v_level[2] == rate


def test_the_corners_are_a_square_that_grows_by_a_track_at_every_second_turn() -> None:
    corners = [(0, 0), (1, 0), (1, 1), (-1, 1), (-1, -1), (2, -1), (2, 2), (-2, 2), (-2, -2), (3, -2)]
    assert [tuple(expanding_square(n)) for n in range(10)] == corners


@pytest.mark.parametrize("leg", [0, 1, 4, 6, 9])
def test_the_pattern_lies_along_the_ship_and_is_flown_at_its_own_speed(leg: int) -> None:
    forward, right = 2.5 * expanding_square(leg)
    corner = np.array([30.0, 40.0]) + forward * towards(AXIS) + right * towards(AXIS + math.pi / 2.0)
    v = along_pattern(leg, place([30.0, 40.0]), OPTIONS, 0.8, VehicleHold(True)).v_level
    assert v[:2] == pytest.approx(corner / math.hypot(*corner))
    over = place(-(corner - np.array([30.0, 40.0])) + [0.5, 0.0])
    assert along_pattern(leg, over, OPTIONS, 0.8, VehicleHold(True)).v_level[:2] == pytest.approx([0.2, 0.0])


def test_the_next_corner_is_flown_to_at_this_one_and_the_first_after_the_last() -> None:
    def over(leg: int, off_m: float) -> VesselPosition:
        return place(-2.5 * expanding_square(leg) + [0.0, off_m], axis=0.0)

    assert [next_leg(3, over(3, off_m), OPTIONS) for off_m in (0.69, 0.71)] == [4, 3]
    assert [next_leg(0, over(0, off_m), OPTIONS) for off_m in (0.0, 0.7, 0.71)] == [1, 1, 0]
    last = next(n for n in range(99) if math.hypot(*(2.5 * expanding_square(n + 1))) > 10.0 * math.sqrt(2.0))
    assert last == 16
    assert [next_leg(leg, over(leg, 0.0), OPTIONS) for leg in (last - 1, last)] == [last, 0]
