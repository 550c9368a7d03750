import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator import dead_reckoning as dr
from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Sighting, Verdict
from estimator.contracts.geometry import Rotation, wrap_pi
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, BodyVelocity, Imu
from estimator.contracts.time import MonoNs, Stamp
from estimator.options import DeadReckoningOptions

FLIGHT = Path(__file__).parents[2] / "../shared/data/flight_with_mocap"
G = np.array([0.0, 0.0, -G_M_S2])
V_COV = np.diag([1e-4, 1e-4, 1e-4])
V_COV_NO_VERTICAL = np.diag([1e-4, 1e-4, UNKNOWN_VAR])


def ns(seconds: float) -> MonoNs:
    return MonoNs(round(seconds * 1e9))


def stamp(measured_at_s: float, received_at_s: float | None = None) -> Stamp:
    return Stamp(ns(measured_at_s), ns(measured_at_s if received_at_s is None else received_at_s), 1e-3, "sim")


def attitude(t, yaw=0.0, roll=0.0, pitch=0.0):
    return Attitude(stamp(t), Rotation.from_rpy(roll, pitch, yaw), 1e-4 * np.eye(3))


def velocity(t, v, cov=V_COV):
    return BodyVelocity(stamp(t), np.array(v, float), cov)


def imu(t, f):
    return Imu(stamp(t), np.zeros(3), np.array(f, float))


def pushed(*a_body):
    """Return the reading of an accelerometer in a level body under this acceleration."""
    return G + np.array(a_body)


def sighting(t, d, yaw=0.0, received_at=None, ambiguous=False, sigma=0.01):
    yaw_var = UNKNOWN_YAW_VAR if yaw is None else 1e-3
    cov = np.diag([sigma**2] * 3 + [yaw_var])
    return Sighting(stamp(t, received_at), 0, "selected", np.array(d, float), yaw, ambiguous, cov, 0.9)


def feed(events, options=None, state=None):
    state = state or dr.DeadReckoning.start(options)
    verdicts = []
    for event in events:
        state, verdict = dr.step(state, event)
        if verdict is not None:
            verdicts.append(verdict)
    return state, verdicts


def path(seconds, rate_hz, v_level, yaw_rate=0.0, cov=V_COV):
    """Return samples of a flight at constant velocity in level axes and constant turn rate, from heading 0."""
    events = []
    for i in range(round(seconds * rate_hz) + 1):
        t = i / rate_hz
        events += [attitude(t, wrap_pi(yaw_rate * t)), imu(t, G), velocity(t, v_level, cov)]
    return events


def test_nothing_is_known_before_a_sighting():
    state, verdicts = feed([sighting(0.0, [1, 2, 3])])
    assert verdicts == [Verdict.NO_ATTITUDE]
    assert dr.at(state, ns(1.0)) is None
    state, _ = feed(path(0.5, 50, [0.1, 0, 0]), state=state)
    assert dr.at(state, ns(0.5)) is None


def test_flying_towards_the_pad_shortens_the_vector():
    state, _ = feed([attitude(0, 0), sighting(0, [2.0, 1.0, 3.0]), *path(1.0, 100, [0.5, -0.2, 0.1])])
    r = dr.at(state, ns(1.0))
    np.testing.assert_allclose(r.d_body_pad_level, [1.5, 1.2, 2.9], atol=0.006)  # the first 10 ms had no velocity yet
    np.testing.assert_allclose(r.v_pad_level, [-0.5, 0.2, -0.1])
    assert r.path == "dead_reckoning"
    assert r.sighted == 0


def test_the_step_is_taken_from_the_velocity_and_acceleration_at_its_start():
    """p_n = p_(n-1) + v_(n-1) dt + a_(n-1) dt^2 / 2, the right reading of eq. 4.16."""
    events = [attitude(0), imu(0, pushed(2.0, 0, 0)), velocity(0, [1.0, 0, 0]), sighting(0, [0, 0, 2])]
    state, _ = feed([*events, velocity(0.1, [1.2, 0, 0])])
    r = dr.at(state, ns(0.1))
    assert r.d_body_pad_level[0] == pytest.approx(-(0.1 + 0.5 * 2.0 * 0.01))
    assert r.v_pad_level[0] == pytest.approx(-1.2)


def test_turning_on_the_spot_rotates_the_position_vector():
    """Eq. 4.18, 4.19: the whole vector turns, though no velocity was measured."""
    events = [attitude(0), velocity(0, [0, 0, 0]), sighting(0, [2.0, 0.0, 3.0], yaw=0.0)]
    for i in range(1, 101):
        events += [attitude(i * 0.01, math.pi / 2 * i / 100), velocity(i * 0.01, [0, 0, 0])]
    r = dr.at(feed(events)[0], ns(1.0))
    np.testing.assert_allclose(r.d_body_pad_level, [0.0, -2.0, 3.0], atol=1e-9)
    assert r.yaw_rad == pytest.approx(math.pi / 2)


def test_heading_passes_the_limit_of_its_range():
    """Algorithm 2 of the thesis."""
    events = [attitude(0, 3.1), velocity(0, [0, 0, 0]), sighting(0, [1.0, 0.0, 3.0], yaw=3.0)]
    events += [attitude(0.1, wrap_pi(3.1 + 0.2))]
    r = dr.at(feed(events)[0], ns(0.1))
    assert r.yaw_rad == pytest.approx(wrap_pi(3.2))
    np.testing.assert_allclose(r.d_body_pad_level, [math.cos(0.2), -math.sin(0.2), 3.0], atol=1e-9)


@settings(max_examples=20)
@given(st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-0.5, 0.5)), st.floats(-1.5, 1.5), st.floats(0.02, 0.9))
def test_a_late_sighting_ends_where_a_prompt_one_does(v, yaw_rate, delay):
    seen = sighting(0.5, [0.7, -0.4, 2.2], yaw=0.3, received_at=0.5 + delay)
    events = path(1.5, 50, v, yaw_rate)
    prompt = [e for e in events if e.stamp.measured_at <= seen.stamp.measured_at]
    after = [e for e in events if e.stamp.measured_at > seen.stamp.measured_at]
    before_heard = [e for e in after if e.stamp.measured_at <= seen.stamp.received_at]
    rest = after[len(before_heard) :]
    a = dr.at(feed([*prompt, seen, *after])[0], ns(1.5))
    b = dr.at(feed([*prompt, *before_heard, seen, *rest])[0], ns(1.5))
    np.testing.assert_allclose(a.d_body_pad_level, b.d_body_pad_level, atol=1e-9)
    assert a.yaw_rad is not None
    assert b.yaw_rad is not None
    assert abs(wrap_pi(a.yaw_rad - b.yaw_rad)) < 1e-9
    np.testing.assert_allclose(a.cov, b.cov, atol=1e-9)


@settings(max_examples=20)
@given(st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-0.5, 0.5)), st.floats(-1.5, 1.5))
def test_follows_a_flight_along_a_curve(v, yaw_rate):
    """The pad stands still in `ned`; 200 Hz samples carry one sighting over a second and a half."""
    d0 = np.array([1.0, 0.5, 3.0])
    events = path(1.5, 200, v, yaw_rate)
    state, _ = feed([*events[:3], sighting(0, d0, yaw=0.0), *events[3:]])
    fine = np.linspace(0.0, 1.5, 6001)
    middles = 0.5 * (fine[1:] + fine[:-1])
    turned = np.array([Rotation.from_rpy(0, 0, yaw_rate * t) @ np.array(v) for t in middles])
    d_ned = d0 - turned.sum(axis=0) * (fine[1] - fine[0])
    want = Rotation.from_rpy(0, 0, -yaw_rate * 1.5) @ d_ned
    np.testing.assert_allclose(dr.at(state, ns(1.5)).d_body_pad_level, want, atol=0.012)


def test_a_sighting_in_between_does_not_make_time_run_twice():
    events = [attitude(0), velocity(0, [1.0, 0, 0]), sighting(0, [5.0, 0, 2])]
    events += [velocity(0.1, [1.0, 0, 0]), sighting(0.15, [5.0, 0, 2]), velocity(0.2, [1.0, 0, 0])]
    assert dr.at(feed(events)[0], ns(0.2)).d_body_pad_level[0] == pytest.approx(4.95)


def test_a_heading_of_exactly_zero_replaces_and_none_keeps():
    base = [attitude(0, 1.0), velocity(0, [0, 0, 0]), sighting(0, [0, 0, 2], yaw=0.5)]
    zero = dr.at(feed([*base, sighting(0.1, [0, 0, 2], yaw=0.0)])[0], ns(0.1))
    none = dr.at(feed([*base, sighting(0.1, [0, 0, 2], yaw=None)])[0], ns(0.1))
    assert zero.yaw_rad == pytest.approx(0.0)
    assert none.yaw_rad == pytest.approx(0.5)
    never = dr.at(feed([*base[:2], sighting(0.1, [0, 0, 2], yaw=None)])[0], ns(0.1))
    assert never.yaw_rad is None
    assert never.cov[6, 6] == pytest.approx(UNKNOWN_YAW_VAR)


def test_an_ambiguous_heading_takes_the_branch_already_known():
    base = [attitude(0), velocity(0, [0, 0, 0]), sighting(0, [0, 0, 2], yaw=2.9)]
    state, _ = feed([*base, sighting(0.1, [0, 0, 2], yaw=wrap_pi(3.0 + math.pi), ambiguous=True)])
    r = dr.at(state, ns(0.1))
    assert r.yaw_rad == pytest.approx(3.0)
    assert dict(r.details)["yaw_ambiguous"] == 0.0
    alone = dr.at(feed([*base[:2], sighting(0.1, [0, 0, 2], yaw=0.3, ambiguous=True)])[0], ns(0.1))
    assert dict(alone.details)["yaw_ambiguous"] == 1.0


def test_small_readings_inside_the_dead_band_do_not_drift():
    events = [attitude(0), sighting(0, [0, 0, 2])]
    for i in range(200):
        events += [imu(i * 0.05, pushed(0.4, -0.4, 0.0)), velocity(i * 0.05, [0.0029, -0.0029, 0.0029])]
    np.testing.assert_array_equal(dr.at(feed(events)[0], ns(9.95)).d_body_pad_level, [0, 0, 2])


def test_calibration_at_rest_takes_the_means_off():
    bias_v, bias_f = np.array([0.02, -0.03, 0.0]), np.array([0.8, -0.3, 0.4])
    tilt = Rotation.from_rpy(0.05, -0.03, 0.0)
    rng = np.random.default_rng(3)
    events = []
    for i in range(1100):
        t = i * 0.01
        events += [attitude(t, roll=0.05, pitch=-0.03), velocity(t, bias_v + rng.normal(0, 0.005, 3))]
        events += [imu(t, tilt.inv @ G + bias_f + rng.normal(0, 0.1, 3))]
    state, _ = feed(events, DeadReckoningOptions(calibration_s=10.0))
    state, _ = feed([sighting(10.995, [0, 0, 2])], state=state)
    details = dict(dr.at(state, ns(11.0)).details)
    assert details["calibrated"] == 1.0
    assert [details[f"bias_v_{a}_m_s"] for a in "xyz"] == pytest.approx(bias_v, abs=0.001)
    assert [details[f"bias_a_{a}_m_s2"] for a in "xyz"] == pytest.approx(bias_f, abs=0.02)


def test_a_drone_that_moves_is_not_at_rest():
    options = DeadReckoningOptions(calibration_s=1.0, calibration_samples=50)
    events = [e for i in range(200) for e in (attitude(i * 0.01), imu(i * 0.01, G), velocity(i * 0.01, [(i % 50) * 0.01, 0, 0]))]
    state, _ = feed([*events, sighting(1.99, [0, 0, 2])], options)
    assert dict(dr.at(state, ns(2.0)).details)["calibrated"] == 0.0


def test_a_velocity_that_stops_coming_is_not_flown_on_for_ever():
    state, _ = feed([attitude(0), velocity(0, [1.0, 0, 0]), sighting(0, [5.0, 0, 2])])
    soon, late = dr.at(state, ns(0.2)), dr.at(state, ns(3.0))
    assert soon.d_body_pad_level[0] == pytest.approx(4.8)
    assert late.d_body_pad_level[0] == pytest.approx(4.75)
    assert math.sqrt(late.cov[0, 0]) > 2.5
    assert late.v_pad_level[0] == 0.0
    assert late.cov[3, 3] >= 1.0


def test_a_sighting_older_than_the_history_or_the_last_is_refused():
    state, _ = feed(path(4.0, 50, [0, 0, 0]))
    old, verdicts = feed([sighting(1.0, [0, 0, 2], received_at=4.0)], state=state)
    assert verdicts == [Verdict.TOO_OLD]
    assert dr.at(old, ns(4.0)) is None
    _, verdicts = feed([sighting(3.9, [0, 0, 2]), sighting(3.8, [1, 1, 2], received_at=4.0)], state=state)
    assert verdicts == [Verdict.FUSED, Verdict.TOO_OLD]


def test_vertical_velocity_comes_from_sightings_despite_an_accelerometer_bias():
    """The AR.Drone's case: no vertical velocity, an accelerometer off by 0.7 m/s^2, sightings 100 ms late with 5 mm noise."""
    rng = np.random.default_rng(11)
    events = []
    for i in range(1601):
        t = i / 200
        events += [attitude(t), imu(t, pushed(0, 0, 0.7)), velocity(t, [0, 0, 0], V_COV_NO_VERTICAL)]
        if i % 7 == 0 and i > 20:
            z = 4.0 - 0.3 * (t - 0.1)
            events.append(sighting(t - 0.1, [0, 0, z + rng.normal(0, 0.005)], received_at=t, sigma=0.005))
    state, _ = feed(events)
    r = dr.at(state, ns(8.0))
    assert r.height_m == pytest.approx(4.0 - 0.3 * 8.0, abs=0.03)
    assert r.v_pad_level[2] == pytest.approx(-0.3, abs=0.05)
    blind = dr.at(state, ns(12.0))
    assert abs(blind.height_m - r.height_m) < 0.5  # four seconds at 0.3 m/s would be 1.2
    assert math.sqrt(blind.cov[2, 2]) > 1.0


def test_sightings_that_contradict_each_other_are_not_consistent():
    state, _ = feed(path(1.0, 50, [0, 0, 0])[:3])
    for i in range(12):
        t = 0.1 * (i + 1)
        jump = 3.0 * (i % 2)
        state, _ = feed([attitude(t), velocity(t, [0, 0, 0]), sighting(t, [jump, 0, 2])], state=state)
    assert not dr.at(state, ns(1.2)).consistent


events_of_any_kind = st.lists(
    st.tuples(
        st.sampled_from("aivs"),
        st.floats(0, 0.4),
        st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3)),
        st.floats(0, 0.3),
    ),
    max_size=40,
)


@settings(max_examples=60)
@given(events_of_any_kind)
def test_whatever_comes_the_covariance_stays_one_and_grows_without_sightings(script):
    t, state = 1.0, dr.DeadReckoning.start()
    for kind, dt, x, late in script:
        t += dt
        event = {
            "a": lambda t=t, x=x: attitude(t, x[0], 0.1 * x[1], 0.1 * x[2]),
            "i": lambda t=t, x=x: imu(t, G + np.array(x)),
            "v": lambda t=t, x=x: velocity(t, x, V_COV_NO_VERTICAL),
            "s": lambda t=t, x=x, late=late: sighting(t - late, [x[0], x[1], 3.1 + x[2]], yaw=x[0], received_at=t),
        }[kind]()
        state, verdict = dr.step(state, event)
        assert (verdict is not None) == (kind == "s")
        r = dr.at(state, ns(t))
        if r is not None:
            assert np.linalg.eigvalsh(r.cov).min() > -1e-9 * max(1.0, np.abs(r.cov).max())
    if (now := dr.at(state, ns(t))) is not None:
        later = dr.at(state, ns(t + 1.0))
        assert np.trace(later.cov[:3, :3]) > np.trace(now.cov[:3, :3])
        assert len(state.track) <= 400


@pytest.mark.skipif(not FLIGHT.is_dir(), reason="the recorded flight with motion capture is not at hand")
def test_a_real_flight_is_carried_over_five_seconds_without_sightings():
    """An AR.Drone 2.0's own navdata against motion capture: 10 Hz sightings 100 ms late, off for five of every ten seconds."""
    nav = np.genfromtxt(FLIGHT / "navdata.csv", delimiter=",", names=True)
    mocap = np.genfromtxt(FLIGHT / "optitrack.csv", delimiter=",", names=True)
    tm, w, z = mocap["t_stamp_s"], mocap["q4"], mocap["q3"]
    yaw_m = np.unwrap(np.arctan2(2 * (w * z + mocap["q1"] * mocap["q2"]), 1 - 2 * (mocap["q2"] ** 2 + z**2)))

    def truth(t):
        x, y, up, yaw = (float(np.interp(t, tm, c)) for c in (mocap["x_m"], mocap["y_m"], mocap["z_m"], yaw_m))
        c, s = math.cos(yaw), math.sin(yaw)
        return np.array([-c * x - s * y, -s * x + c * y, up]), wrap_pi(-yaw)

    events = []
    for r in nav:
        t = float(r["t_stamp_s"])
        roll, pitch, yaw = np.radians([r["rotX_deg"], -r["rotY_deg"], -r["rotZ_deg"]])
        events += [
            (t, attitude(t, yaw, roll, pitch)),
            (t, imu(t, G_M_S2 * np.array([r["ax_g"], -r["ay_g"], -r["az_g"]]))),
            (t, velocity(t, [r["vx_mm_s"] / 1e3, -r["vy_mm_s"] / 1e3, 0.0], np.diag([2.5e-3, 2.5e-3, UNKNOWN_VAR]))),
        ]
    rng = np.random.default_rng(0)
    for t in np.arange(13.0, 46.0, 0.1):
        if (t - 13.0) // 5 % 2 == 0:
            d, yaw = truth(t)
            events.append((t + 0.1, sighting(t, d + rng.normal(0, 0.01, 3), yaw, received_at=t + 0.1)))
    events.sort(key=lambda e: e[0])
    state, fresh, old = dr.DeadReckoning.start(), list[Any](), list[Any]()
    for i, (t, event) in enumerate(events):
        state, _ = dr.step(state, event)
        if i % 100 == 0 and t > 13.5:
            r = dr.at(state, ns(t))
            error = r.d_body_pad_level - truth(t)[0]
            (fresh if r.age_s(ns(t)) < 0.3 else old).append(
                (np.linalg.norm(error), error @ np.linalg.solve(r.cov[:3, :3], error))
            )
            assert r.consistent
    assert math.sqrt(np.mean([e**2 for e, _ in fresh])) < 0.035
    assert max(e for e, _ in old) < 0.3
    assert np.mean([nees for _, nees in fresh + old]) < 3.0
