"""A contact is an event of the accelerometer: found on a deck, and in no flight."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.guidance.contact import ContactWatch, watched
from estimator.contracts.samples import Imu
from estimator.contracts.time import MonoNs, Stamp

STEP_S = 0.005


def heard(up: np.ndarray) -> list[float]:  # type: ignore[type-arg]
    """Return the times, s, of the contacts that an upward specific force shows."""
    watch, found = ContactWatch(), []
    for k, force in enumerate(up.tolist()):
        at = MonoNs(k * round(STEP_S * 1e9))
        before = watch.newest
        watch = watched(watch, Imu(Stamp(at, at, 0.001, "sim"), np.zeros(3), np.array([0.0, 0.0, -force])))
        if watch.newest is not before:
            assert watch.newest is not None
            found.append(watch.newest.at * 1e-9)
    return found


def flight(seconds: float, seed: int = 0) -> np.ndarray:  # type: ignore[type-arg]
    """Upward specific force of a flight: vibration, gusts, climbs that are begun and ended as quickly as rotors can."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, STEP_S)
    steps = 1.5 * np.sign(np.sin(2.0 * t))
    lagging = np.zeros_like(t)
    for k in range(1, len(t)):
        lagging[k] = lagging[k - 1] + STEP_S / 0.05 * (steps[k] - lagging[k - 1])
    return np.asarray(9.81 + 0.3 * np.sin(1.3 * t) + lagging + 0.25 * rng.standard_normal(t.size))


@pytest.mark.parametrize("seed", range(3))
def test_no_flight_is_a_contact(seed: int) -> None:
    assert heard(flight(60.0, seed)) == []


@pytest.mark.parametrize("speed_m_s", [0.2, 0.45, 0.8])
def test_feet_on_a_deck_are_one_contact_within_a_twentieth_of_a_second(speed_m_s: float) -> None:
    """Feet of 6000 N/m under 1.5 kg take the speed away within a quarter of their period, and give a little of it back."""
    up, w = flight(4.0), math.sqrt(6000.0 / 1.477)
    for k in range(up.size):
        t = k * STEP_S - 3.0
        if t >= 0.0:
            up[k] += speed_m_s * w * math.exp(-0.7 * w * t) * math.cos(w * t)
    found = heard(up)
    assert len(found) == 1
    assert 3.0 <= found[0] <= 3.05


def test_a_sensor_that_jumps_to_another_bias_for_good_is_at_most_one_contact() -> None:
    up = flight(6.0)
    up[600:] += 4.0
    assert len(heard(up)) <= 1


def test_samples_after_a_gap_begin_again() -> None:
    watch = ContactWatch()
    for at, force in ((0, 9.81), (5, 9.81), (2000, 40.0), (2005, 40.0)):
        now = MonoNs(at * 1_000_000)
        watch = watched(watch, Imu(Stamp(now, now, 0.001, "sim"), np.zeros(3), np.array([0.0, 0.0, -force])))
    assert watch.newest is None
