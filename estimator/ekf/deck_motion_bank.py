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
from estimator.core.abi import DIRECTIONS, MEMBER_PAIRS, MEMBER_STATES, MEMBERS
from estimator.core.library import CORE

PERIODS_S = np.geomspace(2.2, 14.0, 9)
ZETAS = np.array([0.2, 0.35, 0.55])
SIGMAS_M = np.array([0.02, 0.055, 0.15, 0.42, 1.15])
SIGMAS_RAD = np.radians([0.25, 0.7, 2.0, 5.5, 15.0])
STATIC_PRIOR = 0.5
"""Probability, before the first sighting, that the deck stands still."""
REST_ODDS = math.log(STATIC_PRIOR / (1.0 - STATIC_PRIOR))
HORIZONS_S = np.array([1.0, 2.0, 3.0])
"""Horizons at which past forecasts are compared with what happened."""


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
_PAIRS = np.triu_indices(MEMBER_STATES)
_PAIR_AT = np.zeros((MEMBER_STATES, MEMBER_STATES), dtype=int)
_PAIR_AT[_PAIRS] = _PAIR_AT[_PAIRS[::-1]] = np.arange(MEMBER_PAIRS)
"""(7, 7) where the upper triangle in rows has the entries of a symmetric matrix."""


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


class IssuedForecast(NamedTuple):
    """The forecast that was made at one instant."""

    t: int
    """Instant of the forecast, ns."""
    waves: F64
    """(3, 5, 2) displacement and rate by horizon and direction (m, m/s; rad, rad/s for roll and pitch)."""


class Skill(NamedTuple):
    """The sums over past comparisons of forecast and observed waves, which fade with time.

    A sea with two wave systems is no single oscillator, so the member of the bank that fits the recent motion best may forecast
    the next seconds badly, with full amplitude. The regression slope of the observed on the forecast motion is the factor that
    minimises the squared error. What the scaled forecasts have missed nonetheless widens the bands of the next ones.
    """

    issued: tuple[IssuedForecast, ...]
    """The forecasts whose longest horizon has not passed yet, oldest first."""
    n: F64
    """(3,) faded number of comparisons by horizon."""
    product: F64
    """(3, 5, 2) faded sum of forecast times observed motion."""
    square: F64
    """(3, 5, 2) faded sum of the squared forecast motion."""
    came: F64
    """(3, 5, 2) faded sum of the squared motion that came."""


class DeckMotionBank(NamedTuple):
    """Learned state. `w_rad_s`, `zeta`, `sigma` are its summary: (5,), for north, east, down in m, roll, pitch in rad."""

    t: int
    """ns, of the newest look; -1 before the first."""
    log_weight: F64
    """(5, G)"""
    x: F64
    """(5, G, 7) each member's [displacement, rate, force, its rate, offset of the IMU's carrying on, its rate, acceleration]."""
    pairs: F64
    """(5, 28, G) the upper triangle of each member's covariance, in rows."""
    skill: Skill
    """The skill of the bank's past forecasts."""
    weight: F64
    """(5, G), sums to one."""
    w_rad_s: F64
    zeta: F64
    sigma: F64

    @property
    def P(self) -> F64:
        """(5, G, 7, 7) covariance of each member."""
        return self.pairs[:, _PAIR_AT].transpose(0, 3, 1, 2)

    @property
    def at_rest(self) -> F64:
        """(5, 4, 4) stationary covariance of the summary's oscillators for sigma = 1."""
        return stationary(self.w_rad_s, self.zeta)


class PackedSea:
    """A bank as the core holds it. It is immutable, as a bank is.

    Attributes:
        record: the core's `dl_bank`.
        pointer: C's pointer to it.
    """

    __slots__ = ("_bank", "pointer", "record")

    def __init__(self, record: NDArray[Any], pointer: Any) -> None:
        self.record, self.pointer = record, pointer
        self._bank: DeckMotionBank | None = None

    @classmethod
    def of(cls, bank: DeckMotionBank) -> PackedSea:
        """Return a bank as the core holds it."""
        record = _written(bank)
        made = cls(record, CORE.array("dl_bank", record, 1))
        made._bank = bank
        return made

    def apart(self) -> PackedSea:
        """Return the same bank in memory of its own."""
        copy, pointer = CORE.copied("dl_bank", self.pointer)
        return PackedSea(np.ndarray((), CORE.dtype("dl_bank"), copy), pointer)

    @property
    def log_evidence_of_rest(self) -> float:
        """Log of how much likelier all that was seen is from a deck at rest than from one that moves."""
        return _log_evidence_of(self.pointer[0].weight[0])

    @property
    def bank(self) -> DeckMotionBank:
        """The bank, whose arrays are parts of the record."""
        if self._bank is None:
            self._bank = _read(self.record)
        return self._bank


@lru_cache(maxsize=1)
def unknown() -> DeckMotionBank:
    """Return a bank that has received no sighting."""
    made, pointer = CORE.room("dl_bank", 1)
    CORE.lib.dl_bank_begin(CORE.array("dl_bank_members", packed_members(), 1), pointer)
    return _read(made[0, ...])


@lru_cache(maxsize=1)
def packed_members() -> NDArray[Any]:
    """Return the core's `dl_bank_members`."""
    members = CORE.record("dl_bank_members", w=W, zeta=ZETA, log_zeta=np.log(ZETA), log_prior=LOG_PRIOR, sigma=SIGMA)
    members.setflags(write=False)
    return members


def _read(record: NDArray[Any]) -> DeckMotionBank:
    record.setflags(write=False)
    known = record["skill"]
    waves = (HORIZONS_S.size, DIRECTIONS, 2)
    issued = known["issued"][: known["issued_n"].item()]
    product, square, came = (known[name].reshape(waves) for name in ("product", "square", "came"))
    return DeckMotionBank(
        record["t"].item(),
        record["log_weight"].reshape(DIRECTIONS, MEMBERS),
        record["x"].reshape(DIRECTIONS, MEMBER_STATES, MEMBERS).transpose(0, 2, 1),
        record["P"].reshape(DIRECTIONS, MEMBER_PAIRS, MEMBERS),
        Skill(
            tuple([IssuedForecast(one["t"].item(), one["waves"].reshape(waves)) for one in issued]),
            known["n"],
            product,
            square,
            came,
        ),
        record["weight"].reshape(DIRECTIONS, MEMBERS),
        *(record[name] for name in ("w_rad_s", "zeta", "sigma")),
    )


def _written(bank: DeckMotionBank) -> NDArray[Any]:
    known = bank.skill
    skill: dict[str, Any] = {name: getattr(known, name) for name in ("n", "product", "square", "came")}
    skill |= {"issued_n": len(known.issued), "issued": [one._asdict() for one in known.issued]}
    values = {name: getattr(bank, name) for name in ("t", "w_rad_s", "zeta", "sigma", "log_weight", "weight")}
    return CORE.record("dl_bank", **values, x=bank.x.transpose(0, 2, 1), P=bank.pairs, skill=skill)


def log_evidence_of_rest(sea: DeckMotionBank) -> float:
    """Log of how much likelier all that was seen is from a deck at rest than from one that moves."""
    return _log_evidence_of(float(sea.weight[0, 0]))


def _log_evidence_of(rest: float) -> float:
    rest = min(max(rest, 1e-12), 1.0 - 1e-12)
    return math.log(rest / (1.0 - rest)) - REST_ODDS
