"""What the deck will do in the next seconds, with bands. Every member of the bank has its say, by its weight."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs
from estimator.ekf import sea, so3
from estimator.ekf.motion import QUARTER, turned
from estimator.ekf.options import EkfOptions
from estimator.ekf.oscillator import transition
from estimator.ekf.state import LIST, SWAY_PER_HEAVE, TH, TURN_RATE, WAVES, Belief, D, N, U, V

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
        """(H,) lower and upper end of the central band of `deck_height_m`, `rise_m_s`, `roll_rad` or `pitch_rad`; (H, 3) of
        `d_body_pad_level`.

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
    """From a settled belief. Means and covariances are those of the mixture over the bank's members."""
    h = np.asarray(horizons_s, dtype=float)
    n = h.size
    x, P = b.x, b.P
    waves, cov_waves = x[WAVES], P[WAVES[:, :, None], WAVES[:, None, :]]
    second = waves[:, :, None] * waves[:, None, :] + cov_waves
    weight = b.sea.weight
    power = weight * sea.SIGMA**2
    mean_a = np.zeros((n, 5, 2, 4))
    extra = np.zeros((n, 5, 2))
    for k in range(n):
        A, q = transition(sea.W, sea.ZETA, float(h[k]), sea.AT_REST)
        for row in range(2):
            a = A[:, row]
            mean = weight @ a
            mean_a[k, :, row] = mean
            # Second moment of the members' forecasts, less that of their mean transition: noise and disagreement.
            moment = (weight * ((a @ second) * a).sum(axis=2)).sum(axis=1) + power @ q[:, row, row]
            extra[k, :, row] = moment - ((mean[:, None] @ second)[:, 0] * mean).sum(axis=1)
    extra = np.maximum(extra, 0.0)

    Z = so3.about_down(-so3.heading(b.R))
    d_now = Z.dot(x[D])
    by_heading = np.array([d_now[1], -d_now[0], 0.0])
    u, sway, heave = x[U], x[SWAY_PER_HEAVE], x[WAVES[2]]
    d, cov_d = np.zeros((n, 3)), np.zeros((n, 3, 3))
    height, rise, roll, pitch = (np.zeros((2, n)) for _ in range(4))
    for k in range(n):
        T = float(h[k])
        A = mean_a[k]
        J = np.zeros((3, N))
        J[:, D] = np.eye(3)
        J[:, V] = -T * np.eye(3)
        turn = turned(float(x[TURN_RATE]), T)
        change = A[:3, 0] - np.array([1.0, 0.0, 0.0, 0.0])
        J[:2, U] = turn.reach
        J[np.arange(3)[:, None], WAVES[:3]] = change
        J[:2, WAVES[2]] += sway[:, None] * change[2]
        ned = J.dot(x)
        J[[0, 1], [52, 53]] = change[2].dot(heave)
        curving = QUARTER.dot(u) * (0.5 * T * T)
        J[:2, TURN_RATE] = curving
        J = Z.dot(J)
        J[:, TH] = np.outer(by_heading, so3.heading_row(b.R).dot(b.R))
        noise = np.diag(extra[k, :3, 0])
        noise[:2, :2] += np.eye(2) * (o.asd_vessel_velocity_m_s2**2 * T**3 / 3.0)
        # The rate of turn wanders by asd sqrt(t): integrated three times against the velocity.
        noise[:2, :2] += np.outer(curving, curving) * (0.2 * o.asd_turn_rate_rad_s2**2 * T)
        phase = np.append(sway, 1.0)
        noise += (np.outer(phase, phase) - np.diag([0.0, 0.0, 1.0])) * extra[k, 2, 0]
        d[k] = Z.dot(ned)
        cov_d[k] = J.dot(P).dot(J.T) + Z.dot(noise).dot(Z.T)
        for out, channel, row in ((height, 2, 0), (rise, 2, 1), (roll, 3, 0), (pitch, 4, 0)):
            c = np.zeros(N)
            c[WAVES[channel]] = A[channel, row]
            if channel >= 3:
                c[LIST[channel - 3]] = 1.0
            out[0, k] = c.dot(x)
            out[1, k] = math.sqrt(max(float(c.dot(P).dot(c)) + float(extra[k, channel, row]), 0.0))
    return Forecast(
        at, h, d, cov_d, -height[0], height[1], -rise[0], rise[1], roll[0], roll[1], pitch[0], pitch[1]
    )  # fmt: skip


def probability_of_motion(b: Belief, prior_rest: float = 0.5) -> float:
    """That the vessel is under way, or rocking: from the bank's evidence and from the steady velocity."""
    evidence = sea.log_evidence_of_rest(b.sea)
    north, east = b.x[U].tolist()
    (nn, ne), (_, ee) = b.P[U, U].tolist()
    # Standing still to a few cm/s against moving with some 1 m/s.
    for var, sign in ((0.03**2, 1.0), (1.0, -1.0)):
        n, e = nn + var, ee + var
        det = n * e - ne * ne
        evidence += sign * -0.5 * (math.log(det) + (e * north * north - 2.0 * ne * north * east + n * east * east) / det)
    odds = prior_rest / (1.0 - prior_rest) * math.exp(max(-60.0, min(60.0, evidence)))
    return 1.0 / (1.0 + odds)
