"""Every hand-written Jacobian against finite differences of the model it linearises, at states drawn at random.

The models are evaluated through the same functions the filter uses, but their derivatives are not: a state is moved by a small
error the way the filter applies a correction (`x + dx`, `R exp(dtheta)`), and the change of the prediction is compared.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.estimates import Pose6, Sighting
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Range
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf.options import EkfOptions
from estimator.ekf.params import FilterParams
from estimator.ekf.state import ATT_ERR, CAMERA_DELAY, CAMERA_MOUNT, PAD_YAW, POS_REL, VEL, VEL_SCALE, VESSEL_VEL, N
from tests.estimator.ekf import flown
from tests.estimator.ekf.belief import G_NED, Aid, Belief, Gathered, initial, process_event, unknown
from tests.estimator.ekf.hand import correlated, params, stamp
from tests.estimator.ekf.oracle import motion as oracle_motion
from tests.estimator.ekf.oracle import sighting as models
from tests.estimator.ekf.oracle import so3
from tests.estimator.ekf.oracle.algebra import Algebra
from tests.estimator.ekf.oracle.samples import Sample
from tests.estimator.ekf.oracle.sighting import LinearizedMeasurement

OPTIONS = EkfOptions()
ALGEBRA = Algebra(N)
WALK = FilterParams(OPTIONS)


def random_belief(seed: int) -> Belief:
    rng = np.random.default_rng(seed)
    R = Rotation.from_rpy(*rng.uniform((-0.4, -0.4, -3.0), (0.4, 0.4, 3.0))).matrix
    b = initial(OPTIONS, 0, R, 0.05, 0.1, unknown())
    x = b.x.copy()
    x[POS_REL] = rng.uniform(-2, 2, 3) + np.array([0, 0, 4])
    x[VEL] = rng.normal(size=3)
    x[9:15] = 0.1 * rng.normal(size=6)
    x[VEL_SCALE] = rng.uniform(0.6, 1.2)
    x[VESSEL_VEL] = rng.normal(size=2)
    x[18:38] = 0.2 * rng.normal(size=20)
    x[PAD_YAW] = rng.uniform(-3, 3)
    x[39:42] = 0.05 * rng.normal(size=3)
    x[CAMERA_DELAY] = 0.02 * rng.normal()
    x[CAMERA_MOUNT] = 0.05 * rng.normal(size=3)
    x[46:52] = 0.05 * rng.normal(size=6)
    return b._replace(x=x)


def moved(b: Belief, dx: F64) -> Belief:
    """Return the belief with an error put in as a correction would be."""
    x = b.x + dx
    x[ATT_ERR] = 0.0
    R = b.R @ so3.exp(dx[ATT_ERR])
    return b._replace(x=x, R=R, R_cov=R)


def differences(predict, b: Belief, h: float = 1e-6) -> F64:
    """(m, N) of `predict(belief) -> (m,)` by central differences."""
    columns = []
    for k in range(N):
        dx = np.zeros(N)
        dx[k] = h
        columns.append((predict(moved(b, dx)) - predict(moved(b, -dx))) / (2 * h))
    return np.array(columns).T


def sighting(seed: int, *, pose6: bool, sigma_s: float = 0.0) -> tuple[Sighting, F64]:
    rng = np.random.default_rng(seed + 1000)
    stamp = Stamp(MonoNs(0), MonoNs(0), sigma_s, "sim")
    d = rng.uniform(-1, 1, 3) + np.array([0, 0, 4])
    cov = np.diag([0.02, 0.03, 0.04, 0.01]) ** 2
    pose = Pose6(d, Rotation.from_rpy(0.1, -0.1, rng.uniform(-3, 3)), np.diag([0.02, 0.03, 0.04, 0.01, 0.01, 0.02]) ** 2)
    levelled_by = Rotation.from_rpy(*rng.uniform((-0.4, -0.4, -3.0), (0.4, 0.4, 3.0))).matrix
    return Sighting(stamp, 1, "selected", d, rng.uniform(-3, 3), False, cov, 1.0, pose if pose6 else None), levelled_by


def check_sighting(b: Belief, seed: int, pose6: bool, rows: slice) -> None:
    seen, levelled_by = sighting(seed, pose6=pose6)
    w = np.random.default_rng(seed).normal(size=3)

    def row(c: Belief) -> LinearizedMeasurement:
        return flown.sighting(c.x, c.R, w, seen, levelled_by, np.zeros((3, 3)), 0.1)

    if pose6:
        # Matching the measurement to the prediction keeps the rotation residual near zero, where its logarithm is linear.
        A = models.levelling(b.R, levelled_by)
        M = so3.exp(row(b).H[3:, CAMERA_DELAY] * b.x[CAMERA_DELAY]) @ A @ so3.exp(-b.x[CAMERA_MOUNT]) @ b.R.T @ models.deck(b.x).R
        assert seen.pose6 is not None
        pose = Pose6(seen.pose6.d_body_pad_level, Rotation(M), seen.pose6.cov)
        seen = Sighting(seen.stamp, 1, "selected", seen.d_body_pad_level, seen.yaw_rad, False, seen.cov, 1.0, pose)
    at_b = row(b)
    assert at_b.H.shape == ((6 if pose6 else 4), N)

    def predict(c: Belief) -> F64:
        change = row(c).innov - at_b.innov
        change[3:] = np.remainder(change[3:] + math.pi, math.tau) - math.pi
        return -change

    np.testing.assert_allclose(at_b.H[rows], differences(predict, b)[rows], atol=5e-7)


@given(st.integers(0, 10_000), st.booleans())
@settings(max_examples=20)
def test_sighting_place(seed: int, pose6: bool) -> None:
    check_sighting(random_belief(seed), seed, pose6, slice(0, 3))


@given(st.integers(0, 10_000), st.booleans())
@settings(max_examples=20)
def test_sighting_orientation(seed: int, pose6: bool) -> None:
    """The delay is zero: the orientation's columns leave out a delay times a rate."""
    b = random_belief(seed)
    x = b.x.copy()
    x[CAMERA_DELAY] = 0.0
    check_sighting(b._replace(x=x), seed, pose6, slice(3, None))


@given(st.integers(0, 10_000))
@settings(max_examples=15)
def test_delay_column_is_the_rate_of_what_the_camera_sees(seed: int) -> None:
    b = random_belief(seed)
    seen, levelled_by = sighting(seed, pose6=True)
    w = np.random.default_rng(seed).normal(size=3)
    H = flown.sighting(b.x, b.R, w, seen, levelled_by, np.zeros((3, 3)), 0.1).H[:, CAMERA_DELAY]
    h = 1e-6
    A, E = models.levelling(b.R, levelled_by), so3.exp(-b.x[CAMERA_MOUNT])

    def at(dt: float) -> tuple[F64, F64]:
        x = b.x.copy()
        x[POS_REL] += dt * (np.r_[b.x[VESSEL_VEL], 0.0] - b.x[VEL])
        R = b.R @ so3.exp(dt * (w - b.x[9:12]))
        return E @ R.T @ x[POS_REL], A @ E @ R.T @ models.deck(x).R

    (d1, M1), (d0, M0) = at(h), at(-h)
    np.testing.assert_allclose(H[:3], (d1 - d0) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(H[3:], so3.log(M1 @ M0.T) / (2 * h), atol=1e-6)


def gathered(b: Belief, sample: Sample, chosen: FilterParams) -> Gathered:
    """Return what the core keeps of a sample until it is fused: its Jacobian and its innovation."""
    after, _ = process_event(b, sample, chosen)
    assert after is not None
    (found,) = (aid.gathered for aid in after.aids if aid.gathered is not None)
    return found


@given(st.integers(0, 10_000), st.sampled_from(["ground", "pad", "either"]), st.integers(0, 3))
@settings(max_examples=40)
def test_samples_of_the_vehicle_by_the_core(seed: int, surface: str, kind: int) -> None:
    """The state reaches the core as the filter holds it, moved, and the core's own innovation moves as its Jacobian says."""
    b, chosen, at = random_belief(seed), params(velocity_is_over=surface, deck_radius_m=50.0), stamp(0)
    # The odds of the surface below were judged just now and stay, so that its weight is the same for every state.
    b = b._replace(sighted=0, t_velocity=0, over_pad=0.4, heading_is_given=True, aids=(Aid(fused=0),) * 4, P=correlated(seed))
    seen = Attitude(at, Rotation(b.R @ so3.exp(np.array([1e-7, -2e-7, 1e-7]))), np.eye(3))
    samples: list[Sample] = [seen, BodyVelocity(at, np.zeros(3), 10.0 * np.eye(3)), Range(at, 4.0, 10.0), Baro(at, 4.0, 10.0)]
    at_b = gathered(b, samples[kind], chosen)
    by = differences(lambda c: -np.array(gathered(c, samples[kind], chosen).innov), b)
    np.testing.assert_allclose(at_b.H, by, atol=1e-6)
    np.testing.assert_allclose(at_b.spread - at_b.ambiguity, at_b.H @ b.P @ at_b.H.T, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_vessel_s_report(seed: int) -> None:
    b = random_belief(seed)
    np.testing.assert_allclose(
        models.vessel_velocity(b.x, np.zeros(3), np.eye(3)).H,
        differences(lambda c: -models.vessel_velocity(c.x, np.zeros(3), np.eye(3)).innov, b),
        atol=1e-8,
    )


@given(st.integers(0, 10_000))
@settings(max_examples=10)
def test_transition(seed: int) -> None:
    """Errors carried by `settle`'s F agree with carrying a disturbed state through the nonlinear motion."""
    rng = np.random.default_rng(seed)
    b = random_belief(seed)
    ws, fs = 0.5 * rng.normal(size=(6, 3)), rng.normal(size=(6, 3)) - b.R.T @ G_NED
    probe = Probe()

    def run(c: Belief) -> Belief:
        c = c._replace(t_imu=0)
        for k in range(6):
            c = oracle_motion.propagate_state(c, (k + 1) * 4_000_000, ws[k], fs[k], 10**9)
        return oracle_motion.propagate_covariance(c, WALK, probe)  # type: ignore[arg-type]

    end = run(b)
    F = probe.F

    def error(c: Belief) -> F64:
        after = run(c)
        dx = after.x - end.x
        dx[ATT_ERR] = so3.log(end.R.T @ after.R)
        return dx

    # First order in bias times turn over 24 ms: what is left out is a few percent of those between gyro bias and velocity.
    np.testing.assert_allclose(F, differences(error, b, 1e-5), atol=3e-4)


class Probe:
    """Stands where the algebra does and keeps the F it is given."""

    F: F64

    def predict(self, P: F64, F: F64, Q: F64) -> F64:
        self.F = F
        assert np.linalg.eigvalsh(Q).min() > -1e-12
        return P
