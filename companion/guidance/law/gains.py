"""Gains of the deck-following law, solved once for a vehicle: its tilt as a discrete model, a regulator and an observer.

The regulator's state on one axis is [p, w, a, a', f, u1 .. un]: place and speed of the pad against the body, tilt and its rate
less the tilt that holds the body over the deck (the reference), the rotors' lag, and the commands that have not reached the
vehicle. With the commands under way in the state the regulator is a Smith predictor: it acts on where the vehicle will be when
its command arrives.

The observer of one axis finds what else accelerates the body:
    p' = w,   w' = a_deck - a_lean - d,   d' = noise,   b' = noise
p, w: the pad against the body (the filter's, with errors of their own); a_lean: the reported tilt as an acceleration; d: wind,
drag and the error of the reported tilt; b: the error of the levelled accelerometer. p, w and the acceleration a_lean + d + b are
measured. The accelerometer feels a gust at once; place and speed show it a second later. That the disturbance is the measured
acceleration less the one that was requested is the idea of incremental control; here it passes a Kalman filter.

Sources: Anderson & Moore, Optimal Control: Linear Quadratic Methods, 1990, sec. 2.4; Smith, A controller to overcome dead time,
ISA J. 6(2), 1959; Mirkin & Raskin, Every stabilizing dead-time controller has an observer-predictor-based structure, Automatica
39(10), 2003; Smeur, de Croon & Chu, Gust disturbance alleviation with incremental nonlinear dynamic inversion, IROS 2016,
sec. III.

The native core (estimator/core/law/law.c) has the mathematics of a cycle, and the law's memory; it gets the law as it is flown,
made once, and the numbers of each cycle.
"""

import math
from bisect import bisect_left
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np

from companion.guidance.controller import FieldOfView, Knowledge, Target
from companion.settings.guidance import ClimbResponse, TiltResponse
from estimator.contracts.geometry import F64
from estimator.contracts.motion import BodyMotion
from estimator.core.abi import DL_UNDER_WAY_MAX
from estimator.core.library import CORE
from estimator.ekf import Forecast


def exponential(A: F64) -> F64:
    """Return the matrix exponential by scaling, a Taylor series of order 12 and squaring; A is (n, n)."""
    size = float(np.abs(A).sum(axis=1).max())
    halvings = max(0, math.ceil(math.log2(size / 0.25))) if size > 0.25 else 0
    X = A / 2.0**halvings
    out = term = np.eye(A.shape[0])
    for k in range(1, 13):
        term = term.dot(X) / k
        out = out + term
    for _ in range(halvings):
        out = out.dot(out)
    return np.asarray(out)


@np.errstate(over="ignore", invalid="ignore")
def riccati(A: F64, B: F64, Q: F64, R: F64) -> F64:
    """Return the stabilising solution X of X = A' X A - A' X B (R + B' X B)^-1 B' X A + Q, (n, n).

    Args:
        A: (n, n), B: (n, m), Q: (n, n) positive semidefinite, R: (m, m) positive definite.

    Raises:
        ValueError: it does not converge: the model cannot be stabilised through B.

    Source: Anderson, Second-order convergent algorithms for the steady-state Riccati equation, Int. J. Control 28(2), 1978.
    """
    n = A.shape[0]
    unit = np.eye(n)
    step, G, H = A, B.dot(np.linalg.solve(R, B.T)), Q
    for _ in range(60):
        if not step.any():
            return np.asarray(0.5 * (H + H.T))
        W = unit + G.dot(H)
        forward = np.linalg.solve(W, step)
        G = G + step.dot(np.linalg.solve(W, G)).dot(step.T)
        H, step = H + step.T.dot(H).dot(forward), step.dot(forward)
    raise ValueError("the Riccati equation does not converge: the model cannot be stabilised")


def regulator(A: F64, B: F64, Q: F64, R: F64) -> F64:
    """Return the gain K of u = -K x that minimises the sum of x' Q x + u' R u, (m, n).

    Source: Anderson & Moore, Optimal Control: Linear Quadratic Methods, 1990, sec. 2.4.
    """
    X = riccati(A, B, Q, R)
    return np.asarray(np.linalg.solve(R + B.T.dot(X).dot(B), B.T.dot(X).dot(A)))


def observer(A: F64, C: F64, Q: F64, R: F64) -> F64:
    """Return the steady gain L of the filter x <- x + L (z - C x) after a prediction by A, (n, m).

    Source: Anderson & Moore, Optimal Filtering, 1979, sec. 4.4 (the dual of `regulator`).
    """
    X = riccati(A.T, C.T, Q, R)
    return np.asarray(np.linalg.solve(C.dot(X).dot(C.T) + R, C.dot(X)).T)


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
    m = 5 if tilt.lag_s else 4
    A = np.zeros((m, m))
    A[0, 1], A[1, 2], A[2, 3] = 1.0, -1.0, 1.0
    A[3, 2], A[3, 3] = -w * w, -2.0 * z * w
    b = np.zeros(m)
    if m == 5:
        A[3, 4], A[4, 4], b[4] = w * w, -1.0 / tilt.lag_s, 1.0 / tilt.lag_s
    else:
        b[3] = w * w
    late = tilt.delay_s / period_s
    n = max(1, math.ceil(late - 1e-9))
    part = late - (n - 1)
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


class TiltWeights(NamedTuple):
    """The regulator's weights: amounts of each quantity that cost the same."""

    p_m: float = 0.006
    w_m_s: float = 4.1
    u_m_s2: float = 0.3
    lean_m: float = 0.01
    """Place that a lean of 1 m/s^2 beyond the one that holds counts as, m.

    A vehicle that leans touches with the lower feet, and levels over them away from where it leaned: by 0.01 m where they are
    0.1 m below it. It damps as well.
    """


class TiltGains(NamedTuple):
    """u = reference - (p x p + w x w + a x (a - reference) + ...)."""

    p: float
    w: float
    a: float
    rate: float
    lag: float
    under_way: tuple[float, ...]
    """Gains of the commands under way, newest first."""


@lru_cache(maxsize=256)
def tilt_gains(response: TiltResponse, weights: TiltWeights, period_s: float) -> TiltGains:
    """Return the gains for a vehicle, solved once in a process: a campaign flies the same vehicle again and again.

    Raises:
        ValueError: there are no gains that stabilise such a vehicle.
    """
    model = tilt_model(response, period_s)
    n, m = model.A.shape[0], model.states
    stands, Q = np.zeros(n), np.zeros((n, n))
    stands[0], stands[2] = 1.0, weights.lean_m
    Q[1, 1] = weights.w_m_s**-2
    Q += np.outer(stands, stands) * weights.p_m**-2
    K = regulator(model.A, model.B[:, None], Q, np.array([[weights.u_m_s2**-2]]))[0].tolist()
    lag = K[4] if m == 5 else 0.0
    return TiltGains(K[0], K[1], K[2], K[3], lag, tuple(K[m:]))


SIGMAS_P_M = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16)
"""Standard deviations of the place for which gains are kept, m."""


_UP_TO_M = tuple(1.4 * sigma for sigma in SIGMAS_P_M)
_Kept = TypeVar("_Kept")


class ObserverNoise(NamedTuple):
    """The noise that the observer is solved for."""

    sigma_w_m_s: float = 0.08
    """The filter's speed of the pad against the body. Its errors are 0.01 to 0.02 m/s and last for a second, so a cycle's reading
    counts for less than if they were new every time."""
    sigma_a_m_s2: float = 0.06
    psd_d: float = 2.0
    """Growth of the variance of the disturbance, (m/s^2)^2/s. Gusts of 0.6 m/s that last 2 s on a drag of 0.35 1/s give 0.04;
    with so much more the accelerometer is trusted within some cycles, as far as the stability margins allow."""
    psd_b: float = 0.1
    """Growth of the variance of the accelerometer's error.

    A contradiction to place and speed becomes its error within half a second.
    """
    psd_w: float = 0.01
    """Growth of the variance of the speed: the deck's own acceleration is known that badly."""
    accelerometer: bool = True
    """True if the accelerometer is used."""


class ObserverGains(NamedTuple):
    """Steady gains: rows p, w, d, b; columns place, speed, acceleration."""

    rows: tuple[tuple[float, float, float], ...]


@lru_cache(maxsize=64)
def observer_gains(noise: ObserverNoise, period_s: float) -> tuple[ObserverGains, ...]:
    """Return the steady gains for each of `SIGMAS_P_M`."""
    T = period_s
    A = np.eye(4)
    A[0, 1], A[0, 2], A[1, 2] = T, -0.5 * T * T, -T
    Q = np.diag([1e-8, noise.psd_w * T, noise.psd_d * T, noise.psd_b * T])
    C = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]])
    out = []
    for sigma in SIGMAS_P_M:
        # An error of the filter lasts for some ten cycles: R counts it as if it were new in each.
        R = np.diag([10.0 * sigma**2, 10.0 * noise.sigma_w_m_s**2, noise.sigma_a_m_s2**2 if noise.accelerometer else 1e6])
        L = observer(A, C, Q, R)
        out.append(ObserverGains(tuple((float(a), float(b), float(c)) for a, b, c in L)))
    return tuple(out)


def chosen(table: tuple[_Kept, ...], sigma_p_m: float) -> _Kept:
    """Return what is kept for a standard deviation of the place; the table has one entry for each of `SIGMAS_P_M`."""
    return table[min(bisect_left(_UP_TO_M, sigma_p_m), len(_UP_TO_M) - 1)]


LawParams = Mapping[str, Any]
"""The core's `dl_law_params`, by name."""


def law_params(
    tilt: TiltResponse,
    climb: ClimbResponse,
    period_s: float,
    remembered: int,
    view: FieldOfView | None = None,
    *,
    over_ground: bool,
) -> LawParams:
    """Return what the core's law is made for.

    Args:
        remembered: number of commands under way that are kept.
        view: None for no limit by it.

    Raises:
        ValueError: more commands are under way than the core keeps.
    """
    if remembered > DL_UNDER_WAY_MAX:
        raise ValueError(f"{remembered} commands of {period_s} s are under way, and the law keeps {DL_UNDER_WAY_MAX}")
    seen = view or FieldOfView(0.0, 0.0, 0.0, 0.0)
    return {
        "remembered": remembered, "over_ground": over_ground, "keeps_in_view": view is not None,
        "period_s": period_s, "frequency_rad_s": tilt.frequency_rad_s, "damping": tilt.damping, "lag_s": tilt.lag_s,
        "tilt_max_m_s2": tilt.max_m_s2, "climb_lag_s": climb.lag_s, "climb_max_m_s": climb.max_m_s,
        "view_forward_m": seen.forward_m, "view_right_m": seen.right_m,
        "half_forward_rad": seen.half_forward_rad, "half_right_rad": seen.half_right_rad,
    }  # fmt: skip


def law_gains(gains: TiltGains, tilt_delay: int, climb_delay: int, slowness_s: float) -> Mapping[str, Any]:
    """Return the core's `dl_law_gains`, by name.

    Args:
        tilt_delay, climb_delay: after how many periods a command acts.
        slowness_s: how late a slowly changing tilt is behind its command.
    """
    given = {"n": len(gains.under_way), "tilt_delay": tilt_delay, "climb_delay": climb_delay, "slowness_s": slowness_s}
    return given | gains._asdict()


def law_in_use(
    params: LawParams, gains: Mapping[str, Any], observer: ObserverGains, gains_before: Mapping[str, Any] | None = None
) -> Any:
    """Return the core's `dl_law_in_use`; without `gains_before` no earlier gains are left."""
    values = {"params": params, "gains": gains, "gains_before": gains_before or gains, "observer": {"gains": observer.rows}}
    return CORE.ffi.new("dl_law_in_use *", values)


def law_cycle(knowledge: Knowledge, body: BodyMotion, target: Target | None, dt: float, share: float, *, goes_on: bool) -> Any:
    """Return the core's `dl_law_cycle`; the knowledge has an estimate.

    Args:
        target: None while somebody else commands.
        dt: time since the cycle before, s.
        share: of the gains that are flown by, 0 to 1.
        goes_on: whether that cycle was not too long ago.
    """
    relative, deck, forecast = knowledge.relative, knowledge.deck, knowledge.forecast
    assert relative is not None
    cycle = CORE.ffi.new("dl_law_cycle *")
    cycle.goes_on, cycle.dt, cycle.share, cycle.heading_rad = goes_on, dt, share, body.heading_rad
    cycle.d, cycle.v = relative.d_body_pad_level.tolist(), relative.v_pad_level.tolist()
    cycle.a_body, cycle.w_body, cycle.lean = body.a_level.tolist(), body.w_body.tolist(), body.lean_m_s2
    if relative.yaw_rad is not None:
        cycle.has_yaw, cycle.yaw_rad = 1, relative.yaw_rad
    if forecast is not None:
        cycle.forecast_age_s = (knowledge.at - forecast.at) / 1e9
    if deck is not None:
        cycle.has_deck, cycle.v_deck, cycle.a_deck = 1, deck.v_level.tolist(), deck.a_level.tolist()
    if target is not None:
        _steer(cycle, target)
    return cycle


def _steer(cycle: Any, target: Target) -> None:
    cycle.steers, cycle.wanted = 1, target.d_body_pad_level.tolist()
    cycle.rate_max_m_s, cycle.speed_max_m_s = target.vertical_rate_max_m_s, target.speed_max_m_s
    if target.descent_rate_m_s is not None:
        cycle.has_rate, cycle.rate_m_s = 1, target.descent_rate_m_s
    if target.yaw_rad is not None:
        cycle.has_wanted_yaw, cycle.wanted_yaw_rad = 1, target.yaw_rad
    if target.lean_max_rad is not None:
        cycle.has_lean_max, cycle.lean_max_rad = 1, target.lean_max_rad


@lru_cache(maxsize=4)
def law_course(forecast: Forecast | None) -> Any:
    """Return the core's `dl_law_course` of a forecast, which serves some ten cycles."""
    if forecast is None:
        return CORE.ffi.new("dl_law_course *")
    horizons_s, rates_m_s = forecast.horizons_s.tolist(), forecast.v_pad_level.tolist()
    return CORE.ffi.new("dl_law_course *", {"n": len(horizons_s), "horizons_s": horizons_s, "rates_m_s": rates_m_s})
