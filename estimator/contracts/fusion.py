"""The result of one measurement: the verdict and, if it was compared with a prediction, the innovation.

The words are those of PX4's topics `estimator_innovations`, `estimator_innovation_variances` and
`estimator_innovation_test_ratios`: an innovation is measured minus predicted, and a test ratio above 1 is refused.
"""

import math
from typing import Literal

from msgspec import Struct

from estimator.contracts.estimates import PathName, Sighting, Verdict
from estimator.contracts.geometry import F64
from estimator.contracts.samples import (
    Attitude,
    Baro,
    BodyVelocity,
    GeoFix,
    GimbalAttitude,
    Imu,
    Range,
    Sample,
    VehicleStatus,
    VesselReport,
)
from estimator.contracts.time import MonoNs

Source = Literal["imu", "attitude", "gimbal", "velocity", "range", "baro", "vessel", "fix", "status", "sighting"]

_SOURCES: dict[type[Sample] | type[Sighting], Source] = {
    Imu: "imu",
    Attitude: "attitude",
    GimbalAttitude: "gimbal",
    BodyVelocity: "velocity",
    Range: "range",
    Baro: "baro",
    VesselReport: "vessel",
    GeoFix: "fix",
    VehicleStatus: "status",
    Sighting: "sighting",
}
COMPONENTS: dict[Source, tuple[str, ...]] = {
    "imu": (),
    "attitude": ("roll_rad", "pitch_rad", "yaw_rad"),
    "gimbal": (),
    "velocity": ("forward_m_s", "right_m_s", "down_m_s"),
    "range": ("range_m",),
    "baro": ("height_m",),
    "vessel": ("north_m_s", "east_m_s", "down_m_s", "heading_rad"),
    "fix": (),
    "status": (),
    "sighting": ("x_m", "y_m", "z_m", "yaw_rad"),
}
"""The components of an innovation by source, each name with its unit. Attitude: small rotations about the body's axes; velocity:
`level`; vessel: `ned`; sighting: the pad's place in the body's axes and its heading."""
POSE_COMPONENTS = ("x_m", "y_m", "z_m", "rotation_x_rad", "rotation_y_rad", "rotation_z_rad")
"""The components of a sighting whose whole pose was compared: the last three are a small rotation in `level`."""


class FusionResult(Struct, frozen=True, eq=False):
    """The result of one measurement in one path of the estimator."""

    path: PathName
    source: Source
    verdict: Verdict
    measured_at: MonoNs
    """The instant at which the measurement was true."""
    received_at: MonoNs
    """The instant at which the measurement arrived."""
    innovation: F64 | None = None
    """(m,) measured minus predicted; None where nothing was compared."""
    innovation_cov: F64 | None = None
    """(m, m) covariance of the innovation that the filter claims; None where nothing was compared."""
    components: tuple[str, ...] = ()
    """(m,) names of the innovation's components, each with its unit."""
    nis: float = math.nan
    """Normalized innovation squared, `innovation' inv(innovation_cov) innovation`; nan where nothing was compared. It is m on
    average when the covariance is honest."""
    test_ratio: float = math.nan
    """NIS over the gate's limit for m components: above 1 the gate refuses; nan where nothing was compared."""

    @property
    def normalized_nis(self) -> float:
        """NIS over the number of components: 1 on average when the covariance is honest; nan where nothing was compared."""
        return self.nis / len(self.components) if self.components else math.nan


def source_of(event: Sample | Sighting) -> Source:
    """Return the source that a measurement comes from.

    Raises:
        TypeError: the object is no measurement.
    """
    try:
        return _SOURCES[type(event)]
    except KeyError:
        raise TypeError(f"a measurement is a sample or a sighting, not {type(event).__name__}") from None


def uncompared(path: PathName, event: Sample | Sighting, verdict: Verdict) -> FusionResult:
    """Return the result of a measurement that a path compares with no prediction."""
    return FusionResult(path, source_of(event), verdict, event.stamp.measured_at, event.stamp.received_at)


def components_of(source: Source, size: int) -> tuple[str, ...]:
    """Return the names of the components of an innovation of `size` numbers whose components are the source's first ones."""
    return POSE_COMPONENTS if source == "sighting" and size == len(POSE_COMPONENTS) else COMPONENTS[source][:size]
