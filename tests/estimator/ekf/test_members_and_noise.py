"""The numbers that the core is given: the bank's members, the noise of every state, and what is read off a forecast."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtri

from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, Baro, BodyVelocity, Range, VesselReport
from estimator.contracts.time import MonoNs
from estimator.core.library import CORE
from estimator.ekf import Event, Forecast, deck_motion_bank, state
from estimator.ekf.deck_motion_bank import carrying
from estimator.ekf.event import packed
from estimator.ekf.forecast import log_evidence_of_rest, probability_of_motion
from estimator.ekf.params import NOT_MEASURED_VAR
from tests.estimator.ekf.hand import T, imu, params, sighting, stamp


def test_the_members_are_every_period_damping_and_size_and_a_deck_at_rest() -> None:
    w, zeta, sigma, log_prior = deck_motion_bank._grid()
    assert w.shape == zeta.shape == log_prior.shape == (1 + 9 * 3 * 5,)
    assert (w[0], zeta[0]) == (1.0, 0.5)
    assert sigma.shape == (5, 136)
    assert sigma[:, 0].tolist() == [1e-7] * 5
    assert np.exp(log_prior).sum() == pytest.approx(1.0)
    assert np.exp(log_prior[:2]) == pytest.approx([0.5, 0.5 / 135])
    assert set(log_prior[1:].tolist()) == {log_prior[1]}
    periods = math.tau / w[1::15]
    assert periods[[0, -1]] == pytest.approx([2.2, 14.0])
    assert np.diff(np.log(periods)) == pytest.approx(np.full(8, math.log(14.0 / 2.2) / 8))
    members = {(round(one, 9), z, s) for one, z, s in zip(w[1:].tolist(), zeta[1:].tolist(), sigma[0, 1:].tolist(), strict=True)}
    assert len(members) == 135
    assert sorted({z for _, z, _ in members}) == [0.2, 0.35, 0.55]
    assert sigma[:3, 1:6].tolist() == [[0.02, 0.055, 0.15, 0.42, 1.15]] * 3
    for tilt in sigma[3:, 1:6]:
        assert np.degrees(tilt) == pytest.approx([0.25, 0.7, 2.0, 5.5, 15.0])


def test_a_position_carried_by_an_imu_errs_as_its_sensors_do() -> None:
    accel, drift, tilt = carrying(0.02, 0.003, 0.0007)
    turn = math.sqrt(2.0) * 0.003
    assert accel.tolist() == [0.02, 0.02, 0.02, 0.0, 0.0]
    assert drift == pytest.approx([9.81 * turn, 9.81 * turn, 0.0007, 0.0, 0.0])
    assert tilt == pytest.approx([turn, turn, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("rest", [0.0, 1e-5, 0.3, 0.5, 1.0])
def test_the_evidence_of_rest_is_finite(rest: float) -> None:
    bounded = min(max(rest, 1e-12), 1.0 - 1e-12)
    assert log_evidence_of_rest(rest) == pytest.approx(math.log(bounded / (1.0 - bounded)), abs=1e-12)


def test_every_state_s_noise_is_its_option_squared() -> None:
    given: dict[str, tuple[Any, float]] = {
        "asd_gyro_rad_s": (state.ATT_ERR, 0.011), "asd_gyro_bias_rad_s2": (state.GYRO_BIAS, 0.0012),
        "asd_accel_bias_m_s3": (state.ACCEL_BIAS, 0.0013), "asd_velocity_scale": (state.VEL_SCALE, 0.0014),
        "asd_vessel_velocity_m_s2": (state.VESSEL_VEL, 0.15), "asd_turn_rate_rad_s2": (state.TURN_RATE, 0.016),
        "delay_drift_s_sqrt_s": (state.CAMERA_DELAY, 0.00018),
        "mount_drift_rad_sqrt_s": (state.CAMERA_MOUNT, 0.00019), "asd_baro_offset_m": (state.BARO_OFFSET, 0.021),
        "asd_range_offset_m": (state.RANGE_OFFSET, 0.022), "asd_attitude_bias_rad_s": (state.ATT_BIAS, 0.0023),
    }  # fmt: skip
    noise = params(
        **{name: value for name, (_, value) in given.items()}, asd_accel_m_s2=0.31, asd_coast_m_s2=0.32, asd_coast_rad_s=0.33
    )
    expected = np.zeros(state.N)
    for place, value in given.values():
        expected[place] = value**2
    np.testing.assert_allclose(noise.psd, expected, rtol=1e-14)
    assert (noise.psd_accel, noise.psd_coast, noise.psd_coast_turn) == pytest.approx((0.31**2, 0.32**2, 0.33**2))
    assert noise.not_measured_var == NOT_MEASURED_VAR == pytest.approx(0.1 * UNKNOWN_VAR)
    for ours, theirs in zip(noise.carrying, carrying(0.31, 0.011, 0.0013), strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("probability", [0.5, 0.68, 0.8, 0.9, 0.95, 0.99])
def test_a_band_holds_its_share_of_a_normal_quantity(probability: float) -> None:
    h, n = np.array([1.0, 2.0]), np.zeros(2)
    cov = np.stack([np.diag([4.0, 9.0, 16.0]), np.diag([1.0, 0.25, -1e-12])])
    made = Forecast(MonoNs(0), h, np.ones((2, 3)), cov, np.zeros((2, 3)), n, n + 1.0, n + 3.0, n + 2.0, n, n + 0.1, n, n + 0.2)
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


def test_the_core_s_record_of_an_event_holds_its_values_and_zeros_to_its_end() -> None:
    zero, at = np.zeros(3), stamp(T)
    head = CORE.ffi.offsetof("dl_event", "sample")
    events: list[tuple[Event, int]] = [
        (imu(T, zero, np.ones(3)), 6),
        (Attitude(at, Rotation.identity(), np.eye(3)), 18), (BodyVelocity(at, zero, np.eye(3)), 12),
        (Range(at, 1.0, 0.1), 2), (Baro(at, 1.0, 0.1), 2), (VesselReport(at, zero, np.eye(3), 1.0, 0.1), 15),
    ]  # fmt: skip
    for event, n in events:
        record = packed(event)
        assert len(record) == CORE.dtype("dl_event").itemsize
        assert any(record[head + 8 * n - 8 : head + 8 * n])
        assert not any(record[head + 8 * n :])
    blind = packed(VesselReport(at, None, None, None, None))
    assert not any(blind[head:])
    no_pose = np.frombuffer(packed(sighting((0.0, 0.0, 2.0))), CORE.dtype("dl_event"))[0]["sample"]["sighting"]
    assert not any(no_pose[name].any() for name in ("has_yaw", "yaw_ambiguous", "has_pose6", "yaw_rad"))
    assert not any(no_pose[name].any() for name in ("pose_d_level", "pose_R", "pose_cov"))
