"""Lateral disturbance observer, one axis at a time: position, speed, disturbance and accelerometer error.

    p' = w,   w' = a_deck - a_lean - d,   d' = noise,   b' = noise
p, w: the pad against the body (the filter's, with errors of their own); a_lean: the reported tilt as an acceleration; d: what
else accelerates the body (wind, drag, the error of the reported tilt); b: the error of the levelled accelerometer. p, w and the
acceleration a_lean + d + b are measured. The accelerometer feels a gust at once; place and speed show it a second later.
That the disturbance is the measured acceleration less the one that was requested is the idea of incremental control; here it
passes a Kalman filter with steady gains.
Source: Smeur, de Croon & Chu, Gust disturbance alleviation with incremental nonlinear dynamic inversion, IROS 2016, sec. III.
"""

from bisect import bisect_left
from functools import lru_cache
from typing import NamedTuple, TypeVar

import numpy as np

from companion.guidance.riccati import observer

SIGMAS_P_M = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16)
"""Standard deviations of the place for which gains are kept, m."""


_UP_TO_M = tuple(1.4 * sigma for sigma in SIGMAS_P_M)
_Kept = TypeVar("_Kept")


class ObserverNoise(NamedTuple):
    """The noise that the observer is solved for."""

    sigma_w_m_s: float = 0.08
    """The filter's speed of the pad against the body. Its errors are 0.01 to 0.02 m/s and last for a second, so a cycle's reading
    counts for less than if they were new every time."""
    sigma_a_m_s2: float = 0.06
    psd_d: float = 2.0
    """Growth of the variance of the disturbance, (m/s^2)^2/s. Gusts of 0.6 m/s that last 2 s on a drag of 0.35 1/s give 0.04;
    with so much more the accelerometer is trusted within some cycles, as far as the stability margins allow (`benches.law`)."""
    psd_b: float = 0.1
    """Growth of the variance of the accelerometer's error.

    A contradiction to place and speed becomes its error within half a second.
    """
    psd_w: float = 0.01
    """Growth of the variance of the speed: the deck's own acceleration is known that badly."""
    accelerometer: bool = True
    """True if the accelerometer is used."""


class ObserverGains(NamedTuple):
    """Steady gains: rows p, w, d, b; columns place, speed, acceleration."""

    rows: tuple[tuple[float, float, float], ...]


@lru_cache(maxsize=16)
def observer_gains(noise: ObserverNoise, period_s: float) -> tuple[ObserverGains, ...]:
    """Return the steady gains for each of `SIGMAS_P_M`."""
    T = period_s
    A = np.eye(4)
    A[0, 1], A[0, 2], A[1, 2] = T, -0.5 * T * T, -T
    Q = np.diag([1e-8, noise.psd_w * T, noise.psd_d * T, noise.psd_b * T])
    C = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]])
    out = []
    for sigma in SIGMAS_P_M:
        # An error of the filter lasts for some ten cycles: R counts it as if it were new in each.
        R = np.diag([10.0 * sigma**2, 10.0 * noise.sigma_w_m_s**2, noise.sigma_a_m_s2**2 if noise.accelerometer else 1e6])
        L = observer(A, C, Q, R)
        out.append(ObserverGains(tuple((float(a), float(b), float(c)) for a, b, c in L)))
    return tuple(out)


def chosen(table: tuple[_Kept, ...], sigma_p_m: float) -> _Kept:
    """Return what is kept for a standard deviation of the place; the table has one entry for each of `SIGMAS_P_M`."""
    return table[min(bisect_left(_UP_TO_M, sigma_p_m), len(_UP_TO_M) - 1)]
