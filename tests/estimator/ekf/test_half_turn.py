"""The core's rotation vectors where their formula has no value: of hardly a turn, of half a turn, and straight up."""

import math

import numpy as np
import pytest

from estimator.contracts.geometry import F64, Rotation, rpy_matrix
from estimator.contracts.samples import Attitude
from estimator.ekf.state import CAMERA_MOUNT, N
from tests.estimator.ekf.belief import process_event
from tests.estimator.ekf.hand import LEVEL, TILTED, TOOLS, T, belief, correlated, sighting, stamp, state, under, whole
from tests.estimator.ekf.oracle import so3
from tests.estimator.ekf.test_core_sightings import agrees

AXES = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.5, 0.7, 0.3), (0.3, -0.2, 0.9), (0.9, 0.1, -0.4)]


def innovation(R: F64) -> F64:
    """Return the rotation vector, (3,) rad, by which a level belief finds an attitude turned."""
    event = Attitude(stamp(T), Rotation(R), 1e-4 * np.eye(3))
    b = belief(LEVEL, x=np.zeros(N), P=1e-4 * np.eye(N))
    _, outcome = process_event(b, event, TOOLS)
    assert outcome.innovation is not None
    return np.asarray(outcome.innovation)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("short_rad", [0.0, 3e-7, 1.5e-6, 4e-6])
def test_half_a_turn_is_about_its_axis(axis: tuple[float, float, float], short_rad: float) -> None:
    n = np.array(axis) / math.hypot(*axis)
    half = 2.0 * np.outer(n, n) - np.eye(3)
    v = innovation(half @ so3.exp(-short_rad * n))
    v = v if v @ n > 0.0 else -v
    np.testing.assert_allclose(v / math.hypot(*v), n, atol=3e-7)
    assert math.hypot(*v) == pytest.approx(math.pi - (short_rad if short_rad > 1e-6 else 0.0), abs=1e-9)


@pytest.mark.parametrize("rad", [1e-9, 4e-7, 2e-6, 1e-3, 1.0, 3.0])
def test_a_turn_of_any_size_is_as_large_as_it_is(rad: float) -> None:
    n = np.array([0.5, -0.7, 0.3]) / math.hypot(0.5, 0.7, 0.3)
    np.testing.assert_allclose(innovation(so3.exp(rad * n)), rad * n, rtol=1e-6)


@pytest.mark.parametrize("rad", [0.0, 1e-5, 9e-5, 5e-4, 9e-4, 2e-3])
def test_a_camera_that_is_hardly_turned_is_corrected_as_the_oracle_does(rad: float) -> None:
    x = state()
    x[CAMERA_MOUNT] = rad * np.array([0.6, -0.64, 0.48])
    d = x[3:6] + np.array([0.005, -0.004, 0.006])
    agrees(belief(TILTED, x=x, P=correlated()), sighting(d, 0.0, pose6=whole(d, rpy_matrix(0.02, -0.03, 0.1))), TOOLS)


def test_a_nose_straight_up_has_no_heading_and_breaks_nothing() -> None:
    up = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    x = under()
    after, _ = agrees(belief(up, x=x, P=correlated()), sighting(x[3:6], 0.2), TOOLS)
    assert np.isfinite(after.P).all()
