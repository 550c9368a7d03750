"""Turns as rotation vectors, and the attitude that a gyro gives between two instants."""

import numpy as np

from estimator.contracts.geometry import F64

_SMALL_RAD = 1e-4  # angle below which a turn is computed by its series


def exps(rotvec_rad: F64) -> F64:
    """Return the rotations (N, 3, 3) by rotation vectors (N, 3)."""
    angle2 = (rotvec_rad * rotvec_rad).sum(axis=1)
    angle = np.sqrt(angle2)
    small = angle < _SMALL_RAD
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0 - angle2 / 6.0, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle2 / 24.0, (1.0 - np.cos(safe)) / (safe * safe))
    x, y, z = rotvec_rad.T
    K = np.zeros((rotvec_rad.shape[0], 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -z, y, -x
    K[:, 1, 0], K[:, 2, 0], K[:, 2, 1] = z, -y, x
    return np.asarray(np.eye(3) + a[:, None, None] * K + b[:, None, None] * (K @ K))


def exp(rotvec_rad: F64) -> F64:
    """Return the rotation (3, 3) by a rotation vector (3,)."""
    return np.asarray(exps(np.asarray(rotvec_rad, dtype=float)[None])[0])


def logs(R: F64) -> F64:
    """Return the rotation vectors (N, 3) of rotations (N, 3, 3) of less than half a turn."""
    v = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine = np.sqrt((v * v).sum(axis=1))
    angle = np.arctan2(sine, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    known = sine > 1e-12
    return np.asarray(v * np.where(known, angle / np.where(known, sine, 1.0), 1.0)[:, None])


def transposed(R: F64) -> F64:
    """Return the inverse of rotations (N, 3, 3)."""
    return np.swapaxes(R, -1, -2)


def interpolated(t_of: F64, R: F64, t: F64) -> F64:
    """Return rotations (M, 3, 3) known at `t_of` (M,) at the times `t` (N,), on the great arc."""
    i = np.clip(np.searchsorted(t_of, t) - 1, 0, t_of.size - 2)
    share = ((t - t_of[i]) / (t_of[i + 1] - t_of[i]))[:, None]
    return np.asarray(R[i] @ exps(logs(transposed(R[i]) @ R[i + 1]) * share))


class GyroAttitude:
    """The attitude by a gyro alone, from a first attitude.

    Args:
        t: (G,) s, ascending.
        w_body: (G, 3) rad/s, without its bias.
        R_first: (3, 3), `R_ned_body` at the first sample.
    """

    def __init__(self, t: F64, w_body: F64, R_first: F64) -> None:
        self._t, self._w = t, w_body
        dt = np.diff(t)
        steps = exps(0.5 * (w_body[1:] + w_body[:-1]) * dt[:, None])
        R = np.empty((t.size, 3, 3))
        R[0] = R_first
        for i, step in enumerate(steps):
            R[i + 1] = R[i] @ step
        self._R = R
        self._integral = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(0.5 * (R[1:] + R[:-1]) * dt[:, None, None], axis=0)])

    def at(self, t: F64) -> F64:
        """Return `R_ned_body` (N, 3, 3)."""
        i, part = self._place(t)
        share = (part / (self._t[i + 1] - self._t[i]))[:, None]
        w = self._w[i] * (1.0 - 0.5 * share) + self._w[i + 1] * (0.5 * share)
        return np.asarray(self._R[i] @ exps(w * part[:, None]))

    def integral_at(self, t: F64) -> F64:
        """Return the integral of `R_ned_body` over time (N, 3, 3), s: a bias of the gyro turns the attitude by it."""
        i, part = self._place(t)
        return np.asarray(self._integral[i] + self._R[i] * part[:, None, None])

    def rate_ned(self, t: F64, over_s: float) -> F64:
        """Return the angular rate in `ned`, (N, 3) rad/s, as the mean over `over_s` before and after."""
        return logs(self.at(t + over_s) @ transposed(self.at(t - over_s))) / (2.0 * over_s)

    def _place(self, t: F64) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.intp]], F64]:
        i = np.clip(np.searchsorted(self._t, t) - 1, 0, self._t.size - 2)
        return i, t - self._t[i]
