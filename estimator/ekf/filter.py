"""The filter's public functions: start, step, at, motion_at, forecast, moving.

An answer at one instant is read as the native core wrote it (estimator/core/filter/answer.c).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Details, RelativeState
from estimator.contracts.fusion import FusionResult
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import Imu
from estimator.contracts.time import MonoNs
from estimator.core.library import CORE
from estimator.ekf import forecast as forecasting
from estimator.ekf import gate
from estimator.ekf.deck_motion_bank import log_evidence_of_rest
from estimator.ekf.forecast import Forecast, probability_of_motion
from estimator.ekf.history import History, put_all
from estimator.ekf.options import EkfOptions
from estimator.ekf.outcome import Outcome, result
from estimator.ekf.packed_belief import PackedBelief
from estimator.ekf.packed_event import Event
from estimator.ekf.params import FilterParams
from estimator.ekf.state import (
    ACCEL_BIAS,
    BARO_OFFSET,
    CAMERA_DELAY,
    CAMERA_MOUNT,
    GYRO_BIAS,
    RANGE_OFFSET,
    TURN_RATE,
    VEL_SCALE,
    VESSEL_VEL,
    Belief,
)
from estimator.integrity import IntegrityOptions, sensors
from estimator.integrity.sensors import SensorWatch


class FilterAnswer:
    """The pad, the body's motion and the deck's motion at one instant; each is put together when it is first requested.

    Attributes:
        before: the last belief before the instant.
        params: the parameters by which it was propagated.
    """

    def __init__(self, before: PackedBelief, now: MonoNs, params: FilterParams) -> None:
        self.before, self.params = before, params
        self._now, self._options, self._evidence_of_rest = now, params.options, before.sea.log_evidence_of_rest
        made, pointer = CORE.room("dl_answer", 1)
        CORE.lib.dl_filter_answer(params.core, now, before.whole, pointer)
        self._answer = made[0, ...]
        self._answer.setflags(write=False)

    @cached_property
    def pad(self) -> RelativeState | None:
        """The estimate of the pad; None if no pad is tracked."""
        if not self._number("has_pad"):
            return None
        cov = self._matrix("cov", 7)
        yaw: float | None = wrap_pi(self._number("yaw"))
        if not self._number("heading_known"):
            yaw = None
            cov = cov.copy()
            cov[6, :] = cov[:, 6] = 0.0
            cov[6, 6] = UNKNOWN_YAW_VAR
        fits = gate.consistent(self._number("nis_mean")) and self._number("agreed") >= 3
        return RelativeState(
            at=self._now,
            path="ekf",
            d_body_pad_level=self._vector("d"),
            v_pad_level=self._vector("v"),
            yaw_rad=yaw,
            cov=cov,
            sighted=MonoNs(self._number("sighted")),
            consistent=fits and self._confirmed(cov, self._options),
            adrift=bool(self._number("adrift")),
            steers=bool(self._number("steers")),
            details=Details(_figures(self._answer, self._evidence_of_rest)),
        )

    @cached_property
    def body(self) -> BodyMotion | None:
        """The body's motion by the newest IMU sample; None while there is none or no attitude was reported."""
        if not self._number("has_body"):
            return None
        return BodyMotion(
            self._now,
            self._number("heading"),
            self._vector("a_body"),
            self._matrix("cov_a_body", 3),
            self._vector("w_body"),
            Rotation(self._matrix("levelled_by", 3)),
            self._matrix("cov_levelled_by", 3),
        )

    @cached_property
    def deck(self) -> DeckMotion | None:
        """The deck's motion by the oscillators of the main state (docs/estimator.md, section "Waves"); None without a pad.

        The covariance is the one of at most `EkfOptions.tick_s` before.
        """
        if not self._number("has_pad"):
            return None
        roll, pitch, roll_rate, pitch_rate = self._vector("tilt").tolist()
        return DeckMotion(
            self._now,
            self._vector("v_deck"),
            self._vector("a_deck"),
            self._matrix("cov_deck", 6),
            roll,
            pitch,
            roll_rate,
            pitch_rate,
            self._matrix("cov_tilt", 4),
        )

    def _confirmed(self, cov: F64, o: EkfOptions) -> bool:
        """Return whether a recent aiding measurement confirms the estimate and its position is certain enough to use.

        Either a sighting or a fused velocity confirms it: both bound the drift of the position.
        """
        newest = max(self._number("sighted"), self._number("velocity_fused"))
        var_max = float(max(cov.diagonal()[:3].tolist()))
        return (self._now - newest) * 1e-9 <= o.confirm_s and var_max <= o.consistent_sigma_m**2

    def _number(self, name: str) -> Any:
        return self._answer[name].item()

    def _vector(self, name: str) -> F64:
        return self._answer[name]

    def _matrix(self, name: str, n: int) -> F64:
        return self._answer[name].reshape(n, n)


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


def _figures(answer: NDArray[Any], evidence_of_rest: float) -> Callable[[], tuple[tuple[str, float], ...]]:
    """Return what puts the figures for the records together."""

    def figures() -> tuple[tuple[str, float], ...]:
        x, var = answer["x"], answer["var"]
        (nn, ee), ne = var[VESSEL_VEL].tolist(), answer["cov_vessel"].item()
        moving = probability_of_motion(evidence_of_rest, x[VESSEL_VEL].tolist(), (nn, ne, ee))
        values = [answer["nis_mean"].item(), moving, *x[_PLAIN].tolist()]
        values += np.sqrt(np.maximum(var[_SURE], 0.0)).tolist()
        values += [*x[CAMERA_MOUNT].tolist(), *x[GYRO_BIAS].tolist(), *x[ACCEL_BIAS].tolist()]
        values += [*(math.tau / answer["wave_w"]).tolist(), *answer["wave_zeta"].tolist(), *answer["wave_sigma"].tolist()]
        return tuple(zip(_NAMES, values, strict=True))

    return figures


_LIMITS = IntegrityOptions()
_ANSWERS_KEPT = 8
"""The oldest answers are forgotten beyond this number."""


@dataclass(frozen=True, slots=True, eq=False)
class Ekf:
    """The whole state of the filter. It is immutable: `step` returns the next one and leaves this one as it was."""

    params: FilterParams
    """The options, and what is made of them once."""
    history: History
    limits: IntegrityOptions | None = None
    """The limits that an IMU sample must keep; None if `estimator.integrity` checks the samples before the filter."""
    imu: SensorWatch = field(default_factory=SensorWatch)
    """The recent IMU samples, from which frozen ones are recognised."""
    answers: dict[MonoNs, FilterAnswer] = field(default_factory=dict, repr=False)
    """The newest answers of this filter and of those before it: guidance, recorder and links each request the same instant, and
    vision for the one whose sighting comes later. An answer counts where the last belief before the instant is still the same."""

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
    return Ekf(FilterParams(options or EkfOptions()), History(), limits)


def step(ekf: Ekf, event: Event) -> tuple[Ekf, Sequence[FusionResult]]:
    """Process one sample or sighting, as `step_all` does."""
    return step_all(ekf, (event,))


def step_all(ekf: Ekf, events: Sequence[Event]) -> tuple[Ekf, Sequence[FusionResult]]:
    """Process samples and sightings in the order in which they were received; they may be out of sequence.

    Returns:
        The next filter, and the result of each event. Its verdict is FUSED; GATED (implausible, or nothing to compare it with
        yet); LOW_CONFIDENCE (a sighting with less than `min_confidence`); IMPOSSIBLE (an IMU sample beyond the limits); FROZEN
        (an IMU sample that has repeated itself for too long); TOO_OLD (before the history); TOO_NEW (measured after every time
        of reception so far); SINGULAR; or NO_ATTITUDE (no sample has shown which way is down yet). A measurement that was
        compared with a prediction has its innovation, the innovation's covariance, NIS and test ratio, whatever the verdict.

    Raises:
        TypeError: an event is not a measurement (a frame, for example).
    """
    if ekf.limits is None:
        history, results = put_all(ekf.history, events, ekf.params)
        return Ekf(ekf.params, history, None, ekf.imu, ekf.answers), results
    imu, refused, admitted = ekf.imu, dict[int, FusionResult](), list[Event]()
    for n, event in enumerate(events):
        refusal = None
        if isinstance(event, Imu):
            imu, refusal = sensors.watch_reading(imu, event, ekf.limits, flying=True)
        if refusal is None:
            admitted.append(event)
        else:
            refused[n] = result(event, Outcome(refusal))
    history, made = put_all(ekf.history, admitted, ekf.params)
    results = list(made)
    for n, one in refused.items():
        results.insert(n, one)
    return Ekf(ekf.params, history, ekf.limits, imu, ekf.answers), results


def _answer(ekf: Ekf, now: MonoNs) -> FilterAnswer | None:
    """Return what the filter says of an instant, propagated from the last event before it; None before the first attitude."""
    before = ekf.history.before(now)
    if before is None:
        return None
    found, params = ekf.answers.get(now), ekf.params
    if found is None or found.before is not before or found.params is not params:
        if len(ekf.answers) >= _ANSWERS_KEPT:
            ekf.answers.clear()
        found = ekf.answers[now] = FilterAnswer(before, now, params)
    return found


def at(ekf: Ekf, now: MonoNs) -> RelativeState | None:
    """Return the estimate of the pad at an instant, propagated from the last event before it, or None if no pad is tracked."""
    answer = _answer(ekf, now)
    return None if answer is None else answer.pad


def motion_at(ekf: Ekf, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
    """Return the motion of body and deck at an instant; each is None while it is not known.

    The state is propagated to the instant; the covariance is the one of at most `EkfOptions.tick_s` before.
    """
    answer = _answer(ekf, now)
    return (None, None) if answer is None else (answer.body, answer.deck)


def forecast(ekf: Ekf, now: MonoNs, horizons_s: Sequence[float] | F64) -> Forecast | None:
    """Return the forecast of the deck at `now` plus each of the horizons, or None if no pad is tracked.

    Args:
        ekf: the filter.
        now: the instant from which the horizons count.
        horizons_s: (H,) s, each 0 or more.

    Raises:
        ValueError: a horizon that is negative or not finite.
    """
    h = np.array(horizons_s, dtype=float).ravel()
    if not all(0.0 <= x < math.inf for x in h.tolist()):
        raise ValueError(f"horizons must be seconds of 0 or more, got {horizons_s!r}")
    before = ekf.history.before(now)
    return None if before is None else forecasting.forecast(before, now, h, ekf.params)


def moving(ekf: Ekf) -> float | None:
    """Return the probability, 0..1, that the vessel moves (under way or on waves), or None before the first sighting."""
    b = ekf.belief
    if b is None or b.sighted < 0:
        return None
    (nn, ne), (_, ee) = b.P[VESSEL_VEL, VESSEL_VEL].tolist()
    return probability_of_motion(log_evidence_of_rest(b.sea), b.x[VESSEL_VEL].tolist(), (nn, ne, ee))
