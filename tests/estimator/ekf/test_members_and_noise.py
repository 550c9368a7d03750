"""The numbers that the core is given: the bank's members, the noise of every state, and what is computed from a forecast."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.special import chdtri, ndtri

from estimator.contracts.samples import UNKNOWN_VAR
from estimator.core.library import CORE
from estimator.ekf import EkfOptions, Event, Forecast, params
from estimator.ekf.event import packed
from estimator.ekf.filter import log_evidence_of_rest, probability_of_motion
from estimator.ekf.params import NIS_MAX, FilterParams, carrying
from tests.make import attitude, baro, imu, ns, range_down, sighting, tuned, velocity, vessel


def test_the_members_are_every_period_damping_and_size_and_a_deck_at_rest() -> None:
    w, zeta, sigma, log_prior = params._grid()
    assert w.shape == zeta.shape == log_prior.shape == (1 + 9 * 3 * 5,)
    assert (w[0], zeta[0], sigma[:, 0].tolist()) == (1.0, 0.5, [1e-7] * 5)
    assert np.exp(log_prior[:2]) == pytest.approx([0.5, 0.5 / 135])
    assert set(log_prior[1:].tolist()) == {log_prior[1]}
    assert math.tau / w[1::15] == pytest.approx(np.geomspace(2.2, 14.0, 9))
    assert len({(round(one, 9), z, s) for one, z, s in zip(w[1:], zeta[1:], sigma[0, 1:], strict=True)}) == 135
    assert sorted(set(zeta[1:].tolist())) == [0.2, 0.35, 0.55]
    assert sigma[:3, 1:6].tolist() == [[0.02, 0.055, 0.15, 0.42, 1.15]] * 3
    assert np.degrees(sigma[3:, 1:6]) == pytest.approx(np.tile([0.25, 0.7, 2.0, 5.5, 15.0], (2, 1)))
    # The sizes of an oscillator lie side by side: the core computes its transition once.
    for by_size in (w[1:].reshape(27, 5), zeta[1:].reshape(27, 5)):
        assert np.all(by_size == by_size[:, :1])


def test_every_state_s_noise_is_its_option_squared() -> None:
    given: dict[str, tuple[Any, float]] = {
        "asd_gyro_rad_s": (params.ATT_ERR, 0.011), "asd_gyro_bias_rad_s2": (params.GYRO_BIAS, 0.0012),
        "asd_accel_bias_m_s3": (params.ACCEL_BIAS, 0.0013), "asd_velocity_scale": (params.VEL_SCALE, 0.0014),
        "asd_vessel_velocity_m_s2": (params.VESSEL_VEL, 0.15), "asd_turn_rate_rad_s2": (params.TURN_RATE, 0.016),
        "delay_drift_s_sqrt_s": (params.CAMERA_DELAY, 0.00018),
        "mount_drift_rad_sqrt_s": (params.CAMERA_MOUNT, 0.00019), "asd_baro_offset_m": (params.BARO_OFFSET, 0.021),
        "asd_range_offset_m": (params.RANGE_OFFSET, 0.022), "asd_attitude_bias_rad_s": (params.ATT_BIAS, 0.0023),
    }  # fmt: skip
    changed: dict[str, Any] = {name: value for name, (_, value) in given.items()}
    noise = FilterParams(tuned(EkfOptions, **changed, asd_accel_m_s2=0.31, asd_coast_m_s2=0.32, asd_coast_rad_s=0.33))
    expected = np.zeros(params.N)
    for place, value in given.values():
        expected[place] = value**2
    np.testing.assert_allclose(noise.psd, expected, rtol=1e-14)
    assert (noise.psd_accel, noise.psd_coast, noise.psd_coast_turn) == pytest.approx((0.31**2, 0.32**2, 0.33**2))
    assert noise.not_measured_var == pytest.approx(0.1 * UNKNOWN_VAR)
    turn = math.sqrt(2.0) * 0.011
    accel, drift, tilt = noise.carrying
    assert accel == pytest.approx([0.31, 0.31, 0.31, 0.0, 0.0])
    assert drift == pytest.approx([9.81 * turn, 9.81 * turn, 0.0013, 0.0, 0.0])
    assert tilt == pytest.approx([turn, turn, 0.0, 0.0, 0.0])
    assert carrying(0.31, 0.011, 0.0013)[1].tolist() == drift.tolist()


def test_a_gate_is_what_a_consistent_measurement_exceeds_so_seldom() -> None:
    assert pytest.approx(chdtri(np.arange(1, 10), 1e-4), abs=6e-4) == NIS_MAX


@pytest.mark.parametrize("probability", [0.5, 0.68, 0.8, 0.9, 0.95, 0.99])
def test_a_band_holds_its_share_of_a_normal_quantity(probability: float) -> None:
    h, n = np.array([1.0, 2.0]), np.zeros(2)
    cov = np.stack([np.diag([4.0, 9.0, 16.0]), np.diag([1.0, 0.25, -1e-12])])
    made = Forecast(ns(0), h, np.ones((2, 3)), cov, np.zeros((2, 3)), n, n + 1.0, n + 3.0, n + 2.0, n, n + 0.1, n, n + 0.2)
    z = ndtri(0.5 + 0.5 * probability)
    for name, mean, sigma in (
        ("deck_height_m", 0.0, 1.0), ("rise_m_s", 3.0, 2.0), ("roll_rad", 0.0, 0.1), ("pitch_rad", 0.0, 0.2),
        ("d_body_pad_level", 1.0, np.array([[2.0, 3.0, 4.0], [1.0, 0.5, 0.0]])),
    ):  # fmt: skip
        low, high = made.band(name, probability)
        np.testing.assert_allclose(low, np.broadcast_to(mean - z * sigma, low.shape), atol=1e-3)
        np.testing.assert_allclose(high, np.broadcast_to(mean + z * sigma, high.shape), atol=1e-3)


@pytest.mark.parametrize("prior", [0.5, 0.9])
@pytest.mark.parametrize("v", [(0.0, 0.0), (0.1, -0.05), (0.02, 0.2)])
def test_motion_is_as_likely_as_bayes_has_it(v: tuple[float, float], prior: float) -> None:
    def density(cov: np.ndarray) -> float:
        return math.exp(-0.5 * np.array(v) @ np.linalg.solve(cov, v)) / math.tau / math.sqrt(np.linalg.det(cov))

    cov = np.array([[0.004, 0.001], [0.001, 0.006]])
    still, moving = (density(cov + var * np.eye(2)) for var in (0.03**2, 1.0))
    rest = prior * still * math.exp(0.7)
    expected = (1.0 - prior) * moving / ((1.0 - prior) * moving + rest)
    reported = probability_of_motion(0.7, v, (0.004, 0.001, 0.006), prior)
    assert reported == pytest.approx(expected, rel=1e-9)
    if prior == 0.5:
        assert probability_of_motion(0.7, v, (0.004, 0.001, 0.006)) == reported


def test_neither_rest_nor_motion_is_ever_certain() -> None:
    still, prior = ((0.0, 0.0), (0.01, 0.0, 0.01)), 1.0 - 1e-12
    assert probability_of_motion(1e4, *still) == pytest.approx(math.exp(-60.0), rel=1e-9, abs=0.0)
    assert probability_of_motion(-1e4, *still, prior) < 1.0
    for rest in (0.0, 1e-5, 0.3, 1.0):
        bounded = min(max(rest, 1e-12), 1.0 - 1e-12)
        assert log_evidence_of_rest(rest) == pytest.approx(math.log(bounded / (1.0 - bounded)), abs=1e-12)


def test_the_core_s_record_of_an_event_holds_its_values_and_zeros_to_its_end() -> None:
    head, at = CORE.ffi.offsetof("dl_event", "sample"), 500.0
    events: list[tuple[Event, int]] = [
        (imu(at), 6), (attitude(at), 18), (velocity(at), 12), (range_down(at, 1.0), 2), (baro(at), 2),
        (vessel(at, np.ones(3), 1.0), 15), (vessel(at), 0),
    ]  # fmt: skip
    for event, n in events:
        record = packed(event)
        assert len(record) == CORE.dtype("dl_event").itemsize
        assert n == 0 or any(record[head + 8 * n - 8 : head + 8 * n])
        assert not any(record[head + 8 * n :])
    no_pose = np.frombuffer(packed(sighting(at, yaw=None)), CORE.dtype("dl_event"))[0]["sample"]["sighting"]
    names = ("has_yaw", "yaw_ambiguous", "has_pose6", "yaw_rad", "pose_d_level", "pose_R", "pose_cov")
    assert not any(no_pose[name].any() for name in names)
