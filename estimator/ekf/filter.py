"""The filter's public functions: start, step, at, motion_at, forecast, moving."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, RelativeState
from estimator.contracts.fusion import FusionResult
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import Imu
from estimator.contracts.time import MonoNs
from estimator.ekf import answers, gate, measure, motion, so3
from estimator.ekf import forecast as forecasting
from estimator.ekf.forecast import Forecast
from estimator.ekf.history import History, put
from estimator.ekf.options import EkfOptions
from estimator.ekf.outcome import Outcome
from estimator.ekf.packed_belief import STATE_ALONE, WITH_COVARIANCE
from estimator.ekf.packed_event import Event
from estimator.ekf.propagate import FilterParams, result
from estimator.ekf.state import (
    ACCEL_BIAS,
    ATT_ERR,
    BARO_OFFSET,
    CAMERA_DELAY,
    CAMERA_MOUNT,
    GYRO_BIAS,
    PAD_YAW,
    POS_REL,
    RANGE_OFFSET,
    TURN_RATE,
    VEL,
    VEL_SCALE,
    VELOCITY,
    VESSEL_VEL,
    Belief,
    N,
)
from estimator.integrity import IntegrityOptions, sensors
from estimator.integrity.sensors import SensorWatch

_LIMITS = IntegrityOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Ekf:
    """The whole state of the filter. It is immutable: `step` returns the next one and leaves this one as it was."""

    options: EkfOptions
    params: FilterParams
    history: History
    limits: IntegrityOptions | None = None
    """The limits that an IMU sample must keep; None if `estimator.integrity` checks the samples before the filter."""
    imu: SensorWatch = field(default_factory=SensorWatch)
    """The recent IMU samples, from which frozen ones are recognised."""

    @property
    def belief(self) -> Belief | None:
        """The newest belief, or None before the first attitude."""
        return self.history.newest()


def start(options: EkfOptions | None = None, limits: IntegrityOptions | None = _LIMITS) -> Ekf:
    """Return a filter that has received nothing yet.

    Args:
        options: the filter's options, by default `EkfOptions()`.
        limits: the limits that an IMU sample must keep: every other sensor has a gate, the IMU has none. Pass None if
            `estimator.integrity.admit` has already checked every sample, as in `estimator.pipeline`.
    """
    o = options or EkfOptions()
    return Ekf(o, FilterParams(o, motion.ProcessNoise(o)), History(), limits)


def step(ekf: Ekf, event: Event) -> tuple[Ekf, list[FusionResult]]:
    """Process one sample or sighting, as `step_all` does."""
    return step_all(ekf, (event,))


def step_all(ekf: Ekf, events: Sequence[Event]) -> tuple[Ekf, list[FusionResult]]:
    """Process samples and sightings in the order in which they were received; they may be out of sequence.

    Returns:
        The next filter, and the result of each event. Its verdict is FUSED; GATED (implausible, or nothing to compare it with
        yet); IMPOSSIBLE (an IMU sample beyond the limits); FROZEN (an IMU sample that has repeated itself for too long); TOO_OLD
        (before the history); TOO_NEW (measured after every time of reception so far); SINGULAR; or NO_ATTITUDE (no sample has
        shown which way is down yet). A measurement that was compared with a prediction has its innovation, the innovation's
        covariance, NIS and test ratio, whatever the verdict.

    Raises:
        TypeError: an event is not a measurement (a frame, for example).
    """
    history, imu, results = ekf.history, ekf.imu, []
    for event in events:
        refusal = None
        if ekf.limits is not None and isinstance(event, Imu):
            imu, refusal = sensors.watch(imu, event, ekf.limits, flying=True)
        if refusal is None:
            history, outcome = put(history, event, ekf.params)
        else:
            outcome = result(event, Outcome(refusal))
        results.append(outcome)
    return Ekf(ekf.options, ekf.params, history, ekf.limits, imu), results


class Settled(NamedTuple):
    """The belief propagated to an instant, with the covariance of at most `EkfOptions.tick_s` before."""

    b: Belief
    """Everything but `P` holds at the instant."""
    F: F64
    Q: F64
    """(N, N): with F they propagate `P` to the instant."""
    x: F64
    """(N,) state with the deck moved from the camera's time to the body's, as `measure.aligned` gives it."""
    T: F64
    """(N, N) Jacobian of `x`."""


@lru_cache(maxsize=4)  # the estimate and the motion at one instant begin alike; the answer is read-only
def _settled(ekf: Ekf, now: MonoNs) -> Settled | None:
    """Return the belief at an instant, propagated from the last event before it; None before the first attitude."""
    before = ekf.history.before(now)
    if before is None:
        return None
    noise = ekf.params.process_noise
    b, F, Q = before.propagated(now, noise, STATE_ALONE).settled(noise)
    return Settled(b, F, Q, *measure.aligned(b))


def forget_answers() -> None:
    """Drop the cached answers. They keep the filters alive that they were asked of, with all their history."""
    _settled.cache_clear()
    at.cache_clear()


def _tracked(b: Belief, now: MonoNs, o: EkfOptions) -> bool:
    return b.sighted >= 0 and (now - b.sighted) * 1e-9 <= o.forget_s


@lru_cache(maxsize=4)  # guidance, recorder and links each ask for the same instant; the answer is read-only
def at(ekf: Ekf, now: MonoNs) -> RelativeState | None:
    """Return the estimate of the pad at an instant, propagated from the last event before it, or None if no pad is tracked."""
    settled = _settled(ekf, now)
    if settled is None or not _tracked(settled.b, now, ekf.options):
        return None
    b, F, Q, x, T = settled
    psi = so3.heading(b.R)
    Z = so3.about_down(-psi)
    d, v = Z.dot(x[POS_REL]), Z.dot(measure.v_pad_ned(x) - x[VEL])
    turning = so3.heading_row(b.R).dot(b.R)
    J = np.zeros((7, N))
    J[:3, POS_REL] = Z
    J[:3, ATT_ERR] = np.outer([d[1], -d[0], 0.0], turning)
    J[3:6] = Z.dot(measure.by_v_pad_ned(x))
    J[3:6, VEL] = -Z
    J[3:6, ATT_ERR] = np.outer([v[1], -v[0], 0.0], turning)
    J[6, ATT_ERR] = turning
    J[6, PAD_YAW] = -1.0
    # Only seven components are returned, so only their covariance is propagated, not that of the whole state.
    J = J.dot(T)
    cov = J.dot(Q).dot(J.T)
    J = J.dot(F)
    cov += J.dot(b.P).dot(J.T)
    yaw: float | None = wrap_pi(psi - float(x[PAD_YAW]))
    if not b.heading_known:
        yaw = None
        cov[6, :] = cov[:, 6] = 0.0
        cov[6, 6] = UNKNOWN_YAW_VAR
    return RelativeState(
        at=now,
        path="ekf",
        d_body_pad_level=d,
        v_pad_level=v,
        yaw_rad=yaw,
        cov=0.5 * (cov + cov.T),
        sighted=MonoNs(b.sighted),
        consistent=gate.consistent(b.nis_mean) and b.agreed >= 3 and _confirmed(b, now, cov, ekf.options),
        details=_details(b),
    )


def _confirmed(b: Belief, now: MonoNs, cov: F64, o: EkfOptions) -> bool:
    """Return whether a recent aiding measurement confirms the estimate and its position is certain enough to use.

    Either a sighting or a fused velocity confirms it: both bound the drift of the position.
    """
    newest = max(b.sighted, b.aids[VELOCITY].fused)
    return (now - newest) * 1e-9 <= o.confirm_s and float(cov.diagonal()[:3].max()) <= o.consistent_sigma_m**2


def motion_at(ekf: Ekf, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
    """Return the motion of body and deck at an instant; each is None while it is not known.

    The state is propagated to the instant; the covariance is the one of at most `EkfOptions.tick_s` before.
    """
    settled = _settled(ekf, now)
    if settled is None:
        return None, None
    b, _, _, x, T = settled
    body = answers.body_motion(b, now, ekf.options)
    if not _tracked(b, now, ekf.options):
        return body, None
    return body, answers.deck_motion(b.changed(x=x, P=T.dot(b.P).dot(T.T)), now)


def forecast(ekf: Ekf, now: MonoNs, horizons_s: Sequence[float] | F64) -> Forecast | None:
    """Return the forecast of the deck at `now` plus each of the horizons, or None if no pad is tracked.

    Args:
        ekf: the filter.
        now: the instant from which the horizons count.
        horizons_s: (H,) s, each 0 or more.

    Raises:
        ValueError: a horizon that is negative or not finite.
    """
    h = np.asarray(horizons_s, dtype=float).reshape(-1)
    if not (np.all(np.isfinite(h)) and np.all(h >= 0.0)):
        raise ValueError(f"horizons must be seconds of 0 or more, got {horizons_s!r}")
    before = ekf.history.before(now)
    if before is None or not _tracked(before.belief, now, ekf.options):
        return None
    b = before.propagated(now, ekf.params.process_noise, WITH_COVARIANCE).belief
    x, T = measure.aligned(b)
    b = b._replace(x=x, P=T.dot(b.P).dot(T.T))
    return forecasting.forecast(b, now, h, ekf.options)


def moving(ekf: Ekf) -> float | None:
    """Return the probability, 0..1, that the vessel moves (under way or on waves), or None before the first sighting."""
    b = ekf.belief
    if b is None or b.sighted < 0:
        return None
    return forecasting.probability_of_motion(b)


_AXES = "xyz"
_CHANNELS = ("north", "east", "down", "roll", "pitch")
_NAMES = (
    "nis_mean", "probability_moving", "velocity_scale", "camera_delay_s", "baro_offset_m", "range_offset_m",
    "v_vessel_north_m_s", "v_vessel_east_m_s", "turn_rate_rad_s", "sigma_velocity_scale", "sigma_camera_delay_s",
    *(f"sigma_mount_{k}_rad" for k in _AXES), *(f"mount_{k}_rad" for k in _AXES),
    *(f"gyro_bias_{k}_rad_s" for k in _AXES), *(f"accel_bias_{k}_m_s2" for k in _AXES),
    *(f"period_{k}_s" for k in _CHANNELS), *(f"damping_{k}" for k in _CHANNELS), *(f"swing_{k}" for k in _CHANNELS),
)  # fmt: skip
_PLAIN = np.r_[VEL_SCALE, CAMERA_DELAY, BARO_OFFSET, RANGE_OFFSET, VESSEL_VEL, TURN_RATE]
_SURE = np.r_[VEL_SCALE, CAMERA_DELAY, CAMERA_MOUNT]


def _details(b: Belief) -> tuple[tuple[str, float], ...]:
    x, sea = b.x, b.sea
    values = [b.nis_mean, forecasting.probability_of_motion(b), *x[_PLAIN].tolist()]
    values += np.sqrt(np.maximum(b.P[_SURE, _SURE], 0.0)).tolist()
    values += [*x[CAMERA_MOUNT].tolist(), *x[GYRO_BIAS].tolist(), *x[ACCEL_BIAS].tolist()]
    values += [*(math.tau / sea.w_rad_s).tolist(), *sea.zeta.tolist(), *sea.sigma.tolist()]
    return tuple(zip(_NAMES, values, strict=True))
