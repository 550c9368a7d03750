"""The exact transition of the deck's oscillators (estimator/ekf/deck_motion_bank.py)."""

from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64
from tests.estimator.ekf.belief import stationary


class Transition(NamedTuple):
    """The discrete transition over a time T: state(t + T) = A state(t) + noise of covariance sigma^2 q."""

    A: F64
    """(..., 4, 4) transition matrix."""
    q: F64
    """(..., 4, 4) covariance of the noise for sigma = 1."""


def transition(w_rad_s: F64, zeta: F64, dt_s: float, at_rest: F64 | None = None) -> Transition:
    """Return the exact transition over `dt_s`, for 0 < zeta < 1.

    Both diagonal blocks are the single oscillator's exp(J T), with J = K - delta and K^2 = -wd^2. The upper right block is the
    integral of exp(J (T - s)) B exp(J s), where B adds the force's rate to the acceleration.

    Args:
        w_rad_s: (...) natural frequency, rad/s.
        zeta: (...) damping ratio.
        dt_s: length of the step, s.
        at_rest: `stationary(w_rad_s, zeta)` if the caller has it already.
    """
    w = np.asarray(w_rad_s)
    delta = zeta * w
    w2, wd2 = w * w, w * w - delta * delta
    wd = np.sqrt(wd2)
    e = np.exp(-delta * dt_s)
    c, s = e * np.cos(wd * dt_s), e * np.sin(wd * dt_s) / wd
    cc, cs, ss = 0.5 * (dt_s * c + s), 0.5 * dt_s * s, 0.5 * (s - dt_s * c) / wd2
    A = np.zeros((*w.shape, 4, 4))
    A[..., 0, 0] = A[..., 2, 2] = c + delta * s
    A[..., 0, 1] = A[..., 2, 3] = s
    A[..., 1, 0] = A[..., 3, 2] = -w2 * s
    A[..., 1, 1] = A[..., 3, 3] = c - delta * s
    # [[fa, fb], [fc, fd]] is the integral for a drive by f; multiplied by J it becomes the integral for a drive by f'.
    fa, fb, fc, fd = cs + delta * ss, ss, cc - delta * delta * ss, cs - delta * ss
    A[..., 0, 2], A[..., 0, 3] = -w2 * fb, fa - 2.0 * delta * fb
    A[..., 1, 2], A[..., 1, 3] = -w2 * fd, fc - 2.0 * delta * fd
    P = stationary(w_rad_s, zeta) if at_rest is None else at_rest
    q = P - A @ P @ np.swapaxes(A, -1, -2)
    return Transition(A, 0.5 * (q + np.swapaxes(q, -1, -2)))
