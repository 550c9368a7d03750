"""Identification of a vehicle's response from commanded and reported values: delay, tilt frequency, damping, vertical lag.

The model's output is computed from the commanded course alone (output error) and compared with the reported one. Gauss-Newton
steps from the delay of the largest correlation minimise the squared residuals, which are whitened by a first-order
autoregression: the error of a reported attitude lasts for a second. A weak prior keeps parameters that a flight does not
determine near the start of the search, with a large sigma. The covariance is the larger of two in every direction: of the
residuals as they should be, and of the fits that leave out one stretch of one axis each (a jackknife by one step), which also
holds where model or whitening do not fit.
Sources: Ljung, System Identification, 2nd ed., 1999, sec. 4.3 (output error), 7.2 (prediction error), 10.2 (Gauss-Newton);
Bell & McCaffrey, Bias reduction in standard errors for linear regression with multi-stage samples, Survey Methodology 28(2), 2002
(the second covariance).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from companion.settings.guidance import ClimbResponse, Response, TiltResponse, within
from estimator.contracts.geometry import F64

STEP_S = 0.02
"""Step of a course, s."""
_C128 = NDArray[np.complex128]
_DELAY_MAX_S = 0.6  # longest delay that is searched
_PRIOR_DELAY_S = 0.25  # standard deviation of the prior of the delay
_PRIOR_SHAPE = 0.5
"""Standard deviation of the prior of frequency, damping and lag, as a natural logarithm."""
_PRIOR_GAIN = 0.2  # standard deviation of the prior of the gain
_STEPS = 12  # steps of the search at most
_TILT_BLOCK_S = 1.0  # length of a stretch that the jackknife leaves out of a tilt's course (docs/decisions/response.md)
_CLIMB_BLOCK_S = 2.0  # the same of a climb's, whose residuals last longer
_LEAST_S = 4.0
"""A shorter course is no flight to identify from, s."""
_NEAR_S = 0.15
"""A fit whose delay is known better than this is near enough to go on from, s."""
_SETTLED_S = 8.0
"""The response to a command is over after this time, s."""
_SETTLED_WITHIN_S = 0.02
"""A last step of the delay up to this belongs to a search that is at its end, s. On the way there a covariance says nothing."""
_FLOOR_S = 0.004
"""Floor of the delay's standard deviation, s: each command waits a random time for the next datagram."""


class FlightCourse(NamedTuple):
    """Commanded and reported values in steps of `STEP_S`; each column is one axis with the same response."""

    asked: F64
    """(n, axes), held over the step that begins there."""
    reported: F64
    """(n, axes), at the beginning of the step."""
    counts: NDArray[np.bool_]
    """(n,), whether the reported value may be compared: both are known, and the command has been known for a while."""
    stamp_sigma_s: float = 0.0
    """Standard deviation of the reports' time: such an error is an error of the delay."""
    drifts: int = 0
    """Degree of the polynomial that the report may be off by: 0 for an offset, 1 for a drift."""


class Fitted(NamedTuple):
    """A fit. The order of `values` is that of the model: the delay first, then the shape, the gain last."""

    values: F64
    cov: F64
    model: F64
    """(n, axes) output of the fitted model; nan where nothing was compared."""
    offset: F64
    """(n, axes), what the report is off by: its offset or drift."""
    residual: float
    """Standard deviation of reported less modelled."""
    rho: float
    """Coefficient of the residuals' autoregression."""
    seconds: float
    """Length of what was compared."""
    settled: bool = True
    """True if the search had converged: its last step was free in length, and small in the delay."""


class TiltFit(msgspec.Struct, frozen=True):
    """The identified response of the tilt, with standard deviations."""

    response: TiltResponse
    """Fitted response, with `delay_sigma_s` and the other sigmas set."""
    gain: float
    """Reported tilt over commanded tilt."""
    fitted: Fitted

    @property
    def delay_sigma_s(self) -> float:
        """Standard deviation of the delay."""
        return math.sqrt(float(self.fitted.cov[0, 0]))

    @property
    def cov(self) -> F64:
        """Covariance of delay, frequency and damping, (3, 3), in s, rad/s and 1."""
        return _in_units(self.fitted.cov, (1.0, *np.exp(self.fitted.values[1:3]).tolist()))


class ClimbFit(msgspec.Struct, frozen=True):
    """The identified response of the vertical speed, with standard deviations."""

    response: ClimbResponse
    gain: float
    fitted: Fitted

    @property
    def cov(self) -> F64:
        """Covariance of delay and lag, (2, 2) s^2."""
        return _in_units(self.fitted.cov, (1.0, math.exp(self.fitted.values[1])))


def _in_units(cov: F64, per_parameter: tuple[float, ...]) -> F64:
    k, scale = len(per_parameter), np.array(per_parameter)
    return np.asarray(cov[:k, :k] * np.outer(scale, scale))


_Transfer = Callable[[F64, _C128], tuple[_C128, _C128]]
"""Takes parameters and s = j w, (m,); returns the transfer function, (m,), and its derivatives, (parameters, m)."""


def _tilt_transfer(lag_s: float) -> _Transfer:
    def transfer(x: F64, s: _C128) -> tuple[_C128, _C128]:
        w, z = math.exp(x[1]), math.exp(x[2])
        below = s * s + 2.0 * z * w * s + w * w
        H = math.exp(x[3]) * np.exp(-s * x[0]) * (w * w) / (below * (1.0 + s * lag_s))
        d_frequency = H * (2.0 - (2.0 * z * w * s + 2.0 * w * w) / below)
        return H, np.stack([-s * H, d_frequency, -H * (2.0 * z * w) * s / below, H])

    return transfer


def _climb_transfer(x: F64, s: _C128) -> tuple[_C128, _C128]:
    lag = math.exp(x[1])
    H = math.exp(x[2]) * np.exp(-s * x[0]) / (1.0 + s * lag)
    return H, np.stack([-s * H, -H * (s * lag) / (1.0 + s * lag), H])


def fit_tilt(course: FlightCourse, start: TiltResponse, begin: TiltFit | None = None, steps: int = _STEPS) -> TiltFit | None:
    """Return the response of the tilt; None if the course is too short.

    Args:
        course: commanded and reported tilt forward and right, as accelerations, (n, 2) m/s^2.
        start: where the search begins; its lag and its limit are kept, since lag and delay can hardly be distinguished.
        begin: an earlier fit of the same flight to begin from instead; the prior stays that of `start`.
        steps: largest number of steps.
    """
    first = np.array([start.delay_s, math.log(start.frequency_rad_s), math.log(start.damping), 0.0])
    prior_sigma = np.array([_PRIOR_DELAY_S, _PRIOR_SHAPE, _PRIOR_SHAPE, _PRIOR_GAIN])
    begun = None if begin is None else begin.fitted
    found = _fit(course, _tilt_transfer(start.lag_s), first, prior_sigma, _TILT_BLOCK_S, begun, steps)
    if found is None:
        return None
    delay, (w, z, gain) = float(found.values[0]), (math.exp(x) for x in found.values[1:].tolist())
    sigma = np.sqrt(np.diag(found.cov))
    frequency, damping = within(w, z)
    response = TiltResponse(
        delay_s=delay,
        frequency_rad_s=frequency,
        damping=damping,
        lag_s=start.lag_s,
        max_deg=start.max_deg,
        delay_sigma_s=float(sigma[0]),
        frequency_sigma_rad_s=float(w * sigma[1]),
        damping_sigma=float(z * sigma[2]),
    )
    return TiltFit(response, gain, found)


def fit_climb(course: FlightCourse, start: ClimbResponse) -> ClimbFit | None:
    """Return the response of the vertical speed; None if the course is too short.

    Args:
        course: commanded and reported vertical speed, (n, 1) m/s.
        start: where the search begins; its limit is kept.
    """
    first = np.array([start.delay_s, math.log(start.lag_s), 0.0])
    found = _fit(course, _climb_transfer, first, np.array([_PRIOR_DELAY_S, _PRIOR_SHAPE, _PRIOR_GAIN]), _CLIMB_BLOCK_S)
    if found is None:
        return None
    delay, (lag, gain) = float(found.values[0]), (math.exp(x) for x in found.values[1:].tolist())
    sigma = np.sqrt(np.diag(found.cov))
    response = ClimbResponse(
        delay_s=delay,
        lag_s=min(3.0, max(0.02, lag)),
        max_m_s=start.max_m_s,
        delay_sigma_s=float(sigma[0]),
        lag_sigma_s=float(lag * sigma[1]),
    )
    return ClimbFit(response, gain, found)


def _fit(
    course: FlightCourse,
    transfer: _Transfer,
    first: F64,
    prior_sigma: F64,
    block_s: float,
    begin: Fitted | None = None,
    steps: int = _STEPS,
) -> Fitted | None:
    compared = course.counts[1:] & course.counts[:-1]
    if np.count_nonzero(compared) * STEP_S < _LEAST_S:
        return None
    loop, prior = _Loop(course, transfer, compared, block_s), prior_sigma**-2.0
    if begin is None or begin.cov[0, 0] > _NEAR_S**2:
        x, rho = first.copy(), 0.9
        x[0] = loop.best_delay(first)
    else:
        x, rho = begin.values.copy(), begin.rho
    stride = np.array([0.1, *(0.4,) * (first.size - 1)])
    for k in range(steps):
        whitened = loop.whitened(x, rho)
        A = whitened.information + np.diag(prior)
        dx = np.linalg.solve(A, whitened.score + prior * (first - x))
        x = x + np.clip(dx, -stride, stride)
        x[0] = min(_DELAY_MAX_S, max(0.0, x[0]))
        rho = whitened.next_rho
        if k > 1 and float(np.abs(dx).max()) < 1e-3:
            break
    cov = _covariance(whitened, prior)
    settled = bool(np.all(np.abs(dx) < stride)) and abs(float(dx[0])) <= _SETTLED_WITHIN_S
    cov[0, 0] += _FLOOR_S**2 + course.stamp_sigma_s**2
    return Fitted(x, cov, *loop.output(x), rho, float(np.count_nonzero(compared) * STEP_S), settled)


def _covariance(of: _Whitened, prior: F64) -> F64:
    """Return the larger of the two covariances, direction by direction."""
    A, blocks = of.information + np.diag(prior), of.scores.shape[0]
    C = np.linalg.inv(A)
    steps = np.linalg.solve(A - of.informations, of.scores[..., None])[..., 0]
    jackknife = steps.T @ steps * ((blocks - 1) / blocks) + C @ np.diag(prior) @ C
    root = np.linalg.cholesky(C)
    back = np.linalg.inv(root)
    sizes, axes = np.linalg.eigh(back @ jackknife @ back.T)
    return np.asarray(root @ (axes * np.maximum(sizes, 1.0)) @ axes.T @ root.T)


class _Whitened(NamedTuple):
    """The whitened residuals at one set of parameters, summed up."""

    information: F64
    score: F64
    scores: F64
    """(blocks, parameters), what each stretch of each axis adds to the score."""
    informations: F64
    """(blocks, parameters, parameters), and to the information."""
    next_rho: float


class _Loop:
    """A course and a model, as far as they do not change with the parameters."""

    def __init__(self, course: FlightCourse, transfer: _Transfer, compared: NDArray[np.bool_], block_s: float) -> None:
        n = course.asked.shape[0]
        self._size = _good_size(n + round(_SETTLED_S / STEP_S))
        self._transfer, self._compared, self._counts = transfer, compared, course.counts
        self._reported = course.reported
        s = np.asarray(2j * math.pi * np.fft.rfftfreq(self._size, STEP_S), dtype=np.complex128)
        self._s = s
        held = np.ones_like(s)
        held[1:] = (1.0 - np.exp(-s[1:] * STEP_S)) / (s[1:] * STEP_S)
        self._first = course.asked[0]
        # The vehicle rests at the first value, and the command is filtered from there.
        self._U = np.fft.rfft(course.asked - self._first, self._size, axis=0).T * held
        self._powers = (np.arange(n) / n)[:, None] ** np.arange(course.drifts + 1)
        self._block = (np.flatnonzero(compared) * STEP_S / block_s).astype(int)

    def _filtered(self, H: _C128) -> F64:
        """Return the commanded course, filtered; `H` is (k, m), the result (k, axes, n)."""
        out = np.fft.irfft(H[:, None, :] * self._U, self._size, axis=-1)
        return np.asarray(out[..., : self._reported.shape[0]])

    def best_delay(self, x: F64) -> float:
        """Return the delay with which the other parameters fit best, whatever the gain: where the correlation is largest."""
        H, _ = self._transfer(np.array([0.0, *x[1:]]), self._s)
        # The difference whitens well enough to find the delay.
        noted = np.where(self._compared[:, None], np.diff(self._reported, axis=0), 0.0)
        spectrum = np.fft.rfft(noted, self._size, axis=0).T * np.conj(H * self._U * (1.0 - np.exp(-self._s * STEP_S)))
        lags = np.fft.irfft(spectrum, self._size, axis=-1).sum(axis=0)[: round(_DELAY_MAX_S / STEP_S)]
        return float(STEP_S * np.argmax(lags))

    def whitened(self, x: F64, rho: float) -> _Whitened:
        """Return residuals and derivatives whitened by an autoregression with the coefficient `rho`.

        The value at rest is left out: it is a constant, like the offset that is taken from both.
        """
        H, dH = self._transfer(x, self._s)
        out = self._filtered(np.concatenate([H[None], dH]))
        white = (out[..., 1:] - rho * out[..., :-1])[..., self._compared]
        noted = (self._reported[1:] - rho * self._reported[:-1]).T[:, self._compared]
        base, _ = np.linalg.qr((self._powers[1:] - rho * self._powers[:-1])[self._compared])
        e, J = noted - white[0], white[1:]
        e, J = e - (e @ base) @ base.T, J - (J @ base) @ base.T
        var = max(1e-12, float((e * e).mean()))
        flat = J.reshape(J.shape[0], -1)
        each = J * e / var
        k, starts = J.shape[0], np.flatnonzero(np.diff(self._block, prepend=-1))
        scores = np.add.reduceat(each, starts, axis=-1).reshape(k, -1).T
        products = np.add.reduceat(J[:, None] * J[None] / var, starts, axis=-1)
        informations = np.moveaxis(products.reshape(k, k, -1), -1, 0)
        off = (self._reported.T - out[0])[:, self._counts]
        off = off - off.mean(axis=1, keepdims=True)
        near = float((off[:, 1:] * off[:, :-1]).sum() / max(1e-12, float((off * off).sum())))
        return _Whitened(flat @ flat.T / var, flat @ e.ravel() / var, scores, informations, min(0.999, max(0.0, near)))

    def output(self, x: F64) -> tuple[F64, F64, float]:
        """Return the model's course, the report's offset, and the standard deviation of what is left."""
        H, _ = self._transfer(x, self._s)
        model = (self._filtered(H[None])[0] + math.exp(x[-1]) * self._first[:, None]).T
        off = self._reported - model
        best, *_ = np.linalg.lstsq(self._powers[self._counts], off[self._counts], rcond=None)
        offset = self._powers @ best
        model[~self._counts] = math.nan
        return model, offset, float((off - offset)[self._counts].std())


def _good_size(least: int) -> int:
    """Return a length that the Fourier transform is fast for."""
    size = 1 << (least - 1).bit_length()
    return 3 * size // 4 if 3 * size // 4 >= least else size


_PLACES = {"max_deg": 1, "frequency_rad_s": 3, "frequency_sigma_rad_s": 3}


def text(response: Response, source: str, tilt: TiltFit, climb: ClimbFit | None) -> str:
    """Return a response as TOML, with the covariance of what was identified.

    Args:
        source: name of the recording that it was identified from.
        tilt, climb: the fits behind it; None where the given numbers were kept.

    Raises:
        ValueError: a covariance is none, because the flight determines next to nothing.
    """
    climbed = "as given: not identified" if climb is None else f"{climb.fitted.residual:.3f} m/s beside the model"
    tilt_table = _identified(response.tilt, "cov_delay_frequency_damping", tilt.cov)
    climb_table = _table(response.climb) if climb is None else _identified(response.climb, "cov_delay_lag", climb.cov)
    return (
        f"# Identified from {' '.join(source.split())}: {tilt.fitted.seconds:.1f} s of leans, {tilt.fitted.residual:.3f} m/s^2 "
        f"beside the model,\n# {tilt.gain:.2f} of the commanded tilt flown; climb {climbed}. The lag of the tilt and the limits "
        f"are as given.\n\n[tilt]\n{tilt_table}\n[climb]\n{climb_table}"
    )


def _identified(of: TiltResponse | ClimbResponse, key: str, cov: F64) -> str:
    """Return a table whose standard deviations stand in its covariance, and as comments for people."""
    rows = [[float(f"{0.5 * (a + b):.6g}") for a, b in zip(*pair, strict=True)] for pair in zip(cov, cov.T, strict=True)]
    none: dict[str, float | None] = {name: None for name in msgspec.structs.asdict(of) if "sigma" in name}
    known = msgspec.structs.replace(of, **{**none, key: tuple(tuple(row) for row in rows)})
    lines = []
    for name, value in _numbers(known).items():
        sigma = getattr(known, _SIGMAS.get(name, ""), None)
        if "sigma" not in name:
            lines.append(f"{name} = {value!r}" + ("" if sigma is None else f"  # +- {sigma:.2g}"))
    matrix = "".join(f"    {row!r},\n" for row in rows)
    return "\n".join(lines) + f"\n{key} = [\n{matrix}]\n"


_SIGMAS = {
    "delay_s": "delay_sigma_s", "frequency_rad_s": "frequency_sigma_rad_s", "damping": "damping_sigma", "lag_s": "lag_sigma_s",
}  # fmt: skip


def _table(of: ClimbResponse) -> str:
    lines = [f"{name} = {value!r}\n" for name, value in _numbers(of).items()]
    if of.cov_delay_lag is not None:
        lines = [line for line in lines if "sigma" not in line]
        lines.append(f"cov_delay_lag = {[list(row) for row in of.cov_delay_lag]!r}\n")
    return "".join(lines)


def _numbers(of: TiltResponse | ClimbResponse) -> dict[str, float]:
    given = {name: value for name, value in msgspec.structs.asdict(of).items() if isinstance(value, float | int)}
    return {name: round(float(value), _PLACES.get(name, 4)) for name, value in given.items()}
