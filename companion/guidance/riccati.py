"""The two equations behind gains that are solved once: the matrix exponential and the discrete Riccati equation. numpy only."""

import math

import numpy as np

from estimator.contracts.geometry import F64


def exponential(A: F64) -> F64:
    """Return the matrix exponential by scaling, a Taylor series of order 12 and squaring; A is (n, n)."""
    size = float(np.abs(A).sum(axis=1).max())
    halvings = max(0, math.ceil(math.log2(size / 0.25))) if size > 0.25 else 0
    X = A / 2.0**halvings
    out = term = np.eye(A.shape[0])
    for k in range(1, 13):
        term = term.dot(X) / k
        out = out + term
    for _ in range(halvings):
        out = out.dot(out)
    return np.asarray(out)


def riccati(A: F64, B: F64, Q: F64, R: F64) -> F64:
    """Return the stabilising solution X of X = A' X A - A' X B (R + B' X B)^-1 B' X A + Q, (n, n).

    Args:
        A: (n, n), B: (n, m), Q: (n, n) positive semidefinite, R: (m, m) positive definite.

    Raises:
        ValueError: it does not converge: the model cannot be stabilised through B.

    Source: Anderson, Second-order convergent algorithms for the steady-state Riccati equation, Int. J. Control 28(2), 1978.
    """
    n = A.shape[0]
    unit = np.eye(n)
    step, G, H = A, B.dot(np.linalg.solve(R, B.T)), Q
    for _ in range(60):
        W = unit + G.dot(H)
        forward = np.linalg.solve(W, step)
        G = G + step.dot(np.linalg.solve(W, G)).dot(step.T)
        more = step.T.dot(H).dot(forward)
        H, step = H + more, step.dot(forward)
        if not float(np.abs(H).max()) < 1e100:
            break
        if float(np.abs(more).max()) <= 1e-12 * float(np.abs(H).max()):
            return np.asarray(0.5 * (H + H.T))
    raise ValueError("the Riccati equation does not converge: the model cannot be stabilised")


def regulator(A: F64, B: F64, Q: F64, R: F64) -> F64:
    """Return the gain K of u = -K x that minimises the sum of x' Q x + u' R u, (m, n).

    Source: Anderson & Moore, Optimal Control: Linear Quadratic Methods, 1990, sec. 2.4.
    """
    X = riccati(A, B, Q, R)
    return np.asarray(np.linalg.solve(R + B.T.dot(X).dot(B), B.T.dot(X).dot(A)))


def observer(A: F64, C: F64, Q: F64, R: F64) -> F64:
    """Return the steady gain L of the filter x <- x + L (z - C x) after a prediction by A, (n, m).

    Source: Anderson & Moore, Optimal Filtering, 1979, sec. 4.4 (the dual of `regulator`).
    """
    X = riccati(A.T, C.T, Q, R)
    return np.asarray(np.linalg.solve(C.dot(X).dot(C.T) + R, C.dot(X)).T)
