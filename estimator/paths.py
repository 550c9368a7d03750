"""The interface of the estimator's paths: `put(samples)` and `sight(sighting)` return results, `at(now)` an estimate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from estimator.contracts.estimates import FusionResult, PathName, RelativeState, Sighting
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import GeoFix, GimbalAttitude, Sample, VehicleStatus, VesselWind
from estimator.contracts.time import MonoNs
from estimator.ekf import EkfOptions, Filter, FilterAnswer, Forecast

Event = Sample | Sighting


GAP_S = 0.5  # Time without a sighting after which a path other than the filter starts again
_UNUSED_BY_EKF = frozenset({VehicleStatus, GeoFix, GimbalAttitude, VesselWind})


class Path(Protocol):
    """One estimator path from samples and sightings to an estimate."""

    name: PathName

    def put(self, samples: Sequence[Sample], *, wanted: bool = True) -> Sequence[FusionResult | None]:
        """Process samples in the order in which they were received; return each sample's result, if `wanted`.

        The result is None for a kind of sample that this path does not use. Otherwise it holds the verdict and, if the path
        compares the measurement with a prediction, the innovation.
        """
        return [None] * len(samples)

    def sight(self, sighting: Sighting) -> FusionResult:
        """Process one sighting; return the result."""
        ...

    def at(self, now: MonoNs) -> RelativeState | None:
        """Return the estimate at an instant; None before there is one."""
        ...

    def motion(self, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
        """Return the motion of body and deck at an instant; None for what this path does not estimate or does not know yet."""
        return None, None

    def forecast(self, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
        """Return the deck at these times, s, after an instant; None if this path does not forecast or tracks no pad."""
        return None


class EkfPath(Path):
    """The error-state Kalman filter: it fuses every sample and every sighting, late ones included."""

    name: PathName = "ekf"

    def __init__(self, options: EkfOptions) -> None:
        self._filter = Filter(options)

    def put(self, samples: Sequence[Sample], *, wanted: bool = True) -> Sequence[FusionResult | None]:
        used = [s for s in samples if type(s) not in _UNUSED_BY_EKF]
        made = self._filter.put(used, wanted=wanted)  # type: ignore[arg-type]
        if len(used) == len(samples) or not wanted:
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

    def answer(self, at: MonoNs) -> FilterAnswer | None:
        """Return all that the filter knows at an instant; None before there is anything."""
        return self._filter.answer(at)

    def carried_down_m(self, at: MonoNs) -> float:
        """Return the body's place by the IMU alone at an instant, m downward from anywhere; nan before there is one."""
        answer = self._filter.answer(at)
        return math.nan if answer is None else answer.carried_down_m
