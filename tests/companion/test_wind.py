"""The wind over the drone: its mean and gusts by the tilt, whatever the nose does, and how much of it the tilt can fly."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.guidance.controller import FieldOfView, Knowledge
from companion.guidance.mission.wind import (
    GUST_SIGMAS,
    MEAN_S,
    ReportedWind,
    WindWatch,
    reported,
    trim_level,
    watched,
    wind_by_ship,
    wind_over_drone,
)
from companion.settings.guidance import TiltResponse
from estimator.contracts.geometry import Rotation
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import VesselWind
from tests.make import body, ns, stamp

TILT = TiltResponse(0.05, 4.0, 0.8, max_deg=28.0, drag_1_s=0.35)
DT = 0.02


def leaning(t: float, heading_rad: float, against_ned: np.ndarray, a_ned: np.ndarray) -> Knowledge:
    """Return a body that tilts against an air's push and accelerates beside it."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    level = np.array([[c, s], [-s, c]])
    forward, right = level @ (against_ned + a_ned)
    pitch = -math.atan(forward / G_M_S2)
    roll = math.atan(right * math.cos(pitch) / G_M_S2)
    a = np.array([*(level @ a_ned), 0.0])
    reported = Rotation.from_rpy(roll, pitch, heading_rad)
    return Knowledge(ns(t), None, body(t, a, reported=reported, heading=heading_rad))


@given(st.floats(0.0, 12.0), st.floats(-3.1, 3.1), st.floats(-0.3, 0.3), st.floats(0.0, 2.0))
@settings(max_examples=15, deadline=None)
def test_wind_is_what_the_tilt_holds_against(speed: float, bearing: float, turn: float, gust: float) -> None:
    into = np.array([math.cos(bearing), math.sin(bearing)])
    watch, heading = WindWatch(), 0.0
    for n in range(1500):
        t = n * DT
        heading = turn * t
        # Gusts along the wind that go round in 2 s: of amplitude g they are g / 2 on one axis of two.
        push = 0.35 * (speed + gust * math.sin(math.pi * t)) * into
        a = 0.8 * np.array([math.sin(2.0 * t), math.cos(3.0 * t)])
        watch = watched(watch, leaning(t, heading, push, a))
        early = wind_over_drone(watch, TILT, heading)
        assert (early is None) == (watch.known_s < 1.0)
        assert early is None or early.known == (watch.known_s >= MEAN_S)
        assert early is None or early.known or not (early.too_strong or early.spent), "it only says how to turn"
    wind = wind_over_drone(watch, TILT, heading)
    assert wind.speed_m_s == pytest.approx(speed, abs=0.15 + 0.25 * gust)
    assert wind.gust_m_s == pytest.approx(0.5 * gust, abs=0.1 + 0.2 * gust)
    assert wind.limit_m_s <= G_M_S2 * math.tan(math.radians(28.0)) / 0.35 + 1e-9
    left = math.radians(28.0) - GUST_SIGMAS * math.atan(0.35 * wind.gust_m_s / G_M_S2)
    assert wind.limit_m_s == pytest.approx(G_M_S2 * math.tan(left) / 0.35)
    if speed > 2.0 + gust:
        turned = np.array([math.cos(bearing - heading), math.sin(bearing - heading)])
        assert wind.into_level == pytest.approx(turned, abs=0.2)


def test_a_wind_that_falls_steadily_on_the_way_down_is_no_gust() -> None:
    """WHY: a descent from 16 m/s of wind to 10 counted as gusts of 2.6 m/s, and ended the landing."""
    watch = WindWatch()
    for n in range(1500):
        speed = 16.0 - 0.4 * max(0.0, n * DT - 15.0)
        watch = watched(watch, leaning(n * DT, 0.3, np.array([0.3 * speed, 0.0]), np.zeros(2)))
    wind = wind_over_drone(watch, TILT, 0.3)
    assert wind.gust_m_s < 0.6


def test_the_ship_s_anemometer_says_where_to_look_and_forbids_only_what_is_far_too_strong() -> None:
    def blows(speed: float) -> ReportedWind:
        mean = None
        for n in range(10):
            mean = reported(mean, VesselWind(stamp(1.0 + n), "mast", math.pi / 2, speed))
        assert mean is not None
        return mean

    wind = wind_by_ship(blows(8.0), ns(10.5), np.array([0.0, 1.5]), TILT, math.pi / 2)
    assert wind.speed_m_s == pytest.approx(9.5), "she sails into it"
    assert wind.into_level == pytest.approx([1.0, 0.0], abs=1e-9), "the nose is east, and so is the wind"
    assert [wind.forbids, wind.too_strong, wind.known] == [False] * 3
    most_m_s = G_M_S2 * math.tan(math.radians(28.0)) / 0.35
    assert most_m_s == pytest.approx(14.9, abs=0.1)
    for speed, forbids in ((14.0, False), (18.0, True)):
        wind = wind_by_ship(blows(speed), ns(10.5), None, TILT, 0.0)
        assert wind.forbids is forbids, "an instrument that is 30 % off refuses no flight"
    assert wind_by_ship(blows(18.0), ns(30.0), None, TILT, 0.0) is None, "an old report says nothing"


@pytest.mark.parametrize(("gust_m_s", "sigma_m_s"), [(15.0, 0.3), (15.0, 0.8), (0.0, 0.3), (0.0, 1.5)])
def test_a_gust_that_begins_is_told_from_those_before_while_a_commit_can_still_end(gust_m_s: float, sigma_m_s: float) -> None:
    """WHY: a gust of 15 m/s that began 0.8 s before the contact (seed 510202 of the demo) dragged a drone 1 m over the deck."""
    watch, rng, push, begins_s = WindWatch(), np.random.default_rng(7), np.zeros(2), None
    for n in range(3000):
        t, keep = n * DT, math.exp(-DT / 1.0)
        push = keep * push + math.sqrt(1.0 - keep * keep) * 0.35 * sigma_m_s * rng.standard_normal(2)
        grown = gust_m_s * math.sin(min(0.5, max(0.0, t - 59.0) / 3.0) * math.pi) ** 2
        watch = watched(watch, leaning(t, 0.3, np.array([0.35 * (3.0 + grown), 0.0]) + push, 0.1 * rng.standard_normal(2)))
        wind = wind_over_drone(watch, TILT, 0.3)
        if wind is not None and wind.known and wind.begins_m_s > wind.begins_most_m_s:
            begins_s = t - 59.0
            break
    assert (begins_s is not None) is (gust_m_s > 0.0)
    assert begins_s is None or 0.0 < begins_s < 0.8
    assert wind.drags is (wind.push_rad > math.radians(8.0))


def test_a_drone_that_flies_away_by_a_velocity_that_lies_meets_no_wind() -> None:
    """WHY: a reversed velocity was flown away from at 16 m/s, and the landing refused for 14 m/s of wind."""
    watch, push = WindWatch(), np.array([0.35 * 3.0, 0.0])
    for n in range(500):
        watch = watched(watch, leaning(n * DT, 0.4, push, np.zeros(2)))
    flees = replace(leaning(0.0, 0.4, 5.0 * push, np.zeros(2)), trusts_velocity=False)
    after = watch
    for n in range(500, 1000):
        after = watched(after, replace(flees, at=ns(n * DT)))
    assert after == watch
    assert trim_level(after, 0.0) == pytest.approx(push, abs=0.1)
    assert trim_level(after, 0.4) == pytest.approx([push[0] * math.cos(0.4), -push[0] * math.sin(0.4)], abs=0.1)


@given(st.floats(-3.1, 3.1))
@settings(max_examples=30, deadline=None)
def test_the_turn_across_the_wind_is_the_smaller_one_to_the_wider_side(bearing: float) -> None:
    watch = WindWatch(known_s=MEAN_S, mean=(3.0 * math.cos(bearing), 3.0 * math.sin(bearing)))
    for half_forward, half_right in ((0.4, 0.7), (0.7, 0.4)):
        wind = wind_over_drone(watch, TILT, 0.0, FieldOfView(0.0, 0.0, half_forward, half_right))
        assert abs(wind.across_rad) <= 0.5 * math.pi + 1e-9
        after = bearing - wind.across_rad
        narrow = math.cos(after) if half_right > half_forward else math.sin(after)
        assert narrow == pytest.approx(0.0, abs=1e-9)
    level = wind_over_drone(watch, TILT, 0.0)
    assert level.across_rad == 0.0


def test_a_vehicle_touches_upwind_by_what_levelling_takes_to_lee() -> None:
    wind = wind_over_drone(WindWatch(known_s=MEAN_S, mean=(3.57, 0.0)), TILT, 0.5 * math.pi)
    ahead, aside = wind.aim_level(0.1)
    assert (ahead, aside) == (pytest.approx(0.0, abs=1e-9), pytest.approx(0.056, abs=1e-3)), "the wind comes over the left side"
