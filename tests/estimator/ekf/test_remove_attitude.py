"""Removal of an attitude's errors from a measurement's covariance: exactly what they added."""

import math

import numpy as np
import pytest
from scipy.linalg import eigh

from estimator.contracts.geometry import F64
from estimator.core.abi import DL_ROWS_MAX as ROWS_MAX
from tests.support.core_parts import part

KEPT, NOT_A_PART = 0.02, 1.5
SIZES = (1, 2, 3, 6, ROWS_MAX)
_REMOVE = part("remove_attitude")


def rest_of(cov: F64, J: F64, cov_attitude: F64) -> F64:
    m, out = len(cov), np.ascontiguousarray(cov).copy()
    J, cov_attitude = np.ascontiguousarray(J), np.ascontiguousarray(cov_attitude)
    _REMOVE(m, out, J, cov_attitude)
    return out


def drawn(m: int, seed: int) -> tuple[F64, F64, F64]:
    """Own covariance (m, m), J (m, 3) and the attitude's covariance (3, 3), nothing in them alike or zero."""
    rng = np.random.default_rng([m, seed])
    root, tilt = rng.normal(size=(m, m)), rng.normal(size=(3, 3))
    own = (root @ root.T + 0.3 * np.eye(m)) * np.outer(scale := 10.0 ** rng.uniform(-2.0, 0.0, m), scale)
    return own, rng.normal(size=(m, 3)) * scale[:, None], 0.01 * (tilt @ tilt.T + 0.2 * np.eye(3))


def fractions(part: F64, cov: F64) -> F64:
    """Return the part's share of the whole variance, in the directions in which both are independent."""
    return np.asarray(eigh(part, cov, eigvals_only=True))


def part_of(cov: F64, J: F64, cov_attitude: F64, largest: float) -> F64:
    """Return the attitude's covariance, scaled so that its largest share of the whole is as given."""
    return cov_attitude * largest / fractions(J @ cov_attitude @ J.T, cov)[-1]


@pytest.mark.parametrize("m", SIZES)
def test_what_vision_itself_is_uncertain_of_is_found_again(m: int) -> None:
    own, J, cov_attitude = drawn(m, 1)
    part = J @ cov_attitude @ J.T
    np.testing.assert_allclose(rest_of(own + part, J, cov_attitude), own, rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("m", SIZES)
@pytest.mark.parametrize("largest", [0.979, 0.981, 0.999, 1.2, 1.499])
def test_each_direction_keeps_a_fiftieth_at_least_and_no_direction_more_than_is_its_own(m: int, largest: float) -> None:
    for seed in range(4):
        cov, J, cov_attitude = drawn(m, seed)
        cov_attitude = part_of(cov, J, cov_attitude, largest)
        part = J @ cov_attitude @ J.T
        rest = rest_of(cov, J, cov_attitude)
        before, axes = eigh(part, cov)
        in_axes = axes.T @ rest @ axes
        np.testing.assert_allclose(in_axes, np.diag(np.maximum(1.0 - before, KEPT)), atol=1e-9)


@pytest.mark.parametrize("m", SIZES)
@pytest.mark.parametrize(("largest", "stays"), [(1.49, False), (1.51, True), (40.0, True)])
def test_a_covariance_that_cannot_contain_the_part_is_left_as_it_is(m: int, largest: float, stays: bool) -> None:
    cov, J, cov_attitude = drawn(m, 7)
    cov = 0.5 * (cov + cov.T)
    rest = rest_of(cov, J, part_of(cov, J, cov_attitude, largest))
    assert np.array_equal(rest, cov) is stays


@pytest.mark.parametrize("m", SIZES)
def test_an_attitude_taken_as_exact_takes_nothing_out_to_the_bit(m: int) -> None:
    cov, J, cov_attitude = drawn(m, 3)
    np.testing.assert_array_equal(rest_of(cov, J, np.zeros((3, 3))), cov)
    np.testing.assert_array_equal(rest_of(cov, np.zeros((m, 3)), cov_attitude), cov)
    np.testing.assert_array_equal(rest_of(-cov, J, cov_attitude), -cov, "nor out of what is no covariance")


@pytest.mark.parametrize("m", SIZES)
def test_only_what_belongs_to_the_matrix_is_written(m: int) -> None:
    cov, J, cov_attitude = drawn(m, 4)
    for largest in (0.5, 1.2):
        room = np.full(m * m + 2 * ROWS_MAX, 7.0)
        room[: m * m] = cov.ravel()
        of_attitude = np.ascontiguousarray(part_of(cov, J, cov_attitude, largest))
        _REMOVE(m, room, np.ascontiguousarray(J), of_attitude)
        assert (room[m * m :] == 7.0).all()


def test_directions_that_do_not_hang_together_stay_apart() -> None:
    """Two alike, and two that the attitude moves together by more than is there."""
    J = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.5]])
    rest = rest_of(np.eye(4), J, 0.9 * np.eye(3))
    along, across = np.array([2.0, 1.0]) / math.sqrt(5.0), np.array([-1.0, 2.0]) / math.sqrt(5.0)
    np.testing.assert_allclose(rest[:2], [[0.1, 0.0, 0.0, 0.0], [0.0, 0.1, 0.0, 0.0]], atol=1e-15)
    np.testing.assert_allclose(rest[2:, 2:], KEPT * np.outer(along, along) + np.outer(across, across), atol=1e-14)
