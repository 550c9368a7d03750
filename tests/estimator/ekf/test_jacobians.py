"""The oracle's Jacobians, which the core shares, against finite differences of what they linearise, at drawn states.

A state is moved by a small error as a correction moves it (`x + dx`, `R exp(dtheta)`); the change of the prediction is compared.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest

from estimator.contracts.estimates import Pose6
from estimator.contracts.geometry import F64, Rotation, rpy_matrix
from estimator.contracts.samples import BodyVelocity
from estimator.ekf import EkfOptions
from estimator.ekf.params import (
    ATT_ERR,
    CAMERA_DELAY,
    CAMERA_MOUNT,
    GYRO_BIAS,
    PAD_YAW,
    POS_REL,
    RANGE_OFFSET,
    VEL,
    VESSEL_VEL,
    FilterParams,
    N,
)
from tests.estimator.ekf import oracle
from tests.estimator.ekf.core_state import MS, State, T, drawn_x, known, seen, sighting_rows
from tests.make import stamp_at

PARAMS = FilterParams(EkfOptions())
SEEDS = pytest.mark.parametrize("seed", range(8))


def drawn(seed: int) -> State:
    """Return a state with any heading, and of the sizes that states have."""
    rng = np.random.default_rng(seed)
    x = drawn_x(seed, 0.5)
    x[VEL], x[VESSEL_VEL], x[PAD_YAW] = rng.normal(size=3), rng.normal(size=2), rng.uniform(-3.0, 3.0)
    x[POS_REL] += [0.0, 0.0, 2.0]
    x[CAMERA_DELAY], x[CAMERA_MOUNT] = 0.02 * rng.normal(), 0.05 * rng.normal(size=3)
    R, levelled_by = (rpy_matrix(*rng.uniform((-0.4, -0.4, -3.0), (0.4, 0.4, 3.0))) for _ in range(2))
    return known(PARAMS, R, x=x, w=rng.normal(size=3), levelled_by=levelled_by, f=rng.normal(size=3) - R[2] * 9.80665, t_imu=T)


def moved(b: State, dx: F64) -> State:
    """Return the state with an error that is applied as a correction is."""
    x = b.x + dx
    x[ATT_ERR] = 0.0
    R = b.R @ oracle.exp(dx[ATT_ERR])
    return b.copy(x=x, R=R, R_cov=R)


def differences(predict: Callable[[State], F64], b: State, h: float = 1e-6) -> F64:
    """Return the derivatives (m, N) of a prediction (m,) by central differences."""
    return np.array([(predict(moved(b, h * dx)) - predict(moved(b, -h * dx))) / (2 * h) for dx in np.eye(N)]).T


@SEEDS
@pytest.mark.parametrize("whole", [False, True])
def test_a_sighting(seed: int, whole: bool) -> None:
    """The delay is small: columns of the orientation leave out a delay times a rate."""
    b, none, rng = drawn(seed), np.zeros((3, 3)), np.random.default_rng(seed)
    x = b.x.copy()
    x[CAMERA_DELAY] *= not whole
    b = b.copy(x=x)
    M = oracle.levelling(b) @ oracle.exp(-x[CAMERA_MOUNT]) @ b.R.T @ oracle.deck_attitude(x)[0]
    d = rng.uniform((-1.0, -1.0, 3.0), (1.0, 1.0, 5.0))
    s = seen(d, 0.4, pose6=Pose6(d, Rotation(M), np.eye(6)) if whole else None)
    at_b = oracle.sighting_rows(b, s, none, 0.1)

    def predict(c: State) -> F64:
        change = oracle.sighting_rows(c, s, none, 0.1).innov - at_b.innov
        change[3:] = np.remainder(change[3:] + math.pi, math.tau) - math.pi
        return -change

    assert at_b.H.shape == (6 if whole else 4, N)
    rows = slice(None) if whole else slice(3)
    np.testing.assert_allclose(at_b.H[rows], differences(predict, b)[rows], atol=5e-7)
    ours = sighting_rows(b, s)
    np.testing.assert_allclose(ours.H, at_b.H, atol=1e-11)
    np.testing.assert_allclose(ours.by_rate, at_b.by_rate, atol=1e-11)


@SEEDS
def test_the_column_of_the_delay_is_the_rate_of_what_the_camera_sees(seed: int) -> None:
    b, d, h = drawn(seed), np.array([0.3, -0.2, 4.0]), 1e-6
    H = sighting_rows(b, seen(d, pose6=Pose6(d, Rotation.identity(), np.eye(6)))).H[:, CAMERA_DELAY]
    A, E = oracle.levelling(b), oracle.exp(-b.x[CAMERA_MOUNT])

    def at(dt: float) -> tuple[F64, F64]:
        place = b.x[POS_REL] + dt * (np.r_[b.x[VESSEL_VEL], 0.0] - b.x[VEL])
        R = b.R @ oracle.exp(dt * (b.w - b.x[GYRO_BIAS]))
        return E @ R.T @ place, A @ E @ R.T @ oracle.deck_attitude(b.x)[0]

    (d1, M1), (d0, M0) = at(h), at(-h)
    np.testing.assert_allclose(H[:3], (d1 - d0) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(H[3:], oracle.log(M1 @ M0.T) / (2 * h), atol=1e-6)


def test_a_late_frame_of_a_body_that_rocks_is_predicted_by_the_rate_of_its_exposure() -> None:
    """Two swings a second by 15 degrees, 5 m over the pad, 20 ms late: a rate smoothed over 30 ms is 12 cm off."""
    late_s, w_rad_s, swing_rad, d_ned, x = 0.02, 13.0, 0.26, np.array([0.3, -0.2, 5.0]), np.zeros(N)
    x[POS_REL], x[CAMERA_DELAY] = d_ned, late_s
    lag, off = w_rad_s * 0.03, []
    for phase in np.arange(0.0, math.tau, 0.26).tolist():
        R, shown = (rpy_matrix(swing_rad * math.sin(at), 0.0, 0.0) for at in (phase, phase + w_rad_s * late_s))
        rate = swing_rad * w_rad_s * math.cos(phase)
        smooth = swing_rad * w_rad_s * (math.cos(phase) + lag * math.sin(phase)) / (1.0 + lag * lag)
        b = known(PARAMS, R, x=x, w=np.array([rate, 0.0, 0.0]), w_smooth=np.array([smooth, 0.0, 0.0]))
        off.append(float(np.linalg.norm(sighting_rows(b, seen(R @ shown.T @ d_ned)).innov[:3])))
    assert max(off) < 0.05


@SEEDS
@pytest.mark.parametrize("deck_weight", [0.0, 0.4, 1.0])
def test_a_velocity(seed: int, deck_weight: float) -> None:
    event = BodyVelocity(stamp_at(T), np.zeros(3), np.eye(3))

    def rows(c: State) -> oracle.Rows:
        return oracle._velocity_rows(c.x, c.R, event, deck_weight, [0, 1, 2])

    np.testing.assert_allclose(rows(drawn(seed)).H, differences(lambda c: -rows(c).innov, drawn(seed)), atol=1e-7)


@SEEDS
def test_a_range(seed: int) -> None:
    def predicted(c: State) -> tuple[float, F64]:
        found = oracle._by_range(c.x, c.R)
        return found[0] + c.x[RANGE_OFFSET], found[1]

    b = drawn(seed)
    np.testing.assert_allclose(predicted(b)[1], differences(lambda c: np.array([predicted(c)[0]]), b), atol=1e-6)


@SEEDS
def test_transition(seed: int) -> None:
    """Errors that F propagates agree with the propagation of a disturbed state through the nonlinear motion."""
    rng, b = np.random.default_rng(seed), drawn(seed)
    ws, fs = 0.5 * rng.normal(size=(6, 3)), rng.normal(size=(6, 3)) - b.R[2] * 9.80665

    def run(c: State) -> tuple[State, F64]:
        c = c.copy()
        for k in range(6):
            oracle._propagate_state(c, T + (k + 1) * 4 * MS, ws[k], fs[k], PARAMS.options)
        F, Q = oracle.move(c, PARAMS)
        assert np.linalg.eigvalsh(Q).min() > -1e-12
        return c, F

    end, F = run(b)

    def error(c: State) -> F64:
        after, _ = run(c)
        dx = after.x - end.x
        dx[ATT_ERR] = oracle.log(end.R.T @ after.R)
        return np.asarray(dx)

    # First order in bias times turn over 24 ms: what is left out is a few percent of those between gyro bias and velocity.
    np.testing.assert_allclose(F, differences(error, b, 1e-5), atol=3e-4)
