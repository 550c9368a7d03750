"""A range sensor over the pad, and a barometer's change, against the camera's height."""

import math

import numpy as np
import pytest

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Baro, Range
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity.crosschecks import HeightWatch, add_baro, add_range, add_sighting
from estimator.integrity.options import IntegrityOptions

LIMITS = IntegrityOptions()


def at(t_s: float) -> Stamp:
    t = MonoNs(round(t_s * 1e9))
    return Stamp(t, t, 0.001, "sim")


def sighting(t_s: float, d: tuple[float, float, float]) -> Sighting:
    return Sighting(at(t_s), 1, "registration", np.array(d), 0.0, False, np.diag([1e-4, 1e-4, 1e-4, 1e-3]), 0.9)


def watched(seen_m, range_m, seconds: float = 3.0, aside_m: float = 0.1, tilt_rad: float = 0.05) -> HeightWatch:
    """Camera and range sensor for a while; both heights as functions of time."""
    rng = np.random.default_rng(1)
    state = HeightWatch()
    for i in range(round(seconds * 25)):
        t = 1.0 + i / 25
        state = add_sighting(state, sighting(t - 0.1, (aside_m, 0.0, seen_m(t))), Rotation.from_rpy(tilt_rad, 0.0, 0.5))
        state = add_range(state, Range(at(t), range_m(t) + abs(rng.normal(0, 0.005)), 0.02), LIMITS)
    return state


@pytest.mark.parametrize("height_m", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("tilt_rad", [0.0, 0.2])
def test_true_heights_agree_at_any_tilt(height_m: float, tilt_rad: float) -> None:
    for along in (1.0, 1.0 / math.cos(tilt_rad)):
        state = watched(lambda t: height_m, lambda t, k=along: height_m * k, tilt_rad=tilt_rad, aside_m=0.0)
        assert not state.contradicted
        assert state.confirmed(round(4e9)) or tilt_rad > 0.0


@pytest.mark.parametrize("scale", [0.8, 1.25])
@pytest.mark.parametrize("height_m", [1.7, 2.0, 3.0])
def test_a_focal_length_wrong_by_a_fifth_contradicts_before_the_descent(scale: float, height_m: float) -> None:
    assert watched(lambda t: scale * height_m, lambda t: height_m).contradicted


def test_a_pad_seen_below_where_there_is_water_contradicts() -> None:
    assert watched(lambda t: 2.0, lambda t: 4.5).contradicted


def test_beside_the_pad_a_range_reports_nothing() -> None:
    state = watched(lambda t: 2.0, lambda t: 4.5, aside_m=1.5)
    assert not state.contradicted
    assert state.agreed_at < 0


def test_a_passing_difference_is_no_contradiction_and_agreement_ends_one() -> None:
    assert not watched(lambda t: 2.0, lambda t: 2.6 if t < 1.7 else 2.0).contradicted
    assert not watched(lambda t: 2.0, lambda t: 2.6 if t < 2.5 else 2.0, seconds=6.0).contradicted
    assert watched(lambda t: 2.0, lambda t: 2.6 if t < 2.5 else 2.0, seconds=1.7).contradicted


def test_a_sensor_that_receives_nothing_nearer_than_its_least_does_not_contradict_at_touchdown() -> None:
    assert not watched(lambda t: max(0.1, 0.5 - 0.2 * (t - 1)), lambda t: max(0.2, 0.5 - 0.2 * (t - 1))).contradicted


def pressed(baro_m, seen_m, seconds: float = 12.0) -> HeightWatch:
    rng = np.random.default_rng(4)
    state = HeightWatch()
    for i in range(round(seconds * 20)):
        t = 1.0 + i / 20
        state = add_sighting(state, sighting(t - 0.1, (0.1, 0.0, seen_m(t))), Rotation.identity())
        state = add_baro(state, Baro(at(t), baro_m(t) + rng.normal(0, 0.5), 0.7), LIMITS)
    return state


def test_a_barometer_contradicts_a_height_that_stands_while_the_drone_climbs() -> None:
    assert pressed(lambda t: 30.0 + 0.8 * t, lambda t: 1.5).baro_contradicted


@pytest.mark.parametrize(("rate_m_s", "seconds"), [(0.9, 7.5), (-0.9, 7.5), (0.55, 11.5), (-0.55, 11.5)])
def test_a_drift_is_contradicted_the_sooner_the_faster_it_is(rate_m_s: float, seconds: float) -> None:
    assert pressed(lambda t: 30.0 + rate_m_s * t, lambda t: 1.5, seconds).baro_contradicted


@pytest.mark.parametrize("period_s", [5.0, 7.0, 9.0, 12.0])
@pytest.mark.parametrize("phase", [0.0, 1.5, 3.0, 4.5])
def test_a_drone_that_follows_a_deck_in_a_high_sea_is_no_contradiction(period_s: float, phase: float) -> None:
    for end in (8.0, 12.0, 15.5, 19.0):
        heave = pressed(lambda t: 30.0 + 2.0 * math.sin(math.tau * t / period_s + phase), lambda t: 0.4, seconds=end)
        assert not heave.baro_contradicted, end


def test_a_heaving_deck_and_a_descent_are_no_contradiction() -> None:
    assert not pressed(lambda t: 30.0 - 0.4 * t, lambda t: 6.0 - 0.4 * t + 0.8 * math.sin(0.7 * t)).baro_contradicted
