"""The bank of oscillators in numpy, against which the core's is held."""

import math
from functools import lru_cache

import numpy as np

from estimator.contracts.geometry import F64
from estimator.ekf.deck_motion_bank import LOG_PRIOR, REST_ODDS, SIGMA, ZETA, Carrying, W
from tests.estimator.ekf.belief import HORIZONS_S, MEMBER_STATES, DeckMotionBank, stationary
from tests.estimator.ekf.oracle import skill
from tests.estimator.ekf.oracle.oscillator import transition

AT_REST = stationary(W, ZETA)
"""(G, 4, 4) for sigma = 1."""
MEMORY_S = 180.0
"""Evidence fades over this time, so that another sea is learned."""
PERIOD_S = 0.2
"""Members look at most this often; a wave is seen dozens of times anyway."""
_EVIDENCE_WEIGHT = 0.6
"""Weight that a forecast gives to the evidence for a member."""
_NIS_MAX = 16.0
"""NIS beyond which an innovation counts no more against a member."""
DRIFT_VAR = np.array([[25.0, 9.0, 1.0]] * 3 + [[math.radians(2.0) ** 2, 0.0, 0.0]] * 2)
"""(5, 3) prior of offset, its rate, acceleration. A deck's list is an offset that does not drift."""
_AHEAD = np.stack([transition(W, ZETA, h, AT_REST).A[:, :2] for h in HORIZONS_S.tolist()])
"""(3, G, 2, 4) displacement and rate at the horizons of `skill`."""
_UPRIGHT = slice(2, 5)
"""Heave, roll, pitch: they decide whether the deck is at rest. Sideways an attitude that errs looks like a deck that moves, and
no deck surges without heaving."""


def pairs_of(P: F64) -> F64:
    """Return the upper triangles in rows, (5, 28, G), of covariances (5, G, 7, 7)."""
    rows, columns = np.triu_indices(MEMBER_STATES)
    return np.ascontiguousarray(P[:, :, rows, columns].transpose(0, 2, 1))


def unknown() -> DeckMotionBank:
    """Return a bank that has received no sighting."""
    P = np.zeros((*SIGMA.shape, MEMBER_STATES, MEMBER_STATES))
    P[:, :, :4, :4] = (SIGMA**2)[:, :, None, None] * AT_REST
    for i in range(3):
        P[:, :, 4 + i, 4 + i] = DRIFT_VAR[:, i, None]
    log_weight = np.broadcast_to(LOG_PRIOR, SIGMA.shape)
    return DeckMotionBank(
        -1, log_weight, np.zeros((*SIGMA.shape, MEMBER_STATES)), pairs_of(P), skill.unknown(), *_summary(log_weight)
    )


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
        waves = weight_ahead(log_weight, summary[0][:, :1])[..., None] * x[..., :4]
        known = skill.compared(known, t, waves[..., :2].sum(axis=1), np.einsum("kgri,cgi->kcr", _AHEAD, waves))
    return DeckMotionBank(t, log_weight, x, pairs_of(P), known, *summary)


def weight_ahead(log_weight: F64, rest: F64) -> F64:
    """Return the (5, G) weights for a forecast, with (5, 1) `rest` for the member at rest."""
    log_weight = _EVIDENCE_WEIGHT * (log_weight - LOG_PRIOR)[:, 1:]
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    return np.concatenate([rest, (1.0 - rest) * weight / weight.sum(axis=1, keepdims=True)], axis=1)


def _carried(x: F64, P: F64, dt: float, by: Carrying, reach_m: float) -> tuple[F64, F64]:
    F, q = _moved_on(dt)
    # F P F' = F (F P)' as P is symmetric, the five directions side by side: one product a member and not one each.
    half = (F @ P.transpose(1, 2, 0, 3).reshape(W.size, MEMBER_STATES, -1)).reshape(W.size, MEMBER_STATES, 5, MEMBER_STATES)
    P = (F @ half.transpose(0, 3, 2, 1).reshape(W.size, MEMBER_STATES, -1)).reshape(W.size, MEMBER_STATES, 5, MEMBER_STATES)
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
    F = np.zeros((W.size, MEMBER_STATES, MEMBER_STATES))
    F[:, :4, :4] = A
    F[:, 4:, 4:] = [[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, 1.0]]
    Q = (SIGMA**2)[:, :, None, None] * q
    F.setflags(write=False)
    Q.setflags(write=False)
    return F, Q


def _summary(log_weight: F64) -> tuple[F64, F64, F64, F64]:
    """(5, G) weights; (5,) rad/s, damping, standard deviation: from mean variances and mean logarithm."""
    top = log_weight.max(axis=1, keepdims=True)
    weight = np.exp(log_weight - top)
    moving = weight[:, 1:].sum(axis=1)
    # Each direction's odds of rest without its prior; the prior comes in once, for all of them.
    odds = float(np.sum((log_weight[:, 0] - top[:, 0] - np.log(moving))[_UPRIGHT]) - 2 * REST_ODDS)
    rest = 1.0 / (1.0 + math.exp(min(-odds, 500.0)))
    weight[:, 1:] *= ((1.0 - rest) / moving)[:, None]
    weight[:, 0] = rest
    energy = weight * SIGMA**2
    total = energy.sum(axis=1)
    fraction = energy / total[:, None]
    # Of the mixture's displacement and rate the variances stay: while the period is unknown, the quick members count.
    w, zeta = np.sqrt(fraction @ W**2), np.exp(fraction @ np.log(ZETA))
    return weight, w, zeta, np.sqrt(total)
