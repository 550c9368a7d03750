import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from companion.guidance.controller import Knowledge, Target
from companion.guidance.law.pid import Pid, PidController
from companion.settings.guidance import HeadingGains, HorizontalGains, PidOptions, VerticalGains
from estimator.contracts.commands import Hover, Velocity
from estimator.contracts.geometry import wrap_pi
from tests.make import estimate, ns

TURN_MAX_RAD_S = math.radians(34.4)
P_ONLY = PidOptions(HorizontalGains(1.0, 0.0, 0.0), VerticalGains(1.0, 0.0, 0.0), HeadingGains(1.0, 0.0))


def above(height, yaw=None):
    return Target(np.array([0.0, 0.0, height]), yaw_rad=yaw)


def stepped(state, t, seen, target, gains=None):
    return PidController(gains or PidOptions()).step(state, ns(t), Knowledge(ns(t), seen), target)


def test_flies_towards_where_the_set_point_wants_it():
    """Pad ahead and to starboard, drone too high: forward, right, down."""
    _, u = stepped(Pid(), 1, estimate(1, [0.5, 0.2, 2.3]), above(2.0), P_ONLY)
    np.testing.assert_allclose(u.v_level, [0.5, 0.2, 0.3])
    assert u.yaw_rate_rad_s == 0.0


def test_limits_hold_and_keep_the_horizontal_direction():
    _, u = stepped(Pid(), 1, estimate(1, [30, 40, 9]), above(2.0), P_ONLY)
    np.testing.assert_allclose(u.v_level, [0.6, 0.8, 0.5])
    _, u = stepped(Pid(), 1, estimate(1, [0, 0, 0.5]), above(2.0), structs.replace(P_ONLY, climb_max_m_s=0.3))
    assert u.v_level[2] == pytest.approx(-0.3)


def test_the_derivative_acts_on_the_measurement_per_second():
    gains = PidOptions(HorizontalGains(0.0, 0.0, 0.5), VerticalGains(0.0, 0.0, 0.5), HeadingGains(0.0, 0.0))
    state, u = stepped(Pid(), 1, estimate(1, [1, 0, 2], v=[-0.4, 0, 0.2]), above(2.0), gains)
    np.testing.assert_allclose(u.v_level, [-0.2, 0, 0.1])
    _, kicked = stepped(state, 1.01, estimate(1.01, [1, 0, 2], v=[-0.4, 0, 0.2]), above(1.0), gains)
    np.testing.assert_allclose(kicked.v_level, u.v_level)


@pytest.mark.parametrize("rate_hz", [10, 50, 100])
def test_the_integral_is_per_second_whatever_the_rate(rate_hz):
    gains = PidOptions(HorizontalGains(0.0, 0.1, 0.0), VerticalGains(0.0, 0.0, 0.0), HeadingGains(0.0, 0.0))
    state = Pid()
    for i in range(2 * rate_hz + 1):
        state, u = stepped(state, i / rate_hz, estimate(i / rate_hz, [1, 0, 2]), above(2.0), gains)
    assert u.v_level[0] == pytest.approx(0.2, rel=0.06)


def test_no_wind_up_behind_a_limit():
    state = Pid()
    for i in range(500):
        state, _ = stepped(state, i * 0.02, estimate(i * 0.02, [20, 0, 9]), above(2.0), PidOptions())
    np.testing.assert_array_equal(state.integral, 0.0)
    _, back = stepped(state, 10, estimate(10, [-0.1, 0, 1.9]), above(2.0), PidOptions())
    assert back.v_level[0] < 0
    assert back.v_level[2] < 0


@given(st.floats(-math.pi, math.pi), st.floats(-10, 10))
def test_heading_turns_the_short_way(yaw, wanted):
    _, u = stepped(Pid(), 1, estimate(1, [0, 0, 2], yaw=yaw), above(2.0, yaw=wanted), P_ONLY)
    error = wrap_pi(wanted - yaw)
    assert u.yaw_rate_rad_s == pytest.approx(np.clip(error, -TURN_MAX_RAD_S, TURN_MAX_RAD_S), abs=1e-9)


def test_without_an_estimate_it_hovers_with_frozen_integrals_and_after_a_long_silence_they_start_again():
    state = Pid(np.ones(4), ns(0))
    assert PidController(PidOptions()).step(state, ns(3), Knowledge(ns(3), None), above(2.0)) == (state, Hover())
    back, _ = stepped(state, 3, estimate(3, [0, 0, 2]), above(2.0))
    np.testing.assert_array_equal(back.integral, 0.0)


def fly_pid(d0, pad_v=(0.0, 0.0, 0.0), wind=(0.0, 0.0, 0.0), gains=None, seconds=30.0, lag_s=0.3, delay_s=0.15):
    """Return a vehicle that follows its command with a first-order lag, off by `wind`; the controller sees it `delay_s` late."""
    gains = gains or PidOptions()
    dt, state, v, d = 0.02, Pid(), np.zeros(3), np.array(d0, float)
    seen = [(d.copy(), np.array(pad_v) - v)] * (round(delay_s / dt) + 1)
    track = []
    for i in range(round(seconds / dt)):
        d_seen, v_seen = seen.pop(0)
        state, u = stepped(state, i * dt, estimate(i * dt, d_seen, v_seen, age=delay_s), above(2.0), gains)
        assert isinstance(u, Velocity)
        v = v + (u.v_level + np.array(wind) - v) * dt / lag_s
        d = d + (np.array(pad_v) - v) * dt
        seen.append((d.copy(), np.array(pad_v) - v))
        track.append(d.copy())
    return np.array(track)


def test_a_step_settles_without_ringing():
    track = fly_pid([3.0, -2.0, 5.0])
    error = track - [0, 0, 2.0]
    assert np.abs(error[-250:]).max() < 0.05
    assert error[:, 0].min() > -0.3  # overshoot under a tenth of the step
    assert np.abs(error[500:]).max() < 0.25


def test_a_moving_pad_and_a_steady_wind_leave_no_error():
    track = fly_pid([1.0, 0.0, 3.0], pad_v=(0.3, -0.1, 0.0), wind=(-0.1, 0.1, 0.05), seconds=45)
    assert np.abs(track[-50:] - [0, 0, 2.0]).max() < 0.06


@settings(max_examples=15)
@given(st.floats(0.1, 0.5), st.floats(0.0, 0.3))
def test_stable_over_the_vehicles_and_delays_to_expect(lag_s, delay_s):
    track = fly_pid([1.0, 0.5, 3.0], lag_s=lag_s, delay_s=delay_s, seconds=25)
    assert np.abs(track[-100:] - [0, 0, 2.0]).max() < 0.1
