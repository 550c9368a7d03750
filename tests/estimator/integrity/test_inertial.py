"""Gyro, accelerometer, attitude and velocity against each other and the pad's sightings (own truth); frozen halves."""

import math
from collections import deque
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.integrity import inertial, parity
from estimator.integrity.inertial import Differences, Inertial, Usual
from estimator.integrity.options import IntegrityOptions
from estimator.integrity.parity import Bin, Half, Slope, TurnByAttitude, Vec3, read_half, replace_halves, turn_between
from tests.make import attitude, imu, stamp, velocity

OPTIONS = IntegrityOptions()
DT, BEGIN_S, LATE_S = 0.01, 2.0, 0.12
G = np.array([0.0, 0.0, -9.81])
NONE: Vec3 = (0.0, 0.0, 0.0)
Change = Callable[[F64], F64]


def put(state: Inertial, t_s: float, w: F64, f: F64, R: Rotation | None = None) -> Inertial:
    """Return the state after an IMU sample and an attitude of one instant."""
    state, _ = inertial.felt(state, imu(t_s, w, f), OPTIONS, True)
    return state if R is None else inertial.levelled(state, Attitude(stamp(t_s), R, 1e-4 * np.eye(3)), True)


# Gyro and attitude


def body(t: float) -> Rotation:
    return Rotation.from_rpy(0.15 * math.sin(4.0 * t), 0.12 * math.sin(3.1 * t + 1.0), 0.3 + 0.1 * math.sin(0.5 * t))


def deck(t: float) -> Rotation:
    return Rotation.from_rpy(0.06 * math.sin(0.8 * t), 0.04 * math.cos(0.7 * t), 1.0)


def plain(x: F64) -> F64:
    return x


def turned(
    gyro: Change = plain,
    tilt: Change = plain,
    until: float = 5.0,
    seen: bool = True,
    well_from: float = math.inf,
    heading: Callable[[float], float] = lambda lies_s: 0.0,
) -> list[Inertial]:
    """Return the states every `DT` of a body that sways over a deck that rolls.

    Args:
        gyro: what it makes of its rates, rad/s, from `BEGIN_S` on.
        tilt: what the attitude makes of roll and pitch, rad.
        well_from: from when on both are well again, s.
        heading: what is added to the heading, rad, by the time for which it lies, s. The pictures' attitude has the right one.
    """
    rng, state, out, frames, reported = np.random.default_rng(5), Inertial(), [], list[float](), {}
    for n in range(round(until / DT)):
        t = n * DT
        lies = BEGIN_S <= t < well_from
        w = (body(t - DT).inv @ body(t)).rotvec_rad / DT + 0.01 * rng.standard_normal(3)
        f = G + 0.1 * rng.standard_normal(3)
        roll, pitch, yaw = body(t).rpy_rad
        if lies:
            roll, pitch = tilt(np.array([roll, pitch]))
            yaw += heading(t - BEGIN_S)
        R = reported[n] = Rotation.from_rpy(roll, pitch, yaw) @ Rotation.from_rotvec(0.002 * rng.standard_normal(3))
        state = put(state, t, gyro(w) if lies else w, f, R)
        frames += [t] if n % 3 == 0 else []
        while seen and frames and frames[0] <= t - LATE_S:
            at = frames.pop(0)
            off_rad = heading(at - BEGIN_S) if BEGIN_S <= at < well_from else 0.0
            R_then = Rotation.from_rpy(0.0, 0.0, -off_rad) @ reported[round(at / DT)]
            R_pad = R_then @ body(at).inv @ deck(at) @ Rotation.from_rotvec(0.006 * rng.standard_normal(3))
            seen_now = parity.pictured(state.parity, round(at * 1e9), R_then.matrix, R_pad.matrix, off_rad)
            state = replace(state, parity=seen_now)
        out.append(state)
    return out


def named(states: list[Inertial]) -> tuple[str, float]:
    """Return who was named first, and how long after the fault's beginning."""
    first = next((n for n, state in enumerate(states) if state.lost), None)
    return ("", math.inf) if first is None else ("attitude" if states[first].attitude_fault else "gyro", first * DT - BEGIN_S)


FAULTS: dict[str, Change] = {
    "sign": lambda x: -x,
    "a third": lambda x: 0.334 * x,
    "frozen on an axis": lambda x: x * (np.arange(len(x)) != 0),
    "twice": lambda x: 2.0 * x,
    "in degrees": np.degrees,
    "swapped": lambda x: x[[1, 0, *range(2, len(x))]],
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("who", ["gyro", "attitude"])
def test_of_two_that_turn_apart_the_picture_names_the_one_that_lies(who: str, fault: str) -> None:
    states = turned(gyro=FAULTS[fault]) if who == "gyro" else turned(tilt=FAULTS[fault])
    found, after_s = named(states)
    assert (found, 0.0 < after_s < 1.0, len(states[-1].lost)) == (who, True, 1)


@pytest.mark.parametrize("leap_deg", [-40.0, 0.0, 120.0])
@pytest.mark.parametrize("drift_deg_s", [0.0, 20.0])
@pytest.mark.parametrize("seen", [True, False])
def test_a_heading_that_lies_says_nothing_of_roll_and_pitch(leap_deg: float, drift_deg_s: float, seen: bool) -> None:
    """WHY: beside a reversed velocity that tilted the drone, a compass 40 degrees off had a healthy gyro named in pitch."""
    states = turned(seen=seen, heading=lambda lies_s: math.radians(leap_deg + drift_deg_s * lies_s), until=8.0)
    assert {text for state in states for text in state.lost} == set()


def test_an_attitude_that_is_well_again_counts_again_and_the_filter_starts_again() -> None:
    states = turned(tilt=FAULTS["sign"], until=7.0, well_from=4.0)
    assert states[390].attitude_fault is not None
    assert states[-1].attitude_fault is None
    assert states[-1].named == 2, "once without it and once with it"


def test_without_pictures_a_gyro_that_turns_against_the_attitude_is_the_one() -> None:
    found, after_s = named(turned(gyro=FAULTS["sign"], seen=False))
    assert (found, after_s < 0.7) == ("gyro", True)


# Frozen halves


@pytest.mark.parametrize("turns", [False, True])
def test_an_axis_of_coarse_steps_that_repeats_itself_is_frozen_only_while_the_attitude_turns_otherwise(turns: bool) -> None:
    """ArduPilot's RAW_IMU has steps of 1 mrad/s: a steady heading repeats itself for longer than any limit."""
    rng, state, found = np.random.default_rng(5), Inertial(), False
    for n in range(400):
        yaw = 0.1 * math.sin(0.02 * n) if turns and n > 200 else 2e-6 * n
        w = np.round([*0.02 * rng.standard_normal(2), 0.003 * (n < 40 and n % 2)], 3)
        state = put(state, 0.01 * n, w, G + 0.1 * rng.standard_normal(3), Rotation.from_rpy(0.0, 0.0, yaw))
        found = found or bool(state.lost)
    assert found is turns


@pytest.mark.parametrize(
    ("axis", "value", "frozen_at"),
    [
        (2, lambda n: -9.8 + 0.1 * math.sin(n) if n < 100 else -9.8, 161),
        (2, lambda n: 0.0, None),
        *((axis, lambda n: 0.01 * (n % 7) if n < 100 else 0.21, 161) for axis in (0, 1)),
        *((axis, lambda n: 0.01 * (n % 7) if n < 100 else 0.0, None) for axis in (0, 1)),
    ],
    ids=["along the thrust", "an axis that it does not have", "across", "across too", "still air", "still air too"],
)
def test_one_frozen_axis_is_a_frozen_half_in_a_third_of_a_second(axis, value, frozen_at):
    rng, state, lost = np.random.default_rng(1), Inertial(), []
    for n in range(200):
        f = rng.standard_normal(3)
        f[axis] = value(n)
        state = put(state, 0.005 * n, rng.standard_normal(3), f)
        lost.append(state.accel_lost)
    assert any(lost) is (frozen_at is not None)
    assert frozen_at is None or abs(lost.index(True) - frozen_at) <= 2


def frozen_after(values: list[int], step_ms: int, flying: bool = True) -> list[bool]:
    """Return whether a half that reads these values counts as frozen after each."""
    half, found = Half(), []
    for n, value in enumerate(values):
        same, t = n > 0 and value == values[n - 1], n * step_ms * 1_000_000
        half = read_half(half, t - step_ms * 1_000_000 if same else None, t, 0.15, flying)
        found.append(half.frozen)
    return found


def lasting(*of_ms: int) -> list[int]:
    """Return values every 10 ms, of which each lasts so long."""
    return [n for n, ms in enumerate(of_ms) for _ in range(ms // 10)]


def test_a_half_that_repeats_itself_is_frozen_after_the_limit_and_back_at_once() -> None:
    found = frozen_after([0, 1, *[2] * 40, 3, 4], 5)
    assert found.index(True) in (32, 33), "150 ms after its first reading"
    assert (all(found[33:42]), found[-2:]) == (True, [False, False])
    assert not any(frozen_after([0] * 400, 5, flying=False)), "on the ground"
    assert not any(frozen_after([0, 0, 1, 1] * 100, 5)), "it toggles"
    assert not any(frozen_after(lasting(20, 60, 100, 140, 250, 400, 20), 10)), "each within three times the one before"
    assert any(frozen_after(lasting(20, 20, 250), 10))
    assert any(frozen_after(lasting(60, 100, 140, 1300), 10)), "nothing excuses a second"


@settings(max_examples=60)
@given(st.lists(st.floats(-0.4, 0.4), min_size=3, max_size=3), st.floats(-3.0, 3.0))
def test_the_turn_between_two_attitudes_is_their_rotation_vector(turn: list[float], yaw: float) -> None:
    first = Rotation.from_rpy(0.2, -0.1, yaw)
    a, b = (Attitude(stamp(5.0), R, 1e-4 * np.eye(3)) for R in (first, first @ Rotation.from_rotvec(np.array(turn))))
    assert turn_between(a, b) == pytest.approx(tuple(turn), abs=1e-9)


def test_a_lost_gyro_is_replaced_by_the_turn_of_the_attitude_while_there_is_one() -> None:
    turn = TurnByAttitude()
    for n in range(20):
        turn = turn.after(attitude(5.0 + 0.005 * n, roll=0.0025 * n))
    sample, late = imu(5.097, (9.0, 9.0, 9.0)), imu(5.4)
    left, accel = replace_halves(sample, 0.005, 0.0, turn), replace_halves(late, 0.0, 0.155, turn)
    assert left.w_body == pytest.approx((0.5, 0.0, 0.0), abs=1e-9)
    assert (left.gyro_lost_s, left.accel_lost_s, left.f_body is sample.f_body) == (0.005, 0.0, True)
    assert replace_halves(late, 0.005, 0.0, turn) is None, "nothing says how it turns by now"
    assert (accel.w_body is late.w_body, accel.accel_lost_s) == (True, 0.155)


# The accelerometer


def newest_bin(f: Vec3) -> Bin:
    return Bin(0, 0.1, NONE, NONE, NONE, NONE, NONE, f, (0.0, 0.0, 1.0), (1.0, 0.0))


@pytest.mark.parametrize(("f", "accused"), [((-2.0, 0.4, -9.8), True), ((0.1, 2.8, -9.8), False), ((2.2, 0.0, -9.8), False)])
def test_a_deck_that_moves_both_its_witnesses_accuses_no_accelerometer(f: Vec3, accused: bool) -> None:
    """Flow and sightings miss 2.2 m/s^2 ahead; an accelerometer that lies feels it the other way, and drag does not."""
    off = Differences(None, None, (2.2, 0.0))
    assert bool(inertial._accel_lies(off, Usual(n=20, sides=20), newest_bin(f))[0]) is accused


def test_a_bias_that_shows_late_is_usual_and_a_later_one_is_named() -> None:
    """WHY: in weather_4 the pad was out of sight for the first 2 s, and a bias of 1.8 m/s^2 took the accelerometer away."""
    usual, found = Usual(), []
    for side, bins in ((None, 25), ((2.0, 0.1), 40), ((4.0, 0.1), 1)):
        for _ in range(bins):
            off = Differences(Slope(0.1, 0.01), None, side)
            found.append(bool(inertial._accel_lies(off, usual, newest_bin((-2.5, 0.0, -9.8)))[0]))
            usual = usual if found[-1] else usual.after(off)
    assert found == [False] * 65 + [True]
    assert (usual.n, usual.sides, usual.ahead) == (65, 40, pytest.approx(2.0))


@pytest.mark.parametrize(("side_m_s2", "lost"), [(7.0, False), (9.0, True)])
def test_the_drag_of_a_wind_that_takes_the_whole_tilt_is_no_fault(side_m_s2: float, lost: bool) -> None:
    """WHY: in 11 m/s of wind a drag of 6.2 m/s^2 was taken for a lying accelerometer, and the estimate began again."""
    state, rng, lean = Inertial(), np.random.default_rng(3), Rotation.from_rpy(0.0, -0.5, 0.0)
    for n in range(200):
        f = np.array([side_m_s2, 0.0, -9.0]) + 0.1 * rng.standard_normal(3)
        R = lean @ Rotation.from_rotvec(0.002 * rng.standard_normal(3))
        state = put(state, 0.01 * n, 0.01 * rng.standard_normal(3), f, R)
    assert (state.accel_fault is not None) is lost


# The velocity

LIES_FROM_S = 3.0
Lie = Callable[[F64, float], F64]


def honest(v: F64, lies_s: float) -> F64:
    return v


def moved(
    lie: Lie,
    *,
    seen: bool,
    blind_from: float = math.inf,
    size_m_s: float = 0.8,
    deck_m_s: float = 0.0,
    off: tuple[F64, float] = (np.zeros(3), 0.0),
    until: float = 9.0,
    seed: int = 1,
) -> list[Inertial]:
    """Return the states every `DT` of a body that swings to and fro over a deck that does.

    Args:
        lie: what the sensor makes of the velocity against the deck, (2,) m/s, by the time for which it lies, s.
        seen: the pad's sightings come, 33 a second, until `blind_from`, s.
        deck_m_s: size of the deck's own swing.
        off: what is added to the specific force, (3,) m/s^2, and from when on, s.
    """
    rng, state, out, p = np.random.default_rng(seed), Inertial(), list[Inertial](), np.zeros(2)
    for n in range(round(until / DT)):
        t = n * DT
        phases = np.array([1.7 * t, 1.3 * t + 1.0])
        own, a = size_m_s * np.sin(phases), size_m_s * np.array([1.7, 1.3]) * np.cos(phases)
        v = own - deck_m_s * np.sin(0.8 * t + np.array([0.3, 1.4]))
        p = p + v * DT
        f = np.array([*a, -9.81]) + 0.1 * rng.standard_normal(3) + (off[0] if t >= off[1] else 0.0)
        state = put(state, t, 0.01 * rng.standard_normal(3), f)
        v = lie(v, t - LIES_FROM_S) if t >= LIES_FROM_S else v
        sample = velocity(t, (*(v + 0.05 * rng.standard_normal(2)), 0.0), var=(0.01, 0.01, 1e6))
        state = replace(state, parity=parity.moved(state.parity, sample))
        level = Attitude(stamp(t), Rotation.from_rotvec(0.002 * rng.standard_normal(3)), 1e-4 * np.eye(3))
        state = inertial.levelled(state, level, True)
        if seen and n % 3 == 0 and t < blind_from:
            x, y = (-p + 0.01 * rng.standard_normal(2)).tolist()
            state = replace(state, parity=parity.sighted(state.parity, stamp(t).measured_at, (x, y, 2.0), 0.0))
        out.append(state)
    return out


def named_after_s(states: list[Inertial]) -> float:
    return next((n * DT - LIES_FROM_S for n, state in enumerate(states) if state.velocity_fault is not None), math.inf)


LIES: dict[str, Lie] = {
    "sign": lambda v, t: -v,
    "swapped": lambda v, t: v[::-1] * (1.0, -1.0),
    "runs away": lambda v, t: v * max(-1.0, 1.0 - t),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("seen", [True, False])
@pytest.mark.parametrize("off_m_s2", [0.0, 0.9])
def test_a_velocity_against_the_accelerometer_is_named_within_two_seconds(lie: str, seen: bool, off_m_s2: float) -> None:
    states = moved(LIES[lie], seen=seen, off=(np.array([0.0, off_m_s2, 0.0]), 0.0))
    assert 0.0 < named_after_s(states) < 2.5
    (text,) = states[-1].lost
    assert text.startswith("the velocity")
    assert (states[-1].named > 0) is not seen, "out of sight the estimate has followed it, and begins again"


@settings(max_examples=15, deadline=None)
@given(st.floats(0.0, 1.2), st.floats(0.0, 0.8), st.floats(-1.1, 1.1), st.booleans(), st.integers(0, 99))
def test_an_honest_velocity_is_never_named_over_a_deck_that_sways_nor_for_an_attitude_that_errs(
    size_m_s, deck_m_s, off_m_s2, seen, seed
):
    off = np.array([0.0, off_m_s2, 0.0]), 0.0
    states = moved(honest, seen=seen, size_m_s=size_m_s, deck_m_s=deck_m_s, off=off, until=6.0, seed=seed)
    assert named_after_s(states) == math.inf


@pytest.mark.parametrize(("size_m_s", "since"), [(0.8, LIES_FROM_S), (0.1, 0.0)])
def test_an_accelerometer_that_lies_in_sight_leaves_the_velocity_alone(size_m_s: float, since: float) -> None:
    states = moved(honest, seen=True, size_m_s=size_m_s, off=(np.array([2.5, 0.0, 0.0]), since), blind_from=4.5)
    assert named_after_s(states) == math.inf, "nor out of sight soon after"


def test_a_late_velocity_is_named_once_it_swings_the_vehicle() -> None:
    """Its share of the integral's swing is of the right sign; in clean flights the difference is a third of this one's."""
    late = deque([np.zeros(2)] * 50)

    def half_a_second_old(v: F64, t: float) -> F64:
        late.append(v)
        return late.popleft()

    assert named_after_s(moved(half_a_second_old, seen=False, size_m_s=2.0)) < 3.0


def test_a_deck_that_ends_below_makes_a_leap_and_no_lie() -> None:
    assert named_after_s(moved(lambda v, t: v + np.array([4.0, 0.0]), seen=False)) == math.inf


def test_a_naming_is_withdrawn_when_the_velocity_agrees_again() -> None:
    states = moved(lambda v, t: -v if t < 2.5 else v, seen=True, until=12.0)
    assert states[round(5.4 / DT)].velocity_fault is not None
    assert states[-1].velocity_fault is None
