"""The samples of the sensors. They are immutable, are checked once at construction, and carry their measurement instant."""

import math
from collections.abc import Callable
from operator import mul
from typing import Any, Literal, TypeVar, get_args

import numpy as np
from msgspec import Struct
from msgspec.structs import force_setattr
from numpy.typing import NDArray

from estimator.contracts.geometry import DOUBLE, F64, GeoPoint, Rotation, own_array
from estimator.contracts.time import MonoNs, Stamp

SAMPLE_QUEUE_ITEMS = 4096
"""Samples that wait for the reader of a link; the oldest is dropped and counted."""
UNKNOWN_VAR = 1e6
"""Variance (SI units squared) of a direction that was not measured."""
_ROUNDED = 1e-6  # Share of a variance by which rounding may make a covariance indefinite
_ROUNDED_OF_LARGEST = 1e-9  # The same of the largest variance


def checked_vector(name: str, value: F64) -> F64:
    """Return the value as an array (3,) that nobody can change.

    Raises:
        ValueError: it has another shape, or a number is not finite.
    """
    base: object = value.base if type(value) is np.ndarray else None
    a = value if type(base) is bytes and value.dtype is DOUBLE else own_array(value)
    # In plain numbers: there are hundreds of samples a second, and numpy's calls on a few numbers take ten times as long.
    if a.shape == (3,):
        x, y, z = a.tolist()
        # A sum is finite only of finite numbers; one that is not may have overflowed.
        if math.isfinite(x + y + z) or (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
            return a
    raise ValueError(f"{name} needs finite numbers of shape (3,), got {value!r}")


def checked_covariance(name: str, value: F64, n: int, *, estimated: bool = False) -> F64:
    """Return the value as an array (n, n) that nobody can change.

    Args:
        estimated: it is a result of the estimator, which no measurement may be refused for: it may be indefinite.

    Raises:
        ValueError: it has another shape, a number is not finite, or it is no covariance.
    """
    a = own_array(value)
    if a.shape != (n, n):
        raise ValueError(f"{name} needs finite numbers of shape ({n}, {n}), got {value!r}")
    numbers = a.ravel().tolist()
    if not (math.isfinite(sum(numbers)) or all(map(math.isfinite, numbers))):
        raise ValueError(f"{name} needs finite numbers of shape ({n}, {n}), got {value!r}")
    if n == 3:
        _, xy, xz, yx, _, yz, zx, zy, _ = numbers
        alike = xy == yx and xz == zx and yz == zy
    else:
        alike = a.tobytes() == a.T.tobytes()
    gap = 0.0 if alike else float(np.abs(a - a.T).max())
    if min(numbers[:: n + 1]) < 0.0 or (gap > 1e-9 and gap > 1e-9 * float(np.abs(a).max())):
        raise ValueError(f"{name} must be symmetric with a non-negative diagonal, got {value!r}")
    if not estimated and _indefinite(numbers, n):
        raise ValueError(f"{name} must be positive semi-definite: its errors are more alike than they are large, got {value!r}")
    return a


def _indefinite(numbers: list[float], n: int) -> bool:
    """Return whether a symmetric matrix (n, n), row by row, has a negative eigenvalue beyond rounding, by its Cholesky factor."""
    variances = numbers[:: n + 1]
    if sum(map(abs, numbers)) == sum(variances):
        return False
    least = _ROUNDED_OF_LARGEST * max(variances)
    factor: list[list[float]] = []
    for i, variance in enumerate(variances):
        row: list[float] = []
        for j, other in enumerate(factor):
            row.append((numbers[i * n + j] - sum(map(mul, row, other))) / other[j])
        left = variance + _ROUNDED * variance + least - sum(map(mul, row, row))
        if not left > 0.0:
            return True
        factor.append([*row, math.sqrt(left)])
    return False


class Frame(Struct, frozen=True, eq=False):
    """One frame. Pixel (u, v) is px[v, u]; (0, 0) is the centre of the top-left pixel."""

    stamp: Stamp
    seq: int
    """The device's own counter: a gap is a lost frame."""
    px: NDArray[np.uint8]
    """Pixels, (H, W, 3) BGR; the constructor makes them read-only."""
    exposure_s: float = 0.0
    """Exposure time; 0 if unknown."""
    gain: float = 0.0
    """Amplification of the sensor's light against its least, of a camera whose exposure is driven; 0 if unknown."""
    coded: bool = False
    """True if a codec predicted it from other frames, as H.264 does: that moves patches of it by fractions of a pixel."""

    def __post_init__(self) -> None:
        if self.px.ndim != 3 or self.px.shape[2] != 3 or self.px.dtype != np.uint8:
            raise ValueError(f"a frame needs (H, W, 3) uint8 BGR, got {self.px.shape} {self.px.dtype}")
        self.px.setflags(write=False)


class Imu(Struct, frozen=True, eq=False):
    """Rate gyro and accelerometer, in `body`."""

    stamp: Stamp
    w_body: F64
    """Angular rate, (3,) rad/s."""
    f_body: F64
    """Specific force, (3,) m/s^2: at rest and level it reads (0, 0, -9.81)."""
    gyro_lost_s: float = 0.0
    """Time up to this sample, s, in which the gyro measured nothing, and `w_body` is what else is known. 0 if it measures."""
    accel_lost_s: float = 0.0
    """Time up to this sample, s, in which the accelerometer measured nothing; `f_body` is not used then."""

    def __post_init__(self) -> None:
        w_body, f_body = self.w_body, self.f_body
        if (own := checked_vector("Imu.w_body", w_body)) is not w_body:
            force_setattr(self, "w_body", own)
        if (own := checked_vector("Imu.f_body", f_body)) is not f_body:
            force_setattr(self, "f_body", own)


class Attitude(Struct, frozen=True, eq=False):
    """The vehicle's own attitude estimate."""

    stamp: Stamp
    R_ned_body: Rotation
    cov_body: F64
    """Covariance of the small rotation error written in `body`, (3, 3) rad^2."""

    def __post_init__(self) -> None:
        cov_body = self.cov_body
        if (own := checked_covariance("Attitude.cov_body", cov_body, 3)) is not cov_body:
            force_setattr(self, "cov_body", own)


GimbalFrame = Literal["ned", "level", "body"]


class GimbalAttitude(Struct, frozen=True, eq=False):
    """The attitude of the gimbal that carries the camera, as the gimbal reports it.

    The axes of `gimbal` are those of its last axis: x ahead through the lens of a camera that is mounted straight, y to the right
    of its image, z down in it. A gimbal that points down has a pitch of -90 degrees.
    """

    stamp: Stamp
    frame: GimbalFrame
    """Reference of the attitude: north, the horizon and the vehicle's heading, or the vehicle itself."""
    R_frame_gimbal: Rotation
    cov_gimbal: F64
    """Covariance of the small rotation error written in `gimbal`, (3, 3) rad^2."""

    def __post_init__(self) -> None:
        if self.frame not in ("ned", "level", "body"):
            raise ValueError(f"GimbalAttitude.frame must be ned, level or body, got {self.frame!r}")
        cov_gimbal = self.cov_gimbal
        if (own := checked_covariance("GimbalAttitude.cov_gimbal", cov_gimbal, 3)) is not cov_gimbal:
            force_setattr(self, "cov_gimbal", own)


class BodyVelocity(Struct, frozen=True, eq=False):
    """Velocity of the body over the ground (or over the surface that its flow sensor sees), written in `level`."""

    stamp: Stamp
    v_level: F64
    """Velocity, (3,) m/s forward, right, down."""
    cov_level: F64
    """Covariance of the velocity, (3, 3) (m/s)^2."""

    def __post_init__(self) -> None:
        v_level, cov_level = self.v_level, self.cov_level
        if (own := checked_vector("BodyVelocity.v_level", v_level)) is not v_level:
            force_setattr(self, "v_level", own)
        if (own := checked_covariance("BodyVelocity.cov_level", cov_level, 3)) is not cov_level:
            force_setattr(self, "cov_level", own)


_S = TypeVar("_S", bound=Imu | Attitude | BodyVelocity)
_copied: Callable[[Any], Any] = Struct.__copy__  # type: ignore[attr-defined]
_NO_STAMP, _ZEROS, _NO_COV = Stamp(MonoNs(0), MonoNs(0), 0.0, "sim"), np.zeros(3), np.zeros((3, 3))
_BLANK: dict[type, Any] = {
    Imu: Imu(_NO_STAMP, _ZEROS, _ZEROS),
    Attitude: Attitude(_NO_STAMP, Rotation.identity(), _NO_COV),
    BodyVelocity: BodyVelocity(_NO_STAMP, _ZEROS, _NO_COV),
}


def known(cls: type[_S], stamp: Stamp, first: F64 | Rotation, second: F64) -> _S:
    """Return a sample whose arrays the caller has checked: read-only, finite, a covariance. Drivers make hundreds a second."""
    made: _S = _copied(_BLANK[cls])
    _, first_name, second_name, *_ = cls.__struct_fields__
    force_setattr(made, "stamp", stamp)
    force_setattr(made, first_name, first)
    force_setattr(made, second_name, second)
    return made


class Range(Struct, frozen=True):
    """Distance from the body along its own down axis to the nearest surface (ultrasound, lidar)."""

    stamp: Stamp
    range_m: float
    sigma_m: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.range_m) and self.range_m >= 0 and math.isfinite(self.sigma_m) and self.sigma_m > 0):
            raise ValueError(f"Range needs a distance >= 0 and a sigma > 0, got {self.range_m}, {self.sigma_m}")


class Baro(Struct, frozen=True):
    """Height above an arbitrary fixed level, positive up."""

    stamp: Stamp
    height_m: float
    sigma_m: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.height_m) and math.isfinite(self.sigma_m) and self.sigma_m > 0):
            raise ValueError(f"Baro needs a finite height and a sigma > 0, got {self.height_m}, {self.sigma_m}")


class VesselReport(Struct, frozen=True, eq=False):
    """Report of the ship about her way (GNSS, compass, rate gyro). Any part may be missing."""

    stamp: Stamp
    v_vessel_ned: F64 | None
    """Velocity of the vessel, (3,) m/s."""
    cov_v_ned: F64 | None
    """Covariance of the velocity, (3, 3) (m/s)^2."""
    heading_rad: float | None
    """Heading of the vessel's bow, clockwise from north."""
    sigma_heading_rad: float | None
    turn_rad_s: float | None = None
    """Rate of turn, clockwise seen from above positive."""
    sigma_turn_rad_s: float | None = None

    def __post_init__(self) -> None:
        if (self.v_vessel_ned is None) != (self.cov_v_ned is None):
            raise ValueError("VesselReport: a velocity needs its covariance and the other way round")
        if (self.heading_rad is None) != (self.sigma_heading_rad is None):
            raise ValueError("VesselReport: a heading needs its sigma and the other way round")
        if (self.turn_rad_s is None) != (self.sigma_turn_rad_s is None):
            raise ValueError("VesselReport: a rate of turn needs its sigma and the other way round")
        if self.v_vessel_ned is not None and self.cov_v_ned is not None:
            force_setattr(self, "v_vessel_ned", checked_vector("VesselReport.v_vessel_ned", self.v_vessel_ned))
            force_setattr(self, "cov_v_ned", checked_covariance("VesselReport.cov_v_ned", self.cov_v_ned, 3))


class GeoFix(Struct, frozen=True, eq=False):
    """Report of the vehicle or of the ship where it is on the Earth."""

    stamp: Stamp
    whose: Literal["vehicle", "vessel"]
    place: GeoPoint
    sigma_m: float
    """Standard deviation of the place, on each horizontal axis."""
    v_ned: F64 | None = None
    """Velocity over the ground, (3,) m/s; None if the source does not report it."""

    def __post_init__(self) -> None:
        if self.whose not in ("vehicle", "vessel"):
            raise ValueError(f"GeoFix.whose must be vehicle or vessel, got {self.whose!r}")
        if not (math.isfinite(self.sigma_m) and self.sigma_m > 0):
            raise ValueError(f"GeoFix needs a sigma > 0, got {self.sigma_m}")
        if self.v_ned is not None:
            force_setattr(self, "v_ned", checked_vector("GeoFix.v_ned", self.v_ned))


class VehicleStatus(Struct, frozen=True):
    """Report of the vehicle about its own condition; a missing part is None."""

    stamp: Stamp
    flying: bool | None
    mode: str
    """The vehicle's own name for its flight mode, lower case: landed, taking_off, hovering, flying, landing, ..."""
    battery_fraction: float | None
    emergency: bool
    link_ok: bool
    taken: str | None = None
    """Holder of the vehicle if it was taken from this service, in the vehicle's own words, for people; None otherwise."""
    jerk_max_m_s3: float | None = None
    """Largest rate at which it changes its acceleration along the ground, by its own settings; None if it does not say."""
    tilt_max_deg: float | None = None
    """Largest tilt that it flies, by its own settings; None if it does not say."""
    others_at: MonoNs | None = None
    """Newest time at which somebody else chose for it: a mode, an arming or a disarm that was not ordered here, or a failsafe."""


class VesselMotion(Struct, frozen=True):
    """Report of a motion sensor on the ship: her motion on the waves. Any part may be missing.

    The sigmas are those of the numbers' digits. What the sensor itself is worth is found against the camera.
    """

    stamp: Stamp
    sensor: str
    """Name of the sensor in its stream: the talker and the kind of its sentences, or its address on a bus."""
    roll_rad: float | None = None
    """Starboard down positive."""
    pitch_rad: float | None = None
    """Bow up positive."""
    sigma_tilt_rad: float = 0.0
    heave_down_m: float | None = None
    """Displacement of the sensor's place from its mean, down positive."""
    sigma_heave_m: float = 0.0
    acceleration_m_s2: float | None = None
    """Horizontal acceleration of the sensor's place, without a direction."""

    def __post_init__(self) -> None:
        numbers = [number for name in self.__struct_fields__[2:] if (number := getattr(self, name)) is not None]
        if not all(map(math.isfinite, numbers)) or min(self.sigma_tilt_rad, self.sigma_heave_m) < 0.0:
            raise ValueError(f"VesselMotion needs finite numbers and sigmas >= 0, got {numbers}")


class VesselWind(Struct, frozen=True):
    """Report of the ship's anemometer: the wind over the ground."""

    stamp: Stamp
    sensor: str
    from_rad: float
    """Direction that it blows from, clockwise from north."""
    speed_m_s: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.from_rad) and math.isfinite(self.speed_m_s) and self.speed_m_s >= 0.0):
            raise ValueError(f"VesselWind needs a direction and a speed >= 0, got {self.from_rad}, {self.speed_m_s}")


BaselineFix = Literal["fixed", "float"]


class Baseline(Struct, frozen=True, eq=False):
    """The vector from the ship's GNSS antenna to the drone's, by carrier phase (moving-baseline RTK)."""

    stamp: Stamp
    fix: BaselineFix
    """The ambiguities of the phases are whole numbers (fixed) or estimated (float)."""
    d_ned: F64
    """(3,) m."""
    cov_ned: F64
    """Covariance of the vector, (3, 3) m^2."""
    antenna_body: F64 = _ZEROS
    """The drone's antenna from the body's origin, (3,) m in the body's axes."""
    antenna_vessel: F64 = _ZEROS
    """The ship's antenna from the pad's centre, (3,) m towards the bow, to starboard, down."""
    alone: bool = False
    """True if the estimate may begin with it, before any sighting of the pad."""

    def __post_init__(self) -> None:
        if self.fix not in get_args(BaselineFix):
            raise ValueError(f"Baseline.fix must be fixed or float, got {self.fix!r}")
        for name in ("d_ned", "antenna_body", "antenna_vessel"):
            force_setattr(self, name, checked_vector(f"Baseline.{name}", getattr(self, name)))
        force_setattr(self, "cov_ned", checked_covariance("Baseline.cov_ned", self.cov_ned, 3))


OfVessel = VesselReport | VesselMotion | VesselWind
"""The reports of a ship's own sensors except for her place."""
Sample = (
    Imu | Attitude | GimbalAttitude | BodyVelocity | Range | Baro | VesselReport | GeoFix | VehicleStatus
    | VesselMotion | VesselWind | Baseline
)  # fmt: skip
"""Everything that a driver delivers besides frames."""
