"""Motion of body and deck at the level `truth`: the true one with errors as the filter's, which it claims as its covariance."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from estimator.contracts.geometry import F64, known_rotation, rpy_matrix
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import Attitude
from estimator.contracts.time import NS_PER_S, MonoNs
from estimator.ekf import Forecast
from sitl.perception.port import PerceivedWorld

SIGMA_ACCEL_M_S2, ACCEL_TIME_S = 0.06, 4.0
"""Levelled acceleration: the tilt that the filter errs by, times g, and how fast it changes."""
SIGMA_SAMPLE_M_S2 = 0.043
"""One sample of the accelerometer beside that."""
SIGMA_DECK_M_S, DECK_TIME_S = (0.05, 0.05, 0.02), 1.5
"""The deck's velocity over the ground, north, east, down."""
SIGMA_DECK_M_S2 = (0.04, 0.04, 0.04)
SIGMA_TILT_RAD, SIGMA_TILT_RATE_RAD_S = 0.004, 0.006
AHEAD_S = (0.0, 0.3, 1.0, 2.0, 3.0)
AHEAD_FRACTION = (0.0, 0.06, 0.2, 0.4, 0.6)
"""Error of the forecast change of velocity, as a fraction of the deck's own rms velocity on waves."""
_CHANNELS = 3 + 3 + 3 + 4 + 3
_EYE = np.eye(3)
_SIGMA_DECK = np.array([*SIGMA_DECK_M_S, *SIGMA_DECK_M_S2])
_SIGMA_TILT = np.array([SIGMA_TILT_RAD, SIGMA_TILT_RAD, SIGMA_TILT_RATE_RAD_S, SIGMA_TILT_RATE_RAD_S])
_COV_ACCEL, _COV_DECK, _COV_TILT = (
    (SIGMA_ACCEL_M_S2**2 + SIGMA_SAMPLE_M_S2**2) * np.eye(3),
    np.diag(_SIGMA_DECK**2).copy(),
    np.diag(_SIGMA_TILT**2).copy(),
)
for _cov in (_COV_ACCEL, _COV_DECK, _COV_TILT):
    _cov.setflags(write=False)


class TrueMotion:
    """Draws the motion that guidance is told. One generator; the errors are Gauss-Markov processes."""

    def __init__(self, world: PerceivedWorld, rng: np.random.Generator) -> None:
        self._world, self._rng = world, rng
        self._standard = rng.standard_normal(_CHANNELS)
        self._at: MonoNs | None = None
        times = np.linspace(0.0, 60.0, 121)
        pad = world.vessel.pad(times)
        self._level_m = float(np.mean(pad.p_ned[0, :, 2]))
        v = pad.v_ned[0]
        self._rms_m_s = np.sqrt(np.mean((v - v.mean(axis=0)) ** 2, axis=0))

    def motion(self, now: MonoNs, reported: Attitude | None) -> tuple[BodyMotion | None, DeckMotion]:
        """Return the motion at an instant."""
        standard = self._wander(now)
        truth, pad = self._world.truth(), self._world.pad_motion()
        heading = truth.R_ned_body.rpy_rad[2]
        Z = rpy_matrix(0.0, 0.0, -heading)
        body = None
        if reported is not None:
            a = Z.dot(truth.a_body_ned) + SIGMA_ACCEL_M_S2 * standard[:3] + SIGMA_SAMPLE_M_S2 * self._rng.standard_normal(3)
            a.setflags(write=False)
            truth.w_body.setflags(write=False)
            body = BodyMotion(now, heading, a, _COV_ACCEL, truth.w_body, reported.R_ned_body, reported.cov_body)
        v = Z.dot(pad.v_ned + _SIGMA_DECK[:3] * standard[3:6])
        a = Z.dot(pad.a_ned + _SIGMA_DECK[3:] * standard[6:9])
        v.setflags(write=False)
        a.setflags(write=False)
        roll, pitch, _ = truth.R_ned_pad.rpy_rad
        off = (_SIGMA_TILT * standard[9:13]).tolist()
        roll_rate, pitch_rate, _ = pad.w.tolist()
        return body, DeckMotion(
            now, v, a, _COV_DECK, roll + off[0], pitch + off[1], roll_rate + off[2], pitch_rate + off[3], _COV_TILT
        )

    def forecast(self, now: MonoNs, horizons_s: Sequence[float], d_body_pad_level: F64) -> Forecast:
        """Return the deck ahead of an instant.

        Args:
            d_body_pad_level: (3,) m, where the pad is told to be now.
        """
        standard = self._wander(now)
        h = np.asarray(horizons_s, dtype=float)
        truth, pad, here = self._world.truth(), self._world.pad_ahead(h), self._world.pad_motion()
        Z = rpy_matrix(0.0, 0.0, -truth.R_ned_body.rpy_rad[2])
        fraction = np.interp(h, AHEAD_S, AHEAD_FRACTION)[:, None]
        spread = fraction * self._rms_m_s
        off = spread * standard[13:16]
        v = pad.v_ned[0] + off + _SIGMA_DECK[:3] * standard[3:6]
        moved = pad.p_ned[0] - here.p_ned + off * (h[:, None] / 3.0)
        d = d_body_pad_level + (moved - h[:, None] * truth.v_body_ned) @ Z.T
        sigma_d = 0.02 + spread * h[:, None] / 2.0
        tilts = np.array([known_rotation(R).rpy_rad[:2] for R in pad.R_ned[0]])
        tilt_off = np.radians(1.0) * fraction * standard[9:11]
        tilt_sigma = SIGMA_TILT_RAD + np.radians(1.0) * fraction[:, 0]
        return Forecast(
            now, h, d, _EYE * (sigma_d * sigma_d)[:, None, :], v @ Z.T,
            self._level_m - pad.p_ned[0, :, 2], sigma_d[:, 2],
            -v[:, 2], np.hypot(spread[:, 2], _SIGMA_DECK[2]),
            tilts[:, 0] + tilt_off[:, 0], tilt_sigma, tilts[:, 1] + tilt_off[:, 1], tilt_sigma,
        )  # fmt: skip

    def _wander(self, now: MonoNs) -> F64:
        """Carry the standard normal numbers of the errors on to another instant."""
        if self._at is not None and now != self._at:
            keep, new = _carried(max(0, now - self._at))
            self._standard = keep * self._standard + new * self._rng.standard_normal(_CHANNELS)
        self._at = now
        return self._standard


@lru_cache(maxsize=8)
def _carried(ns: int) -> tuple[F64, F64]:
    """Return how much of the errors' standard normal numbers stays over a time, and how much is new, both (16,)."""
    dt = ns / NS_PER_S
    keep = np.repeat(np.exp([-dt / ACCEL_TIME_S, -dt / DECK_TIME_S]), [3, _CHANNELS - 3])
    return keep, np.sqrt(1.0 - keep * keep)
