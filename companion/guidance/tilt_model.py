"""The tilt's course as a discrete model, from the response that a file or the flight gives."""

import math

import msgspec
import numpy as np

from companion.guidance.riccati import exponential
from companion.settings.response import TiltResponse
from estimator.contracts.geometry import F64


class TiltModel(msgspec.Struct, frozen=True):
    """The tilt's course in steps of one guidance period, with the pad's place and speed against the body.

    x = [p, p', a, a', f, u(k-1) .. u(k-n)], x(k+1) = A x(k) + B u(k); without a lag f is left out.
    """

    A: F64
    B: F64
    delays: int
    """Number of commands under way, n."""
    states: int
    """Number of states before them: 4 or 5."""


def tilt_model(tilt: TiltResponse, period_s: float) -> TiltModel:
    """Return the exact discrete model of a response whose commands are held for a period each; the delay may be any.

    Source: Astrom & Wittenmark, Computer-Controlled Systems, 3rd ed., sec. 3.2 (delay that is no multiple of the period).
    """
    w, z = tilt.frequency_rad_s, tilt.damping
    m = 5 if tilt.lag_s > 1e-4 else 4
    A = np.zeros((m, m))
    A[0, 1], A[1, 2], A[2, 3] = 1.0, -1.0, 1.0
    A[3, 2], A[3, 3] = -w * w, -2.0 * z * w
    b = np.zeros(m)
    if m == 5:
        A[3, 4], A[4, 4], b[4] = w * w, -1.0 / tilt.lag_s, 1.0 / tilt.lag_s
    else:
        b[3] = w * w
    n = max(1, math.ceil(tilt.delay_s / period_s - 1e-9))
    part = tilt.delay_s / period_s - (n - 1)
    whole, _ = _held(A, b, period_s)
    after, b_new = _held(A, b, (1.0 - part) * period_s)
    b_old = after.dot(_held(A, b, part * period_s)[1])
    size = m + n
    out, drive = np.zeros((size, size)), np.zeros(size)
    out[:m, :m] = whole
    out[:m, m + n - 1] += b_old
    if n == 1:
        drive[:m] = b_new
    else:
        out[:m, m + n - 2] += b_new
    drive[m] = 1.0
    for k in range(1, n):
        out[m + k, m + k - 1] = 1.0
    return TiltModel(out, drive, n, m)


def _held(A: F64, b: F64, dt: float) -> tuple[F64, F64]:
    """Return the transition over `dt` and the effect of an input that is held for it."""
    m = b.size
    block = np.zeros((m + 1, m + 1))
    block[:m, :m], block[:m, m] = A * dt, b * dt
    e = exponential(block)
    return e[:m, :m], e[:m, m]
