"""The estimator paths behind one interface: `put(samples)` and `sight(sighting)` return results, `at(now)` an estimate."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from estimator import dead_reckoning, filters
from estimator.contracts.estimates import UNKNOWN_YAW_VAR, PathName, RelativeState, Sighting, Verdict
from estimator.contracts.fusion import FusionResult, source_of
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import GeoFix, GimbalAttitude, Sample, VehicleStatus
from estimator.contracts.time import MonoNs, seconds_between
from estimator.ekf import EkfOptions, Filter, Forecast
from estimator.options import DeadReckoningOptions

Event = Sample | Sighting


_UNUSED_BY_EKF = frozenset({VehicleStatus, GeoFix, GimbalAttitude})


class Path(Protocol):
    """One estimator path from samples and sightings to an estimate."""

    name: PathName

    def put(self, samples: Sequence[Sample]) -> Sequence[FusionResult | None]:
        """Process samples in the order in which they were received; return each sample's result.

        The result is None for a kind of sample that this path does not use. Otherwise it holds the verdict and, if the path
        compares the measurement with a prediction, the innovation.
        """
        ...

    def sight(self, sighting: Sighting) -> FusionResult:
        """Process one sighting; return the result."""
        ...

    def at(self, now: MonoNs) -> RelativeState | None:
        """Return the estimate at an instant; None before there is one."""
        ...

    def motion(self, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
        """Return the motion of body and deck at an instant; None for what this path does not estimate or does not know yet."""
        ...

    def forecast(self, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
        """Return the deck at these times, s, after an instant; None if this path does not forecast or tracks no pad."""
        ...


_SIGMA_V_M_S = 0.5
"""Standard deviation of the relative velocity that a held value ignores."""


class MedianMeanPath:
    """The filtered sightings alone, held until the next one.

    The velocity is the slope of the running medians. The covariance includes the motion of the drone since the sighting.
    """

    name: PathName = "median_mean"

    def __init__(self, max_gap_s: float) -> None:
        self._filter = filters.MedianMean(max_gap_s)
        self._newest: filters.Filtered | None = None
        self._sighting: Sighting | None = None

    def put(self, samples: Sequence[Sample]) -> Sequence[FusionResult | None]:
        return [None] * len(samples)

    def sight(self, sighting: Sighting) -> FusionResult:
        memory, out = filters.step(
            self._filter, sighting.stamp.measured_at, sighting.d_body_pad_level, sighting.yaw_rad, sighting.yaw_ambiguous
        )
        if out is None:
            return _uncompared(self.name, sighting, Verdict.TOO_OLD)
        self._filter, self._newest, self._sighting = memory, out, sighting
        return _uncompared(self.name, sighting, Verdict.FUSED)

    def at(self, now: MonoNs) -> RelativeState | None:
        if self._newest is None or self._sighting is None:
            return None
        out = self._newest
        late_s = max(0.0, seconds_between(out.holds_at, now))
        moved_var, v_var = (_SIGMA_V_M_S * late_s) ** 2, _SIGMA_V_M_S**2
        yaw_var = UNKNOWN_YAW_VAR if out.yaw_rad is None else min(UNKNOWN_YAW_VAR, float(self._sighting.cov[3, 3]))
        cov = np.diag([moved_var, moved_var, moved_var, v_var, v_var, v_var, yaw_var])
        cov[:3, :3] += self._sighting.cov[:3, :3] * filters.VARIANCE_RATIO[out.samples - 1]
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


class DeadReckoningPath:
    """Sightings through the median and mean, then propagated with the drone's own velocity and heading."""

    name: PathName = "dead_reckoning"

    def __init__(self, max_gap_s: float, options: DeadReckoningOptions) -> None:
        self._filter = filters.MedianMean(max_gap_s)
        self._state = dead_reckoning.DeadReckoning.start(options)

    def put(self, samples: Sequence[Sample]) -> Sequence[FusionResult | None]:
        for sample in samples:
            self._state, _ = dead_reckoning.step(self._state, sample)
        return [None] * len(samples)

    def sight(self, sighting: Sighting) -> FusionResult:
        memory, smooth = filters.smooth(self._filter, sighting)
        if smooth is None:
            return _uncompared(self.name, sighting, Verdict.TOO_OLD)
        self._filter = memory
        self._state, verdict = dead_reckoning.sighted(self._state, smooth)
        return _uncompared(self.name, sighting, verdict)

    def at(self, now: MonoNs) -> RelativeState | None:
        return dead_reckoning.at(self._state, now)

    def motion(self, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
        return None, None

    def forecast(self, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
        return None


class EkfPath:
    """The error-state Kalman filter: it fuses every sample and every sighting, late ones included."""

    name: PathName = "ekf"

    def __init__(self, options: EkfOptions) -> None:
        self._filter = Filter(options)

    def put(self, samples: Sequence[Sample]) -> Sequence[FusionResult | None]:
        used = [s for s in samples if type(s) not in _UNUSED_BY_EKF]
        made = self._filter.put(used)  # type: ignore[arg-type]
        if len(used) == len(samples):
            return made
        of_used = iter(made)
        return [None if type(s) in _UNUSED_BY_EKF else next(of_used) for s in samples]

    def sight(self, sighting: Sighting) -> FusionResult:
        return self._filter.put((sighting,))[0]

    def at(self, now: MonoNs) -> RelativeState | None:
        return self._filter.at(now)

    def motion(self, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
        return self._filter.motion(now)

    def forecast(self, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
        return self._filter.forecast(now, horizons_s)


def _uncompared(path: PathName, event: Event, verdict: Verdict) -> FusionResult:
    """Return the result of a path that compares no measurement with a prediction."""
    return FusionResult(path, source_of(event), verdict, event.stamp.measured_at, event.stamp.received_at)
