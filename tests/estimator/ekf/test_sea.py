"""The deck's motion: oscillators, learning them, forecasting by them, and telling a moving vessel from one at rest."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from scipy.linalg import expm

from estimator.contracts.estimates import Sighting
from estimator.contracts.samples import VesselReport
from estimator.ekf import EkfOptions, Filter, deck_motion_bank
from estimator.ekf.params import FilterParams
from tests.estimator.ekf import flown
from tests.estimator.ekf.belief import newest, stationary, unknown
from tests.estimator.ekf.oracle.oscillator import transition
from tests.support.estimator_truth import Setting, TruthFlight, events, ns, stamp

QUICK = Setting(seed=3, sea=4, duration_s=20.0, imu_hz=50.0, sighting_hz=10.0, attitude_hz=10.0, velocity_hz=10.0, pose6=True)


def matrix(w: float, zeta: float) -> np.ndarray:
    J = np.array([[0.0, 1.0], [-w * w, -2.0 * zeta * w]])
    return np.block([[J, np.array([[0.0, 0.0], [0.0, 1.0]])], [np.zeros((2, 2)), J]])


@given(st.floats(0.3, 3.0), st.floats(0.05, 0.9), st.floats(0.001, 5.0))
@settings(max_examples=60)
def test_transition_is_the_matrix_exponential(w: float, zeta: float, dt: float) -> None:
    got = transition(np.array(w), np.array(zeta), dt)
    np.testing.assert_allclose(got.A, expm(matrix(w, zeta) * dt), atol=1e-9 * max(1.0, w**3))
    assert np.linalg.eigvalsh(got.q).min() > -1e-9 * float(np.trace(stationary(np.array(w), np.array(zeta))))


@given(st.floats(0.3, 3.0), st.floats(0.05, 0.9))
@settings(max_examples=30)
def test_stationary_covariance_is_stationary(w: float, zeta: float) -> None:
    F, P = matrix(w, zeta), stationary(np.array(w), np.array(zeta))
    change = F @ P + P @ F.T
    assert change[3, 3] < 0.0
    change[3, 3] = 0.0
    np.testing.assert_allclose(change, 0.0, atol=1e-9 * float(np.trace(P)))
    assert P[0, 0] == 1.0


NOISE = FilterParams(EkfOptions())


def test_the_bank_learns_an_oscillation_and_its_size() -> None:
    rng = np.random.default_rng(0)
    w, zeta, sigma, dt = 0.9, 0.3, 0.4, 0.2
    a = transition(np.array(w), np.array(zeta), dt)
    x = np.zeros(4)
    L = np.linalg.cholesky(sigma**2 * a.q + 1e-15 * np.eye(4))
    bank = unknown()
    var = np.array([1e6, 1e6, 0.01**2, 1e6, 1e6])
    for k in range(400):
        x = a.A @ x + L @ rng.standard_normal(4)
        drift = 3.0 + 0.5 * k * dt
        bank = flown.observe(
            bank,
            round(k * dt * 1e9),
            np.array([0.0, 0.0, x[0] + drift + 0.01 * rng.standard_normal(), 0.0, 0.0]),
            var,
            NOISE,
            2.0,
        )
    assert 0.65 < bank.w_rad_s[2] < 1.25
    assert 0.2 < bank.sigma[2] < 0.8
    assert bank.weight[:, 0].max() < 1e-3, "a vessel that heaves is not at rest sideways"
    np.testing.assert_allclose(bank.weight[0, 1:], 1.0 / (len(deck_motion_bank.W) - 1), rtol=1e-3)


def test_a_deck_at_rest_is_found_to_be_at_rest() -> None:
    rng = np.random.default_rng(1)
    bank = unknown()
    var = np.array([1.0, 1.0, 1.0, 1.0, 1.0]) * 0.01**2
    for k in range(150):
        bank = flown.observe(bank, k * 200_000_000, 0.01 * rng.standard_normal(5), var, NOISE, 2.0)
    assert bank.weight[:, 0].min() > 0.6
    assert bank.sigma[:3].max() < 0.05


def run(s: Setting) -> tuple[TruthFlight, Filter, list[float]]:
    """Return the flight, the final memory, and the NEES of the RelativeState twice a second after 6 s."""
    flight, ekf, nees, next_s = TruthFlight(s), Filter(), [], 6.0
    for event in events(flight):
        while event.stamp.received_at > ns(next_s):
            state = ekf.at(ns(next_s))
            assert state is not None
            assert state.yaw_rad is not None
            d, v, yaw = (x[0] for x in flight.relative(np.array([next_s])))
            turn = math.remainder(state.yaw_rad - yaw, math.tau)
            e = np.concatenate([state.d_body_pad_level - d, state.v_pad_level - v, [turn]])
            nees.append(float(e @ np.linalg.solve(state.cov, e)))
            next_s += 0.5
        ekf.put([event])
    return flight, ekf, nees


def test_consistent_and_the_forecast_holds_its_bands() -> None:
    inside = {0.68: 0, 0.95: 0}
    total, nees = 0, []
    for seed in (3, 4):
        nees += run(replace(QUICK, seed=seed))[2]
    ekf, next_s = Filter(), 10.0
    flight = TruthFlight(QUICK)
    for event in events(flight):
        if event.stamp.received_at > ns(next_s) and next_s < 17.0:
            reported = ekf.forecast(ns(next_s), (1.0, 2.0, 3.0))
            assert reported is not None
            p, v, _ = flight.pad(next_s + np.array([1.0, 2.0, 3.0]))
            for probability in inside:
                low, high = reported.band("deck_height_m", probability)
                inside[probability] += int(np.sum((low < flight.p0[2] - p[:, 2]) & (flight.p0[2] - p[:, 2] < high)))
                low, high = reported.band("rise_m_s", probability)
                inside[probability] += int(np.sum((low < -v[:, 2]) & (-v[:, 2] < high)))
            total += 6
            next_s += 0.5
        ekf.put([event])
    assert inside[0.68] / total > 0.5
    assert inside[0.95] / total > 0.8
    assert 0.4 < np.mean(nees) / 7.0 < 2.5


def test_forecast_grows_with_the_horizon_and_starts_at_the_belief() -> None:
    _, ekf, _ = run(replace(QUICK, duration_s=8.0))
    now = ns(7.9)
    reported, state = ekf.forecast(now, (0.0, 1.0, 3.0)), ekf.at(now)
    assert reported is not None
    assert state is not None
    np.testing.assert_allclose(reported.d_body_pad_level[0], state.d_body_pad_level, atol=1e-9)
    np.testing.assert_allclose(reported.cov_d_level[0], state.cov[:3, :3], atol=1e-9)
    assert reported.sigma_deck_height_m[0] < reported.sigma_deck_height_m[1] < reported.sigma_deck_height_m[2]
    with pytest.raises(ValueError, match="horizons"):
        ekf.forecast(now, [-1.0])


def test_moving_or_not() -> None:
    probabilities = []
    for sea_state, speed in ((0, 0.0), (0, 1.0), (4, 0.0)):
        s = replace(QUICK, sea=sea_state, vessel_speed_m_s=speed, duration_s=14.0, accel_bias=0.05)
        _, ekf, _ = run(s)
        state = ekf.at(ns(13.9))
        assert state is not None
        probabilities.append(dict(state.details)["probability_moving"])
    assert probabilities[0] < 0.2
    assert probabilities[1] > 0.9
    assert probabilities[2] > 0.99


def test_loss_of_sight_grows_the_covariance_and_the_return_does_not_jump_beyond_it() -> None:
    s = replace(QUICK, blind=((10.0, 14.0),), duration_s=17.0)
    flight, ekf = TruthFlight(s), Filter()
    sigma, before = list[float](), None
    for event in events(flight):
        now = event.stamp.received_at
        first = isinstance(event, Sighting) and event.stamp.measured_at > ns(14.0) and before is None
        if first:
            before = ekf.at(now)
        ekf.put([event])
        if first:
            after = ekf.at(now)
        if (
            ns(10.3) < now < ns(14.0)
            and isinstance(event, Sighting) is False
            and len(sigma) < (now - ns(10.3)) // 500_000_000 + 1
        ):
            state = ekf.at(now)
            assert state is not None
            sigma.append(float(np.sqrt(np.trace(state.cov[:3, :3]))))
            error = state.d_body_pad_level - flight.relative(np.array([(now - ns(0.0)) * 1e-9]))[0][0]
            assert float(error @ np.linalg.solve(state.cov[:3, :3], error)) < 25.0
    assert sigma == sorted(sigma)
    assert before is not None
    assert after is not None
    jump = after.d_body_pad_level - before.d_body_pad_level
    assert float(jump @ np.linalg.solve(before.cov[:3, :3], jump)) < 16.0
    assert np.trace(after.cov[:3, :3]) < np.trace(before.cov[:3, :3])


def test_a_report_of_the_ship_gives_its_velocity_and_heading() -> None:
    s = replace(QUICK, sea=0, vessel_speed_m_s=1.2, velocity_hz=0.0, duration_s=6.0)
    flight, ekf, next_s = TruthFlight(s), Filter(), 1.0
    for event in events(flight):
        ekf.put([event])
        if event.stamp.received_at > ns(next_s):
            heading = math.atan2(flight.u[1], flight.u[0])
            report = VesselReport(stamp(next_s), flight.u, np.eye(3) * 0.05**2, heading, 0.02)
            outcomes = ekf.put([report])
            assert outcomes[0].verdict.value == "fused"
            next_s += 0.5
    np.testing.assert_allclose(newest(ekf).x[16:18], flight.u[:2], atol=0.1)


def test_half_a_heading_is_used_only_when_the_other_half_is_known() -> None:
    """An H alone: its heading may be 180 degrees off."""
    flight = TruthFlight(replace(QUICK, duration_s=5.0, pose6=False))
    ekf, ambiguous = Filter(), 0
    for event in events(flight):
        if isinstance(event, Sighting) and event.stamp.measured_at > ns(1.0):
            assert event.yaw_rad is not None
            opposite = math.remainder(event.yaw_rad + math.pi, math.tau)
            event = structs.replace(event, yaw_rad=opposite, yaw_ambiguous=True)
            ambiguous += 1
        ekf.put([event])
    state = ekf.at(ns(4.9))
    assert state is not None
    assert state.yaw_rad is not None
    assert abs(math.remainder(state.yaw_rad - flight.relative(np.array([4.9]))[2][0], math.tau)) < 0.15

    ekf = Filter()
    for event in events(flight):
        if isinstance(event, Sighting):
            event = structs.replace(event, yaw_ambiguous=True)
        ekf.put([event])
    state = ekf.at(ns(4.9))
    assert state is not None
    assert state.yaw_rad is None
    assert ambiguous > 20
