import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator import dead_reckoning as dr
from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import Rotation, wrap_pi
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import UNKNOWN_VAR
from tests.make import attitude, imu, ns, sighting, stamp, velocity

G = np.array([0.0, 0.0, -G_M_S2])
NO_VERTICAL = (1e-4, 1e-4, UNKNOWN_VAR)


def facing(t, yaw=0.0, roll=0.0, pitch=0.0):
    return attitude(t, roll, pitch, yaw)


def moving(t, v, var=1e-4):
    return velocity(t, v, var=var)


def felt(t, f):
    return imu(t, f=f)


def pushed(*a_body):
    """Return the reading of an accelerometer in a level body under this acceleration."""
    return G + np.array(a_body)


def pad_at(t, d, yaw=0.0, received_at=None, ambiguous=False, sigma=0.01):
    return sighting(stamp(t, 0.0 if received_at is None else received_at - t), d, yaw, var=sigma**2, ambiguous=ambiguous)


def feed(events, options=None, state=None):
    state = state or dr.DeadReckoning.start(options)
    verdicts = []
    for event in events:
        state, verdict = dr.step(state, event)
        if verdict is not None:
            verdicts.append(verdict)
    return state, verdicts


def path(seconds, rate_hz, v_level, yaw_rate=0.0, var=1e-4):
    """Return samples of a flight at constant velocity in level axes and constant turn rate, from heading 0."""
    events = []
    for i in range(round(seconds * rate_hz) + 1):
        t = i / rate_hz
        events += [facing(t, wrap_pi(yaw_rate * t)), felt(t, G), moving(t, v_level, var)]
    return events


def test_nothing_is_known_before_a_sighting():
    state, verdicts = feed([pad_at(0.0, [1, 2, 3])])
    assert verdicts == [Verdict.NO_ATTITUDE]
    assert dr.at(state, ns(1.0)) is None
    state, _ = feed(path(0.5, 50, [0.1, 0, 0]), state=state)
    assert dr.at(state, ns(0.5)) is None


def test_the_step_is_taken_from_the_velocity_and_acceleration_at_its_start():
    """p_n = p_(n-1) + v_(n-1) dt + a_(n-1) dt^2 / 2, the right reading of eq. 4.16."""
    events = [facing(0), felt(0, pushed(2.0, 0, 0)), moving(0, [1.0, 0, 0]), pad_at(0, [0, 0, 2])]
    state, _ = feed([*events, moving(0.1, [1.2, 0, 0])])
    r = dr.at(state, ns(0.1))
    assert r.d_body_pad_level[0] == pytest.approx(-(0.1 + 0.5 * 2.0 * 0.01))
    assert r.v_pad_level[0] == pytest.approx(-1.2)


@settings(max_examples=20)
@given(st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-0.5, 0.5)), st.floats(-1.5, 1.5), st.floats(0.02, 0.9))
def test_a_late_sighting_ends_where_a_prompt_one_does(v, yaw_rate, delay):
    seen = pad_at(0.5, [0.7, -0.4, 2.2], yaw=0.3, received_at=0.5 + delay)
    events = path(1.5, 50, v, yaw_rate)
    prompt = [e for e in events if e.stamp.measured_at <= seen.stamp.measured_at]
    after = [e for e in events if e.stamp.measured_at > seen.stamp.measured_at]
    before_heard = [e for e in after if e.stamp.measured_at <= seen.stamp.received_at]
    rest = after[len(before_heard) :]
    a = dr.at(feed([*prompt, seen, *after])[0], ns(1.5))
    b = dr.at(feed([*prompt, *before_heard, seen, *rest])[0], ns(1.5))
    np.testing.assert_allclose(a.d_body_pad_level, b.d_body_pad_level, atol=1e-9)
    assert abs(wrap_pi(a.yaw_rad - b.yaw_rad)) < 1e-9
    np.testing.assert_allclose(a.cov, b.cov, atol=1e-9)


@settings(max_examples=20)
@given(st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-0.5, 0.5)), st.floats(-1.5, 1.5))
def test_follows_a_flight_along_a_curve(v, yaw_rate):
    """The pad stands still in `ned`; 200 Hz samples carry one sighting over a second and a half."""
    d0 = np.array([1.0, 0.5, 3.0])
    events = path(1.5, 200, v, yaw_rate)
    state, _ = feed([*events[:3], pad_at(0, d0, yaw=0.0), *events[3:]])
    fine = np.linspace(0.0, 1.5, 6001)
    middles = 0.5 * (fine[1:] + fine[:-1])
    turned = np.array([Rotation.from_rpy(0, 0, yaw_rate * t) @ np.array(v) for t in middles])
    d_ned = d0 - turned.sum(axis=0) * (fine[1] - fine[0])
    want = Rotation.from_rpy(0, 0, -yaw_rate * 1.5) @ d_ned
    np.testing.assert_allclose(dr.at(state, ns(1.5)).d_body_pad_level, want, atol=0.012)


def test_a_sighting_in_between_does_not_make_time_run_twice():
    events = [facing(0), moving(0, [1.0, 0, 0]), pad_at(0, [5.0, 0, 2])]
    events += [moving(0.1, [1.0, 0, 0]), pad_at(0.15, [5.0, 0, 2]), moving(0.2, [1.0, 0, 0])]
    assert dr.at(feed(events)[0], ns(0.2)).d_body_pad_level[0] == pytest.approx(4.95)


def test_place_and_velocity_together_are_no_surer_than_each():
    r = dr.at(feed([facing(0), moving(0, [0, 0, 0]), pad_at(0, [0, 0, 0.2])])[0], ns(0.5))
    assert r.cov[0, 3] ** 2 < 0.5 * r.cov[0, 0] * r.cov[3, 3]


def test_an_ambiguous_heading_takes_the_branch_already_known():
    base = [facing(0), moving(0, [0, 0, 0]), pad_at(0, [0, 0, 2], yaw=2.9)]
    state, _ = feed([*base, pad_at(0.1, [0, 0, 2], yaw=wrap_pi(3.0 + math.pi), ambiguous=True)])
    r = dr.at(state, ns(0.1))
    assert r.yaw_rad == pytest.approx(3.0)
    assert dict(r.details)["yaw_ambiguous"] == 0.0
    alone = dr.at(feed([*base[:2], pad_at(0.1, [0, 0, 2], yaw=0.3, ambiguous=True)])[0], ns(0.1))
    assert dict(alone.details)["yaw_ambiguous"] == 1.0


def test_small_readings_inside_the_dead_band_do_not_drift():
    events = [facing(0), pad_at(0, [0, 0, 2])]
    for i in range(200):
        events += [felt(i * 0.05, pushed(0.4, -0.4, 0.0)), moving(i * 0.05, [0.0029, -0.0029, 0.0029])]
    np.testing.assert_array_equal(dr.at(feed(events)[0], ns(9.95)).d_body_pad_level, [0, 0, 2])


def test_a_velocity_that_stops_coming_is_not_flown_on_for_ever():
    state, _ = feed([facing(0), moving(0, [1.0, 0, 0]), pad_at(0, [5.0, 0, 2])])
    soon, late = dr.at(state, ns(0.2)), dr.at(state, ns(3.0))
    assert soon.d_body_pad_level[0] == pytest.approx(4.8)
    assert late.d_body_pad_level[0] == pytest.approx(4.75)
    assert math.sqrt(late.cov[0, 0]) > 2.5
    assert late.v_pad_level[0] == 0.0
    assert late.cov[3, 3] >= 1.0


def test_a_sighting_older_than_the_history_or_the_last_is_refused():
    state, _ = feed(path(4.0, 50, [0, 0, 0]))
    old, verdicts = feed([pad_at(1.0, [0, 0, 2], received_at=4.0)], state=state)
    assert verdicts == [Verdict.TOO_OLD]
    assert dr.at(old, ns(4.0)) is None
    _, verdicts = feed([pad_at(3.9, [0, 0, 2]), pad_at(3.8, [1, 1, 2], received_at=4.0)], state=state)
    assert verdicts == [Verdict.FUSED, Verdict.TOO_OLD]


def test_vertical_velocity_comes_from_sightings_despite_an_accelerometer_bias():
    """The AR.Drone's case: no vertical velocity, an accelerometer off by 0.7 m/s^2, sightings 100 ms late with 5 mm noise."""
    rng = np.random.default_rng(11)
    events = []
    for i in range(1601):
        t = i / 200
        events += [facing(t), felt(t, pushed(0, 0, 0.7)), moving(t, [0, 0, 0], NO_VERTICAL)]
        if i % 7 == 0 and i > 20:
            z = 4.0 - 0.3 * (t - 0.1)
            events.append(pad_at(t - 0.1, [0, 0, z + rng.normal(0, 0.005)], received_at=t, sigma=0.005))
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
        state, _ = feed([facing(t), moving(t, [0, 0, 0]), pad_at(t, [jump, 0, 2])], state=state)
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
            "a": lambda t=t, x=x: facing(t, x[0], 0.1 * x[1], 0.1 * x[2]),
            "i": lambda t=t, x=x: felt(t, G + np.array(x)),
            "v": lambda t=t, x=x: moving(t, x, NO_VERTICAL),
            "s": lambda t=t, x=x, late=late: pad_at(t - late, [x[0], x[1], 3.1 + x[2]], yaw=x[0], received_at=t),
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
