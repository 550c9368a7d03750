"""Gyro, accelerometer, attitude and velocity against each other and the pad's sightings (own truth); frozen halves."""

import math
from collections import deque
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, BodyVelocity, Imu
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity import inertial
from estimator.integrity.inertial import Differences, Inertial, Usual
from estimator.integrity.options import IntegrityOptions
from estimator.integrity.parity import Bin, Half, Slope, TurnByAttitude, Vec3, read_half, replace_halves, turn_between
from tests.make import stamp_at

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


VELOCITY_DT, VELOCITY_BEGIN_S = 0.01, 3.0


Change_velocity = Callable[[F64, float], F64]


def flown_velocity(
    velocity: Change_velocity,
    *,
    seen: bool,
    blind_from: float = math.inf,
    size_m_s: float = 0.8,
    deck_m_s: float = 0.0,
    accelerometer: F64 | None = None,
    since: float = VELOCITY_BEGIN_S,
    until: float = 9.0,
    seed: int = 1,
) -> list[Inertial]:
    """Return the states of a body that swings to and fro over a deck that does, every `VELOCITY_DT`.

    Args:
        velocity: what the sensor makes of the velocity against the deck, (2,) m/s, with the time for which it lies, s.
        seen: the pad's sightings come, 30 a second, until `blind_from`, s.
        deck_m_s: size of the deck's own swing.
        accelerometer: what it adds to the specific force from `since` on, s, (3,) m/s^2.
    """
    rng, state, out = np.random.default_rng(seed), Inertial(), list[Inertial]()
    p = np.zeros(2)
    for n in range(round(until / VELOCITY_DT)):
        t = n * VELOCITY_DT
        stamp = Stamp(MonoNs(round(t * 1e9)), MonoNs(round(t * 1e9)), 0.001, "sim")
        phases = np.array([1.7 * t, 1.3 * t + 1.0])
        own, a = size_m_s * np.sin(phases), size_m_s * np.array([1.7, 1.3]) * np.cos(phases)
        deck = deck_m_s * np.sin(0.8 * t + np.array([0.3, 1.4]))
        p = p + (own - deck) * VELOCITY_DT
        f = np.array([*a, -9.81]) + 0.1 * rng.standard_normal(3)
        if accelerometer is not None and t >= since:
            f = f + accelerometer
        state, _ = inertial.felt(state, Imu(stamp, 0.01 * rng.standard_normal(3), f), OPTIONS, True)
        v = own - deck
        v = velocity(v, t - VELOCITY_BEGIN_S) if t >= VELOCITY_BEGIN_S else v
        state = inertial.moved(
            state, BodyVelocity(stamp, np.array([*(v + 0.05 * rng.standard_normal(2)), 0.0]), np.diag([0.01] * 2 + [1e6]))
        )
        attitude = Rotation.from_rotvec(0.002 * rng.standard_normal(3))
        state = inertial.levelled(state, Attitude(stamp, attitude, 1e-4 * np.eye(3)), True)
        if seen and n % 3 == 0 and t < blind_from:
            at = tuple((-p + 0.01 * rng.standard_normal(2)).tolist())
            state = inertial.sighted(state, stamp.measured_at, (*at, 2.0), 0.0)
        out.append(state)
    return out


def named_after_s(states: list[Inertial]) -> float:
    return next(
        (n * VELOCITY_DT - VELOCITY_BEGIN_S for n, state in enumerate(states) if state.velocity_fault is not None), math.inf
    )


LIES: dict[str, Change_velocity] = {
    "sign": lambda v, t: -v,
    "swapped": lambda v, t: v[::-1] * (1.0, -1.0),
    "runs away": lambda v, t: v * max(-1.0, 1.0 - t),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("seen", [True, False])
@pytest.mark.parametrize("off_m_s2", [0.0, 0.9])
def test_a_velocity_against_the_accelerometer_is_named_within_two_seconds(lie: str, seen: bool, off_m_s2: float) -> None:
    states = flown_velocity(LIES[lie], seen=seen, accelerometer=np.array([0.0, off_m_s2, 0.0]), since=0.0)
    assert 0.0 < named_after_s(states) < 2.5
    (text,) = states[-1].lost
    assert text.startswith("the velocity")
    assert (states[-1].named > 0) is not seen, "out of sight the estimate has followed it, and begins again"


@settings(max_examples=15, deadline=None)
@given(st.floats(0.0, 1.2), st.floats(0.0, 0.8), st.floats(-1.1, 1.1), st.booleans(), st.integers(0, 99))
def test_an_honest_velocity_is_never_named_over_a_deck_that_sways_nor_for_an_attitude_that_errs(
    size_m_s, deck_m_s, off_m_s2, seen, seed
):
    off = np.array([0.0, off_m_s2, 0.0])
    states = flown_velocity(
        lambda v, t: v, seen=seen, size_m_s=size_m_s, deck_m_s=deck_m_s, accelerometer=off, since=0.0, until=6.0, seed=seed
    )
    assert named_after_s(states) == math.inf


@pytest.mark.parametrize(("size_m_s", "since"), [(0.8, VELOCITY_BEGIN_S), (0.1, 0.0)])
def test_an_accelerometer_that_lies_in_sight_leaves_the_velocity_alone(size_m_s: float, since: float) -> None:
    lies = np.array([2.5, 0.0, 0.0])
    states = flown_velocity(lambda v, t: v, seen=True, size_m_s=size_m_s, accelerometer=lies, since=since, blind_from=4.5)
    assert named_after_s(states) == math.inf, "nor out of sight soon after"


def test_a_late_velocity_is_named_once_it_swings_the_vehicle() -> None:
    """Its share of the integral's swing is of the right sign; in clean flights the difference is a third of this one's."""
    late = deque([np.zeros(2)] * 50)

    def half_a_second_old(v: F64, t: float) -> F64:
        late.append(v)
        return late.popleft()

    assert named_after_s(flown_velocity(half_a_second_old, seen=False, size_m_s=2.0)) < 3.0


def test_a_deck_that_ends_below_makes_a_leap_and_no_lie() -> None:
    states = flown_velocity(lambda v, t: v + np.array([4.0, 0.0]), seen=False)
    assert named_after_s(states) == math.inf


def test_a_naming_is_withdrawn_when_the_velocity_agrees_again() -> None:
    states = flown_velocity(lambda v, t: -v if t < 2.5 else v, seen=True, until=12.0)
    assert states[round(5.4 / VELOCITY_DT)].velocity_fault is not None
    assert states[-1].velocity_fault is None


MS = 1_000_000


T = 5_000_000_000


def attitude(t: int, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Attitude:
    return Attitude(stamp_at(t), Rotation.from_rpy(roll, pitch, yaw), 1e-4 * np.eye(3))


def frozen_after(values: list[bytes], step_ms: int, flying: bool = True) -> list[bool]:
    half, found, step = Half(), [], step_ms * MS
    for n, value in enumerate(values):
        same = n > 0 and value == values[n - 1]
        half = read_half(half, T + (n - 1) * step if same else None, T + n * step, 0.15, flying)
        found.append(half.frozen)
    return found


def test_a_half_that_repeats_itself_is_frozen_after_the_limit_and_back_at_once() -> None:
    found = frozen_after([b"a", b"b", *[b"c"] * 40, b"d", b"e"], 5)
    assert found.index(True) in (2 + 30, 2 + 31), "150 ms after its first reading"
    assert found[-2:] == [False, False]
    assert all(found[33:42])


def test_what_stands_on_the_ground_repeats_itself_and_is_not_frozen() -> None:
    assert not any(frozen_after([b"a"] * 400, 5, flying=False))


def test_readings_that_toggle_between_two_values_are_not_frozen() -> None:
    assert not any(frozen_after([b"a", b"a", b"b", b"b"] * 100, 5))


def test_a_sensor_of_coarse_steps_gets_the_time_that_it_has_needed_before() -> None:
    def runs(*of_ms: int) -> list[bytes]:
        return [bytes([n]) for n, ms in enumerate(of_ms) for _ in range(ms // 10)]

    assert not any(frozen_after(runs(20, 60, 100, 140, 250, 400, 20), 10)), "each longer one within three times the one before"
    assert any(frozen_after(runs(20, 20, 250), 10))
    assert any(frozen_after(runs(60, 100, 140, 1300), 10)), "nothing excuses a second"


@settings(max_examples=60)
@given(st.lists(st.floats(-0.4, 0.4), min_size=3, max_size=3), st.floats(-3.0, 3.0))
def test_the_turn_between_two_attitudes_is_their_rotation_vector(turn: list[float], yaw: float) -> None:
    first = Rotation.from_rpy(0.2, -0.1, yaw)
    second = first @ Rotation.from_rotvec(np.array(turn))
    a, b = (Attitude(stamp_at(T), R, 1e-4 * np.eye(3)) for R in (first, second))
    assert turn_between(a, b) == pytest.approx(tuple(turn), abs=1e-9)


def test_a_lost_gyro_is_replaced_by_the_turn_of_the_attitude_while_there_is_one() -> None:
    turn = TurnByAttitude()
    for n in range(20):
        turn = turn.after(attitude(T + 5 * n * MS, roll=0.5 * 0.005 * n))
    imu = Imu(stamp_at(T + 97 * MS), np.array([9.0, 9.0, 9.0]), np.array([0.1, 0.2, -9.8]))
    left = replace_halves(imu, 0.005, 0.0, turn)
    assert left is not None
    assert left.w_body == pytest.approx((0.5, 0.0, 0.0), abs=1e-9)
    assert (left.gyro_lost_s, left.accel_lost_s) == (0.005, 0.0)
    assert left.f_body is imu.f_body
    late = Imu(stamp_at(T + 400 * MS), imu.w_body, imu.f_body)
    assert replace_halves(late, 0.005, 0.0, turn) is None, "nothing says how it turns by now"
    accel = replace_halves(late, 0.0, 0.155, turn)
    assert accel is not None
    assert accel.w_body is imu.w_body
    assert math.isclose(accel.accel_lost_s, 0.155)
