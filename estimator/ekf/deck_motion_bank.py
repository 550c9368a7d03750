"""Learned deck motion: a bank of oscillators for each direction, weighted by their likelihood.

The core learns and forecasts (bank.h and bank_ahead.h in estimator/core/filter); here are the members that it compares.

A member models the deck's motion in one direction as a damped oscillator driven by the rate of a second, equal one:

    x'' = -w^2 x - 2 zeta w x' + f'        f'' = -w^2 f - 2 zeta w f' + white noise

A single oscillator driven by white noise has a discontinuous acceleration, which no hull has. Driven by f instead of f' it would
have power at low frequencies, where a sea has none (docs/estimator.md). The noise intensity is such that x has the standard
deviation `sigma`. The states are [x, x', f, f'].
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.core.library import CORE

PERIODS_S = np.geomspace(2.2, 14.0, 9)
ZETAS = np.array([0.2, 0.35, 0.55])
SIGMAS_M = np.array([0.02, 0.055, 0.15, 0.42, 1.15])
SIGMAS_RAD = np.radians([0.25, 0.7, 2.0, 5.5, 15.0])
STATIC_PRIOR = 0.5
"""Probability, before the first sighting, that the deck stands still."""
REST_ODDS = math.log(STATIC_PRIOR / (1.0 - STATIC_PRIOR))


def _grid() -> tuple[F64, F64, F64, F64]:
    period, zeta, size = (a.ravel() for a in np.meshgrid(PERIODS_S, ZETAS, np.arange(SIGMAS_M.size), indexing="ij"))
    size = size.astype(int)
    w = np.concatenate([[1.0], math.tau / period])
    sigma = np.stack([np.concatenate([[1e-7], a[size]]) for a in (*(SIGMAS_M,) * 3, *(SIGMAS_RAD,) * 2)])
    prior = np.full(w.size, (1.0 - STATIC_PRIOR) / (w.size - 1))
    prior[0] = STATIC_PRIOR
    return w, np.concatenate([[0.5], zeta]), sigma, np.log(prior)


W, ZETA, SIGMA, LOG_PRIOR = _grid()
"""(G,) rad/s, (G,), (5, G) m or rad, (G,): the members."""
CARRIED = np.array([1.0, 1.0, 1.0, 0.0, 0.0])
"""1 for directions that the IMU's errors affect, (5,); a deck's roll and pitch are measured directly."""


class Carrying(NamedTuple):
    """The errors of the position propagated by the IMU, (5,) by direction; a deck's roll and pitch are measured directly."""

    asd_accel: F64
    """Noise density of the acceleration, m/s^2/sqrt(Hz)."""
    asd_drift: F64
    """Random walk of the acceleration's error, m/s^3/sqrt(Hz)."""
    asd_tilt: F64
    """Random walk of the tilt, rad/sqrt(s), which moves the measured position by the tilt times the distance."""


def carrying(asd_accel_m_s2: float, asd_gyro_rad_s: float, asd_accel_bias_m_s3: float) -> Carrying:
    """Return the dead-reckoning errors of an IMU.

    The accelerometer's noise acts in every direction, its bias drift acts downwards, and the tilt drift times gravity acts
    sideways. A tilt that is held level drifts by the gyro's noise and by as much again from the levelling.
    """
    sideways, asd_tilt = np.array([1.0, 1.0, 0.0, 0.0, 0.0]), math.sqrt(2.0) * asd_gyro_rad_s
    return Carrying(
        asd_accel_m_s2 * CARRIED,
        9.81 * asd_tilt * sideways + np.array([0.0, 0.0, asd_accel_bias_m_s3, 0.0, 0.0]),
        asd_tilt * sideways,
    )


@lru_cache(maxsize=1)
def packed_members() -> NDArray[Any]:
    """Return the core's `dl_bank_members`."""
    members = CORE.record("dl_bank_members", w=W, zeta=ZETA, log_zeta=np.log(ZETA), log_prior=LOG_PRIOR, sigma=SIGMA)
    members.setflags(write=False)
    return members
