"""Outputs of the filter from a state made by hand: position, velocity, heading, covariance, and the consistency flag."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, RelativeState, Verdict
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Baro
from estimator.contracts.time import MonoNs
from estimator.core.abi import DL_WITH_COVARIANCE
from estimator.ekf import Ekf, EkfOptions, at, deck_motion_bank, forecast, moving, start, step
from estimator.ekf.forecast import probability_of_motion
from estimator.ekf.history import History
from estimator.ekf.packed_belief import PackedBelief
from estimator.ekf.so3 import about_down
from estimator.ekf.state import (
    ACCEL_BIAS,
    BARO_OFFSET,
    CAMERA_DELAY,
    CAMERA_MOUNT,
    GYRO_BIAS,
    PAD_YAW,
    POS_REL,
    RANGE_OFFSET,
    TURN_RATE,
    VEL,
    VEL_SCALE,
    VESSEL_VEL,
    Belief,
    N,
)
from estimator.integrity import IntegrityOptions
from tests.estimator.ekf.hand import MS, TILTED, TOOLS, S, T, belief, correlated, imu, params, stamp, state
from tests.estimator.ekf.oracle import so3

NOW = MonoNs(T)


def holding(b: Belief | None) -> Ekf:
    return Ekf(TOOLS, History(base=None if b is None else PackedBelief.of(b)))


def probability_moving(b: Belief) -> float:
    (nn, ne), (_, ee) = b.P[VESSEL_VEL, VESSEL_VEL].tolist()
    return probability_of_motion(deck_motion_bank.log_evidence_of_rest(b.sea), b.x[VESSEL_VEL].tolist(), (nn, ne, ee))


def told(b: Belief, now: int = T) -> RelativeState:
    found = at(holding(b), MonoNs(now))
    assert found is not None
    return found


# The numbers


def test_place_and_velocity_are_of_the_pad_as_it_is_now_in_axes_that_turn_with_the_body() -> None:
    """The place is that of the deck at exposure less its motion in the delay; velocities are those of the same deck."""
    b = belief(TILTED, x=state())
    found = told(b)
    into_level = about_down(-0.8)
    v_waves = b.x[[19, 23, 27]]
    d = b.x[POS_REL] - b.x[CAMERA_DELAY] * v_waves
    np.testing.assert_allclose(found.d_body_pad_level, into_level @ d, atol=1e-12)
    vessel = np.array([*b.x[VESSEL_VEL], 0.0])
    np.testing.assert_allclose(found.v_pad_level, into_level @ (v_waves + vessel - b.x[VEL]), atol=1e-12)
    assert found.yaw_rad == pytest.approx(0.8 - b.x[PAD_YAW])
    assert (found.at, found.sighted, found.path) == (T, b.sighted, "ekf")


def test_a_relative_heading_lies_within_half_a_turn() -> None:
    x = state()
    x[PAD_YAW] = -3.0
    assert told(belief(TILTED, x=x)).yaw_rad == pytest.approx(0.8 + 3.0 - math.tau)


def test_the_covariance_is_what_each_error_does_to_what_is_reported() -> None:
    b = belief(TILTED, x=state())

    def leaving(i: int, by: float) -> F64:
        x, R = b.x.copy(), b.R
        if i < 3:
            R = R @ so3.exp(by * np.eye(3)[i])
        else:
            x[i] += by
        found = told(b._replace(x=x, R=R, R_cov=R))
        assert found.yaw_rad is not None
        return np.array([*found.d_body_pad_level, *found.v_pad_level, found.yaw_rad])

    h = 1e-5
    J = np.stack([(leaving(i, h) - leaving(i, -h)) / (2 * h) for i in range(N)], axis=1)
    cov = told(b).cov
    np.testing.assert_allclose(cov, J @ b.P @ J.T, atol=1e-9)
    np.testing.assert_allclose(cov, cov.T, atol=0.0)


def test_a_little_later_it_is_the_belief_carried_on_with_all_its_growing_doubt() -> None:
    b = belief(TILTED, x=state(), t_imu=T, w=np.array([0.1, 0.2, 0.3]), f=np.array([0.3, -0.2, -9.7]))
    now = T + 50 * MS
    found, other = told(b, now), told(PackedBelief.of(b).propagated(now, TOOLS, DL_WITH_COVARIANCE).belief, now)
    for name in ("d_body_pad_level", "v_pad_level", "cov"):
        np.testing.assert_allclose(getattr(found, name), getattr(other, name), atol=1e-9, err_msg=name)
    assert found.yaw_rad == pytest.approx(other.yaw_rad)
    assert np.all(np.diag(found.cov) > 0.0)
    certain = told(b._replace(P=np.zeros((N, N))), now).cov
    assert np.all(np.linalg.eigvalsh(certain) > 0.0), "of a belief without a doubt some comes in that time"


def test_a_heading_never_known_is_none_and_could_be_any() -> None:
    b = belief(TILTED, x=state())
    found, known = told(b._replace(heading_known=False)), told(b)
    assert found.yaw_rad is None
    expected = known.cov.copy()
    expected[6] = expected[:, 6] = 0.0
    expected[6, 6] = UNKNOWN_YAW_VAR
    np.testing.assert_allclose(found.cov, expected)


# Whether there is anything to tell


def test_no_message_reports_a_pad_never_seen_or_not_for_half_a_minute() -> None:
    for b in (None, belief(sighted=-1)):
        assert at(holding(b), NOW) is None
        assert forecast(holding(b), NOW, [0.0]) is None
        assert moving(holding(b)) is None
    b = belief(TILTED, x=state())
    for ago_s, there in ((29.999, True), (30.001, False)):
        ekf = holding(b._replace(sighted=T - round(ago_s * S)))
        assert (at(ekf, NOW) is not None) is there
        assert (forecast(ekf, NOW, [0.0]) is not None) is there
    first = holding(belief(TILTED, x=state(), t=0, sighted=0))
    assert at(first, MonoNs(0)) is not None
    assert forecast(first, MonoNs(0), [0.0]) is not None
    assert moving(first) is not None


@pytest.mark.parametrize("axis", range(3))
def test_it_is_consistent_while_the_place_is_known_to_a_metre_along_each_axis(axis: int) -> None:
    P = np.eye(N) * 1e-12
    for sigma_m, wanted in ((0.999, True), (1.001, False)):
        P[3 + axis, 3 + axis] = sigma_m**2
        assert told(belief(P=P)).consistent is wanted
    for sigma_m, wanted in ((0.499, True), (0.501, False)):
        P[3 + axis, 3 + axis] = sigma_m**2
        chosen = params(consistent_sigma_m=0.5)
        found = at(Ekf(chosen, History(base=PackedBelief.of(belief(P=P)))), NOW)
        assert found is not None
        assert found.consistent is wanted
    P[6 + axis, 6 + axis] = 9.0
    assert told(belief(P=P)).consistent, "of its velocity nothing is asked"


# The figures for records


def test_every_figure_for_the_records_is_the_one_it_is_called_by() -> None:
    x, P = state(), correlated()
    P[VEL_SCALE, VEL_SCALE] = -1e-9
    P[VESSEL_VEL, VESSEL_VEL] = [[0.04, 0.03], [0.03, 0.05]]
    b = belief(TILTED, x=x, P=P, nis_mean=1.3)
    b = b._replace(sea=b.sea._replace(zeta=np.array([0.1, 0.2, 0.3, 0.4, 0.5]), sigma=np.array([0.3, 0.4, 0.5, 0.02, 0.03])))
    expected = {
        "nis_mean": 1.3,
        "probability_moving": probability_moving(b),
        "velocity_scale": x[VEL_SCALE],
        "camera_delay_s": x[CAMERA_DELAY],
        "baro_offset_m": x[BARO_OFFSET],
        "range_offset_m": x[RANGE_OFFSET],
        "v_vessel_north_m_s": x[16],
        "v_vessel_east_m_s": x[17],
        "turn_rate_rad_s": x[TURN_RATE],
        "sigma_velocity_scale": 0.0,
        "sigma_camera_delay_s": math.sqrt(P[CAMERA_DELAY, CAMERA_DELAY]),
    }
    for k, axis in enumerate("xyz"):
        expected[f"sigma_mount_{axis}_rad"] = math.sqrt(P[43 + k, 43 + k])
        expected[f"mount_{axis}_rad"] = x[CAMERA_MOUNT][k]
        expected[f"gyro_bias_{axis}_rad_s"] = x[GYRO_BIAS][k]
        expected[f"accel_bias_{axis}_m_s2"] = x[ACCEL_BIAS][k]
    for k, channel in enumerate(("north", "east", "down", "roll", "pitch")):
        expected[f"period_{channel}_s"] = 2.0 * math.pi / b.sea.w_rad_s[k]
        expected[f"damping_{channel}"] = b.sea.zeta[k]
        expected[f"swing_{channel}"] = b.sea.sigma[k]
    found = dict(told(b).details)
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert found[name] == pytest.approx(value), name


# Forecasts


@pytest.mark.parametrize("later_ms", [0, 50])
def test_a_forecast_of_now_is_what_is_reported_now(later_ms: int) -> None:
    b = belief(TILTED, x=state(), t_imu=T, w=np.array([0.1, 0.2, 0.3]), f=np.array([0.3, -0.2, -9.7]))
    now = T + later_ms * MS
    ahead, found = forecast(holding(b), MonoNs(now), [0.0]), told(b, now)
    assert ahead is not None
    assert ahead.at == now
    np.testing.assert_allclose(ahead.d_body_pad_level[0], found.d_body_pad_level, atol=1e-9)
    np.testing.assert_allclose(ahead.cov_d_level[0], found.cov[:3, :3], atol=1e-9)
    np.testing.assert_allclose(ahead.horizons_s, [0.0])


def test_horizons_are_numbers_of_zero_or_more() -> None:
    ekf = holding(belief(TILTED, x=state()))
    for bad in ([-0.001], [1.0, -1.0], [math.nan], [math.inf], [0.0, math.inf]):
        with pytest.raises(ValueError, match="horizons"):
            forecast(ekf, NOW, bad)
    for good in ([0.0, 1.0], np.array([[0.5], [2.0]])):
        found = forecast(ekf, NOW, good)
        assert found is not None
        assert found.horizons_s.shape == (2,)
        assert found.d_body_pad_level.shape == (2, 3)


def test_a_vessel_under_way_moves_and_one_that_lies_still_may_not() -> None:
    P = np.eye(N) * 1e-6
    under_way, still = np.zeros(N), np.zeros(N)
    under_way[VESSEL_VEL] = 3.0, 1.0
    b = belief(x=under_way, P=P, sea=deck_motion_bank.unknown())
    moves = moving(holding(b))
    assert moves == probability_moving(b)
    assert moves > 0.99
    rests = moving(holding(b._replace(x=still)))
    assert rests is not None
    assert rests < 0.1


# A filter and its steps


def test_a_new_filter_has_the_options_given_or_the_usual_ones_and_knows_nothing() -> None:
    chosen = EkfOptions(forget_s=7.0)
    for ekf, options in ((start(chosen), chosen), (start(), EkfOptions())):
        assert ekf.params.options == options
        assert ekf.history == History()
        assert ekf.belief is None
        assert ekf.limits == IntegrityOptions()
    assert start(limits=None).limits is None


def test_a_step_makes_a_new_memory_and_leaves_the_old_one() -> None:
    old = holding(belief())
    new, outcomes = step(old, Baro(stamp(T), 1.0, 0.5))
    assert [outcome.verdict for outcome in outcomes] == [Verdict.FUSED]
    assert len(new.history.nodes) == 1
    assert old.history == History(base=old.history.base)
    assert old.belief is old.history.base.belief
    assert new.params == old.params
    for f in fields(Ekf):
        assert f.name in ("history", "imu", "answers") or getattr(new, f.name) is getattr(old, f.name)


def test_an_imu_sample_is_held_to_its_limits_where_nothing_before_the_filter_did() -> None:
    rest, thrown = (0.0, 0.0, -9.81), (0.0, 0.0, 1e4)
    ekf, outcomes = step(start(), imu(T, (0.01, 0.0, 0.0), rest))
    assert outcomes[0].verdict is Verdict.FUSED
    spike = imu(T + 10 * MS, (0.0, 0.02, 0.0), thrown)
    refused, outcomes = step(ekf, spike)
    assert [o.verdict for o in outcomes] == [Verdict.IMPOSSIBLE]
    assert (outcomes[0].source, outcomes[0].measured_at) == ("imu", spike.stamp.measured_at)
    assert refused.history is ekf.history
    unchecked, outcomes = step(replace(ekf, limits=None), spike)
    assert outcomes[0].verdict is not Verdict.IMPOSSIBLE
    assert unchecked.history is not ekf.history
    verdicts = []
    for k in range(1, 400):
        ekf, outcomes = step(ekf, imu(T + 10 * k * MS, (0.01, 0.0, 0.0), rest))
        verdicts.append(outcomes[0].verdict)
    assert verdicts[-1] is Verdict.FROZEN, "the watch over the IMU goes on from sample to sample"
    _, outcomes = step(ekf, Baro(stamp(T + 4000 * MS), 1.0, 0.5))
    assert outcomes[0].verdict is not Verdict.FROZEN, "it is the IMU's alone"
