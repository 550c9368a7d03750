"""The cone: how fast the drone may come down at which height and how far from the axis."""

import math

import pytest

from companion.guidance.mission.cone import descent_rate_m_s, inside, outside, radius_m
from companion.settings.mission import ConeOptions

CONE = ConeOptions(slope=0.2, descent_rate_m_s=0.7, feet_below_m=0.1, gate_height_m=0.2)


def test_the_radius_grows_with_the_height_and_is_never_that_of_a_point() -> None:
    assert [radius_m(height_m, CONE) for height_m in (-1.0, 0.1, 0.15, 2.0)] == pytest.approx([0.03, 0.03, 0.03, 0.4])


@pytest.mark.parametrize("height_m", [0.05, 0.5, 3.0])
def test_a_gust_may_carry_it_out_before_it_climbs_and_it_comes_back_in_before_it_descends(height_m: float) -> None:
    for bound, is_within in ((math.sqrt(1.2), inside), (math.sqrt(2.0), lambda *of: not outside(*of))):
        edge_m = bound * radius_m(height_m, CONE)
        assert is_within(0.999 * edge_m, height_m, CONE)
        assert not is_within(1.001 * edge_m, height_m, CONE)


def test_the_descent_is_full_near_the_axis_ends_where_the_cone_does_and_turns_to_a_climb_outside() -> None:
    radius = radius_m(4.0, CONE)
    for share, rate in ((0.0, 0.7), (0.4, 0.7), (1.0, 0.14), (math.sqrt(1.2), 0.0), (math.sqrt(1.7), -0.35), (9.0, -0.7)):
        assert descent_rate_m_s(share * radius, 4.0, CONE) == pytest.approx(rate)


@pytest.mark.parametrize("least_m", [None, 0.3, 0.8])
def test_the_descent_dies_away_towards_the_least_height(least_m: float | None) -> None:
    ends_m = 0.3 if least_m is None else least_m
    for left_m, rate in ((2.0, 0.7), (0.7, 0.7), (0.5, 0.5), (0.1, 0.1), (0.0, 0.0), (-0.2, -0.2)):
        assert descent_rate_m_s(0.0, ends_m + left_m, CONE, least_m) == pytest.approx(rate)
