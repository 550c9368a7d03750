"""Learning how the deck moves: a bank of oscillators for each direction, weighed by how well each foretold what was seen.

Every member is a Kalman filter of its own on one number, where the pad was seen plus where the IMU has carried the body since
the start; the IMU's drift (an offset, its rate, a wandering acceleration) is part of each member's state. The main filter is not
involved, so nothing it believes of the sea can confirm itself. Member 0 says that the deck stands still: it does so in all
directions or in none, because no vessel surges without heaving.
Source: Magill, Optimal adaptive estimation of sampled stochastic processes, IEEE Trans. Automatic Control 10(4), 1965.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64
from estimator.ekf import skill
from estimator.ekf.oscillator import stationary, transition

PERIODS_S = np.geomspace(2.2, 14.0, 9)
ZETAS = np.array([0.2, 0.35, 0.55])
SIGMAS_M = np.array([0.02, 0.055, 0.15, 0.42, 1.15])
SIGMAS_RAD = np.radians([0.25, 0.7, 2.0, 5.5, 15.0])
STATIC_PRIOR = 0.5
"""Probability, before the first sighting, that the deck stands still."""
_REST_ODDS = math.log(STATIC_PRIOR / (1.0 - STATIC_PRIOR))
MEMORY_S = 180.0
"""Evidence fades over this time, so that another sea is learned."""
PERIOD_S = 0.2
"""Members look at most this often; a wave is seen dozens of times anyway."""
_EVIDENCE_WEIGHT = 0.6
"""Weight that a forecast gives to the evidence for a member."""
_NIS_MAX = 16.0
"""NIS beyond which an innovation counts no more against a member."""


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
AT_REST = stationary(W, ZETA)
"""(G, 4, 4) for sigma = 1."""
_AHEAD = np.stack([transition(W, ZETA, h, AT_REST).A[:, :2] for h in skill.HORIZONS_S.tolist()])
"""(3, G, 2, 4) displacement and rate at the horizons of `skill`."""

DRIFT_VAR = np.array([[25.0, 9.0, 1.0]] * 3 + [[math.radians(2.0) ** 2, 0.0, 0.0]] * 2)
"""(5, 3) prior of offset, its rate, acceleration. A deck's list is an offset that does not drift."""
_SIZE = 7
_PRESENT = np.array([1.0, 0.0, 0.0, 0.0])
CARRIED = np.array([1.0, 1.0, 1.0, 0.0, 0.0])
"""Whether the IMU's errors affect a direction, (5,); a deck's roll and pitch are measured directly."""
_UPRIGHT = slice(2, 5)
"""Heave, roll, pitch: they decide whether the deck is at rest. Sideways an attitude that errs looks like a deck that moves, and
no deck surges without heaving."""


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
    P: F64
    """(5, G, 7, 7)"""
    skill: skill.Skill
    """The skill of the bank's past forecasts."""
    weight: F64
    """(5, G), sums to one."""
    w_rad_s: F64
    zeta: F64
    sigma: F64
    at_rest: F64
    """(5, 4, 4) stationary covariance of the summary's oscillators for sigma = 1."""


def unknown() -> DeckMotionBank:
    """Return a bank that has received no sighting."""
    P = np.zeros((*SIGMA.shape, _SIZE, _SIZE))
    P[:, :, :4, :4] = (SIGMA**2)[:, :, None, None] * AT_REST
    for i in range(3):
        P[:, :, 4 + i, 4 + i] = DRIFT_VAR[:, i, None]
    log_weight = np.broadcast_to(LOG_PRIOR, SIGMA.shape)
    return DeckMotionBank(-1, log_weight, np.zeros((*SIGMA.shape, _SIZE)), P, skill.unknown(), *_summary(log_weight))


def observe(sea: DeckMotionBank, t: int, y: F64, var: F64, by: Carrying, reach_m: float) -> DeckMotionBank:
    """Update the bank with one sighting of the deck.

    Args:
        t: ns.
        y: (5,) pad north, east, down plus the body's place by the IMU alone (m); deck roll and pitch (rad).
        var: (5,) of each; 1e6 and more where it was not seen.
        by: how the body was carried.
        reach_m: how far away the pad is.
    """
    x, P, fade = sea.x, sea.P, 1.0
    seen = var < 1e5
    if sea.t < 0:
        # The first look sets the offset's origin; the prior is about it, not about the world's.
        x = x.copy()
        x[:3, :, 4] = np.where(seen, y, 0.0)[:3, None]
    elif t > sea.t:
        x, P = _carried(x, P, (t - sea.t) * 1e-9, by, reach_m)
        fade = math.exp(-(t - sea.t) * 1e-9 / MEMORY_S)
    PH = P[..., 0] + P[..., 4]
    S = PH[..., 0] + PH[..., 4] + var[:, None]
    innov = y[:, None] - x[..., 0] - x[..., 4]
    observed = seen[:, None].astype(float)
    K = PH * (observed / S)[..., None]
    log_weight = fade * (sea.log_weight - LOG_PRIOR) + LOG_PRIOR
    log_weight = log_weight - 0.5 * observed * (np.log(S) + np.minimum(innov * innov / S, _NIS_MAX))
    log_weight = np.maximum(log_weight - log_weight.max(axis=1, keepdims=True), -30.0)
    P = P - K[..., :, None] * PH[..., None, :]
    x = x + K * innov[..., None]
    summary = _summary(log_weight)
    known = sea.skill
    if skill.due(known, t):
        waves = _weight_ahead(log_weight, summary[0][:, :1])[..., None] * x[..., :4]
        known = skill.compared(known, t, waves[..., :2].sum(axis=1), np.einsum("kgri,cgi->kcr", _AHEAD, waves))
    return DeckMotionBank(t, log_weight, x, P, known, *summary)


def _weight_ahead(log_weight: F64, rest: F64) -> F64:
    """Return the (5, G) weights for a forecast, with (5, 1) `rest` for the member at rest.

    No sea is exactly one of the members, so the evidence counts for less than if one of them were the truth.
    Source: Grunwald and van Ommen, Inconsistency of Bayesian inference for misspecified linear models, Bayesian Analysis, 2017.
    """
    log_weight = _EVIDENCE_WEIGHT * (log_weight - LOG_PRIOR)[:, 1:]
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    return np.concatenate([rest, (1.0 - rest) * weight / weight.sum(axis=1, keepdims=True)], axis=1)


class Ahead(NamedTuple):
    """The forecast of the bank at H instants: displacement and rate by direction, (H, 5, 2)."""

    mean: F64
    """The weighted mean of the members' forecasts, scaled by the forecast skill."""
    change: F64
    """The forecast displacement minus the present one, (H, 5)."""
    by_rate: F64
    """Derivative of the forecast with respect to the present rates."""
    var: F64
    """Variance of the forecast without the part that the uncertainty of the present rates adds, (H, 5, 2)."""
    var_change: F64
    """The same variance of the displacement's change, (H, 5)."""


def ahead(sea: DeckMotionBank, t: int, rate: F64, horizons_s: F64) -> Ahead:
    """Forecast the waves from `t`, ns, on.

    Every member goes on from its own state: what pushes it belongs to its own period and damping, and another's would send it
    elsewhere. Only the present rate is the main filter's, which has seen more.

    Args:
        rate: (5,) present rate by direction.
        horizons_s: (H,)
    """
    A, q = transition(W, ZETA, max(0, t - sea.t) * 1e-9 if sea.t >= 0 else 0.0, AT_REST)
    size, weight = (SIGMA**2)[..., None], _weight_ahead(sea.log_weight, sea.weight[:, :1])
    w = weight[..., None]
    x = (A @ sea.x[..., :4, None])[..., 0]
    P = A @ sea.P[..., :4, :4] @ A.transpose(0, 2, 1) + size[..., None] * q
    x[..., 1] += (rate - (weight * x[..., 1]).sum(axis=1))[:, None]
    column = P[..., 1]
    P = P - column[..., :, None] * column[..., None, :] / np.maximum(column[..., 1], 1e-18)[..., None, None]
    now = (w * x).sum(axis=1)[:, 0]
    # Arrays have axes (direction, member, horizon, displacement or rate): one product a member, whatever the number of horizons.
    reach, noise = _reach(tuple(horizons_s.tolist()))
    member = weight[..., None, None]
    a = reach.reshape(W.size, -1, 2, 4)
    observed = (x[:, :, None, :] @ reach.transpose(0, 2, 1)).reshape(*x.shape[:2], -1, 2)
    mean = (member * observed).sum(axis=1)
    own = (((reach @ P) * reach).sum(axis=-1)).reshape(observed.shape)
    var = (member * (own + size[..., None] * noise + (observed - mean[:, None]) ** 2)).sum(axis=1)
    change = a[:, :, 0] - _PRESENT
    moved = observed[..., 0] - x[..., :1]
    spread = (moved - (member[..., 0] * moved).sum(axis=1, keepdims=True)) ** 2
    own_change = ((change @ P) * change).sum(axis=-1)
    var_change = (member[..., 0] * (own_change + size * noise[..., 0] + spread)).sum(axis=1).T
    by_rate = np.einsum("cg,ghr->hcr", weight, a[..., 1])
    mean, var = mean.transpose(1, 0, 2), var.transpose(1, 0, 2)
    kept = skill.factor(sea.skill, horizons_s, sea.w_rad_s)
    skill_var = ((1.0 - kept) * mean) ** 2
    mean = kept * mean
    return Ahead(mean, mean[..., 0] - now, by_rate, var + skill_var, var_change + skill_var[..., 0])


@lru_cache(maxsize=16)  # guidance asks for the same horizons again and again
def _reach(horizons_s: tuple[float, ...]) -> tuple[F64, F64]:
    """Return displacement and rate of the members at H horizons: (G, H 2, 4) of the transition, (G, H, 2) noise for sigma = 1."""
    steps = [transition(W, ZETA, horizon, AT_REST) for horizon in horizons_s]
    reach = np.stack([step.A[:, :2] for step in steps], axis=1).reshape(W.size, -1, 4)
    noise = np.stack([np.diagonal(step.q, axis1=1, axis2=2)[:, :2] for step in steps], axis=1)
    reach.setflags(write=False)
    noise.setflags(write=False)
    return reach, noise


def _carried(x: F64, P: F64, dt: float, by: Carrying, reach_m: float) -> tuple[F64, F64]:
    F, q = _moved_on(dt)
    # F P F' = F (F P)' as P is symmetric, the five directions side by side: one product a member and not one each.
    half = (F @ P.transpose(1, 2, 0, 3).reshape(W.size, _SIZE, -1)).reshape(W.size, _SIZE, 5, _SIZE)
    P = (F @ half.transpose(0, 3, 2, 1).reshape(W.size, _SIZE, -1)).reshape(W.size, _SIZE, 5, _SIZE)
    P = np.ascontiguousarray(P.transpose(2, 0, 1, 3))
    P[:, :, :4, :4] += q
    qa, qb = by.asd_accel**2, by.asd_drift**2
    noise = np.zeros((5, 3, 3))
    noise[:, 0, 0] = qa * dt**3 / 3 + qb * dt**5 / 20 + (reach_m * by.asd_tilt) ** 2 * dt
    noise[:, 0, 1] = noise[:, 1, 0] = qa * dt**2 / 2 + qb * dt**4 / 8
    noise[:, 0, 2] = noise[:, 2, 0] = qb * dt**3 / 6
    noise[:, 1, 1] = qa * dt + qb * dt**3 / 3
    noise[:, 1, 2] = noise[:, 2, 1] = qb * dt**2 / 2
    noise[:, 2, 2] = qb * dt
    P[:, :, 4:, 4:] += noise[:, None]
    return (F @ x[..., None])[..., 0], P


@lru_cache(maxsize=8)  # cameras keep their rate
def _moved_on(dt: float) -> tuple[F64, F64]:
    """(G, 7, 7) transition of the members over `dt` s, (5, G, 4, 4) noise of their oscillators."""
    A, q = transition(W, ZETA, dt, AT_REST)
    F = np.zeros((W.size, _SIZE, _SIZE))
    F[:, :4, :4] = A
    F[:, 4:, 4:] = [[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, 1.0]]
    Q = (SIGMA**2)[:, :, None, None] * q
    F.setflags(write=False)
    Q.setflags(write=False)
    return F, Q


def log_evidence_of_rest(sea: DeckMotionBank) -> float:
    """Log of how much likelier all that was seen is from a deck at rest than from one that moves."""
    rest = min(max(float(sea.weight[0, 0]), 1e-12), 1.0 - 1e-12)
    return math.log(rest / (1.0 - rest)) - _REST_ODDS


def _summary(log_weight: F64) -> tuple[F64, F64, F64, F64, F64]:
    """(5, G) weights; (5,) rad/s, damping, standard deviation: from mean variances and mean logarithm; at rest."""
    top = log_weight.max(axis=1, keepdims=True)
    weight = np.exp(log_weight - top)
    moving = weight[:, 1:].sum(axis=1)
    # Each direction's odds of rest without its prior; the prior comes in once, for all of them.
    odds = float(np.sum((log_weight[:, 0] - top[:, 0] - np.log(moving))[_UPRIGHT]) - 2 * _REST_ODDS)
    rest = 1.0 / (1.0 + math.exp(min(-odds, 500.0)))
    weight[:, 1:] *= ((1.0 - rest) / moving)[:, None]
    weight[:, 0] = rest
    energy = weight * SIGMA**2
    total = energy.sum(axis=1)
    fraction = energy / total[:, None]
    # Of the mixture's displacement and rate the variances stay: while the period is unknown, the quick members count.
    w, zeta = np.sqrt(fraction @ W**2), np.exp(fraction @ np.log(ZETA))
    return weight, w, zeta, np.sqrt(total), stationary(w, zeta)
