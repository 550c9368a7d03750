"""Signs, thresholds and inflations of the filter that a whole flight hardly notices when they are wrong."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, Baro, BodyVelocity, Imu
from estimator.ekf import EkfOptions, Filter
from estimator.ekf.state import (
    ATT_BIAS,
    ATT_ERR,
    BARO_OFFSET,
    CAMERA_DELAY,
    DECK_DISP,
    DECK_RATE,
    PAD_YAW,
    POS_REL,
    TURN_RATE,
    VEL,
    VEL_SCALE,
    VESSEL_VEL,
    YAW_RATE,
    N,
)
from tests.estimator.ekf import flown
from tests.estimator.ekf.belief import newest
from tests.estimator.ekf.oracle.pad_velocity import v_pad_ned
from tests.estimator.ekf.test_jacobians import random_belief, sighting
from tests.support.voyage_truth import OPTIONS, Voyage, VoyageScene, events, ns, stamp

SCENE = VoyageScene(seed=3, sea="jonswap", duration_s=9.5, imu_hz=50.0, sighting_hz=10.0, range_hz=2.0, gaps=0, outliers=0.0)


def hover(
    seconds: float, ekf: Filter, since: float = 0.0, yaw_told: float = 0.0, velocity: tuple[float, float] = (0.0, 0.0)
) -> Filter:
    """Still over a pad that stands two metres below, its arrow to the north-east; a barometer and a velocity sensor."""
    rng = np.random.default_rng(round(10 * since))
    cov = np.diag([0.01, 0.01, 0.02, 0.02]) ** 2
    for k in range(round(seconds * 50)):
        t = since + 0.02 * k
        ekf.put([Imu(stamp(t), 1e-3 * rng.standard_normal(3), [0.0, 0.0, -9.80665] + 1e-2 * rng.standard_normal(3))])
        ekf.put([Attitude(stamp(t), Rotation.from_rpy(0.0, 0.0, yaw_told), np.eye(3) * 0.005**2)])
        if k % 5 == 0:
            d = np.array([0.2, -0.1, 2.0]) + 0.005 * rng.standard_normal(3)
            ekf.put([Sighting(stamp(t), k, "selected", d, -0.7 + 0.01 * rng.standard_normal(), False, cov, 1.0)])
        if k % 5 == 1:
            v = np.array([*velocity, 0.0]) + 0.01 * rng.standard_normal(3)
            ekf.put([BodyVelocity(stamp(t), v, np.diag([0.02**2, 0.02**2, UNKNOWN_VAR]))])
    return ekf


def test_sightings_three_times_as_bad_as_they_say_are_not_consistent() -> None:
    received_at, _ = events(Voyage(SCENE))
    rng = np.random.default_rng(0)
    for factor, expected in ((0.0, True), (3.0, False)):
        ekf = Filter(OPTIONS)
        for event in received_at:
            if isinstance(event, Sighting):
                sigma = np.sqrt(np.diag(event.cov)[:3])
                event = replace(event, d_body_pad_level=event.d_body_pad_level + factor * sigma * rng.standard_normal(3))
            ekf.put([event])
        state = ekf.at(ns(9.4))
        assert state is not None
        assert state.consistent is expected


@pytest.mark.parametrize("pose6", [False, True])
def test_a_stamp_s_sigma_is_noise_along_what_the_image_does_meanwhile(pose6: bool) -> None:
    b = random_belief(5)
    w = np.array([0.3, -0.2, 0.4])
    rows = []
    for sigma_s in (0.0, 0.02):
        seen, levelled_by = sighting(5, pose6=pose6, sigma_s=sigma_s)
        rows.append(flown.sighting(b.x, b.R, w, seen, levelled_by, np.zeros((3, 3)), 0.1))
    H, x = rows[0].H, b.x
    deck_ned = v_pad_ned(x) - np.array([*x[VESSEL_VEL], 0.0])
    turns = H[:, [DECK_DISP[3], DECK_DISP[4], PAD_YAW]].dot([x[DECK_RATE[3]], x[DECK_RATE[4]], x[YAW_RATE] + x[TURN_RATE]])
    rate = H[:, CAMERA_DELAY] + H[:, POS_REL].dot(deck_ned) + turns
    assert float(np.linalg.norm(rate)) > 0.1
    np.testing.assert_allclose(rows[1].R - rows[0].R, np.outer(rate, rate) * 0.02**2, atol=1e-12)


@pytest.mark.parametrize("pose6", [False, True])
def test_a_rate_that_changes_while_a_stamp_may_err_is_noise_across_the_view(pose6: bool) -> None:
    b = random_belief(5)
    seen, levelled_by = sighting(5, pose6=pose6, sigma_s=0.02)
    w = np.array([0.3, -0.2, 0.4])
    still, changing = (
        flown.sighting(b.x, b.R, w, seen, levelled_by, np.zeros((3, 3)), 0.1, rate_var=rate_var).R for rate_var in (0.0, 0.5**2)
    )
    more = np.diag(changing - still)
    np.testing.assert_allclose(changing - still, np.diag(more), atol=1e-15)
    whole = seen.d_body_pad_level if seen.pose6 is None else seen.pose6.d_body_pad_level
    assert more[:3].sum() == pytest.approx((0.02 * 0.5) ** 2 * 2.0 * whole.dot(whole))
    np.testing.assert_allclose(more[3:], (0.02 * 0.5) ** 2)
    assert more[:3].min() >= 0.0


def test_a_late_frame_of_a_body_that_rocks_is_predicted_by_the_rate_of_its_exposure() -> None:
    """Two swings a second by 15 degrees, 5 m over the pad, 20 ms late: a rate smoothed over 30 ms is 12 cm off."""
    late_s, w_rad_s, swing_rad, d_ned = 0.02, 13.0, 0.26, np.array([0.3, -0.2, 5.0])

    def rolled(t: float) -> Rotation:
        return Rotation.from_rpy(swing_rad * math.sin(w_rad_s * t), 0.0, 0.0)

    lag = w_rad_s * 0.03
    off = []
    for t in np.arange(0.0, math.tau / w_rad_s, 0.02):
        rate = swing_rad * w_rad_s * math.cos(w_rad_s * t)
        smooth = swing_rad * w_rad_s * (math.cos(w_rad_s * t) + lag * math.sin(w_rad_s * t)) / (1.0 + lag * lag)
        R = rolled(t).matrix
        d_level = R.dot(rolled(t + late_s).matrix.T.dot(d_ned))
        x = np.zeros(N)
        x[POS_REL], x[CAMERA_DELAY] = d_ned, late_s
        seen = Sighting(stamp(t), 0, "selected", d_level, None, False, np.eye(4) * 1e-4, 1.0)
        row = flown.sighting(x, R, (rate, 0.0, 0.0), seen, R, np.zeros((3, 3)), 0.1, rate_var=(rate - smooth) ** 2)
        off.append(float(np.linalg.norm(row.innov[:3])))
    assert max(off) < 0.05


def test_the_attitude_first_accepted_errs_by_what_the_one_reported_errs() -> None:
    """Told is true plus its constant error: together they are known at once, apart they are not."""
    ekf = Filter()
    ekf.put([Attitude(stamp(0.0), Rotation.from_rpy(0.1, -0.05, 1.0), np.eye(3) * 1e-4)])
    o, P = EkfOptions(), newest(ekf).P
    reported = (
        P[ATT_ERR, ATT_ERR][:2, :2] + P[ATT_ERR, ATT_BIAS][:2] + P[ATT_BIAS, ATT_ERR][:, :2] + P[np.ix_(ATT_BIAS, ATT_BIAS)]
    )
    np.testing.assert_allclose(np.diag(reported), o.sigma_initial_tilt_rad**2, rtol=0.2)
    np.testing.assert_allclose(P[ATT_BIAS, ATT_BIAS], o.sigma_attitude_bias_rad**2)


@pytest.mark.parametrize("yaw", [0.5, -2.0])
def test_the_first_sighting_s_heading_is_the_belief_s(yaw: float) -> None:
    ekf = Filter()
    ekf.put([Attitude(stamp(0.0), Rotation.from_rpy(0.0, 0.0, 1.0), np.eye(3) * 1e-4)])
    cov = np.diag([0.01, 0.01, 0.02, 0.02]) ** 2
    ekf.put([Sighting(stamp(0.0), 0, "selected", np.array([0.3, 0.2, 3.0]), yaw, False, cov, 1.0)])
    state = ekf.at(ns(0.0))
    assert state is not None
    assert state.yaw_rad is not None
    assert math.isclose(state.yaw_rad, yaw, abs_tol=1e-3)
    assert math.isclose(math.remainder(float(newest(ekf).x[PAD_YAW]) - (1.0 - yaw), math.tau), 0.0, abs_tol=1e-3)


def test_an_attitude_with_a_new_north_comes_back_in_and_the_pad_stays() -> None:
    ekf = hover(4.0, Filter())
    before = ekf.at(ns(3.99))
    ekf = hover(4.0, ekf, since=4.0, yaw_told=0.8)
    state = ekf.at(ns(7.99))
    assert before is not None
    assert state is not None
    np.testing.assert_allclose(state.d_body_pad_level, before.d_body_pad_level, atol=0.08)
    assert state.yaw_rad is not None
    assert abs(state.yaw_rad + 0.7) < 0.05
    assert abs(math.atan2(newest(ekf).R[1, 0], newest(ekf).R[0, 0]) - 0.8) < 0.1


def test_a_velocity_that_jumps_for_good_comes_back_in_as_body_and_vessel_together() -> None:
    o = EkfOptions(velocity_is_over="ground")
    ekf = hover(4.0, Filter(o))
    ekf = hover(4.0, ekf, since=4.0, velocity=(1.5, 0.0))
    state = ekf.at(ns(7.99))
    assert state is not None
    assert abs(newest(ekf).x[VEL][0] * newest(ekf).x[VEL_SCALE] - 1.5) < 0.4
    assert abs(newest(ekf).x[VESSEL_VEL][0] - newest(ekf).x[VEL][0]) < 0.2
    assert np.linalg.norm(state.v_pad_level) < 0.2
    np.testing.assert_allclose(state.d_body_pad_level, [0.2, -0.1, 2.0], atol=0.05)


def test_a_barometer_that_jumps_for_good_comes_back_in_by_its_offset() -> None:
    ekf, verdicts = hover(2.0, Filter()), []
    for k in range(200):
        t = 2.0 + 0.02 * k
        jump = 0.0 if k < 50 else 40.0
        ekf = hover(0.02, ekf, since=t)
        outcomes = ekf.put([Baro(stamp(t + 0.01), 12.0 + jump, 0.3)])
        verdicts.append(outcomes[0].verdict)
    assert Verdict.GATED in verdicts[50:60]
    assert verdicts[-20:] == [Verdict.FUSED] * 20
    assert abs(newest(ekf).x[BARO_OFFSET] - 50.0) < 0.5
    assert abs(newest(ekf).x[POS_REL][2] - 2.0) < 0.05
