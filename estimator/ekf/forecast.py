"""Forecast of the deck's motion in the next seconds, with bands. Every member of the bank contributes by its weight."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs
from estimator.ekf import deck_motion_bank, so3
from estimator.ekf.motion import QUARTER, turned
from estimator.ekf.options import EkfOptions
from estimator.ekf.state import (
    ATT_ERR,
    DECK_DISP,
    DECK_RATE,
    DECK_TRIM,
    POS_REL,
    SWAY_EAST,
    SWAY_NORTH,
    SWAY_PER_HEAVE,
    TURN_RATE,
    VEL,
    VESSEL_VEL,
    Belief,
    N,
)

_Z = {0.5: 0.6745, 0.68: 0.9945, 0.8: 1.2816, 0.9: 1.6449, 0.95: 1.9600, 0.99: 2.5758}


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """The deck at H instants ahead of `at`. Axes are those of `level` at `at`; the body is taken to keep its velocity.

    What the body really does is up to whoever steers it: subtract the planned departure from uniform motion.
    """

    at: MonoNs
    horizons_s: F64
    """(H,)"""
    d_body_pad_level: F64
    """(H, 3) m."""
    cov_d_level: F64
    """(H, 3, 3) m^2."""
    v_pad_level: F64
    """(H, 3) velocity of the pad's centre over the ground, m/s."""
    deck_height_m: F64
    """(H,) of the pad's centre above its mean level, positive up."""
    sigma_deck_height_m: F64
    rise_m_s: F64
    """(H,) vertical speed of the pad's centre, positive up."""
    sigma_rise_m_s: F64
    roll_rad: F64
    """(H,) of the deck about the arrow, starboard down positive."""
    sigma_roll_rad: F64
    pitch_rad: F64
    """(H,) of the deck, arrow up positive."""
    sigma_pitch_rad: F64

    def band(self, name: str, probability: float) -> tuple[F64, F64]:
        """Return the lower and upper end of a quantity's central band.

        Each is (H,) for `deck_height_m`, `rise_m_s`, `roll_rad` and `pitch_rad`, and (H, 3) for `d_body_pad_level`.

        Raises:
            KeyError: another probability than 0.5, 0.68, 0.8, 0.9, 0.95, 0.99.
            AttributeError: another name.
        """
        z = _Z[probability]
        mean: F64 = getattr(self, name)
        if name == "d_body_pad_level":
            sigma = np.sqrt(np.maximum(np.diagonal(self.cov_d_level, axis1=1, axis2=2), 0.0))
        else:
            sigma = getattr(self, f"sigma_{name}")
        return mean - z * sigma, mean + z * sigma


def forecast(b: Belief, at: MonoNs, horizons_s: F64, o: EkfOptions) -> Forecast:
    """Return the forecast from a settled belief.

    The waves come from the bank: their means and covariances are those of the mixture over its members.
    """
    h = np.asarray(horizons_s, dtype=float)
    n = h.size
    x, P = b.x, b.P
    waves = deck_motion_bank.ahead(b.sea, at, x[DECK_RATE], h)

    Z = so3.about_down(-so3.heading(b.R))
    d_now = Z.dot(x[POS_REL])
    by_heading = np.array([d_now[1], -d_now[0], 0.0])
    u, sway = x[VESSEL_VEL], x[SWAY_PER_HEAVE]
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
        ned[:2] += sway * change[2]
        J[np.arange(3), DECK_RATE[:3]] = by_rate[:3, 0]
        J[:2, DECK_RATE[2]] += sway * by_rate[2, 0]
        J[[0, 1], [SWAY_NORTH, SWAY_EAST]] = change[2]
        curving = QUARTER.dot(u) * (0.5 * T * T)
        J[:2, TURN_RATE] = curving
        J = Z.dot(J)
        J[:, ATT_ERR] = np.outer(by_heading, so3.heading_row(b.R).dot(b.R))
        noise = np.diag(var[:3])
        noise[:2, :2] += np.eye(2) * (o.asd_vessel_velocity_m_s2**2 * T**3 / 3.0)
        # The rate of turn wanders by asd sqrt(t): integrated three times against the velocity.
        noise[:2, :2] += np.outer(curving, curving) * (0.2 * o.asd_turn_rate_rad_s2**2 * T)
        phase = np.append(sway, 1.0)
        noise += (np.outer(phase, phase) - np.diag([0.0, 0.0, 1.0])) * var[2]
        d[k] = Z.dot(ned)
        v = waves.mean[k, :3, 1].copy()
        v[:2] += turn.by.dot(u) + sway * v[2]
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


def probability_of_motion(
    evidence_of_rest: float, v_ned: Sequence[float], var_ned: tuple[float, float, float], prior_rest: float = 0.5
) -> float:
    """Return the probability that the vessel is under way or rocks, by the bank's evidence and the steady velocity.

    Args:
        evidence_of_rest: of the bank, `deck_motion_bank.log_evidence_of_rest`.
        v_ned: (2,) the vessel's steady velocity north and east, m/s.
        var_ned: variance north, covariance, and variance east of that, (m/s)^2.
        prior_rest: the probability of rest before any evidence.
    """
    evidence = evidence_of_rest
    north, east = v_ned
    nn, ne, ee = var_ned
    # Standing still to a few cm/s against moving with some 1 m/s.
    for var, sign in ((0.03**2, 1.0), (1.0, -1.0)):
        n, e = nn + var, ee + var
        det = n * e - ne * ne
        evidence += sign * -0.5 * (math.log(det) + (e * north * north - 2.0 * ne * north * east + n * east * east) / det)
    odds = prior_rest / (1.0 - prior_rest) * math.exp(max(-60.0, min(60.0, evidence)))
    return 1.0 / (1.0 + odds)
