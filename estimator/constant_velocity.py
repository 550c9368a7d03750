"""A Kalman filter of the pad's relative position and velocity, fed by the sightings alone.

The model is a constant velocity of the pad against the body, driven by white noise in place of the accelerations of drone and
deck (Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, sec. 6.2.1). Position and
velocity are written in `ned`, so a turn of the drone is not a motion of the pad; the vehicle's own attitude rotates sightings
into `ned` and the answer out of it. filterpy's filter does the algebra: one is made for each step from the arrays of the belief,
which do not change.

The belief holds at the exposure of the newest fused frame, so a frame that arrives late needs no repair: `at` predicts from the
exposure to any instant, and the covariance grows with the time between. A frame exposed before the newest fused one is refused.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from msgspec import structs

from estimator.attitude_history import AttitudeHistory
from estimator.contracts.estimates import UNKNOWN_YAW_VAR, FusionResult, PathName, RelativeState, Sighting, Verdict, components_of
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import Attitude, Sample
from estimator.contracts.time import MonoNs, seconds_between
from estimator.dead_reckoning import ArrowHeading, heading_after
from estimator.options import EstimatorOptions
from estimator.paths import GAP_S, Path

GATE_NIS = 16.27
"""Chi-square with 3 degrees of freedom, 99.9 %."""
_KEPT = 5  # Number of innovations by which the belief is called consistent
_ACCELERATION_DENSITY_M2_S3 = 1.0  # Spectral density of the acceleration of drone and deck along each axis
_SIGMA_V_M_S = 1.0  # Standard deviation of the velocity at the first sighting
_SIGMA_HEADING_RATE_RAD_S = 0.01  # Drift of the vehicle's heading against the pad's: one standard deviation


@dataclass(frozen=True, slots=True, eq=False)
class _Belief:
    """Position and velocity of the pad against the body at the exposure of the newest fused frame."""

    at: MonoNs
    x: F64
    """(6,) position, m, and velocity, m/s, in `ned`."""
    P: F64
    agreed: tuple[bool, ...] = ()
    """True for each of the newest innovations that lay inside the gate."""


class ConstantVelocityPath(Path):
    """Sightings through a Kalman filter of constant velocity.

    It starts again after `GAP_S` without a fused sighting.
    """

    name: PathName = "constant_velocity"

    def __init__(self, options: EstimatorOptions) -> None:
        self._attitudes = AttitudeHistory(options.history_s)
        self._belief: _Belief | None = None
        self._arrow: ArrowHeading | None = None

    def put(self, samples: Sequence[Sample], *, wanted: bool = True) -> Sequence[FusionResult | None]:
        self._attitudes = self._attitudes.add(*[s for s in samples if type(s) is Attitude])
        return [None] * len(samples)

    def sight(self, sighting: Sighting) -> FusionResult:
        stamp, last = sighting.stamp, self._belief
        result = FusionResult(self.name, "sighting", Verdict.FUSED, stamp.measured_at, stamp.received_at)
        attitude = self._attitudes.at(stamp.measured_at, stamp)
        if attitude is None:
            return structs.replace(result, verdict=Verdict.NO_ATTITUDE)
        elapsed_s = math.inf if last is None else seconds_between(last.at, stamp.measured_at)
        if elapsed_s <= 0.0:
            return structs.replace(result, verdict=Verdict.TOO_OLD)
        heading_rad = attitude.R_ned_body.rpy_rad[2]
        R_ned_level = Rotation.from_rpy(0.0, 0.0, heading_rad).matrix
        z, R = R_ned_level @ sighting.d_body_pad_level, R_ned_level @ sighting.cov[:3, :3] @ R_ned_level.T
        if last is None or elapsed_s > GAP_S:
            P = _SIGMA_V_M_S**2 * np.eye(6)
            P[:3, :3] = R
            first = _Belief(stamp.measured_at, np.concatenate([z, np.zeros(3)]), P)
            self._belief, self._arrow = first, heading_after(None, heading_rad, sighting)
            return result

        kalman = self._predicted(last, elapsed_s)
        kalman.update(z, R)
        nis = float(kalman.mahalanobis) ** 2
        to_body = attitude.R_ned_body.inv.matrix
        result = structs.replace(
            result,
            verdict=Verdict.FUSED if nis <= GATE_NIS else Verdict.GATED,
            innovation=to_body @ kalman.y,
            innovation_cov=to_body @ kalman.S @ to_body.T,
            components=components_of("sighting", 3),
            nis=nis,
            test_ratio=nis / GATE_NIS,
        )
        agreed = (*last.agreed, nis <= GATE_NIS)[-_KEPT:]
        if nis > GATE_NIS:
            self._belief = replace(last, agreed=agreed)
            return result
        self._belief = _Belief(stamp.measured_at, kalman.x, kalman.P, agreed)
        self._arrow = heading_after(self._arrow, heading_rad, sighting)
        return result

    def at(self, now: MonoNs) -> RelativeState | None:
        belief = self._belief
        if belief is None:
            return None
        kalman = self._predicted(belief, seconds_between(belief.at, now))
        # The vehicle's heading now; the newest one if no attitude covers it.
        newest = self._attitudes.samples[-1]
        heading_rad = (self._attitudes.at(now, newest.stamp) or newest).R_ned_body.rpy_rad[2]
        R_level_ned = Rotation.from_rpy(0.0, 0.0, -heading_rad).matrix
        turn, cov = np.kron(np.eye(2), R_level_ned), np.zeros((7, 7))
        d, v = (turn @ kalman.x).reshape(2, 3)
        cov[:6, :6] = turn @ kalman.P @ turn.T
        cov[6, 6] = UNKNOWN_YAW_VAR if self._arrow is None else self._arrow.var_at(now, _SIGMA_HEADING_RATE_RAD_S)
        return RelativeState(
            at=now,
            path=self.name,
            d_body_pad_level=d,
            v_pad_level=v,
            yaw_rad=None if self._arrow is None else wrap_pi(heading_rad - self._arrow.heading_rad),
            cov=0.5 * (cov + cov.T),
            sighted=belief.at,
            consistent=2 * sum(belief.agreed) >= len(belief.agreed),
            details=(("yaw_ambiguous", float(self._arrow is not None and self._arrow.ambiguous)),),
        )

    def _predicted(self, belief: _Belief, elapsed_s: float) -> KalmanFilter:
        """Return filterpy's filter with the belief `elapsed_s` later; the belief's own arrays are not changed."""
        kalman = KalmanFilter(dim_x=6, dim_z=3)
        kalman.x, kalman.P, kalman.H = belief.x, belief.P, np.eye(3, 6)
        kalman.F = np.eye(6) + elapsed_s * np.eye(6, k=3)
        kalman.Q = Q_continuous_white_noise(2, abs(elapsed_s), _ACCELERATION_DENSITY_M2_S3, 3, order_by_dim=False)
        kalman.predict()
        return kalman
