"""Gyro against attitude with the pad's own rotation as the third witness (own truth)."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, Imu
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity import inertial
from estimator.integrity.inertial import Differences, Inertial, Usual
from estimator.integrity.options import IntegrityOptions
from estimator.integrity.parity import Bin, Slope, Vec3

OPTIONS = IntegrityOptions()
DT, BEGIN_S, LATE_S = 0.01, 2.0, 0.12
G = np.array([0.0, 0.0, -9.81])
Change = Callable[[F64], F64]


def body(t: float) -> Rotation:
    return Rotation.from_rpy(0.15 * math.sin(4.0 * t), 0.12 * math.sin(3.1 * t + 1.0), 0.3 + 0.1 * math.sin(0.5 * t))


def deck(t: float) -> Rotation:
    return Rotation.from_rpy(0.06 * math.sin(0.8 * t), 0.04 * math.cos(0.7 * t), 1.0)


def flown(
    gyro: Change,
    attitude: Change,
    until: float = 5.0,
    seen: bool = True,
    well_from: float = math.inf,
    heading: Callable[[float], float] = lambda lies_s: 0.0,
) -> list[Inertial]:
    """Return the states every `DT`.

    Args:
        gyro: what it makes of its rates, rad/s, from `BEGIN_S` on.
        attitude: what it makes of roll and pitch, rad.
        well_from: from when on both are well again, s.
        heading: what is added to the heading, rad, by the time for which it lies, s. The pictures' attitude has the right one.
    """
    rng, state, out, frames = np.random.default_rng(5), Inertial(), [], list[float]()
    output = {}
    for n in range(round(until / DT)):
        t = n * DT
        lies = BEGIN_S <= t < well_from
        stamp = Stamp(MonoNs(round(t * 1e9)), MonoNs(round(t * 1e9)), 0.001, "sim")
        w = (body(t - DT).inv @ body(t)).rotvec_rad / DT + 0.01 * rng.standard_normal(3)
        state, _ = inertial.felt(state, Imu(stamp, gyro(w) if lies else w, G + 0.1 * rng.standard_normal(3)), OPTIONS, True)
        roll, pitch, yaw = body(t).rpy_rad
        if lies:
            roll, pitch = attitude(np.array([roll, pitch]))
            yaw += heading(t - BEGIN_S)
        R = output[n] = Rotation.from_rpy(roll, pitch, yaw) @ Rotation.from_rotvec(0.002 * rng.standard_normal(3))
        state = inertial.levelled(state, Attitude(stamp, R, 1e-4 * np.eye(3)), True)
        frames += [t] if n % 3 == 0 else []
        while seen and frames and frames[0] <= t - LATE_S:
            at = frames.pop(0)
            R_then, off_rad = output[round(at / DT)], heading(at - BEGIN_S) if BEGIN_S <= at < well_from else 0.0
            R_then = Rotation.from_rpy(0.0, 0.0, -off_rad) @ R_then
            tilted = Rotation.from_rotvec(0.006 * rng.standard_normal(3))
            R_pad = R_then @ body(at).inv @ deck(at) @ tilted
            state = inertial.pictured(state, round(at * 1e9), R_then.matrix, R_pad.matrix, off_rad)
        out.append(state)
    return out


def named(states: list[Inertial]) -> tuple[str, float]:
    """Return who was named first, and how long after the fault's beginning."""
    for n, state in enumerate(states):
        if state.lost:
            return "attitude" if state.attitude_fault else "gyro", n * DT - BEGIN_S
    return "", math.inf


FAULTS: dict[str, Change] = {
    "sign": lambda x: -x,
    "a third": lambda x: 0.334 * x,
    "frozen on an axis": lambda x: x * (np.arange(len(x)) != 0),
    "twice": lambda x: 2.0 * x,
    "swapped": lambda x: x[[1, 0, *range(2, len(x))]],
}


def plain(x: F64) -> F64:
    return x


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("who", ["gyro", "attitude"])
def test_of_two_that_turn_apart_the_picture_names_the_one_that_lies(who: str, fault: str) -> None:
    change = FAULTS[fault]
    states = flown(change, plain) if who == "gyro" else flown(plain, change)
    found, after_s = named(states)
    assert found == who
    assert 0.0 < after_s < 1.0
    assert len(states[-1].lost) == 1


@pytest.mark.parametrize("leap_deg", [-40.0, 40.0, 120.0])
@pytest.mark.parametrize("drift_deg_s", [0.0, 20.0])
@pytest.mark.parametrize("seen", [True, False])
def test_a_heading_that_lies_says_nothing_of_roll_and_pitch(leap_deg: float, drift_deg_s: float, seen: bool) -> None:
    """WHY: beside a reversed velocity that tilted the drone, a compass 40 degrees off had a healthy gyro named in pitch."""
    states = flown(plain, plain, seen=seen, heading=lambda lies_s: math.radians(leap_deg + drift_deg_s * lies_s))
    assert {text for state in states for text in state.lost} == set()


@pytest.mark.parametrize(("turns", "frozen"), [(False, False), (True, True)])
def test_an_axis_of_coarse_steps_that_repeats_itself_is_frozen_only_while_the_attitude_turns_otherwise(
    turns: bool, frozen: bool
) -> None:
    """ArduPilot's RAW_IMU has steps of 1 mrad/s: a steady heading repeats itself for longer than any limit."""
    rng, state, found = np.random.default_rng(5), inertial.Inertial(), False
    for n in range(400):
        at, t = 0.01 * n, round(1e7 * n)
        stamp = Stamp(MonoNs(t), MonoNs(t), 0.001, "sim")
        yaw = 0.1 * math.sin(2.0 * at) if turns and at > 2.0 else 0.0002 * at
        w = np.round([*0.02 * rng.standard_normal(2), 0.003 * (n < 40 and n % 2)], 3)
        state, _ = inertial.felt(state, Imu(stamp, w, G + 0.1 * rng.standard_normal(3)), OPTIONS, True)
        state = inertial.levelled(state, Attitude(stamp, Rotation.from_rpy(0.0, 0.0, yaw), 1e-4 * np.eye(3)), True)
        found = found or bool(state.lost)
    assert found is frozen


def test_one_frozen_axis_is_a_frozen_half_in_a_third_of_a_second_and_one_that_never_changed_is_none() -> None:
    def flies(of_z: Callable[[float], float], turned: int = 0) -> list[bool]:
        rng, state, out = np.random.default_rng(1), Inertial(), list[bool]()
        for n in range(200):
            stamp = Stamp(MonoNs(n * 5_000_000), MonoNs(n * 5_000_000), 0.001, "sim")
            f = np.roll([*rng.standard_normal(2), of_z(n)], turned)
            state, _ = inertial.felt(state, Imu(stamp, rng.standard_normal(3), f), OPTIONS, True)
            out.append(state.accel_lost)
        return out

    found = flies(lambda n: -9.8 + 0.1 * math.sin(n) if n < 100 else -9.8)
    assert found.index(True) in range(159, 163), "0.3 s after it first read what it repeats"
    assert not any(flies(lambda n: 0.0)), "a sensor that does not have this axis"
    for across in (1, 2):
        assert any(flies(lambda n: 0.01 * (n % 7) if n < 100 else 0.21, across))
        assert not any(flies(lambda n: 0.01 * (n % 7) if n < 100 else 0.0, across)), "steps of a hundredth of g in still air"


def test_a_clean_flight_over_a_deck_that_rolls_names_nobody() -> None:
    assert named(flown(plain, plain, 8.0)) == ("", math.inf)


def test_an_attitude_that_is_well_again_counts_again_and_the_filter_starts_again() -> None:
    states = flown(plain, FAULTS["sign"], 7.0, well_from=4.0)
    assert states[390].attitude_fault is not None
    assert states[-1].attitude_fault is None
    assert states[-1].named == 2, "once without it and once with it"


def test_without_pictures_a_gyro_that_turns_against_the_attitude_is_the_one() -> None:
    found, after_s = named(flown(FAULTS["sign"], plain, seen=False))
    assert (found, after_s < 0.7) == ("gyro", True)


def test_a_deck_that_moves_both_its_witnesses_accuses_no_accelerometer() -> None:
    """Flow and sightings miss 2.2 m/s^2 ahead; an accelerometer that lies feels it the other way, and drag does not."""
    off, none = Differences(None, None, (2.2, 0.0)), (0.0, 0.0, 0.0)

    def accused(f: Vec3) -> bool:
        newest = Bin(0, 0.1, none, none, none, none, none, f, (0.0, 0.0, 1.0), (1.0, 0.0))
        return bool(inertial._accel_lies(off, Usual(n=20, sides=20), newest)[0])

    assert accused((-2.0, 0.4, -9.8))
    assert not accused((0.1, 2.8, -9.8))
    assert not accused((2.2, 0.0, -9.8))


def test_a_bias_that_shows_late_is_usual_and_a_later_one_is_named() -> None:
    """WHY: in weather_4 the pad was out of sight for the first 2 s, and a bias of 1.8 m/s^2 took the accelerometer away."""
    none, down = (0.0, 0.0, 0.0), Slope(0.1, 0.01)

    def after(usual: Usual, side: tuple[float, float] | None, bins: int) -> tuple[Usual, bool]:
        newest, named = Bin(0, 0.1, none, none, none, none, none, (-2.5, 0.0, -9.8), (0.0, 0.0, 1.0), (1.0, 0.0)), False
        for _ in range(bins):
            off = Differences(down, None, side)
            named = named or bool(inertial._accel_lies(off, usual, newest)[0])
            usual = usual if named else usual.after(off)
        return usual, named

    unseen, _ = after(Usual(), None, 25)
    biased, named = after(unseen, (2.0, 0.1), 40)
    assert not named
    assert (biased.n, biased.sides, biased.ahead) == (65, 40, pytest.approx(2.0))
    assert after(biased, (4.0, 0.1), 1)[1]


@pytest.mark.parametrize(("side_m_s2", "lost"), [(7.0, False), (9.0, True)])
def test_the_drag_of_a_wind_that_takes_the_whole_tilt_is_no_fault(side_m_s2: float, lost: bool) -> None:
    """WHY: in 11 m/s of wind a drag of 6.2 m/s^2 was taken for a lying accelerometer, and the estimate began anew."""
    state, rng, lean = Inertial(), np.random.default_rng(3), Rotation.from_rpy(0.0, -0.5, 0.0)
    for n in range(200):
        stamp = Stamp(MonoNs(n * 10**7), MonoNs(n * 10**7), 0.001, "sim")
        f = np.array([side_m_s2, 0.0, -9.0]) + 0.1 * rng.standard_normal(3)
        state, _ = inertial.felt(state, Imu(stamp, 0.01 * rng.standard_normal(3), f), OPTIONS, True)
        turned = lean @ Rotation.from_rotvec(0.002 * rng.standard_normal(3))
        state = inertial.levelled(state, Attitude(stamp, turned, 1e-4 * np.eye(3)), True)
    assert (state.accel_fault is not None) is lost
