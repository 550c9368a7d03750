"""Forecast of the deck in numpy: the oracle of estimator/core/filter/forecast.c and bank_ahead.c."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs
from estimator.ekf.deck_motion_bank import SIGMA, ZETA, W
from estimator.ekf.forecast import Forecast
from estimator.ekf.options import EkfOptions
from estimator.ekf.state import ATT_ERR, DECK_DISP, DECK_RATE, DECK_TRIM, POS_REL, TURN_RATE, VEL, VESSEL_VEL, N
from tests.estimator.ekf.belief import Belief, DeckMotionBank
from tests.estimator.ekf.oracle import skill, so3
from tests.estimator.ekf.oracle.bank import AT_REST, weight_ahead
from tests.estimator.ekf.oracle.motion import QUARTER, turned
from tests.estimator.ekf.oracle.oscillator import transition
from tests.estimator.ekf.oracle.so3 import about_down, heading

_PRESENT = np.array([1.0, 0.0, 0.0, 0.0])


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
    size, weight = (SIGMA**2)[..., None], weight_ahead(sea.log_weight, sea.weight[:, :1])
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
    var = skill.missed(sea.skill, horizons_s, sea.w_rad_s, var + skill_var)
    changes = np.repeat((var_change + skill_var[..., 0])[..., None], 2, axis=-1)
    return Ahead(mean, mean[..., 0] - now, by_rate, var, skill.missed(sea.skill, horizons_s, sea.w_rad_s, changes)[..., 0])


@lru_cache(maxsize=16)  # guidance requests the same horizons again and again
def _reach(horizons_s: tuple[float, ...]) -> tuple[F64, F64]:
    """Return displacement and rate of the members at H horizons: (G, H 2, 4) of the transition, (G, H, 2) noise for sigma = 1."""
    steps = [transition(W, ZETA, horizon, AT_REST) for horizon in horizons_s]
    reach = np.stack([step.A[:, :2] for step in steps], axis=1).reshape(W.size, -1, 4)
    noise = np.stack([np.diagonal(step.q, axis1=1, axis2=2)[:, :2] for step in steps], axis=1)
    reach.setflags(write=False)
    noise.setflags(write=False)
    return reach, noise


def forecast(b: Belief, at: MonoNs, horizons_s: F64, o: EkfOptions) -> Forecast:
    """Return the forecast from a settled belief.

    The waves come from the bank: their means and covariances are those of the mixture over its members.
    """
    h = np.asarray(horizons_s, dtype=float)
    n = h.size
    x, P = b.x, b.P
    waves = ahead(b.sea, at, x[DECK_RATE], h)

    Z = about_down(-heading(b.R))
    d_now = Z.dot(x[POS_REL])
    by_heading = np.array([d_now[1], -d_now[0], 0.0])
    u = x[VESSEL_VEL]
    d, cov_d, v_pad = np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3))
    height, rise, roll, pitch = (np.zeros((2, n)) for _ in range(4))
    for k in range(n):
        T = float(h[k])
        change, by_rate, var = waves.change[k], waves.by_rate[k], waves.var_change[k]
        J = np.zeros((3, N))
        J[:, POS_REL] = np.eye(3)
        J[:, VEL] = -T * np.eye(3)
        turn = turned(float(x[TURN_RATE]), T)
        J[:2, VESSEL_VEL] = turn.reach
        ned = J.dot(x) + change[:3]
        J[np.arange(3), DECK_RATE[:3]] = by_rate[:3, 0]
        curving = QUARTER.dot(u) * (0.5 * T * T)
        J[:2, TURN_RATE] = curving
        J = Z.dot(J)
        J[:, ATT_ERR] = np.outer(by_heading, so3.heading_row(b.R).dot(b.R))
        noise = np.diag(var[:3])
        noise[:2, :2] += np.eye(2) * (o.asd_vessel_velocity_m_s2**2 * T**3 / 3.0)
        # The rate of turn wanders by asd sqrt(t): integrated three times against the velocity.
        noise[:2, :2] += np.outer(curving, curving) * (0.2 * o.asd_turn_rate_rad_s2**2 * T)
        d[k] = Z.dot(ned)
        v = waves.mean[k, :3, 1].copy()
        v[:2] += turn.by.dot(u)
        v_pad[k] = Z.dot(v)
        cov_d[k] = J.dot(P).dot(J.T) + Z.dot(noise).dot(Z.T)
        for out, channel in ((roll, 3), (pitch, 4)):
            c = np.zeros(N)
            c[DECK_TRIM[channel - 3]] = c[DECK_DISP[channel]] = 1.0
            out[0, k] = c.dot(x) + change[channel]
            c[DECK_RATE[channel]] = by_rate[channel, 0]
            out[1, k] = math.sqrt(max(float(c.dot(P).dot(c)) + float(var[channel]), 0.0))
    for out, row in ((height, 0), (rise, 1)):
        out[0] = waves.mean[:, 2, row]
        out[1] = np.sqrt(waves.var[:, 2, row] + waves.by_rate[:, 2, row] ** 2 * P[DECK_RATE[2], DECK_RATE[2]])
    return Forecast(
        at, h, d, cov_d, v_pad, -height[0], height[1], -rise[0], rise[1], roll[0], roll[1], pitch[0], pitch[1]
    )  # fmt: skip
