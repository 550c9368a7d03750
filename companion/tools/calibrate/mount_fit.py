"""Mount, delay and readout of the camera from a flight over a pad, by least squares over the whole flight.

A pad that does not turn ties the camera to the gyro: R_ned_body(t + delay) R_body_cam R_cam_pad stays the same. Leans and turns
about different axes show the rotation between camera and gyro, and their speed shows the delay. The reported attitude bounds the
gyro's drift. Its own constant error is estimated along, with what its source claims as prior.
Source: Furgale, Rehder and Siegwart, Unified temporal and spatial calibration for multi-sensor systems, IROS 2013; here with the
pad's poses in place of splines.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from companion.tools.calibrate.flight_views import FlightViews
from companion.tools.calibrate.gyro_attitude import GyroAttitude, exp, exps, interpolated, logs, transposed
from estimator.contracts.geometry import F64

STATES = 9
"""Errors of the gyro's angle, of the reported attitude and of the deck, each (3,) rad in `ned`."""
_START_RAD = 0.3
"""Standard deviation of the gyro's first attitude."""
_ATTITUDE_WHITE_RAD = 1e-4  # standard deviation of the reported attitude's white noise
_WORTH = 0.5
"""Twice the logarithm of the likelihood that a step has to gain."""
_MOST_STEPS = 15  # steps of the search at most
MOUNT = slice(0, 3)
"""Place of the mount among the parameters, a turn of the camera from its file, in `body`, rad."""
DELAY = 3
"""Place of the delay, s."""
GYRO = slice(4, 7)
"""Place of the gyro's bias, rad/s."""
PAD = slice(7, 10)
"""Place of the pad's attitude, rad."""
LEVEL = slice(10, 12)
"""Place of the constant error of the reported roll and pitch, in `body`, rad."""
READOUT = 12
"""Place of the readout time beyond that of the views, s, which stays 0 where they do not say what it does."""
COUNT = 13
"""Number of parameters."""
_MOUNT_PRIOR_RAD = 0.5  # standard deviation of the prior of the mount
_DELAY_PRIOR_S = 0.3  # standard deviation of the prior of the delay
_GYRO_PRIOR_RAD_S = 0.05  # standard deviation of the prior of the gyro's bias
_PAD_PRIOR_RAD = 1.0  # standard deviation of the prior of the pad's attitude
_READOUT_PRIOR_S = 0.05  # standard deviation of the prior of the readout time
_READOUT_FIXED_S = 1e-6  # the same where the views do not say what it does
_LEVEL_LEAST_RAD = math.radians(0.5)
"""An attitude that claims less than this for its constant error is not used."""
_STEPS = 8  # steps of the fit
_SEARCHED_AT = (2, 4)
"""Steps at which the noise is searched."""
_GATED_FROM = 1  # step from which on outliers are left out
_CONVERGED = 1e-5  # change of a step that ends the fit
_SEARCH_VIEWS = 300  # views that the noise is searched with
_BLOCK_S = 4.0  # length of a stretch of which errors are taken to be alike
_OUTLIER_SIGMAS = 5.0  # standard deviations from which a view is an outlier
_RATE_OVER_S = 0.02  # time over which the gyro's rate is averaged
_DELAY_MAX_S = 0.28
"""Least margin of the gyro's samples before and after the views, s."""


# A filter that turns the errors of a flight's residuals into white ones of unit variance.
#
# The residuals of a view are six: the pad's orientation in `ned` by gyro and camera, and the reported attitude against the
# gyro. Their errors are correlated in time: the gyro's angle walks, the reported attitude and the deck wander. What a Kalman
# filter of these errors cannot predict is white, and the same filter applied to the derivatives by the parameters gives the
# least squares of the whole flight.
#
# Source: Bryson and Ho, Applied Optimal Control, 1975, section 13 (whitening by innovations).

_H = np.block([[-np.eye(3), np.zeros((3, 3)), np.eye(3)], [np.eye(3), np.eye(3), np.zeros((3, 3))]])


class Noise(NamedTuple):
    """The sizes of the errors."""

    gyro_rad_sqrt_s: float = 0.003
    """Random walk of the integrated gyro: its change within 1 s."""
    tilt_rad: float = math.radians(0.4)
    """Wandering error of the reported roll and pitch."""
    heading_rad: float = math.radians(2.0)
    deck_rad: float = math.radians(0.02)
    """Turning of the deck itself."""
    view: float = 1.0
    """Ratio of a view's standard deviation to its claim."""
    tilt_s: float = 1.0
    """Time constants of the wandering."""
    heading_s: float = 5.0
    deck_s: float = 2.0


class Whitened(NamedTuple):
    """Residuals and derivatives after the filter, for each of B noises."""

    rows: F64
    """(B, N, 6, C): for every column of the input."""
    log_det: F64
    """(B,), sum of the logarithms of the innovations' determinants."""


def whiten(t: F64, columns: F64, cov_view: F64, used: NDArray[np.bool_], noises: Sequence[Noise]) -> Whitened:
    """Filter the columns of a flight, under several noises at once.

    Args:
        t: (N,) s, ascending.
        columns: (N, 6, C): residuals and their derivatives.
        cov_view: (N, 3, 3) rad^2, of the pad's orientation in `ned` as the camera claims it.
        used: (N,) whether the view counts; of others only the attitude is used.
    """
    n, _, c = columns.shape
    b = len(noises)
    wander = np.array([[o.tilt_rad, o.tilt_rad, o.heading_rad, *(o.deck_rad,) * 3] for o in noises])
    walk = np.array([noise.gyro_rad_sqrt_s for noise in noises]) ** 2
    view = np.array([noise.view for noise in noises])[:, None, None] ** 2
    # How fast the errors forget, 1/s
    rate = 1.0 / np.array([[*(math.inf,) * 3, o.tilt_s, o.tilt_s, o.heading_s, *(o.deck_s,) * 3] for o in noises])
    x = np.zeros((b, STATES, c))
    P = np.zeros((b, STATES, STATES))
    _diagonal(P)[:] = np.concatenate([np.full((b, 3), _START_RAD**2), wander**2], axis=1)
    R = np.zeros((b, 6, 6))
    R[:, 3:, 3:] = _ATTITUDE_WHITE_RAD**2 * np.eye(3)
    stationary = np.concatenate([np.zeros((b, 3)), wander**2], axis=1)
    walked = np.concatenate([np.repeat(walk[:, None], 3, axis=1), np.zeros((b, STATES - 3))], axis=1)
    rows, log_det, last = np.zeros((b, n, 6, c)), np.zeros(b), float(t[0])
    for i in range(n):
        dt, last = float(t[i]) - last, float(t[i])
        f = np.exp(-dt * rate)
        x *= f[:, :, None]
        P *= f[:, :, None] * f[:, None, :]
        _diagonal(P)[:] += stationary * (1.0 - f * f) + walked * dt
        R[:, :3, :3] = view * cov_view[i]
        part = slice(0 if used[i] else 3, 6)
        PH = P @ _H[part].T
        L = np.linalg.cholesky(_H[part] @ PH + R[:, part, part])
        both = np.linalg.solve(L, np.concatenate([columns[i, part] - _H[part] @ x, np.swapaxes(PH, 1, 2)], axis=2))
        white, K = both[:, :, :c], both[:, :, c:]
        Kt = np.swapaxes(K, 1, 2)
        x += Kt @ white
        P -= Kt @ K
        rows[:, i, part] = white
        log_det += 2.0 * np.log(_diagonal(L)).sum(axis=1)
    return Whitened(rows, log_det)


def _diagonal(matrices: F64) -> F64:
    """Return a view of the diagonals of (B, n, n) contiguous matrices, (B, n)."""
    diagonal: F64 = np.einsum("bii->bi", matrices)
    return diagonal


_LIMITS = {
    "view": (0.2, 50.0),
    "gyro_rad_sqrt_s": (1e-5, 0.3),
    "tilt_rad": (1e-4, 0.3),
    "tilt_s": (0.1, 30.0),
    "heading_rad": (1e-4, 1.0),
    "deck_rad": (1e-5, 0.3),
}
"""The numbers that are searched, with their ranges."""
_FACTORS = (4.0, 1.7, 1.25)


def likeliest(start: Noise, scores: Callable[[Sequence[Noise]], F64]) -> Noise:
    """Return the noise of the lowest score: the best of all steps of one number by a factor, again and again, coarse, then fine.

    Args:
        scores: minus twice the logarithm of the likelihood of each noise.
    """
    best, value = start, float(scores([start])[0])
    for factor in _FACTORS:
        for _ in range(_MOST_STEPS):
            near = _neighbours(best, factor)
            found = scores(near)
            i = int(np.argmin(found))
            if float(found[i]) > value - _WORTH:
                break
            best, value = near[i], float(found[i])
    return best


def _neighbours(of: Noise, factor: float) -> list[Noise]:
    out = []
    for name, (low, high) in _LIMITS.items():
        for by in (factor, 1.0 / factor):
            size = getattr(of, name) * by
            if low <= size <= high:
                out.append(of._replace(**{name: size}))
    return out


class MountFit(Struct, frozen=True, eq=False):
    """Camera mount that a flight yields."""

    values: F64
    """(13,), see `MOUNT` and so on."""
    cov: F64
    """(13, 13)."""
    noise: Noise
    views: int
    left_out: int
    """Number of views that contradict the rest."""

    @property
    def sigma(self) -> F64:
        """Standard deviations, (13,)."""
        return np.sqrt(np.diag(self.cov))


def fit_mount(views: FlightViews) -> MountFit:
    """Return mount and delay with their covariance.

    Each standard deviation is the larger of two: that of the model of the errors, and that of the scores of blocks of four
    seconds, which holds whatever the errors' correlation within a block.
    Source: White, Asymptotic Theory for Econometricians, 1984, section 6 (the covariance of scores).
    """
    prior = _prior(views)
    used = np.ones(views.t.size, bool)
    p, noise = np.zeros(COUNT), Noise()
    for step in range(_STEPS):
        columns, cov_view = _columns(views, p)
        if step in _SEARCHED_AT:
            noise = _searched(views.t, columns, cov_view, used, noise, prior, p)
        white = whiten(views.t, columns, cov_view, used, [noise]).rows[0]
        dp, C = _solved(white, prior, p)
        p = p + dp
        p[DELAY] = min(_DELAY_MAX_S, max(-_DELAY_MAX_S, p[DELAY]))
        if step >= _GATED_FROM:
            used &= np.sqrt((_left(white, dp)[:, :3] ** 2).sum(axis=1)) < _OUTLIER_SIGMAS
        if step > max(_SEARCHED_AT) and float(np.abs(dp[[*range(DELAY + 1), READOUT]]).max()) < _CONVERGED:
            break
    blocks = ((views.t - views.t[0]) / _BLOCK_S).astype(int)
    return MountFit(p, _wider(white, dp, C, blocks), noise, views.t.size, int(np.count_nonzero(~used)))


def _prior(views: FlightViews) -> F64:
    """Return the standard deviations that are assumed before the flight, (13,)."""
    level = max(_LEVEL_LEAST_RAD, views.sigma_tilt_rad)
    readout = _READOUT_FIXED_S if views.by_readout is None else _READOUT_PRIOR_S
    of = (_MOUNT_PRIOR_RAD,) * 3, (_DELAY_PRIOR_S,), (_GYRO_PRIOR_RAD_S,) * 3, (_PAD_PRIOR_RAD,) * 3, (level,) * 2, (readout,)
    return np.concatenate([np.array(part) for part in of])


def _columns(v: FlightViews, p: F64) -> tuple[F64, F64]:
    """Return residuals with their derivatives by the parameters, (N, 6, 14), and the views' covariance in `ned`, (N, 3, 3)."""
    t = v.t + p[DELAY]
    gyro = GyroAttitude(v.t_gyro, v.w_body - p[GYRO], v.R_ned_body[0])
    R, drift = gyro.at(t), gyro.integral_at(t)
    R_ned_cam = R @ (exp(p[MOUNT]) @ v.camera.T_body_cam.R.matrix)
    out = np.zeros((t.size, 6, 1 + COUNT))
    residual, by = out[:, :, 0], out[:, :, 1:]
    R_cam_pad = v.R_cam_pad
    if v.by_readout is not None:
        R_cam_pad = exps(v.by_readout * p[READOUT]) @ R_cam_pad
        by[:, :3, READOUT] = np.einsum("nij,nj->ni", R_ned_cam, v.by_readout)
    residual[:, :3] = logs(R_ned_cam @ R_cam_pad @ (exp(p[PAD]) @ _pad_first(v)).T)
    by[:, :3, MOUNT], by[:, :3, DELAY] = R, gyro.rate_ned(t, _RATE_OVER_S)
    by[:, :3, GYRO], by[:, :3, PAD] = -drift, -np.eye(3)
    reported = interpolated(v.t_attitude, v.R_ned_body, t) @ exp(np.r_[p[LEVEL], 0.0]).T
    residual[:, 3:] = logs(reported @ transposed(R))
    by[:, 3:, GYRO], by[:, 3:, LEVEL] = drift, -R[:, :, :2]
    return out, R_ned_cam @ v.cov @ transposed(R_ned_cam)


def _pad_first(v: FlightViews) -> F64:
    """Return the pad's attitude by the view in the middle of the flight, `R_ned_pad` (3, 3)."""
    i = v.t.size // 2
    R = interpolated(v.t_attitude, v.R_ned_body, v.t[i : i + 1])[0]
    return np.asarray(R @ v.camera.T_body_cam.R.matrix @ v.R_cam_pad[i])


def _left(white: F64, dp: F64) -> F64:
    return np.asarray(white[:, :, 0] + white[:, :, 1:] @ dp)


def _solved(white: F64, prior: F64, p: F64) -> tuple[F64, F64]:
    J, r = white[:, :, 1:].reshape(-1, COUNT), white[:, :, 0].ravel()
    C = np.asarray(np.linalg.inv(J.T @ J + np.diag(prior**-2.0)), dtype=np.float64)
    return -C @ (J.T @ r + p / prior**2), C


def _wider(white: F64, dp: F64, C: F64, blocks: NDArray[np.intp]) -> F64:
    scores = np.einsum("nij,ni->nj", white[:, :, 1:], _left(white, dp))
    starts = np.flatnonzero(np.diff(blocks, prepend=-1))
    summed = np.add.reduceat(scores, starts, axis=0)
    spread = C @ (summed.T @ summed) @ C * (starts.size / max(1.0, starts.size - DELAY - 1.0))
    scale = np.sqrt(np.maximum(1.0, np.diag(spread) / np.diag(C)))
    return np.asarray(scale[:, None] * C * scale)


def _searched(t: F64, columns: F64, cov_view: F64, used: NDArray[np.bool_], start: Noise, prior: F64, p: F64) -> Noise:
    """Return the likeliest noise, the parameters being at their best for each; some views of the flight are enough for it."""
    some = slice(None, None, max(1, math.ceil(t.size / _SEARCH_VIEWS)))

    def scores(noises: Sequence[Noise]) -> F64:
        white = whiten(t[some], columns[some], cov_view[some], used[some], noises)
        out = white.log_det.copy()
        for k, rows in enumerate(white.rows):
            dp, _ = _solved(rows, prior, p)
            out[k] += float((_left(rows, dp) ** 2).sum() + (((p + dp) / prior) ** 2).sum())
        return out

    return likeliest(start, scores)
