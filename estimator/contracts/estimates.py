"""What we conclude: where the pad is, how sure we are, and what became of each input."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Literal

import numpy as np

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import _covariance, _vector
from estimator.contracts.time import MonoNs, Stamp

Method = Literal["ellipse", "arrow", "corners", "registration", "marker", "selected", "fused"]
PathName = Literal["median_mean", "dead_reckoning", "ekf"]

UNKNOWN_YAW_VAR = math.pi**2 / 3.0
"""rad^2, variance of a heading that could be anything: uniform over the circle."""


class Verdict(Enum):
    """What became of one input. Every frame and every measurement ends in exactly one."""

    FUSED = "fused"
    GATED = "gated"
    """Implausible against the belief."""
    TOO_OLD = "too_old"
    TOO_NEW = "too_new"
    SINGULAR = "singular"
    NO_PAD = "no_pad"
    """A frame in which no pad was found."""
    REPLACED = "replaced"
    """A frame that a newer one overtook before anyone looked at it."""
    NO_ATTITUDE = "no_attitude"
    """A frame whose exposure no attitude sample covers."""
    FAILED = "failed"
    """A frame that could not be read or processed."""
    REPEATED = "repeated"
    """A frame whose pixels are those of an earlier one: it tells nothing new of the world, whatever its stamp says."""
    FROZEN = "frozen"
    """A reading that has not changed by one bit for longer than its sensor can hold still, or a pad that stands still in the
    image while the body turns."""
    IMPOSSIBLE = "impossible"
    """A reading beyond what the vehicle can do, or a step that it cannot make."""
    ELSEWHERE = "elsewhere"
    """A sighting at a place that no motion explains: another pad, until the track is given up for it."""


class Doubt(Enum):
    """Why an estimate must not be descended by, as told to the operator."""

    CAMERA_FROZEN = "the camera repeats its frames"
    VIEW_FROZEN = "the pad stands still in the image while the body turns"
    IMU_FROZEN = "the IMU repeats its readings"
    ATTITUDE_FROZEN = "the attitude repeats its readings"
    STAMPS = "the stamps of the frames do not hold"
    ELSEWHERE = "a pad is seen in another place"
    RANGE = "the range sensor contradicts the camera"
    HEIGHT = "the barometer contradicts the camera"


@dataclass(frozen=True, slots=True, eq=False)
class Feature:
    """Something a method saw, in pixels, for frames and records; no estimate is computed from it."""

    kind: Literal["ellipse", "point", "line", "outline"]
    label: str
    uv_px: F64
    """(N, 2); an ellipse is given as its outline."""


@dataclass(frozen=True, slots=True, eq=False)
class Pose6:
    """The whole pose of the pad, where a method knows it."""

    d_body_pad_level: F64
    """(3,) m."""
    R_level_pad: Rotation
    cov: F64
    """(6, 6): [d_body_pad_level (m), small rotation of the pad written in `level` (rad)]."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "d_body_pad_level", _vector("Pose6.d_body_pad_level", self.d_body_pad_level, (3,)))
        object.__setattr__(self, "cov", _covariance("Pose6.cov", self.cov, 6))


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """One look at the pad: the vector from the body's origin to the pad's centre, written in `level`, and the heading."""

    stamp: Stamp
    seq: int
    method: Method
    d_body_pad_level: F64
    """(3,) m forward, right, down."""
    yaw_rad: float | None
    """Heading of the body against the arrow, clockwise from above positive, (-pi, pi]; None when the frame does not tell."""
    yaw_ambiguous: bool
    """The heading may as well be 180 degrees away (an H alone)."""
    cov: F64
    """(4, 4) of [forward, right, down, yaw] in m and rad; an unknown yaw has `UNKNOWN_YAW_VAR`."""
    confidence: float
    """0..1: how probable it is that this is the pad and the estimate holds its covariance."""
    pose6: Pose6 | None = None
    features: tuple[Feature, ...] = field(default=())

    def __post_init__(self) -> None:
        object.__setattr__(self, "d_body_pad_level", _vector("Sighting.d_body_pad_level", self.d_body_pad_level, (3,)))
        object.__setattr__(self, "cov", _covariance("Sighting.cov", self.cov, 4))
        if self.yaw_rad is not None and not -math.pi <= self.yaw_rad <= math.pi:
            raise ValueError(f"Sighting.yaw_rad must lie in (-pi, pi], got {self.yaw_rad}")
        if not 0.0 <= self.confidence <= 1.0:
            raise ValueError(f"Sighting.confidence must lie in [0, 1], got {self.confidence}")


@dataclass(frozen=True, slots=True, eq=False)
class RelativeState:
    """The belief about the pad at one instant: what guidance steers by."""

    at: MonoNs
    path: PathName
    d_body_pad_level: F64
    """(3,) m forward, right, down."""
    v_pad_level: F64
    """(3,) m/s, rate of `d_body_pad_level` seen without rotating: velocity of the pad less that of the body."""
    yaw_rad: float | None
    """Heading of the body against the arrow; None while it was never known."""
    cov: F64
    """(7, 7) of [d (3), v (3), yaw]."""
    sighted: MonoNs
    """When the newest fused sighting was true."""
    consistent: bool
    """Whether recent innovations agree with the covariance claimed."""
    details: tuple[tuple[str, float], ...] = field(default=())
    """Named figures of the path for records and frames (biases, gates): never steered by."""
    track: int = 0
    """Number of the pad that it is about; it goes up when the track is given up for a place that no motion explains."""
    doubts: tuple[Doubt, ...] = field(default=())
    """The reasons not to descend by it now; `consistent` is False while there is any."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "d_body_pad_level", _vector("RelativeState.d_body_pad_level", self.d_body_pad_level, (3,)))
        object.__setattr__(self, "v_pad_level", _vector("RelativeState.v_pad_level", self.v_pad_level, (3,)))
        object.__setattr__(self, "cov", _covariance("RelativeState.cov", self.cov, 7))

    @property
    def height_m(self) -> float:
        """Height of the body's origin over the pad's centre."""
        return float(self.d_body_pad_level[2])

    @property
    def lateral_m(self) -> float:
        """Horizontal distance between body and pad centre."""
        return float(np.hypot(self.d_body_pad_level[0], self.d_body_pad_level[1]))

    def age_s(self, now: MonoNs) -> float:
        """Seconds since the newest fused sighting was true."""
        return (now - self.sighted) * 1e-9
