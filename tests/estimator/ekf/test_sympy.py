"""The measurement models once more, written in symbols and differentiated by sympy."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp

from estimator.contracts.estimates import Sighting
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf.state import (
    ATT_ERR,
    CAMERA_DELAY,
    CAMERA_MOUNT,
    DECK_TRIM,
    GYRO_BIAS,
    PAD_YAW,
    POS_REL,
    VEL,
    VEL_SCALE,
    VESSEL_VEL,
    WAVES,
)
from tests.estimator.ekf import flown
from tests.estimator.ekf.oracle import measure as oracle
from tests.estimator.ekf.test_jacobians import random_belief

ROLL, PITCH = int(WAVES[3, 0]), int(WAVES[4, 0])


def cross(v: sp.Matrix) -> sp.Matrix:
    return sp.Matrix([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def symbols(name: str, n: int) -> sp.Matrix:
    return sp.Matrix(sp.symbols(f"{name}0:{n}"))


def matrix(name: str) -> sp.Matrix:
    return sp.Matrix(3, 3, sp.symbols(f"{name}0:9"))


def jacobian_at(h: sp.Matrix, by: sp.Matrix, values: dict[sp.Symbol, float]) -> np.ndarray:
    return np.array(h.jacobian(by).subs(values).evalf(), dtype=float)


@pytest.mark.parametrize("seed", [0])
def test_place_of_the_pad_in_the_image(seed: int) -> None:
    b = random_belief(seed)
    x = b.x.copy()
    x[CAMERA_MOUNT] = 0.0
    w_value = np.random.default_rng(seed).normal(size=3)
    theta, d, v, u, mount, bg, w = (
        symbols(n, k) for n, k in (("t", 3), ("d", 3), ("v", 3), ("u", 2), ("m", 3), ("g", 3), ("w", 3))
    )
    tau, R = sp.symbols("tau"), matrix("R")
    turn = R * (sp.eye(3) + cross(theta))
    seen = turn.T * d + tau * (turn.T * (sp.Matrix([u[0], u[1], 0]) - v) - cross(w - bg) * (turn.T * d))
    h = (sp.eye(3) - cross(mount)) * seen
    state = sp.Matrix([*theta, *d, *v, *u, *mount, *bg, tau])
    values = dict(zip([*theta, *mount], [0.0] * 6, strict=True))
    values |= dict(zip(d, x[POS_REL], strict=True)) | dict(zip(v, x[VEL], strict=True)) | dict(zip(u, x[VESSEL_VEL], strict=True))
    values |= dict(zip(bg, x[GYRO_BIAS], strict=True)) | dict(zip(w, w_value, strict=True)) | {tau: x[CAMERA_DELAY]}
    values |= dict(zip(R, b.R.ravel(), strict=True))
    stamp = Stamp(MonoNs(0), MonoNs(0), 0.0, "sim")
    s = Sighting(stamp, 0, "selected", np.array([0.0, 0.0, 2.0]), None, False, np.diag([0.01, 0.01, 0.01, 3.28]), 1.0)
    H = flown.sighting(x, b.R, w_value, s, None, np.zeros((3, 3)), 0.1).H
    columns = np.r_[ATT_ERR, POS_REL, VEL, VESSEL_VEL, CAMERA_MOUNT, GYRO_BIAS, CAMERA_DELAY]
    np.testing.assert_allclose(H[:, columns], jacobian_at(h, state, values), atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1])
def test_range_to_a_tilted_deck(seed: int) -> None:
    b = random_belief(seed)
    theta, d = symbols("t", 3), symbols("d", 3)
    R = matrix("R")
    roll, pitch, yaw = sp.symbols("roll pitch yaw")
    normal = sp.rot_axis3(-yaw) * sp.rot_axis2(-pitch) * sp.rot_axis1(-roll) * sp.Matrix([0, 0, 1])
    down = R * (sp.eye(3) + cross(theta)) * sp.Matrix([0, 0, 1])
    h = sp.Matrix([normal.dot(d) / normal.dot(down)])
    state = sp.Matrix([*theta, *d, roll, pitch, yaw])
    values = (
        dict(zip(theta, [0.0] * 3, strict=True))
        | dict(zip(d, b.x[POS_REL], strict=True))
        | dict(zip(R, b.R.ravel(), strict=True))
    )
    values |= {roll: b.x[ROLL] + b.x[DECK_TRIM[0]], pitch: b.x[PITCH] + b.x[DECK_TRIM[1]], yaw: b.x[PAD_YAW]}
    row = oracle.distance(b.x, b.R, 0.0, 0.1)
    assert row is not None
    np.testing.assert_allclose(row.H[:, np.r_[ATT_ERR, POS_REL, ROLL, PITCH, PAD_YAW]], jacobian_at(h, state, values), atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1])
def test_velocity_with_its_scale(seed: int) -> None:
    b = random_belief(seed)
    theta, v = symbols("t", 3), symbols("v", 3)
    scale, R = sp.symbols("scale"), matrix("R")
    turn = R * (sp.eye(3) + cross(theta))
    psi = sp.atan2(turn[1, 0], turn[0, 0])
    h = scale * sp.Matrix([sp.cos(psi) * v[0] + sp.sin(psi) * v[1], -sp.sin(psi) * v[0] + sp.cos(psi) * v[1]])
    values = (
        dict(zip(theta, [0.0] * 3, strict=True)) | dict(zip(v, b.x[VEL], strict=True)) | dict(zip(R, b.R.ravel(), strict=True))
    )
    row = oracle.velocity(b.x, b.R, np.zeros(3), np.diag([0.01, 0.01, 1e6]), 0.0)
    assert row is not None
    got = row.H[:, np.r_[ATT_ERR, VEL, VEL_SCALE]]
    np.testing.assert_allclose(got, jacobian_at(h, sp.Matrix([*theta, *v, scale]), values | {scale: b.x[VEL_SCALE]}), atol=1e-9)
