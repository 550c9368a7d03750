import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from estimator.contracts.geometry import Rotation, Transform, skew, wrap_pi

finite = st.floats(-100.0, 100.0)
vectors = st.tuples(finite, finite, finite).map(np.array)
rotvecs = st.tuples(*[st.floats(-1.8, 1.8)] * 3).map(np.array)  # up to 3.12 rad: short of the half turn, where the axis flips
rotations = st.one_of(
    rotvecs.map(Rotation.from_rotvec),
    st.tuples(*[st.floats(-10.0, 10.0)] * 3).map(lambda rpy: Rotation.from_rpy(*rpy)),
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(lambda q: Rotation.from_quat(np.array(q))),
    st.sampled_from([Rotation(np.diag(d)) for d in ([1.0, 1, 1], [1.0, -1, -1], [-1.0, 1, -1], [-1.0, -1, 1])]),
)
transforms = st.builds(Transform, rotations, vectors)
angles = st.floats(-1e4, 1e4)


def same(a: Rotation, b: Rotation, tol: float = 1e-9) -> bool:
    return bool(np.abs(a.matrix - b.matrix).max() < tol)


@given(rotations, rotations)
def test_closure(a, b):
    m = (a @ b).matrix
    assert np.abs(m @ m.T - np.eye(3)).max() < 1e-12
    assert np.linalg.det(m) == pytest.approx(1.0)


@given(rotations)
def test_identity_and_inverse(a):
    e = Rotation.identity()
    assert same(a @ e, a)
    assert same(e @ a, a)
    assert same(a @ a.inv, e)
    assert same(a.inv @ a, e)
    assert same(a.inv.inv, a)


@given(rotations, rotations, rotations, vectors)
def test_composition_is_associative_and_acts_in_turn(a, b, c, v):
    assert same((a @ b) @ c, a @ (b @ c))
    np.testing.assert_allclose((a @ b) @ v, a @ (b @ v), atol=1e-9)
    np.testing.assert_allclose((a @ b).inv @ v, b.inv @ (a.inv @ v), atol=1e-9)


@given(rotations, vectors, vectors)
def test_lengths_angles_and_handedness_are_kept(a, v, w):
    np.testing.assert_allclose(np.linalg.norm(a @ v), np.linalg.norm(v), atol=1e-9)
    np.testing.assert_allclose((a @ v) @ (a @ w), v @ w, atol=1e-7)
    np.testing.assert_allclose(a @ np.cross(v, w), np.cross(a @ v, a @ w), atol=1e-7)
    np.testing.assert_allclose(skew(v) @ w, np.cross(v, w), atol=1e-9)


@given(rotations)
def test_round_trips_through_quaternion_rotation_vector_and_euler_angles(a):
    q = a.quat_wxyz
    assert q[0] >= 0.0
    assert np.linalg.norm(q) == pytest.approx(1.0)
    assert same(Rotation.from_quat(q), a, 1e-7)
    assert same(Rotation.from_quat(-3.0 * q), a, 1e-7)
    assert np.linalg.norm(a.rotvec_rad) <= math.pi + 1e-9
    assert same(Rotation.from_rotvec(a.rotvec_rad), a, 1e-7)
    roll, pitch, yaw = a.rpy_rad
    assert abs(pitch) <= math.pi / 2
    assert same(Rotation.from_rpy(roll, pitch, yaw), a, 2e-6)  # within 1e-6 rad of the gimbal lock the split is rounding's


@given(st.sampled_from([1.0, -1.0]), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_the_gimbal_lock_gives_the_same_rotation(sign, roll, yaw):
    a = Rotation.from_rpy(roll, sign * math.pi / 2, yaw)
    assert same(Rotation.from_rpy(*a.rpy_rad), a, 1e-6)


@pytest.mark.parametrize("scale", [1e-3, 1e-4, 1e-5, 1e-8, 1e-12, 0.0])
def test_small_rotations_keep_their_digits(scale):
    v = scale * np.array([0.3, -0.5, 0.7])
    np.testing.assert_allclose(Rotation.from_rotvec(v).rotvec_rad, v, rtol=1e-7, atol=1e-15)


def test_signs_are_those_of_the_conventions():
    """Nose up is positive pitch, right wing down positive roll, nose to the right positive yaw; rows of v are columns here."""
    nose, right = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    np.testing.assert_allclose(Rotation.from_rpy(0, 0, math.pi / 2) @ nose, [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(Rotation.from_rpy(0, math.pi / 2, 0) @ nose, [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(Rotation.from_rpy(math.pi / 2, 0, 0) @ right, [0, 0, 1], atol=1e-12)


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_without_heading_keeps_roll_and_pitch(roll, pitch, yaw):
    level = Rotation.from_rpy(roll, pitch, yaw).without_heading()
    assert level.rpy_rad == pytest.approx((roll, pitch, 0.0), abs=1e-7)


@given(rotations, st.tuples(*[st.floats(0.01, 10.0)] * 3), rotations)
def test_a_covariance_turns_with_its_vector(a, variances, b):
    cov = b.matrix @ np.diag(variances) @ b.matrix.T
    turned = a.rotate_cov(cov)
    np.testing.assert_allclose(np.linalg.eigvalsh(turned), np.sort(variances), atol=1e-8)
    v = np.array([0.3, -1.0, 2.0])
    assert (a @ v) @ turned @ (a @ v) == pytest.approx(v @ cov @ v)


@settings(max_examples=20)
@given(rotations)
def test_long_products_do_not_drift(a):
    product = Rotation.identity()
    for _ in range(2000):
        product = product @ a
    m = product.matrix
    assert np.abs(m @ m.T - np.eye(3)).max() < 1e-12


@given(transforms, transforms, transforms, vectors)
def test_transforms_form_a_group(a, b, c, p):
    e = Transform.identity()
    for x, y in ((a @ e, a), (e @ a, a), (a @ a.inv, e), (a.inv @ a, e), ((a @ b) @ c, a @ (b @ c))):
        assert same(x.R, y.R)
        np.testing.assert_allclose(x.t, y.t, atol=1e-8)
    np.testing.assert_allclose((a @ b) @ p, a @ (b @ p), atol=1e-8)
    np.testing.assert_allclose(a.inv @ (a @ p), p, atol=1e-8)


@given(angles, angles)
def test_wrapping(a, b):
    w = wrap_pi(a)
    assert -math.pi < w <= math.pi
    assert math.cos(w) == pytest.approx(math.cos(a), abs=1e-9)
    assert math.sin(w) == pytest.approx(math.sin(a), abs=1e-9)
    assert wrap_pi(w) == w
    assert abs(wrap_pi(wrap_pi(a) + wrap_pi(b) - a - b)) < 1e-8


@pytest.mark.parametrize(
    "matrix",
    [np.eye(4), np.full((3, 3), np.nan), np.diag([1.0, 1.0, -1.0]), 2.0 * np.eye(3), np.eye(3) + 1e-4, np.zeros((3, 3))],
    ids=["shape", "nan", "reflection", "scaled", "sheared", "zero"],
)
def test_what_is_no_rotation_is_refused(matrix):
    with pytest.raises(ValueError, match="rotation"):
        Rotation(matrix)


@pytest.mark.parametrize("quat", [[0, 0, 0, 0], [math.nan, 0, 0, 1], [math.inf, 0, 0, 1], [1, 0, 0]])
def test_what_is_no_quaternion_is_refused(quat):
    with pytest.raises(ValueError, match="quaternion"):
        Rotation.from_quat(quat)


def test_what_is_no_translation_is_refused():
    for t in (np.zeros(2), np.array([0.0, math.nan, 0.0])):
        with pytest.raises(ValueError, match="translation"):
            Transform(Rotation.identity(), t)


@given(rotations, vectors)
def test_values_cannot_be_changed_from_outside(a, t):
    assume(np.all(np.isfinite(t)))
    source = np.array(t)
    transform = Transform(a, source)
    source += 1.0
    np.testing.assert_array_equal(transform.t, t)
    for array in (transform.t, a.matrix):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 7.0
