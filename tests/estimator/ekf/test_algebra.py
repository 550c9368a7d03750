"""The core's rotations where their formulae have no value, and the removal of an attitude's errors from a covariance."""

import math

import numpy as np
import pytest
from scipy.linalg import eigh

from estimator.contracts.estimates import Pose6
from estimator.contracts.geometry import F64, Rotation, rpy_matrix
from estimator.contracts.samples import Attitude
from estimator.core.abi import DL_ROWS_MAX
from estimator.ekf import EkfOptions, Event
from estimator.ekf.params import CAMERA_MOUNT, POS_REL, FilterParams, N
from tests.estimator.ekf import oracle
from tests.estimator.ekf.core_state import TILTED, State, T, drawn_x, holding, known, newest, put, seen
from tests.make import stamp_at
from tests.support.core_parts import part

PARAMS = FilterParams(EkfOptions())
AXES = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.5, 0.7, 0.3), (0.3, -0.2, 0.9), (0.9, 0.1, -0.4)]


def innovation(R: F64) -> F64:
    """Return the rotation vector, (3,) rad, by which a level state finds an attitude turned."""
    b = known(PARAMS, np.eye(3), x=np.zeros(N), P=1e-4 * np.eye(N))
    found = put(holding(b, PARAMS), Attitude(stamp_at(T), Rotation(R), 1e-4 * np.eye(3))).innovation
    assert found is not None
    return found


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("short_rad", [0.0, 3e-7, 1.5e-6, 4e-6])
def test_half_a_turn_is_about_its_axis(axis: tuple[float, float, float], short_rad: float) -> None:
    n = np.array(axis) / math.hypot(*axis)
    v = innovation((2.0 * np.outer(n, n) - np.eye(3)) @ oracle.exp(-short_rad * n))
    v = v if v @ n > 0.0 else -v
    np.testing.assert_allclose(v / math.hypot(*v), n, atol=3e-7)
    assert math.hypot(*v) == pytest.approx(math.pi - (short_rad if short_rad > 1e-6 else 0.0), abs=1e-9)


@pytest.mark.parametrize("rad", [1e-9, 4e-7, 2e-6, 1e-3, 1.0, 3.0])
def test_a_turn_of_any_size_is_as_large_as_it_is(rad: float) -> None:
    n = np.array([0.5, -0.7, 0.3]) / math.hypot(0.5, 0.7, 0.3)
    np.testing.assert_allclose(innovation(oracle.exp(rad * n)), rad * n, rtol=1e-6)


def corrected(b: State, event: Event) -> State:
    """Return the state after an event, which agrees with the oracle's."""
    filter, (expected, _) = holding(b, PARAMS), oracle.process(b, event, PARAMS)
    put(filter, event)
    found = newest(filter)
    np.testing.assert_allclose(found.x, expected.x, rtol=1e-9, atol=1e-9)
    return found


@pytest.mark.parametrize("rad", [0.0, 1e-5, 9e-5, 5e-4, 9e-4, 2e-3])
def test_a_camera_that_is_hardly_turned_is_corrected(rad: float) -> None:
    x = drawn_x()
    x[CAMERA_MOUNT] = rad * np.array([0.6, -0.64, 0.48])
    d = x[POS_REL] + [0.005, -0.004, 0.006]
    pose = Pose6(d, Rotation(rpy_matrix(0.02, -0.03, 0.1)), np.diag([1e-4] * 3 + [1e-3] * 3))
    corrected(known(PARAMS, TILTED, x=x), seen(d, 0.0, pose6=pose))


def test_a_nose_straight_up_has_no_heading_and_breaks_nothing() -> None:
    up = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    b = known(PARAMS, up)
    assert np.isfinite(corrected(b, seen(b.x[POS_REL], 0.2)).P).all()


# Removal of an attitude's errors


def rest_of(cov: F64, J: F64, cov_attitude: F64) -> F64:
    """Return the covariance that the core leaves; it writes nothing beyond it."""
    m, room = len(cov), np.full(len(cov) ** 2 + 2 * DL_ROWS_MAX, 7.0)
    room[: m * m] = cov.ravel()
    part("remove_attitude")(m, room, np.ascontiguousarray(J), np.ascontiguousarray(cov_attitude))
    assert (room[m * m :] == 7.0).all()
    return room[: m * m].reshape(m, m)


def drawn(m: int, seed: int, largest: float) -> tuple[F64, F64, F64]:
    """Return a covariance (m, m), J (m, 3), and an attitude's covariance whose largest share of the whole is as given."""
    rng = np.random.default_rng([m, seed])
    root, tilt = rng.normal(size=(m, m)), rng.normal(size=(3, 3))
    cov = (root @ root.T + 0.3 * np.eye(m)) * np.outer(scale := 10.0 ** rng.uniform(-2.0, 0.0, m), scale)
    cov, J, cov_attitude = 0.5 * (cov + cov.T), rng.normal(size=(m, 3)) * scale[:, None], tilt @ tilt.T + 0.2 * np.eye(3)
    return cov, J, cov_attitude * largest / eigh(J @ cov_attitude @ J.T, cov, eigvals_only=True)[-1]


@pytest.mark.parametrize("m", [1, 2, 3, 6, DL_ROWS_MAX])
@pytest.mark.parametrize("largest", [0.5, 0.979, 0.981, 0.999, 1.2, 1.499])
def test_each_direction_keeps_what_is_its_own_and_a_fiftieth_at_least(m: int, largest: float) -> None:
    for seed in range(4):
        cov, J, cov_attitude = drawn(m, seed, largest)
        before, axes = eigh(J @ cov_attitude @ J.T, cov)
        in_axes = axes.T @ rest_of(cov, J, cov_attitude) @ axes
        np.testing.assert_allclose(in_axes, np.diag(np.maximum(1.0 - before, 0.02)), atol=1e-9)


@pytest.mark.parametrize("m", [1, 2, 3, 6, DL_ROWS_MAX])
@pytest.mark.parametrize("largest", [1.51, 40.0, 0.0])
def test_what_cannot_contain_the_part_and_what_has_no_part_stay_to_the_bit(m: int, largest: float) -> None:
    cov, J, cov_attitude = drawn(m, 7, largest)
    np.testing.assert_array_equal(rest_of(cov, J, cov_attitude), cov)
    np.testing.assert_array_equal(rest_of(-cov, J, np.eye(3)), -cov, "nor of what is no covariance")


def test_directions_that_are_not_correlated_stay_apart() -> None:
    """Two alike, and two that the attitude moves together by more than is there."""
    J = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.5]])
    rest = rest_of(np.eye(4), J, 0.9 * np.eye(3))
    along, across = np.array([2.0, 1.0]) / math.sqrt(5.0), np.array([-1.0, 2.0]) / math.sqrt(5.0)
    np.testing.assert_allclose(rest[:2], [[0.1, 0.0, 0.0, 0.0], [0.0, 0.1, 0.0, 0.0]], atol=1e-15)
    np.testing.assert_allclose(rest[2:, 2:], 0.02 * np.outer(along, along) + np.outer(across, across), atol=1e-14)
