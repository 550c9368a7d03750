"""Closed forms that the spectra of the simulated sea are held to."""

import math

import numpy as np

from estimator.contracts.geometry import F64


def ittc(w_rad_s: F64, hs_m: float, tp_s: float) -> F64:
    """Return ITTC's modified Pierson-Moskowitz spectrum (Bretschneider's shape) at angular frequencies, positive, of any shape.

    Source: ITTC 1978 two-parameter spectrum with the modal period, A = 487 Hs^2 / T0^4, B = 1949 / T0^4.
    """
    w = np.asarray(w_rad_s, dtype=float)
    return np.asarray(487.0 * hs_m**2 / tp_s**4 * w**-5 * np.exp(-1949.0 / tp_s**4 * w**-4))


def ochi_hubble_moment(n: int, hs_m: float, tp_s: float, shape: float) -> float:
    """Return the n-th moment of `sitl.sea.sea.ochi_hubble_part`, m^2 (rad/s)^n, in closed form; infinite unless n < 4 shape.

    With x = b w^-4 the integral of w^n S is a gamma function; a shape of 1 gives the moments of Bretschneider's spectrum.
    """
    if n >= 4.0 * shape:
        return math.inf
    b = (4.0 * shape + 1.0) / 4.0 * (math.tau / tp_s) ** 4
    return float(hs_m**2 / 16.0 * b ** (n / 4.0) * math.gamma(shape - n / 4.0) / math.gamma(shape))


def spread_density(off_rad: F64, s: float) -> F64:
    """Return the density per rad of directions `off_rad` from the mean one, of any shape: cos^2s of half the angle.

    Source: Longuet-Higgins, Cartwright & Smith 1963; the factor makes the integral over the circle 1.
    """
    factor = math.exp(2.0 * s * math.log(2.0) + 2.0 * math.lgamma(s + 1.0) - math.lgamma(2.0 * s + 1.0)) / math.tau
    return np.asarray(factor * np.abs(np.cos(0.5 * np.asarray(off_rad, dtype=float))) ** (2.0 * s))
