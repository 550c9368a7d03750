"""What is learned of the deck's motion: a bank of oscillators for each direction, weighed by what each foretold.

The core learns (estimator/core/filter/bank.h) and forecasts (bank_ahead.h there); here are the members that it compares.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64
from estimator.core.abi import DIRECTIONS, MEMBER_PAIRS, MEMBER_STATES, MEMBERS
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, address, start_of
from estimator.ekf import skill
from estimator.ekf.oscillator import stationary

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
"""Whether the IMU's errors affect a direction, (5,); a deck's roll and pitch are measured directly."""
_PAIRS = np.triu_indices(MEMBER_STATES)
_PAIR_AT = np.zeros((MEMBER_STATES, MEMBER_STATES), dtype=int)
_PAIR_AT[_PAIRS] = _PAIR_AT[_PAIRS[::-1]] = np.arange(MEMBER_PAIRS)
"""(7, 7) where the upper triangle in rows has the entries of a symmetric matrix."""
_BEGIN = CORE.function("bank_begin")
_SEA, _SKILL, _MEMBERS = (places_of(name) for name in ("sea", "forecast_skill", "bank_members"))
_ISSUED_SIZE = size_of("issued_forecast")
SEA_SIZE = size_of("sea")
"""Size of the core's `sea`, in words of eight bytes."""


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


class DeckMotionBank(NamedTuple):
    """What has been learned. `w_rad_s`, `zeta`, `sigma` are its summary: (5,), for north, east, down in m, roll, pitch in rad."""

    t: int
    """ns, of the newest look; -1 before the first."""
    log_weight: F64
    """(5, G)"""
    x: F64
    """(5, G, 7) each member's [displacement, rate, force, its rate, offset of the IMU's carrying on, its rate, acceleration]."""
    pairs: F64
    """(5, 28, G) the upper triangle of each member's covariance, in rows."""
    skill: skill.Skill
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
    """A bank as the core holds it, in its `sea`. It is immutable, as a bank is.

    Attributes:
        block: words of which it is a part.
        address: where it begins.
    """

    __slots__ = ("_at", "_bank", "address", "block")

    def __init__(self, block: F64, at: int, address: int) -> None:
        self.block, self._at, self.address = block, at, address
        self._bank: DeckMotionBank | None = None

    @classmethod
    def of(cls, bank: DeckMotionBank) -> PackedSea:
        """Return a bank as the core holds it."""
        block = np.zeros(SEA_SIZE)
        _write(block, bank)
        made = cls(block, 0, start_of(block))
        made._bank = bank
        return made

    def apart(self) -> PackedSea:
        """Return the same bank in memory of its own."""
        block = self.block[self._at : self._at + SEA_SIZE].copy()
        return PackedSea(block, 0, start_of(block))

    @property
    def log_evidence_of_rest(self) -> float:
        """Log of how much likelier all that was seen is from a deck at rest than from one that moves."""
        return _log_evidence_of(self.block.item(self._at + _SEA["weight"].start))

    @property
    def bank(self) -> DeckMotionBank:
        """The bank, whose arrays are parts of the block."""
        if self._bank is None:
            self._bank = _read(self.block[self._at : self._at + SEA_SIZE])
        return self._bank


@lru_cache(maxsize=1)
def unknown() -> DeckMotionBank:
    """Return a bank that has received no sighting."""
    block, members = np.empty(SEA_SIZE), packed_members()
    _BEGIN(address(members), start_of(block))
    return _read(block)


@lru_cache(maxsize=1)
def packed_members() -> F64:
    """Return the core's `bank_members`."""
    words = np.empty(size_of("bank_members"))
    parts = {"w": W, "zeta": ZETA, "log_zeta": np.log(ZETA), "log_prior": LOG_PRIOR, "sigma": SIGMA}
    for name, values in parts.items():
        words[_MEMBERS[name]] = values.ravel()
    words.setflags(write=False)
    return words


def _read(words: F64) -> DeckMotionBank:
    words.setflags(write=False)
    known = words[_SEA["skill"]]
    issued = known[_SKILL["issued"]].reshape(-1, _ISSUED_SIZE)[: known[_SKILL["issued_n"]].view(np.int64).item()]
    waves = (skill.HORIZONS_S.size, DIRECTIONS, 2)
    product, square, came = (known[_SKILL[name]].reshape(waves) for name in ("product", "square", "came"))
    return DeckMotionBank(
        words[_SEA["t"]].view(np.int64).item(),
        words[_SEA["log_weight"]].reshape(DIRECTIONS, MEMBERS),
        words[_SEA["x"]].reshape(DIRECTIONS, MEMBER_STATES, MEMBERS).transpose(0, 2, 1),
        words[_SEA["P"]].reshape(DIRECTIONS, MEMBER_PAIRS, MEMBERS),
        skill.Skill(
            tuple([skill.IssuedForecast(one[:1].view(np.int64).item(), one[1:].reshape(waves)) for one in issued]),
            known[_SKILL["n"]],
            product,
            square,
            came,
        ),
        words[_SEA["weight"]].reshape(DIRECTIONS, MEMBERS),
        *(words[_SEA[name]] for name in ("w_rad_s", "zeta", "sigma")),
    )


def _write(words: F64, bank: DeckMotionBank) -> None:
    words[_SEA["t"]].view(np.int64)[:] = bank.t
    for name in ("w_rad_s", "zeta", "sigma"):
        words[_SEA[name]] = getattr(bank, name)
    for name in ("log_weight", "weight"):
        words[_SEA[name]] = getattr(bank, name).ravel()
    words[_SEA["x"]] = bank.x.transpose(0, 2, 1).ravel()
    words[_SEA["P"]] = bank.pairs.ravel()
    known = words[_SEA["skill"]]
    known[_SKILL["issued_n"]].view(np.int64)[:] = len(bank.skill.issued)
    for one, into in zip(bank.skill.issued, known[_SKILL["issued"]].reshape(-1, _ISSUED_SIZE), strict=False):
        into[:1].view(np.int64)[:], into[1:] = one.t, one.waves.ravel()
    for name in ("n", "product", "square", "came"):
        known[_SKILL[name]] = getattr(bank.skill, name).ravel()


def log_evidence_of_rest(sea: DeckMotionBank) -> float:
    """Log of how much likelier all that was seen is from a deck at rest than from one that moves."""
    return _log_evidence_of(float(sea.weight[0, 0]))


def _log_evidence_of(rest: float) -> float:
    rest = min(max(rest, 1e-12), 1.0 - 1e-12)
    return math.log(rest / (1.0 - rest)) - REST_ODDS
