"""Stability margins of the law that follows the deck, and the error that it should reach.

One horizontal axis is linear, so the whole loop (vehicle, observer, regulator with the commands under way) is one matrix, made by
asking the law's own functions what they do to each unit vector. The loop is broken where the command leaves the law: gain margin,
phase margin and the delay that it stands beyond the one it knows come from the frequency response there. The error is the
stationary covariance under gusts, a wandering tilt and the filter's errors near the deck.
Source: Astrom & Murray, Feedback Systems, 2nd ed., sec. 10.3 (margins), 12.2 (sensitivity).
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.guidance.law.gains import (
    ObserverNoise,
    TiltWeights,
    chosen,
    law_gains,
    law_in_use,
    law_params,
    observer_gains,
    tilt_gains,
    tilt_model,
)
from companion.settings.guidance import ClimbResponse, TiltResponse
from estimator.contracts.geometry import F64
from estimator.core.library import CORE

PERIOD_S = 0.02
"""The guidance period that the margins are for, s."""
MEDIAN_OF_AXIS = math.sqrt(2.0 * math.log(2.0))
"""Median of a distance whose two axes have standard deviation 1 (Rayleigh)."""
_LATE_M_S2 = 0.6
"""Acceleration that is unknown while the video is late, m/s^2.

The median error of 20 flights of sea_state_4 with video 0.26 s late was 3.2 cm, of 20 with 0.09 s 2.2 cm.
"""
_SIGMA_P_M = 0.01  # standard deviation of the place whose observer gains the margins are computed with
_PHASE_LEAST_DEG = 30.0  # phase margin that gains for an identified response keep
_PEAK_MOST = 2.0  # peak of the sensitivity that they keep
_FEW = 120
"""Number of frequencies that tell them within half a degree and 0.02."""
_AXIS, _MEASURED = ("p", "w", "d", "b", "lean", "rate", "lag"), ("p", "w", "lean", "rate", "a_body")
"""The numbers of an axis of the law before the commands under way, and those that are measured."""
_ANY_CLIMB = ClimbResponse(0.1, 0.1)
"""A horizontal axis knows nothing of it."""


class GaussMarkov(NamedTuple):
    """A Gauss-Markov process."""

    sigma: float
    time_s: float


class AxisDisturbances(NamedTuple):
    """Disturbances of one axis at sea state 4, near the deck (levels of perception `model` and `truth`)."""

    gust_m_s2: GaussMarkov = GaussMarkov(0.21, 2.0)
    """Gusts of 0.6 m/s on a drag of 0.35 1/s."""
    tilt_m_s2: GaussMarkov = GaussMarkov(0.07, 1.0)
    """Error of the reported tilt."""
    place_m: GaussMarkov = GaussMarkov(0.006, 20.0)
    """Errors of the filter's place, speed and levelled acceleration."""
    speed_m_s: GaussMarkov = GaussMarkov(0.012, 1.0)
    accel_m_s2: GaussMarkov = GaussMarkov(0.04, 4.0)
    deck_m_s2: GaussMarkov = GaussMarkov(0.06, 1.2)
    """Unknown acceleration of the deck sideways."""
    sample_m_s2: float = 0.043
    """One sample of the accelerometer."""
    drag_1_s: float = 0.35
    downwash_m_s2: GaussMarkov = GaussMarkov(0.0, 0.15)
    """Turbulence of the own downwash and of the hull's wake over the deck."""


class LoopMargins(NamedTuple):
    """One axis under the law."""

    stable: bool
    gain: tuple[float, float]
    """Factors of the vehicle's answer, down and up, within which the loop stays stable; 0 and inf if there is no such limit."""
    phase_deg: float
    """Phase margin."""
    delay_s: float
    """Further delay, unknown to the law, that the loop stands."""
    sensitivity: float
    """Largest amplification of a disturbance."""
    error_m: float
    """Standard deviation of the place, one axis, in the given surroundings."""
    speed_m_s: float
    command_m_s2: float
    """Standard deviation of the commanded tilt."""


def margins(
    assumed: TiltResponse,
    true: TiltResponse | None = None,
    *,
    weights: TiltWeights | None = None,
    around: AxisDisturbances | None = None,
) -> LoopMargins:
    """Return the loop of one axis.

    Args:
        assumed: the response that the law is made for.
        true: the vehicle's own; None for the same.
        weights: of the law.
        around: what disturbs it.
    """
    loop = _closed(assumed, true or assumed, weights or TiltWeights(), around or AxisDisturbances())
    return LoopMargins(loop.stable, *by_frequency(*_open_loop(loop.vehicle, loop.law)), *loop.errors())


def keeps_margins(assumed: TiltResponse, believed: Sequence[TiltResponse], softer: float) -> bool:
    """Return whether gains for one response keep 30 degrees of phase and a sensitivity of 2 with each of several vehicles.

    Args:
        assumed: the response that the law is made for.
        believed: what the vehicle's own may be.
        softer: factor by which the place weighs less.
    """
    usual, around = TiltWeights(), AxisDisturbances()
    law = _law(assumed, usual._replace(p_m=usual.p_m * softer))
    for vehicle in (_plant(one, around) for one in believed):
        own = vehicle.A + np.outer(vehicle.B, law.D @ vehicle.measured)
        M = np.block([[own, np.outer(vehicle.B, law.C)], [law.B @ vehicle.measured, law.A]])
        _, phase_deg, _, peak = by_frequency(*_open_loop(vehicle, law, _FEW))
        if phase_deg < _PHASE_LEAST_DEG or peak > _PEAK_MOST or float(np.abs(np.linalg.eigvals(M)).max()) >= 1.0:
            return False
    return True


def axis_error_m(assumed: TiltResponse, true: TiltResponse) -> float:
    """Return the standard deviation of the place of one axis near the deck at sea state 4, m; inf if the loop is unstable.

    Args:
        assumed: the response that the law is made for.
        true: the vehicle's own.
    """
    return _closed(assumed, true, TiltWeights(), AxisDisturbances()).errors()[0]


@lru_cache(maxsize=64)
def _own_error_m(response: TiltResponse) -> float:
    return axis_error_m(response, response)


def expected_error_m(response: TiltResponse, late_s: float) -> float:
    """Return the median distance from the centre to expect at a contact at sea state 4, m.

    Args:
        late_s: delay of the video, in which the place is carried on by accelerations that err.
    """
    return MEDIAN_OF_AXIS * math.hypot(_own_error_m(response), 0.5 * _LATE_M_S2 * late_s**2)


class _Plant(NamedTuple):
    """One axis of the vehicle, and what of its state is measured."""

    A: F64
    B: F64
    measured: F64


class _Law(NamedTuple):
    """The law of one axis: observer, regulator and the commands under way."""

    A: F64
    B: F64
    C: F64
    D: F64


def _plant(true: TiltResponse, around: AxisDisturbances) -> _Plant:
    vehicle = tilt_model(true, PERIOD_S)
    A, measured = vehicle.A.copy(), np.zeros((5, len(vehicle.A)))
    A[1, 1] -= PERIOD_S * around.drag_1_s
    measured[[0, 1, 2, 3, 4], [0, 1, 2, 3, 2]] = 1.0
    return _Plant(A, vehicle.B, measured)


def _law(assumed: TiltResponse, weights: TiltWeights) -> _Law:
    gains = tilt_gains(assumed, weights, PERIOD_S)
    seeing = chosen(observer_gains(ObserverNoise(), PERIOD_S), _SIGMA_P_M)
    n, seen = max(1, math.ceil(assumed.delay_s / PERIOD_S - 1e-9)), len(_AXIS)
    params = law_params(assumed, _ANY_CLIMB, PERIOD_S, n, over_ground=False)
    flown = law_in_use(params, law_gains(gains, n, 1, assumed.slowness_s), seeing)

    def step(state: F64, z: F64) -> tuple[F64, float]:
        before = dict(zip(_AXIS, state.tolist(), strict=False)) | {"under_way": state[seen:].tolist()}
        measured = CORE.ffi.new("dl_axis_measured *", dict(zip(_MEASURED, z.tolist(), strict=True)))
        was, after = CORE.ffi.new("dl_law_axis *", before), CORE.ffi.new("dl_law_axis *")
        u = CORE.lib.dl_law_axis_step(flown, PERIOD_S, was, measured, after)
        return np.array([*(getattr(after, name) for name in _AXIS), u, *state[seen:-1]]), u

    own = [step(e, np.zeros(5)) for e in np.eye(seen + n)]
    driven = [step(np.zeros(seen + n), e) for e in np.eye(5)]
    (A, C), (B, D) = ((np.array([c[0] for c in of]).T, np.array([c[1] for c in of])) for of in (own, driven))
    return _Law(A, B, C, D)


class _ClosedLoop(NamedTuple):
    """One axis as one matrix, and the parts of its open loop."""

    M: F64
    Q: F64
    command: F64
    """The row that gives the commanded tilt of the loop's state."""
    sampled_m_s2: float
    """The commanded tilt by one sample of the accelerometer."""
    vehicle: _Plant
    law: _Law

    @property
    def stable(self) -> bool:
        return float(np.abs(np.linalg.eigvals(self.M)).max()) < 1.0

    def errors(self) -> tuple[float, float, float]:
        """Return the standard deviations of place, m, speed, m/s, and commanded tilt, m/s^2; inf if the loop is unstable."""
        if not self.stable:
            return math.inf, math.inf, math.inf
        X = stationary(self.M, self.Q)
        return math.sqrt(X[0, 0]), math.sqrt(X[1, 1]), math.sqrt(self.command @ X @ self.command + self.sampled_m_s2**2)


def _closed(assumed: TiltResponse, true: TiltResponse, weights: TiltWeights, around: AxisDisturbances) -> _ClosedLoop:
    vehicle, law = _plant(true, around), _law(assumed, weights)
    (A, B, measured), (Ac, Bc, Cc, Dc) = vehicle, law
    B, a_plant, own = B[:, None], len(A), len(Ac)

    exo = (
        around.gust_m_s2, around.tilt_m_s2, around.place_m, around.speed_m_s, around.accel_m_s2, around.deck_m_s2,
        around.downwash_m_s2,
    )  # fmt: skip
    e = len(exo)
    by_exo, sensed = np.zeros((a_plant, e)), np.zeros((5, e))
    push = np.array([-1.0, 1.0, 0.0, 0.0, 0.0, 1.0, -1.0])
    by_exo[0], by_exo[1] = 0.5 * PERIOD_S**2 * push, PERIOD_S * push
    sensed[0, 2] = sensed[1, 3] = sensed[4, 4] = sensed[4, 0] = sensed[4, 6] = 1.0
    sensed[4, 1] = -1.0
    keep = np.diag([math.exp(-PERIOD_S / w.time_s) for w in exo])
    M = np.block(
        [
            [A + B @ (Dc @ measured)[None], by_exo + B @ (Dc @ sensed)[None], B @ Cc[None]],
            [np.zeros((e, a_plant)), keep, np.zeros((e, own))],
            [Bc @ measured, Bc @ sensed, Ac],
        ]
    )
    Q = np.zeros_like(M)
    for i, w in enumerate(exo):
        Q[a_plant + i, a_plant + i] = w.sigma**2 * (1.0 - keep[i, i] ** 2)
    white = np.concatenate([vehicle.B * Dc[4], np.zeros(e), Bc[:, 4]])
    Q += around.sample_m_s2**2 * np.outer(white, white)
    command = np.concatenate([Dc @ measured, Dc @ sensed, Cc])
    return _ClosedLoop(M, Q, command, around.sample_m_s2 * Dc[4], vehicle, law)


def stationary(M: F64, Q: F64) -> F64:
    """Return X = M X M' + Q of a stable M: twice as many terms of its sum in each step."""
    X, power = Q, M
    for _ in range(40):
        X, power = X + power @ X @ power.T, power @ power
    return X


def _open_loop(vehicle: _Plant, law: _Law, points: int = 1500) -> tuple[F64, NDArray[np.complex128]]:
    w = np.geomspace(0.05, 0.98 * math.pi / PERIOD_S, points)
    z = np.exp(1j * w * PERIOD_S)[:, None, None]
    plant = vehicle.measured @ np.linalg.solve(z * np.eye(len(vehicle.A)) - vehicle.A, vehicle.B[:, None])
    answer = law.C @ np.linalg.solve(z * np.eye(len(law.A)) - law.A, law.B) + law.D
    return w, -(answer * plant[..., 0]).sum(axis=-1)


def by_frequency(w: F64, L: NDArray[np.complex128]) -> tuple[tuple[float, float], float, float, float]:
    """Return gain margins, phase margin in deg, delay margin in s and the sensitivity of a loop that -L closes.

    Args:
        w: (n,) rad/s, rising; L: (n,) open loop there.
    """
    size, angle = np.abs(L), np.angle(L)
    crossings = np.flatnonzero(np.diff(size > 1.0))
    phase = [float((angle[i] + math.pi) % math.tau) for i in crossings]
    delay = [p / float(w[i]) for p, i in zip(phase, crossings, strict=True)]
    turned = np.flatnonzero(np.diff(angle > 0.0) & (np.abs(angle[:-1]) > 2.0))
    factors = [1.0 / float(size[i]) for i in turned]
    down, up = max([f for f in factors if f < 1.0], default=0.0), min([f for f in factors if f > 1.0], default=math.inf)
    worst = min([min(p, math.tau - p) for p in phase], default=math.pi)
    return (down, up), math.degrees(worst), min(delay, default=math.inf), float(np.max(1.0 / np.abs(1.0 + L)))
