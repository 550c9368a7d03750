"""The results of estimation: the pad's relative position, its uncertainty, and the verdict on each input.

An input that was compared with a prediction has an innovation. The words are those of PX4's topics `estimator_innovations`,
`estimator_innovation_variances` and `estimator_innovation_test_ratios`: an innovation is measured minus predicted, and a test
ratio above 1 is refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from enum import Enum
from typing import ClassVar, Literal, overload

import numpy as np
from msgspec import Struct, field
from msgspec.structs import force_setattr
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import (
    Attitude,
    Baro,
    Baseline,
    BodyVelocity,
    GeoFix,
    GimbalAttitude,
    Imu,
    Range,
    Sample,
    VehicleStatus,
    VesselMotion,
    VesselReport,
    VesselWind,
    checked_covariance,
    checked_vector,
)
from estimator.contracts.time import MonoNs, Stamp

Method = Literal["ellipse", "arrow", "corners", "registration", "lamps", "selected", "fused"]
PathName = Literal["median_mean", "dead_reckoning", "ekf", "constant_velocity"]

UNKNOWN_YAW_VAR = math.pi**2 / 3.0
"""rad^2, variance of a heading that could be anything: uniform over the circle."""
UNSURE = 0.2
"""Confidence from which a sighting is taken for the pad by default; one below is hardly it."""
_FAR_PX = 1e4  # Largest coordinate of a feature: what lies farther outside of the frame is cut there


class Verdict(Enum):
    """The verdict on one input. Every frame and every measurement gets exactly one."""

    # By identity: an enumeration's own hash is that of its name, and verdicts are counted thousands of times a second.
    __hash__: ClassVar[Callable[[object], int]] = object.__hash__

    FUSED = "fused"
    GATED = "gated"
    """The input is implausible against the belief."""
    LOW_CONFIDENCE = "low_confidence"
    """A sighting with less confidence than the settings request: it was compared with nothing."""
    TOO_OLD = "too_old"
    TOO_NEW = "too_new"
    SINGULAR = "singular"
    NO_PAD = "no_pad"
    """A frame in which no pad was found."""
    REPLACED = "replaced"
    """A newer frame replaced this one before it was processed."""
    SKIPPED = "skipped"
    """This machine is too slow to look at each frame, and this one was left out."""
    NO_ATTITUDE = "no_attitude"
    """No attitude sample covers the frame's exposure."""
    NO_GIMBAL = "no_gimbal"
    """No attitude of the camera's gimbal covers the frame's exposure, or the gimbal does not point the camera down."""
    FAILED = "failed"
    """The frame could not be read or processed."""
    REPEATED = "repeated"
    """The frame's pixels equal those of an earlier one: it carries no new information, whatever its stamp says."""
    FROZEN = "frozen"
    """A frozen reading.

    It has not changed by one bit for longer than its sensor can hold still, or the pad stands still in the image while the body
    turns.
    """
    IMPOSSIBLE = "impossible"
    """The reading is beyond what the vehicle can do, or a step that it cannot make."""
    ELSEWHERE = "elsewhere"
    """No motion explains the sighting's position: it is another pad, until the track is given up for it."""


class IntegrityAlert(Enum):
    """Reasons not to descend by an estimate; the value is the text for the operator."""

    CAMERA_FROZEN = "the camera repeats its frames"
    VIEW_FROZEN = "the pad stands still in the image while the body turns"
    VIEW_REVERSED = "the image moves against the body: the camera mirrors it, or looks the other way round"
    IMU_FROZEN = "the IMU repeats its readings"
    ATTITUDE_FROZEN = "the attitude repeats its readings"
    ATTITUDE = "the attitude turns otherwise than gyro and camera"
    IMU_LATE = "attitude and image are a tenth of a second apart: the IMU or the video is later than its stamps"
    STAMPS = "timestamps of frames or samples are inconsistent"
    APART = "the estimate and what the camera sees move apart"
    ELSEWHERE = "a pad is seen in another place"
    RANGE = "the range sensor contradicts the camera"
    HEIGHT = "the barometer contradicts the camera"
    BASELINE = "the RTK baseline leapt, or came after a gap, and no picture confirms it"
    UNFELT = "without its accelerometer the vehicle is not held still enough to land"
    DECK = "the deck is believed to move as no deck does"


CENTRE = "centre"
"""The label of the feature that is the pad's centre."""


FeatureKind = Literal["ellipse", "point", "line", "outline"]


class Feature(Struct, frozen=True, eq=False):
    """A feature that a method detected, in pixels, for display and recording; no estimate is computed from it."""

    kind: FeatureKind
    label: str
    uv_px: F64
    """Points, (N, 2); an ellipse is given as its outline."""


class Pose6(Struct, frozen=True, eq=False):
    """The full pose of the pad, from a method that measures it."""

    d_body_pad_level: F64
    """Position of the pad, (3,) m."""
    R_level_pad: Rotation
    cov: F64
    """Covariance, (6, 6): [d_body_pad_level (m), small rotation of the pad written in `level` (rad)]."""

    def __post_init__(self) -> None:
        force_setattr(self, "d_body_pad_level", checked_vector("Pose6.d_body_pad_level", self.d_body_pad_level))
        force_setattr(self, "cov", checked_covariance("Pose6.cov", self.cov, 6, estimated=True))


_DRAWN_BGR = (255, 0, 255)
_AXES = ("forward", "right", "down")


class Sighting(Struct, frozen=True, eq=False):
    """One measurement of the pad: the vector from the body's origin to the pad's centre, written in `level`, and the heading."""

    stamp: Stamp
    seq: int
    method: Method
    d_body_pad_level: F64
    """Position of the pad, (3,) m forward, right, down."""
    yaw_rad: float | None
    """Heading of the body against the arrow, clockwise from above positive, (-pi, pi]; None if the frame does not show it."""
    yaw_ambiguous: bool
    """True if the heading may be 180 degrees off (an H alone)."""
    cov: F64
    """Covariance of [forward, right, down, yaw], (4, 4), in m and rad; an unknown yaw has `UNKNOWN_YAW_VAR`."""
    confidence: float
    """Probability, 0..1, that this is the pad and that the estimate keeps its covariance."""
    pose6: Pose6 | None = None
    features: tuple[Feature, ...] = field(default=())

    def __post_init__(self) -> None:
        force_setattr(self, "d_body_pad_level", checked_vector("Sighting.d_body_pad_level", self.d_body_pad_level))
        force_setattr(self, "cov", checked_covariance("Sighting.cov", self.cov, 4))
        if self.yaw_rad is not None and not -math.pi <= self.yaw_rad <= math.pi:
            raise ValueError(f"Sighting.yaw_rad must lie in (-pi, pi], got {self.yaw_rad}")
        if not 0.0 <= self.confidence <= 1.0:
            raise ValueError(f"Sighting.confidence must lie in [0, 1], got {self.confidence}")

    def draw(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a copy of the image, (height, width, 3) BGR, in which the features of the sighting are drawn in magenta.

        Args:
            image: what the pad was found in, (height, width) or (height, width, 1 or 3), uint8.
        """
        height, width = image.shape[:2]
        out = np.broadcast_to(image.reshape(height, width, -1), (height, width, 3)).copy()
        for feature in self.features:
            uv = np.clip(feature.uv_px[np.isfinite(feature.uv_px).all(axis=1)], -_FAR_PX, _FAR_PX)
            if feature.kind != "point" and len(uv) > 1:
                after = np.roll(uv, -1, axis=0) if feature.kind != "line" else np.vstack([uv[1:], uv[-1:]])
                steps = np.linspace(0.0, 1.0, 2 + int(np.abs(after - uv).max()))[:, None, None]
                uv = (uv + steps * (after - uv)).reshape(-1, 2)
            reach = 3 if feature.kind == "point" else 1
            for across in range(-reach, reach):
                for down in range(-reach, reach):
                    u, v = np.rint(uv + np.array([across, down])).astype(int).T
                    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
                    out[v[inside], u[inside]] = _DRAWN_BGR
        return out

    def _repr_html_(self) -> str:
        """Return the sighting as a notebook shows it."""
        x, y, z = self.d_body_pad_level.tolist()
        sigmas = [math.sqrt(v) for v in self.cov.diagonal().tolist()]
        yaw = "not seen" if self.yaw_rad is None else f"{math.degrees(self.yaw_rad):.1f} &pm; {math.degrees(sigmas[3]):.1f} deg"
        rows = [(name, f"{value:.3f} &pm; {s:.3f} m") for name, value, s in zip(_AXES, (x, y, z), sigmas, strict=False)]
        rows += [
            ("heading", yaw + (" or half a turn off" if self.yaw_ambiguous else "")),
            ("confidence", f"{self.confidence:.2f}"),
        ]
        cells = "".join(f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in rows)
        return f"<table><caption>pad by {self.method}</caption>{cells}</table>"


class Details(Sequence[tuple[str, float]]):
    """Named figures that are put together when they are first read: few of the many estimates are recorded or shown.

    Args:
        make: returns the figures.
    """

    __slots__ = ("_figures", "_make")

    def __init__(self, make: Callable[[], tuple[tuple[str, float], ...]]) -> None:
        self._make = make
        self._figures: tuple[tuple[str, float], ...] | None = None

    @property
    def figures(self) -> tuple[tuple[str, float], ...]:
        """The figures, in order."""
        if self._figures is None:
            self._figures = self._make()
        return self._figures

    def __len__(self) -> int:
        return len(self.figures)

    def __iter__(self) -> Iterator[tuple[str, float]]:
        return iter(self.figures)

    @overload
    def __getitem__(self, index: int) -> tuple[str, float]: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[tuple[str, float], ...]: ...

    def __getitem__(self, index: int | slice) -> tuple[str, float] | tuple[tuple[str, float], ...]:
        return self.figures[index]

    def __repr__(self) -> str:
        return repr(self.figures)


class RelativeState(Struct, frozen=True, eq=False):
    """The belief about the pad at one instant, which guidance steers by."""

    at: MonoNs
    path: PathName
    d_body_pad_level: F64
    """Position of the pad, (3,) m forward, right, down."""
    v_pad_level: F64
    """Rate of `d_body_pad_level` without the rotation of the axes, (3,) m/s: velocity of the pad minus that of the body."""
    yaw_rad: float | None
    """Heading of the body against the arrow; None while it was never known."""
    cov: F64
    """Covariance of [d (3), v (3), yaw], (7, 7)."""
    sighted: MonoNs
    """Measurement instant of the newest fused sighting."""
    consistent: bool
    """True if recent innovations agree with the claimed covariance."""
    details: Sequence[tuple[str, float]] = field(default=())
    """Named figures of the path for recording and display (biases, gates); guidance never uses them."""
    track: int = 0
    """Number of the tracked pad; it increases when the track is given up for a position that no motion explains."""
    alerts: tuple[IntegrityAlert, ...] = field(default=())
    """The reasons not to descend by this belief; `consistent` is False while there are any."""
    lost: tuple[str, ...] = field(default=())
    """Sensors that this belief does without because they lie, and what each does, in words."""
    lens_off_m: tuple[float, float] | None = None
    """Place of the lens less the one in the camera's file, forward and right in `body`, by which the pad's place is off; None
    unless it is surely too far for a landing."""
    adrift: bool = False
    """True if the pad went out of sight while its ship turned hard: `cov` says where it may have been swung."""
    steers: bool = False
    """True if the newest sightings show that the ship brakes, starts or turns hard."""
    jolted: bool = False
    """True if her own sensors have just shown that she begins to."""

    def __post_init__(self) -> None:
        force_setattr(self, "d_body_pad_level", checked_vector("RelativeState.d_body_pad_level", self.d_body_pad_level))
        force_setattr(self, "v_pad_level", checked_vector("RelativeState.v_pad_level", self.v_pad_level))
        force_setattr(self, "cov", checked_covariance("RelativeState.cov", self.cov, 7, estimated=True))

    @property
    def height_m(self) -> float:
        """Height of the body's origin above the pad's centre, metres."""
        return self.d_body_pad_level.item(2)

    @property
    def lateral_m(self) -> float:
        """Horizontal distance between body and pad centre, metres."""
        x, y, _ = self.d_body_pad_level.tolist()
        return math.hypot(x, y)

    @property
    def placed(self) -> bool:
        """True if the place is known well enough to be shown as figures: to 1 m, or to half of the distance."""
        known_m = 2.0 * math.sqrt(max(self.cov.item(i, i) for i in range(3)))
        return known_m <= max(1.0, 0.5 * math.hypot(*self.d_body_pad_level.tolist()))

    def marked(self, alerts: tuple[IntegrityAlert, ...], **fields: object) -> RelativeState:
        """Return the estimate with these alerts, by which it is not consistent, and other fields.

        It is a copy, not a construction: the arrays were checked when this estimate was made.
        """
        made = copy(self)
        for name, value in (*fields.items(), ("alerts", alerts), ("consistent", self.consistent and not alerts)):
            force_setattr(made, name, value)
        return made

    def age_s(self, now: MonoNs) -> float:
        """Return the seconds since the newest fused sighting was measured."""
        return (now - self.sighted) * 1e-9


Source = Literal[
    "imu", "attitude", "gimbal", "velocity", "range", "baro", "vessel", "fix", "status", "motion", "wind", "baseline", "sighting"
]  # fmt: skip

SOURCES: dict[type[Sample] | type[Sighting], Source] = {
    Imu: "imu",
    Attitude: "attitude",
    GimbalAttitude: "gimbal",
    BodyVelocity: "velocity",
    Range: "range",
    Baro: "baro",
    VesselReport: "vessel",
    GeoFix: "fix",
    VehicleStatus: "status",
    VesselMotion: "motion",
    VesselWind: "wind",
    Baseline: "baseline",
    Sighting: "sighting",
}
COMPONENTS: dict[Source, tuple[str, ...]] = {
    "imu": (),
    "attitude": ("roll_rad", "pitch_rad", "yaw_rad"),
    "gimbal": (),
    "velocity": ("forward_m_s", "right_m_s", "down_m_s"),
    "range": ("range_m",),
    "baro": ("height_m",),
    "vessel": ("north_m_s", "east_m_s", "down_m_s", "heading_rad", "turn_rad_s"),
    "fix": (),
    "status": (),
    "motion": ("roll_rad", "pitch_rad", "heave_m"),
    "wind": (),
    "baseline": ("x_m", "y_m", "z_m"),
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
        return SOURCES[type(event)]
    except KeyError:
        raise TypeError(f"a measurement is a sample or a sighting, not {type(event).__name__}") from None


def uncompared(path: PathName, event: Sample | Sighting, verdict: Verdict) -> FusionResult:
    """Return the result of a measurement that a path compares with no prediction."""
    return FusionResult(path, source_of(event), verdict, event.stamp.measured_at, event.stamp.received_at)


def components_of(source: Source, size: int) -> tuple[str, ...]:
    """Return the names of the components of an innovation of `size` numbers whose components are the source's first ones."""
    return POSE_COMPONENTS if source == "sighting" and size == len(POSE_COMPONENTS) else COMPONENTS[source][:size]
