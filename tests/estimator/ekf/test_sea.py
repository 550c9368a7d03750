"""The deck's motion: learning its oscillators, forecasting by them, and a moving vessel against one at rest."""

import math
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from estimator.contracts.estimates import Sighting
from estimator.ekf import EkfOptions, Filter, params
from estimator.ekf.params import FilterParams
from estimator.pipeline import RelativeEstimator
from tests.estimator.ekf import oracle
from tests.estimator.ekf.core_state import newest, observe
from tests.make import vessel
from tests.support.estimator_truth import Setting, TruthFlight, events, ns, stamp

QUICK = Setting(seed=3, sea=4, duration_s=20.0, imu_hz=50.0, sighting_hz=10.0, attitude_hz=10.0, velocity_hz=10.0, pose6=True)
PARAMS = FilterParams(EkfOptions())


def test_the_bank_learns_an_oscillation_and_its_size() -> None:
    rng = np.random.default_rng(0)
    sigma, dt, x, bank = 0.4, 0.2, np.zeros(4), oracle.bank_unknown()
    (A,), (q,) = oracle.transition(np.array([0.9]), np.array([0.3]), dt)
    L = np.linalg.cholesky(sigma**2 * q + 1e-15 * np.eye(4))
    var = np.array([1e6, 1e6, 0.01**2, 1e6, 1e6])
    for k in range(400):
        x = A @ x + L @ rng.standard_normal(4)
        down = x[0] + 3.0 + 0.5 * k * dt + 0.01 * rng.standard_normal()
        bank = observe(bank, round(k * dt * 1e9), np.array([0.0, 0.0, down, 0.0, 0.0]), var, PARAMS)
    assert 0.65 < bank.w_rad_s[2] < 1.25
    assert 0.2 < bank.sigma[2] < 0.8
    assert bank.weight[:, 0].max() < 1e-3, "a vessel that heaves is not at rest sideways"
    np.testing.assert_allclose(bank.weight[0, 1:], 1.0 / (len(params.W) - 1), rtol=1e-3)


def test_a_deck_at_rest_is_found_to_be_at_rest() -> None:
    rng, bank = np.random.default_rng(1), oracle.bank_unknown()
    for k in range(150):
        bank = observe(bank, k * 200_000_000, 0.01 * rng.standard_normal(5), np.full(5, 0.01**2), PARAMS)
    assert bank.weight[:, 0].min() > 0.6
    assert bank.sigma[:3].max() < 0.05


def estimate_sea(s: Setting) -> tuple[TruthFlight, Filter, list[float], dict[float, list[bool]]]:
    """Return flight, filter, the NEES of the estimate twice a second after 6 s, and which bands of forecasts hold the deck."""
    flight, ekf, nees, next_s = TruthFlight(s), Filter(), list[float](), 6.0
    inside: dict[float, list[bool]] = {0.68: [], 0.95: []}
    for event in events(flight):
        while event.stamp.received_at > ns(next_s):
            state = ekf.at(ns(next_s))
            d, v, yaw = (x[0] for x in flight.relative(np.array([next_s])))
            turn = math.remainder(state.yaw_rad - yaw, math.tau)
            e = np.concatenate([state.d_body_pad_level - d, state.v_pad_level - v, [turn]])
            nees.append(float(e @ np.linalg.solve(state.cov, e)))
            forecast = ekf.forecast(ns(next_s), (1.0, 2.0, 3.0))
            p, v, _ = flight.pad(next_s + np.array([1.0, 2.0, 3.0]))
            for probability, held in inside.items():
                for name, true in (("deck_height_m", flight.p0[2] - p[:, 2]), ("rise_m_s", -v[:, 2])):
                    low, high = forecast.band(name, probability)
                    held += ((low < true) & (true < high)).tolist() if next_s >= 10.0 else []
            next_s += 0.5
        ekf.put([event])
    return flight, ekf, nees, inside


def test_consistent_and_the_forecast_holds_its_bands() -> None:
    nees, inside = list[float](), dict[float, list[bool]]()
    for seed in (3, 4):
        _, _, more, held = estimate_sea(replace(QUICK, seed=seed))
        nees, inside = nees + more, {p: inside.get(p, []) + each for p, each in held.items()}
    assert np.mean(inside[0.68]) > 0.5
    assert np.mean(inside[0.95]) > 0.8
    assert 0.4 < np.mean(nees) / 7.0 < 2.5


def test_forecast_grows_with_the_horizon_and_starts_at_the_estimate() -> None:
    _, ekf, _, _ = estimate_sea(replace(QUICK, duration_s=8.0))
    found, state = ekf.forecast(ns(7.9), (0.0, 1.0, 3.0)), ekf.at(ns(7.9))
    np.testing.assert_allclose(found.d_body_pad_level[0], state.d_body_pad_level, atol=1e-9)
    np.testing.assert_allclose(found.cov_d_level[0], state.cov[:3, :3], atol=1e-9)
    assert found.sigma_deck_height_m[0] < found.sigma_deck_height_m[1] < found.sigma_deck_height_m[2]


@pytest.mark.parametrize(("sea", "speed", "least", "most"), [(0, 0.0, 0.0, 0.2), (0, 1.0, 0.9, 1.0), (4, 0.0, 0.99, 1.0)])
def test_moving_or_not(sea: int, speed: float, least: float, most: float) -> None:
    _, ekf, _, _ = estimate_sea(replace(QUICK, sea=sea, vessel_speed_m_s=speed, duration_s=14.0, accel_bias=0.05))
    state = ekf.at(ns(13.9))
    assert least <= dict(state.details)["probability_moving"] <= most


def test_loss_of_sight_grows_the_covariance_and_the_return_does_not_jump_beyond_it() -> None:
    flight, ekf = TruthFlight(replace(QUICK, blind=((10.0, 14.0),), duration_s=17.0)), Filter()
    sigma, jump, next_s = list[float](), None, 10.3
    for event in events(flight):
        now = event.stamp.received_at
        if next_s < 14.0 and now > ns(next_s):
            state = ekf.at(ns(next_s))
            sigma.append(float(np.trace(state.cov[:3, :3])))
            error = state.d_body_pad_level - flight.relative(np.array([next_s]))[0][0]
            assert float(error @ np.linalg.solve(state.cov[:3, :3], error)) < 25.0
            next_s += 0.5
        returns = jump is None and isinstance(event, Sighting) and event.stamp.measured_at > ns(14.0)
        before = ekf.at(now) if returns else None
        ekf.put([event])
        after = ekf.at(now) if returns else None
        if before is not None and after is not None:
            jump = after.d_body_pad_level - before.d_body_pad_level
            assert float(jump @ np.linalg.solve(before.cov[:3, :3], jump)) < 16.0
            assert np.trace(after.cov[:3, :3]) < np.trace(before.cov[:3, :3])
    assert jump is not None
    assert len(sigma) > 6
    assert sigma == sorted(sigma)


def test_a_report_of_the_ship_gives_its_velocity_and_heading() -> None:
    s = replace(QUICK, sea=0, vessel_speed_m_s=1.2, velocity_hz=0.0, duration_s=6.0)
    flight, ekf, next_s = TruthFlight(s), Filter(), 1.0
    for event in events(flight):
        ekf.put([event])
        if event.stamp.received_at > ns(next_s):
            report = vessel(stamp(next_s), flight.u, math.atan2(flight.u[1], flight.u[0]), var=0.05**2, sigma_rad=0.02)
            assert ekf.put([report])[0].verdict.value == "fused"
            next_s += 0.5
    np.testing.assert_allclose(newest(ekf).x[16:18], flight.u[:2], atol=0.1)


def test_a_rate_of_turn_shows_a_manoeuvre_at_once_and_one_that_lies_is_left_out_by_sight() -> None:
    flight, ekf, next_s = TruthFlight(replace(QUICK, vessel_speed_m_s=1.0, duration_s=22.0)), RelativeEstimator(), 5.0
    steered, verdicts, off = dict[float, bool](), dict[float, str](), dict[float, float]()
    named = dict[float, tuple[str, ...]]()
    for event in events(flight):
        ekf.put([event])
        if event.stamp.received_at > ns(next_s):
            verdict = ekf.put([vessel(stamp(next_s), turn_rad_s=0.5 if 7.0 <= next_s < 11.0 else 0.0)])[0][0].verdict.value
            state = ekf.at(ns(next_s))
            error = state.d_body_pad_level - flight.relative(np.array([next_s]))[0][0]
            steered[next_s], verdicts[next_s], off[next_s] = state.steers, verdict, float(np.hypot(*error[:2]))
            named[next_s] = state.lost
            next_s = round(next_s + 0.1, 1)
    assert not any(steers for at, steers in steered.items() if at < 7.0), "a ship that keeps her course does not manoeuvre"
    assert steered[7.0], "one report of many deviations is enough"
    late = [at for at in verdicts if 9.0 < at < 11.0]
    assert {verdicts[at] for at in late} == {"gated"}, "two seconds of sight contradict it"
    assert not any(steered[at] for at in late)
    assert max(off[at] for at in late) < 0.1
    assert max(off.values()) < 0.3, "meanwhile the pad is where sight has it"
    assert {named[at] for at in late} == {("her rate of turn contradicts the camera; flying without it",)}
    assert not any(lost for at, lost in named.items() if at < 8.0 or at > 21.3), "ten seconds after its last lie it counts again"
    assert verdicts[21.5] == "fused"


@pytest.mark.parametrize("known_until_s", [0.0, 1.0])
def test_half_a_heading_is_used_only_when_the_other_half_is_known(known_until_s: float) -> None:
    """An H alone: its heading may be 180 degrees off, and is."""
    flight, ekf = TruthFlight(replace(QUICK, duration_s=5.0, pose6=False)), Filter()
    for event in events(flight):
        if isinstance(event, Sighting) and event.stamp.measured_at > ns(known_until_s):
            event = structs.replace(event, yaw_rad=math.remainder(event.yaw_rad + math.pi, math.tau), yaw_ambiguous=True)
        ekf.put([event])
    state = ekf.at(ns(4.9))
    if known_until_s == 0.0:
        assert state.yaw_rad is None
    else:
        assert abs(math.remainder(state.yaw_rad - flight.relative(np.array([4.9]))[2][0], math.tau)) < 0.15
