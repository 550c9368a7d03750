"""Response of a vehicle to commands: delay and course of its tilt, delay and lag of its climb, and its limits.

A tilt command acts after `delay_s` through a lag (rotors) on a damped oscillator (the attitude loop):
    lag f' = u - f,   a'' = frequency^2 (f - a) - 2 damping frequency a'
with u, f, a as accelerations g tan(tilt). A commanded vertical speed acts after its own delay through a first-order lag.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec.structs import force_setattr

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.contracts.keys import CheckedOptions, number
from estimator.contracts.motion import G_M_S2

_AGREE = 0.02
"""A standard deviation may differ from the covariance's by this much of itself: files round."""
_SYMMETRIC = 1e-3
_LEAST_SIZE = 1e-6
"""Least eigenvalue of the correlation matrix."""
_CURE = "write it as `decklander calibrate vehicle --out` does, or leave it out"
Row2 = tuple[float, float]
Row3 = tuple[float, float, float]


_FREQUENCY_RAD_S, _DAMPING = (1.0, 60.0), (0.2, 3.0)


def within(frequency_rad_s: float, damping: float) -> Row2:
    """Return frequency and damping of a tilt, moved into the limits of a response."""
    (slowest, fastest), (least, most) = _FREQUENCY_RAD_S, _DAMPING
    return min(fastest, max(slowest, frequency_rad_s)), min(most, max(least, damping))


class TiltResponse(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Response of roll and pitch to their commands.

    Raises:
        ValueError: a number outside its range.
    """

    delay_s: Annotated[float, number("delay from guidance's command to its first effect", "s", 0.0, 0.6)]
    frequency_rad_s: Annotated[float, number("natural frequency of the attitude loop", "rad/s", *_FREQUENCY_RAD_S)]
    damping: Annotated[float, number("its damping ratio", "1", *_DAMPING)]
    lag_s: Annotated[float, number("first-order lag before it: rotors", "s", 0.0, 0.5)] = 0.0
    max_deg: Annotated[float, number("largest tilt that a controller may ask for", "deg", 2.0, 45.0)] = 20.0
    jerk_max_m_s3: (
        Annotated[
            float,
            number(
                "largest rate of change of the tilt, as an acceleration, that the vehicle follows; left out if it has no limit",
                "m/s^3",
                0.5,
                1000.0,
            ),
        ]
        | None
    ) = None
    drag_1_s: Annotated[
        float, number("deceleration by the air for each m/s through it; it turns a lean into a wind speed", "1/s", 0.02, 3.0)
    ] = 0.35
    delay_sigma_s: Annotated[float, number("standard deviation of delay_s; left out if it is assumed", "s", 0.0, 0.6)] | None = (
        None
    )
    frequency_sigma_rad_s: Annotated[float, number("standard deviation of frequency_rad_s", "rad/s", 0.0, 60.0)] | None = None
    damping_sigma: Annotated[float, number("standard deviation of damping", "1", 0.0, 3.0)] | None = None
    cov_delay_frequency_damping: tuple[Row3, Row3, Row3] | None = None
    """Their covariance, in s, rad/s and 1; it gives the standard deviations that are left out."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cov_delay_frequency_damping is not None:
            keys = ("delay_sigma_s", "frequency_sigma_rad_s", "damping_sigma")
            _take_sigmas(self, "cov_delay_frequency_damping", keys, (0.6, 60.0, 3.0))

    @property
    def max_m_s2(self) -> float:
        """The largest tilt as an acceleration."""
        return G_M_S2 * math.tan(math.radians(self.max_deg))

    @property
    def slowness_s(self) -> float:
        """Lag of a slowly changing tilt behind its command: delay, lag and course together."""
        return self.delay_s + self.lag_s + 2.0 * self.damping / self.frequency_rad_s


class ClimbResponse(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Response of the vertical speed to its command.

    Raises:
        ValueError: a number outside its range.
    """

    delay_s: Annotated[float, number("delay from guidance's command to its first effect", "s", 0.0, 0.6)]
    lag_s: Annotated[float, number("time constant with which the speed follows", "s", 0.02, 3.0)]
    max_m_s: Annotated[float, number("largest vertical speed that a controller may ask for", "m/s", 0.1, 5.0)] = 1.0
    delay_sigma_s: Annotated[float, number("standard deviation of delay_s; left out if it is assumed", "s", 0.0, 0.6)] | None = (
        None
    )
    lag_sigma_s: Annotated[float, number("standard deviation of lag_s", "s", 0.0, 3.0)] | None = None
    cov_delay_lag: tuple[Row2, Row2] | None = None
    """Covariance of delay_s and lag_s, s^2; it gives the standard deviations that are left out."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cov_delay_lag is not None:
            _take_sigmas(self, "cov_delay_lag", ("delay_sigma_s", "lag_sigma_s"), (0.6, 3.0))


def _take_sigmas(of: TiltResponse | ClimbResponse, key: str, names: tuple[str, ...], largest: tuple[float, ...]) -> None:
    for name, sigma in zip(names, _checked(key, getattr(of, key), {n: getattr(of, n) for n in names}, largest), strict=True):
        if getattr(of, name) is None:
            force_setattr(of, name, sigma)


class Response(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Response of one kind of vehicle to commands."""

    tilt: TiltResponse
    climb: ClimbResponse


def response_from_mapping(table: dict[str, Any], where: str) -> Response:
    """Return the response that the content of a file describes; `where` begins the error.

    Raises:
        BadInput: a key is missing, unknown, of the wrong type or out of range.
    """
    try:
        return msgspec.convert(table, Response)
    except (msgspec.ValidationError, ValueError) as why:
        raise BadInput(f"{where}: {why}") from why


def _checked(key: str, rows: Sequence[Sequence[float]], given: dict[str, float | None], largest: Sequence[float]) -> list[float]:
    """Return the standard deviations of a covariance, in the order of its rows.

    Args:
        key: the covariance's key in its table.
        rows: the covariance, square.
        given: standard deviations by their keys, in the order of the rows; None where the file gives none.
        largest: largest standard deviation of each.

    Raises:
        ValueError: it is no covariance, or contradicts a given standard deviation.
    """
    cov = np.array(rows, dtype=float)
    _check_numbers(key, cov)
    for k, (variance, most) in enumerate(zip(np.diagonal(cov).tolist(), largest, strict=True)):
        if not 0.0 < variance <= most * most:
            raise ValueError(
                f"{key}: the variance in row {k + 1} must be above 0 and at most {most * most:g}, got {variance:g}; {_CURE}"
            )
    sigma = np.sqrt(np.diagonal(cov))
    _check_correlation(key, cov, cov / np.outer(sigma, sigma))
    for k, (name, value) in enumerate(given.items()):
        if value is not None and abs(value - sigma[k]) > _AGREE * sigma[k]:
            raise ValueError(
                f"{name} is {value:g}, but {key} says {sigma[k]:.4g}, the root of {cov[k, k]:g} in row {k + 1}; leave one out"
            )
    return [float(one) for one in sigma]


def _check_numbers(key: str, cov: F64) -> None:
    for (row, column), value in np.ndenumerate(cov):
        if not math.isfinite(value):
            raise ValueError(f"{key}: row {row + 1}, column {column + 1} must be a finite number, got {value:g}; {_CURE}")


def _check_correlation(key: str, cov: F64, correlation: F64) -> None:
    row, column = (int(i) for i in np.unravel_index(np.abs(correlation - correlation.T).argmax(), cov.shape))
    if abs(correlation[row, column] - correlation[column, row]) > _SYMMETRIC:
        raise ValueError(
            f"{key} must be symmetric: row {row + 1}, column {column + 1} is {cov[row, column]:g} and row {column + 1}, column "
            f"{row + 1} is {cov[column, row]:g}; {_CURE}"
        )
    if float(np.linalg.eigvalsh(0.5 * (correlation + correlation.T)).min()) < _LEAST_SIZE:
        raise ValueError(
            f"{key} must be positive definite: its correlations contradict each other or reach 1, so that a sum of its values "
            f"would have a variance of 0 or less; {_CURE}"
        )
