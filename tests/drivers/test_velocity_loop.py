import math
from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.velocity_loop import RESET, LoopState, Sticks, VelocityLoop, held, lean, step
from estimator.contracts.commands import Lean, Velocity
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp

OPTIONS = ArDroneOptions()
STILL = np.zeros(3)


def wanted(forward: float = 0.0, right: float = 0.0, down: float = 0.0, yaw_rate_rad_s: float = 0.0) -> Velocity:
    return Velocity(np.array([forward, right, down]), yaw_rate_rad_s)


def sticks(command: Velocity, v_level: F64 = STILL, state: LoopState = RESET) -> Sticks:
    return step(state, command, v_level, None, 0.0, OPTIONS)[1]


def forward_speed(
    target: float, *, speed_rad_s: float = 3.16, damping: float = 0.79, delay_s: float = 0.09, reads: float = 1.0,
    wind_m_s: float = 0.0, kick_m_s: float = 0.0,
) -> F64:  # fmt: skip
    """Forward speed over 12 s at 200 Hz of a point mass with drag, a second-order tilt and a late velocity sensor.

    Args:
        delay_s: of motors, link and sensor together; half of it is the sensor's, a tilt is read as late.
    """
    dt, v, tilt, rate = 0.005, kick_m_s, 0.0, 0.0
    seen, asked = deque([(v, 0.0)] * round(0.5 * delay_s / dt)), deque([0.0] * round(0.5 * delay_s / dt))
    state, out, stick = RESET, [], 0.0
    for k in range(2400):
        if k % 6 == 0:
            read, a_level = np.array([seen[0][0] * reads, 0.0, 0.0]), np.array([seen[0][1], 0.0])
            state, s = step(state, wanted(target), read, a_level, 0.03, OPTIONS)
            stick = -s.pitch * OPTIONS.euler_angle_max_rad
        asked.append(stick)
        rate += (speed_rad_s**2 * (asked.popleft() - tilt) - 2.0 * damping * speed_rad_s * rate) * dt
        tilt += rate * dt
        v += (9.80665 * math.tan(tilt) - 0.43 * (v - wind_m_s)) * dt
        seen.append((v, 9.80665 * math.tan(tilt)))
        seen.popleft()
        out.append(v)
    return np.array(out)


def test_signs() -> None:
    assert sticks(wanted(forward=0.5)).pitch < 0
    assert sticks(wanted(right=0.5)).roll > 0
    assert sticks(wanted(down=0.5)).gaz == pytest.approx(-0.5 / OPTIONS.vz_max_m_s)
    assert sticks(wanted(yaw_rate_rad_s=OPTIONS.yaw_rate_max_rad_s / 4)).yaw == pytest.approx(0.25)
    back = sticks(wanted(), np.array([0.3, -0.3, 9.0]))
    assert back.pitch > 0
    assert back.roll > 0
    assert back.gaz == 0.0


@pytest.mark.parametrize("target", [0.2, 0.4, 1.0, -0.4])
def test_a_step_is_reached_quickly_and_held(target: float) -> None:
    v = forward_speed(target) / target
    assert np.argmax(v > 0.9) * 0.005 < 1.2
    assert v.max() < 1.35
    assert v[-200:] == pytest.approx(np.ones(200), abs=0.02)


@pytest.mark.parametrize("speed_rad_s", [2.5, 3.16, 3.8])
@pytest.mark.parametrize("damping", [0.6, 0.79, 1.0])
@pytest.mark.parametrize("delay_s", [0.09, 0.14])
def test_a_drone_unlike_its_file_comes_to_rest(speed_rad_s: float, damping: float, delay_s: float) -> None:
    """Two standard deviations of what an owner's identification leaves."""
    v = forward_speed(0.0, speed_rad_s=speed_rad_s, damping=damping, delay_s=delay_s, kick_m_s=0.5)
    assert np.abs(v[-200:]).max() < 0.1


@pytest.mark.parametrize(("speed_rad_s", "damping"), [(8.0, 0.6), (11.5, 0.65), (14.0, 0.5), (20.0, 0.7)])
def test_commands_that_come_late_make_no_quadcopter_swing(speed_rad_s: float, damping: float) -> None:
    """A lead of 1.2 and commands .12 s late made one lean by 67 degrees, and its firmware cut the motors."""
    v = forward_speed(0.0, speed_rad_s=speed_rad_s, damping=damping, delay_s=0.24, kick_m_s=0.8, wind_m_s=-6.0)
    assert np.ptp(v[-400:]) < 0.07, "what is left is the integral's"


@settings(max_examples=200)
@given(*[st.floats(-20, 20)] * 5, st.floats(0, 1))
def test_sticks_stay_inside_and_tilt_keeps_its_direction(vx, vy, vz, mx, my, dt_s):
    state = RESET
    for _ in range(5):
        state, s = step(state, wanted(vx, vy, vz, 50.0), np.array([mx, my, 0.0]), None, dt_s, OPTIONS)
        assert math.hypot(s.roll, s.pitch) <= 1.0 + 1e-9
        assert max(abs(s.gaz), abs(s.yaw)) <= 1.0
        assert math.hypot(state.forward_m_s2, state.right_m_s2) <= 9.80665 * math.tan(OPTIONS.euler_angle_max_rad) + 1e-9
    first = sticks(wanted(vx, vy), np.array([mx, my, 0.0]))
    push = OPTIONS.velocity_gain_1_s * np.array([vx - mx, vy - my]) + OPTIONS.velocity_drag_1_s * np.array([vx, vy])
    assert -first.pitch * push[1] == pytest.approx(first.roll * push[0], abs=1e-6)


@given(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_a_tilt_follows_from_its_acceleration_and_never_exceeds_the_limit(forward, right, trim_forward, trim_right):
    wanted = Lean(np.array([forward, right]), np.array([trim_forward, trim_right]), np.zeros(3), 0.0)
    _, s = lean(wanted, None, OPTIONS)
    tilt = math.hypot(s.roll, s.pitch) * OPTIONS.euler_angle_max_rad
    size = math.hypot(forward + trim_forward, right + trim_right)
    assert tilt == pytest.approx(min(math.atan(size / 9.80665), OPTIONS.euler_angle_max_rad), abs=1e-9)
    assert s.pitch * (forward + trim_forward) <= 1e-12
    assert s.roll * (right + trim_right) >= -1e-12


@pytest.mark.parametrize(("heading", "forward", "right"), [(0.0, 1.2, 0.4), (math.pi / 2, 0.4, -1.2), (math.pi, -1.2, -0.4)])
def test_a_velocity_after_a_tilt_begins_with_its_trim_wherever_the_nose_has_turned(heading, forward, right):
    """Otherwise the wind carries the drone off for as long as an integral takes to come back."""
    state, _ = lean(Lean(np.zeros(2), np.array([1.2, 0.4]), np.zeros(3), 0.0), 0.0, OPTIONS)
    _, s = step(state.at_heading(heading), wanted(), STILL, None, 0.0, OPTIONS)
    size = math.hypot(1.2, 0.4)
    share = math.atan(size / 9.80665) / OPTIONS.euler_angle_max_rad / size
    assert (-s.pitch, s.roll) == pytest.approx((forward * share, right * share))


_AXIS = st.floats(-3.5, 3.5)


@given(_AXIS, _AXIS, st.floats(-1.5, 1.5), st.floats(2.0, 8.0), st.integers(0, 2**32 - 1))
def test_a_velocity_after_a_hover_begins_with_the_tilt_that_held_against_the_wind(forward, right, moves_m_s, for_s, seed):
    """An integral that begins with nothing takes seconds, and the drone is metres to lee by then."""
    against, dt, noise = np.array([forward, right]), 0.03, np.random.default_rng(seed)
    state, before = RESET, np.array([moves_m_s, 0.0])
    for k in range(round(for_s / dt)):
        v = np.array([moves_m_s * math.exp(-k * dt), 0.0])
        swings = 0.3 * math.sin(4.0 * k * dt) + noise.normal(0.0, 0.1, 2)
        tilt = against + OPTIONS.velocity_drag_1_s * v + (v - before) / dt + swings
        state = held(state, v, before, tilt, min(2.0, (k + 1) * dt), dt, OPTIONS)
        before = v
    assert (state.forward_m_s2, state.right_m_s2) == pytest.approx(against.tolist(), abs=0.2)
    _, s = step(state, wanted(), before, None, 0.0, OPTIONS)
    assert math.hypot(s.roll, s.pitch) * OPTIONS.euler_angle_max_rad >= math.atan(math.hypot(*against) / 9.80665) - 0.12


@given(_AXIS, _AXIS, st.floats(-8.0, 8.0), st.floats(-8.0, 8.0))
def test_at_the_limit_the_tilt_against_the_wind_is_kept(trim_forward: float, trim_right: float, vx: float, vy: float) -> None:
    _, s = step(LoopState(trim_forward, trim_right), wanted(), np.array([vx, vy, 0.0]), None, 0.03, OPTIONS)
    tilt = math.hypot(s.roll, s.pitch) * OPTIONS.euler_angle_max_rad
    flown = 9.80665 * math.tan(tilt) * np.array([-s.pitch, s.roll]) / max(1e-9, math.hypot(s.roll, s.pitch))
    more = flown - np.array([trim_forward, trim_right])
    assert float(more @ np.array([-vx, -vy])) >= -1e-3, "what is left brakes, and takes nothing from the trim"


def test_a_climb_without_a_service_leans_as_the_wind_asked_for_and_not_as_feet_on_a_deck_did() -> None:
    loop, at = VelocityLoop(OPTIONS), 0
    for trim, cycles in (2.0, 100), (6.0, 5):
        for _ in range(cycles):
            at += 30_000_000
            now = MonoNs(at)
            loop.on_sample(Attitude(Stamp(now, now, 0.001, "navdata"), Rotation.from_rpy(0.0, 0.0, 0.0), 1e-4 * np.eye(3)))
            loop.fly(Lean(np.zeros(2), np.array([trim, 0.0]), np.zeros(3), 0.0), now)
    leans = -loop.climb().pitch * OPTIONS.euler_angle_max_rad
    assert math.atan(2.0 / 9.80665) <= leans < math.atan(2.5 / 9.80665)


@given(st.floats(0.0, 1.0), st.floats(0.0, 40.0), st.floats(-math.pi, math.pi), st.floats(-2.0, 2.0))
def test_a_drone_that_leans_far_against_its_order_turns_level_before_it_climbs(ordered, leans_deg, off_rad, down):
    """A rotor at 70 % and a go-around with all thrust: 4 of 8 tipped over within .5 s, .2 m over the deck."""
    now, leans = MonoNs(10**9), math.radians(leans_deg)
    R = Rotation.from_rpy(leans * math.sin(off_rad), -leans * math.cos(off_rad), 0.0)
    loop = VelocityLoop(OPTIONS)
    loop.on_sample(Attitude(Stamp(now, now, 0.001, "navdata"), R, 1e-4 * np.eye(3)))
    order = Lean(np.array([3.0 * ordered, 0.0]), np.zeros(2), np.array([0.0, 0.0, down]), 0.0)
    found, plain = loop.fly(order, now), lean(order, 0.0, OPTIONS)[1]
    assert (found.roll, found.pitch) == (plain.roll, plain.pitch)
    far, against = leans_deg > 22.0, ordered > 0.01 and math.cos(off_rad) < -0.1
    if far and against and down < -0.5:
        assert 0.0 < found.gaz < plain.gaz / 1.5
    elif leans_deg < 18.0 or not (ordered > 0.0 and math.cos(off_rad) < 0.1) or down >= 0.0:
        assert found.gaz == plain.gaz
