"""Model of a deck's motion on waves in one direction: a damped oscillator driven by the rate of a second, equal one.

    x'' = -w^2 x - 2 zeta w x' + f'        f'' = -w^2 f - 2 zeta w f' + white noise

A single oscillator driven by white noise has a discontinuous acceleration, which no hull has. Driven by f instead of f' it would
have power at low frequencies, where a sea has none (docs/estimator.md). The noise intensity is such that x has the standard
deviation `sigma`. The states are [x, x', f, f'].
"""

from __future__ import annotations

import numpy as np

from estimator.contracts.geometry import F64


def stationary(w_rad_s: F64, zeta: F64) -> F64:
    """Return the stationary covariance of the states for sigma = 1, (..., 4, 4), for parameters of any one shape (...).

    It is the closed-form solution of the Lyapunov equation; see docs/estimator.md, section "Waves".
    """
    w, delta = np.asarray(w_rad_s), np.asarray(zeta * w_rad_s)
    w2, force = w * w, 8.0 * delta * delta
    P = np.zeros((*w.shape, 4, 4))
    P[..., 0, 0] = 1.0
    P[..., 1, 1] = w2
    P[..., 2, 2] = force
    P[..., 3, 3] = force * w2
    P[..., 0, 2] = P[..., 2, 0] = 2.0 * delta
    P[..., 1, 3] = P[..., 3, 1] = 2.0 * delta * w2
    return P
