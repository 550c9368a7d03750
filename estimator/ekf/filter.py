"""The filter's public functions: start, step, at, motion_at, forecast, moving."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from estimator.contracts.estimates import RelativeState
from estimator.contracts.fusion import FusionResult
from estimator.contracts.geometry import F64
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import Imu
from estimator.contracts.time import MonoNs
from estimator.ekf import forecast as forecasting
from estimator.ekf.answers import FilterAnswer
from estimator.ekf.deck_motion_bank import log_evidence_of_rest
from estimator.ekf.forecast import Forecast, probability_of_motion
from estimator.ekf.history import History, put_all
from estimator.ekf.options import EkfOptions
from estimator.ekf.outcome import Outcome, result
from estimator.ekf.packed_event import Event
from estimator.ekf.params import FilterParams
from estimator.ekf.state import VESSEL_VEL, Belief
from estimator.integrity import IntegrityOptions, sensors
from estimator.integrity.sensors import SensorWatch

_LIMITS = IntegrityOptions()
_ANSWERS_KEPT = 8
"""A filter of which many instants are asked forgets the first."""


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
    """The newest answers of this filter and of those before it: guidance, recorder and links each ask for the same instant, and
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
            imu, refusal = sensors.watch(imu, event, ekf.limits, flying=True)
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
