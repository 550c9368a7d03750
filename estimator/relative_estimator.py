"""Estimate where the pad is between sightings: `estimator.pipeline` with its memory kept in an object."""

from estimator import pipeline
from estimator.contracts.estimates import RelativeState, Sighting, Verdict
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VehicleStatus, VesselReport
from estimator.contracts.time import MonoNs, Stamp
from estimator.options import EstimatorOptions
from estimator.paths import Event


class RelativeEstimator:
    """Fuse sightings of the pad with the vehicle's sensors. Events may come late and in any order.

    Each `on_` method takes one event and returns what became of it: `Verdict.FUSED`, or the reason why it was refused. A refusal
    leaves the estimate as it was. An event that the chosen path has no use for returns None.

    Args:
        options: every number of the estimator; None for the defaults, which suit an AR.Drone 2.0 over a small vessel.
    """

    def __init__(self, options: EstimatorOptions | None = None) -> None:
        self._memory = pipeline.start(options or EstimatorOptions())
        self._newest: MonoNs | None = None

    def on_imu(self, imu: Imu) -> Verdict | None:
        """Take one IMU sample: rates in rad/s and specific force in m/s^2, in `body`."""
        return self._step(imu)

    def on_attitude(self, attitude: Attitude) -> Verdict | None:
        """Take the vehicle's own attitude. Send one before the first sighting, which is otherwise refused with NO_ATTITUDE."""
        return self._step(attitude)

    def on_velocity(self, velocity: BodyVelocity) -> Verdict | None:
        """Take a velocity over the ground, m/s in `level`."""
        return self._step(velocity)

    def on_range(self, distance: Range) -> Verdict | None:
        """Take a distance along the body's down axis, m."""
        return self._step(distance)

    def on_baro(self, height: Baro) -> Verdict | None:
        """Take a barometric height, m."""
        return self._step(height)

    def on_vessel(self, report: VesselReport) -> Verdict | None:
        """Take what the vessel reports of its own motion."""
        return self._step(report)

    def on_status(self, status: VehicleStatus) -> Verdict | None:
        """Take the vehicle's status. Readings that do not change count as frozen only while the vehicle says that it flies."""
        return self._step(status)

    def on_sighting(self, sighting: Sighting) -> Verdict | None:
        """Take what `PadTracker.track` found; its stamp says when the image was exposed."""
        return self._step(sighting)

    def attitude_at(self, stamp: Stamp) -> Attitude | None:
        """Return the attitude at the instant of an exposure, for `PadTracker.track`; None when no sample covers it."""
        return pipeline.attitude_at(self._memory, stamp)

    def at(self, instant: MonoNs) -> RelativeState | None:
        """Return the estimate at an instant, carried on from the newest event before it; None while no pad has been seen."""
        return pipeline.belief(self._memory, instant)

    @property
    def state(self) -> RelativeState | None:
        """The estimate at the newest instant of any event; None while no pad has been seen."""
        return None if self._newest is None else self.at(self._newest)

    def _step(self, event: Event) -> Verdict | None:
        self._memory, outcomes = pipeline.step(self._memory, event)
        verdict = outcomes[0].verdict if outcomes else None
        if verdict in (Verdict.FUSED, None):
            self._newest = max(self._newest or event.stamp.measured_at, event.stamp.measured_at)
        return verdict
