"""Wave spectra: the energy of the sea's surface per angular frequency, and the spread of its directions.

Every spectrum is one-sided, in m^2 s over rad/s, and scaled to a significant height of 4 sqrt(m0).
"""

from __future__ import annotations

import math

import numpy as np

from estimator.contracts.geometry import F64

GRAVITY_M_S2 = 9.80665


def jonswap(w_rad_s: F64, hs_m: float, tp_s: float, gamma: float = 3.3) -> F64:
    """Return the JONSWAP spectrum at angular frequencies, positive, of any shape.

    Source: Hasselmann et al. 1973; scaled to a significant height as in DNV-RP-C205 (2010), 3.5.5, good to 1 %.
    """
    w = np.asarray(w_rad_s, dtype=float)
    wp = math.tau / tp_s
    sigma = np.where(w <= wp, 0.07, 0.09)
    peak = gamma ** np.exp(-0.5 * ((w - wp) / (sigma * wp)) ** 2)
    scale = (1.0 - 0.287 * math.log(gamma)) * 5.0 / 16.0 * hs_m**2 * wp**4
    return np.asarray(scale * w**-5 * np.exp(-1.25 * (wp / w) ** 4) * peak)


def ochi_hubble_part(w_rad_s: F64, hs_m: float, tp_s: float, shape: float) -> F64:
    """Return one of the two three-parameter parts of the Ochi-Hubble spectrum; a shape of 1 is Bretschneider's.

    Source: Ochi & Hubble, Six-parameter wave spectra, Coastal Engineering 1976, chapter 18, eq. 2.
    """
    w = np.asarray(w_rad_s, dtype=float)
    b = (4.0 * shape + 1.0) / 4.0 * (math.tau / tp_s) ** 4
    # In logarithms, because b^shape and w^-(4 shape + 1) overflow for the narrow spectra of swell.
    log = shape * math.log(b) - math.lgamma(shape) - (4.0 * shape + 1.0) * np.log(w) - b * w**-4
    return np.asarray(0.25 * hs_m**2 * np.exp(log))


def fully_grown_period_s(hs_m: float) -> float:
    """Return the peak period of the one-parameter Pierson-Moskowitz spectrum of this significant height, over 0.

    Source: Pierson & Moskowitz 1964 by height, S = 0.0081 g^2 w^-5 exp(-0.032 (g / Hs)^2 w^-4): wp = 0.4 sqrt(g / Hs).
    """
    return math.tau / (0.4 * math.sqrt(GRAVITY_M_S2 / hs_m))


def most_probable_ochi_hubble(hs_m: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return (height m, peak period s, shape) of the swell and of the wind sea that are most probable at a significant height.

    The two heights are scaled by 0.14 % so that they add up to `hs_m`.
    Source: Ochi & Hubble 1976, table 2b, "most probable" of 800 North Atlantic spectra.
    """
    swell, wind = 0.84, 0.54
    scale = hs_m / math.hypot(swell, wind)
    return (
        (swell * scale, math.tau / (0.70 * math.exp(-0.046 * hs_m)), 3.0),
        (wind * scale, math.tau / (1.15 * math.exp(-0.039 * hs_m)), 1.54 * math.exp(-0.062 * hs_m)),
    )
