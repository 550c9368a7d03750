"""How a vehicle answers commands: delay and course of its tilt, delay and lag of its climb, and its limits.

A tilt command acts after `delay_s` through a lag (rotors) on a damped oscillator (the attitude loop):
    lag f' = u - f,   a'' = frequency^2 (f - a) - 2 damping frequency a'
with u, f, a as accelerations g tan(tilt). A commanded vertical speed acts after its own delay through a first-order lag.
"""

import math
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec.structs import force_setattr

from companion.guidance.response_cov import checked
from companion.guidance.riccati import exponential
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.contracts.keys import check_ranges, number
from estimator.contracts.motion import G_M_S2

Row2 = tuple[float, float]
Row3 = tuple[float, float, float]


class TiltResponse(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How roll and pitch follow their commands.

    Raises:
        ValueError: a number outside its range.
    """

    delay_s: Annotated[float, number("delay from guidance's command to its first effect", "s", 0.0, 0.6)]
    frequency_rad_s: Annotated[float, number("natural frequency of the attitude loop", "rad/s", 1.0, 60.0)]
    damping: Annotated[float, number("its damping ratio", "1", 0.2, 3.0)]
    lag_s: Annotated[float, number("first-order lag before it: rotors", "s", 0.0, 0.5)] = 0.0
    max_deg: Annotated[float, number("largest tilt that a controller may ask for", "deg", 2.0, 45.0)] = 20.0
    delay_sigma_s: Annotated[float, number("standard deviation of delay_s; left out if it is assumed", "s", 0.0, 0.6)] | None = (
        None
    )
    frequency_sigma_rad_s: Annotated[float, number("standard deviation of frequency_rad_s", "rad/s", 0.0, 60.0)] | None = None
    damping_sigma: Annotated[float, number("standard deviation of damping", "1", 0.0, 3.0)] | None = None
    cov_delay_frequency_damping: tuple[Row3, Row3, Row3] | None = None
    """Their covariance, in s, rad/s and 1; it gives the standard deviations that are left out."""

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.cov_delay_frequency_damping is not None:
            keys = ("delay_sigma_s", "frequency_sigma_rad_s", "damping_sigma")
            _take_sigmas(self, "cov_delay_frequency_damping", keys, (0.6, 60.0, 3.0))

    @property
    def max_m_s2(self) -> float:
        """The largest tilt as an acceleration."""
        return G_M_S2 * math.tan(math.radians(self.max_deg))

    @property
    def slowness_s(self) -> float:
        """How late a slowly changing tilt is behind its command: delay, lag and course together."""
        return self.delay_s + self.lag_s + 2.0 * self.damping / self.frequency_rad_s


class ClimbResponse(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How the vertical speed follows its command.

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
        check_ranges(self)
        if self.cov_delay_lag is not None:
            _take_sigmas(self, "cov_delay_lag", ("delay_sigma_s", "lag_sigma_s"), (0.6, 3.0))


def _take_sigmas(of: TiltResponse | ClimbResponse, key: str, names: tuple[str, ...], largest: tuple[float, ...]) -> None:
    for name, sigma in zip(names, checked(key, getattr(of, key), {n: getattr(of, n) for n in names}, largest), strict=True):
        if getattr(of, name) is None:
            force_setattr(of, name, sigma)


class Response(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How one kind of vehicle answers commands."""

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


class TiltModel(msgspec.Struct, frozen=True):
    """The tilt's course in steps of one guidance period, with the pad's place and speed against the body.

    x = [p, p', a, a', f, u(k-1) .. u(k-n)], x(k+1) = A x(k) + B u(k); without a lag f is left out.
    """

    A: F64
    B: F64
    delays: int
    """Number of commands under way, n."""
    states: int
    """Number of states before them: 4 or 5."""


def tilt_model(tilt: TiltResponse, period_s: float) -> TiltModel:
    """Return the exact discrete model of a response whose commands are held for a period each; the delay may be any.

    Source: Astrom & Wittenmark, Computer-Controlled Systems, 3rd ed., sec. 3.2 (delay that is no multiple of the period).
    """
    w, z = tilt.frequency_rad_s, tilt.damping
    m = 5 if tilt.lag_s > 1e-4 else 4
    A = np.zeros((m, m))
    A[0, 1], A[1, 2], A[2, 3] = 1.0, -1.0, 1.0
    A[3, 2], A[3, 3] = -w * w, -2.0 * z * w
    b = np.zeros(m)
    if m == 5:
        A[3, 4], A[4, 4], b[4] = w * w, -1.0 / tilt.lag_s, 1.0 / tilt.lag_s
    else:
        b[3] = w * w
    n = max(1, math.ceil(tilt.delay_s / period_s - 1e-9))
    part = tilt.delay_s / period_s - (n - 1)
    whole, _ = _held(A, b, period_s)
    after, b_new = _held(A, b, (1.0 - part) * period_s)
    b_old = after.dot(_held(A, b, part * period_s)[1])
    size = m + n
    out, drive = np.zeros((size, size)), np.zeros(size)
    out[:m, :m] = whole
    out[:m, m + n - 1] += b_old
    if n == 1:
        drive[:m] = b_new
    else:
        out[:m, m + n - 2] += b_new
    drive[m] = 1.0
    for k in range(1, n):
        out[m + k, m + k - 1] = 1.0
    return TiltModel(out, drive, n, m)


def _held(A: F64, b: F64, dt: float) -> tuple[F64, F64]:
    """Return the transition over `dt` and the effect of an input that is held for it."""
    m = b.size
    block = np.zeros((m + 1, m + 1))
    block[:m, :m], block[:m, m] = A * dt, b * dt
    e = exponential(block)
    return e[:m, :m], e[:m, m]
