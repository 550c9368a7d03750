"""The estimator paths behind one interface: `step_samples(samples)`, `step(sighting) -> path, result`, `at(now) -> belief`."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, Self

import numpy as np
from msgspec import Struct

from estimator import dead_reckoning, ekf, filters
from estimator.contracts.estimates import UNKNOWN_YAW_VAR, PathName, RelativeState, Sighting, Verdict
from estimator.contracts.fusion import FusionResult, source_of
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import GeoFix, GimbalAttitude, Sample, VehicleStatus
from estimator.contracts.time import MonoNs, seconds_between
from estimator.ekf import Forecast
from estimator.late import Late

Event = Sample | Sighting


_UNUSED_BY_EKF = frozenset({VehicleStatus, GeoFix, GimbalAttitude})


class Path(Protocol):
    """One estimator path from samples and sightings to a belief. Immutable."""

    @property
    def name(self) -> PathName: ...

    def step_samples(self, samples: Sequence[Sample]) -> tuple[Self, Sequence[FusionResult | None]]:
        """Process samples in the order in which they were received; return the next path and each sample's result.

        The result is None for a kind of sample that this path does not use. Otherwise it holds the verdict and, if the path
        compares the measurement with a prediction, the innovation.
        """
        ...

    def step(self, sighting: Sighting) -> tuple[Self, FusionResult]:
        """Process one sighting; return the next path and the result."""
        ...

    def at(self, now: MonoNs) -> RelativeState | None:
        """Return the belief at an instant; None before there is one."""
        ...

    def motion(self, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
        """Return the motion of body and deck at an instant; None for what this path does not estimate or does not know yet."""
        ...

    def forecast(self, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
        """Return the deck at these times, s, after an instant; None if this path does not forecast or tracks no pad."""
        ...


@dataclass(frozen=True, slots=True)
class MedianMeanPath:
    """The filtered sightings alone, held until the next one.

    The velocity is the slope of the running medians. The covariance includes the motion of the drone since the sighting.
    """

    filter: filters.MedianMean = field(default_factory=filters.MedianMean)
    newest: filters.Filtered | None = None
    sighting: Sighting | None = None
    sigma_v_m_s: float = 0.5
    """Standard deviation of the relative velocity that the held value ignores."""

    @property
    def name(self) -> PathName:
        return "median_mean"

    def step_samples(self, samples: Sequence[Sample]) -> tuple[Self, Sequence[FusionResult | None]]:
        return self, [None] * len(samples)

    def step(self, sighting: Sighting) -> tuple[Self, FusionResult]:
        memory, out = filters.step(
            self.filter, sighting.stamp.measured_at, sighting.d_body_pad_level, sighting.yaw_rad, sighting.yaw_ambiguous
        )
        if out is None:
            return self, _uncompared(self.name, sighting, Verdict.TOO_OLD)
        return replace(self, filter=memory, newest=out, sighting=sighting), _uncompared(self.name, sighting, Verdict.FUSED)

    def at(self, now: MonoNs) -> RelativeState | None:
        if self.newest is None or self.sighting is None:
            return None
        out = self.newest
        late_s = max(0.0, seconds_between(out.holds_at, now))
        moved_var, v_var = (self.sigma_v_m_s * late_s) ** 2, self.sigma_v_m_s**2
        yaw_var = UNKNOWN_YAW_VAR if out.yaw_rad is None else min(UNKNOWN_YAW_VAR, float(self.sighting.cov[3, 3]))
        cov = np.diag([moved_var, moved_var, moved_var, v_var, v_var, v_var, yaw_var])
        cov[:3, :3] += self.sighting.cov[:3, :3] * filters.VARIANCE_RATIO[out.samples - 1]
        return RelativeState(
            at=now,
            path=self.name,
            d_body_pad_level=out.d_body_pad_level,
            v_pad_level=np.zeros(3) if out.v_pad_level is None else out.v_pad_level,
            yaw_rad=out.yaw_rad,
            cov=cov,
            sighted=out.measured_at,
            consistent=True,
            details=(("yaw_ambiguous", float(out.yaw_ambiguous)),),
        )

    def motion(self, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
        return None, None

    def forecast(self, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
        return None


@dataclass(frozen=True, slots=True)
class DeadReckoningPath:
    """Sightings through the median and mean, then propagated with the drone's own velocity and heading."""

    filter: filters.MedianMean = field(default_factory=filters.MedianMean)
    state: dead_reckoning.DeadReckoning = field(default_factory=dead_reckoning.DeadReckoning.start)

    @property
    def name(self) -> PathName:
        return "dead_reckoning"

    def step_samples(self, samples: Sequence[Sample]) -> tuple[Self, Sequence[FusionResult | None]]:
        state = self.state
        for sample in samples:
            state, _ = dead_reckoning.step(state, sample)
        return replace(self, state=state), [None] * len(samples)

    def step(self, sighting: Sighting) -> tuple[Self, FusionResult]:
        memory, smooth = filters.smooth(self.filter, sighting)
        if smooth is None:
            return self, _uncompared(self.name, sighting, Verdict.TOO_OLD)
        state, verdict = dead_reckoning.sighted(self.state, smooth)
        return replace(self, filter=memory, state=state), _uncompared(self.name, sighting, verdict)

    def at(self, now: MonoNs) -> RelativeState | None:
        return dead_reckoning.at(self.state, now)

    def motion(self, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
        return None, None

    def forecast(self, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
        return None


class EkfPath(Struct, frozen=True):
    """The error-state Kalman filter: it fuses every sample and every sighting, late ones included."""

    filter: ekf.Ekf

    @property
    def name(self) -> PathName:
        return "ekf"

    def step_samples(self, samples: Sequence[Sample]) -> tuple[Self, Sequence[FusionResult | None]]:
        used: list[ekf.Event] = [s for s in samples if type(s) not in _UNUSED_BY_EKF]  # type: ignore[misc]
        if not used:
            return self, [None] * len(samples)
        memory, made = ekf.step_all(self.filter, used)
        if len(used) == len(samples):
            return type(self)(memory), made

        def results() -> list[FusionResult | None]:
            of_used = iter(made)
            return [None if type(s) in _UNUSED_BY_EKF else next(of_used) for s in samples]

        return type(self)(memory), Late(len(samples), results)

    def step(self, sighting: Sighting) -> tuple[Self, FusionResult]:
        memory, results = ekf.step(self.filter, sighting)
        return type(self)(memory), results[0]

    def at(self, now: MonoNs) -> RelativeState | None:
        return ekf.at(self.filter, now)

    def motion(self, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
        return ekf.motion_at(self.filter, now)

    def forecast(self, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
        return ekf.forecast(self.filter, now, horizons_s)


def _uncompared(path: PathName, event: Event, verdict: Verdict) -> FusionResult:
    """Return the result of a path that compares no measurement with a prediction."""
    return FusionResult(path, source_of(event), verdict, event.stamp.measured_at, event.stamp.received_at)
