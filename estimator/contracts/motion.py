"""Motion of the body and the deck at one instant: answers of a filter that knows more than the pad's place."""

import math

from msgspec import Struct
from msgspec.structs import force_setattr

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import checked_covariance, checked_vector
from estimator.contracts.time import MonoNs

G_M_S2 = 9.80665  # Standard gravity


class BodyMotion(Struct, frozen=True, eq=False):
    """The body's acceleration, attitude and turn rates at one instant. Axes are those of `level` at `at`."""

    at: MonoNs
    heading_rad: float
    """The heading of `level` against the filter's north, rad: it shows how far the axes have turned between two instants."""
    a_level: F64
    """Acceleration of the body, (3,) m/s^2 forward, right, down: levelled, without gravity and without the sensor's bias."""
    cov_a_level: F64
    """Its covariance, (3, 3)."""
    w_body: F64
    """Turn rates without the sensor's bias, (3,) rad/s in `body`."""
    reported: Rotation
    """R_ned_body as the vehicle itself reports it: a commanded tilt is a tilt by this attitude, with its errors."""
    cov_reported: F64
    """Covariance of the reported attitude's error, (3, 3) rad^2 in `body`."""

    def __post_init__(self) -> None:
        force_setattr(self, "a_level", checked_vector("BodyMotion.a_level", self.a_level))
        force_setattr(self, "w_body", checked_vector("BodyMotion.w_body", self.w_body))
        force_setattr(self, "cov_a_level", checked_covariance("BodyMotion.cov_a_level", self.cov_a_level, 3, estimated=True))
        force_setattr(self, "cov_reported", checked_covariance("BodyMotion.cov_reported", self.cov_reported, 3, estimated=True))

    @property
    def lean_m_s2(self) -> tuple[float, float]:
        """The reported tilt as the acceleration that hovering thrust gives with it, m/s^2 forward and right."""
        x, y, z = self.reported.matrix[2].tolist()
        # Of R = Rz(yaw) Ry(pitch) Rx(roll) the last row is (-sin pitch, cos pitch sin roll, cos pitch cos roll).
        cos_pitch = math.sqrt(max(1e-9, 1.0 - x**2))
        return G_M_S2 * x / cos_pitch, G_M_S2 * y / (max(1e-3, z) * cos_pitch)


class DeckMotion(Struct, frozen=True, eq=False):
    """The motion of the pad's centre over the ground, and the deck's tilt, at one instant. Axes are those of `level` at `at`."""

    at: MonoNs
    v_level: F64
    """Velocity, (3,) m/s forward, right, down: the vessel's way and the waves."""
    a_level: F64
    """Acceleration, (3,) m/s^2."""
    cov_level: F64
    """Covariance of velocity and acceleration, (6, 6)."""
    roll_rad: float
    """Roll of the deck about the arrow, starboard down positive."""
    pitch_rad: float
    """Pitch of the deck, arrow up positive."""
    roll_rate_rad_s: float
    pitch_rate_rad_s: float
    cov_tilt: F64
    """Covariance of roll, pitch and their rates, (4, 4)."""

    def __post_init__(self) -> None:
        force_setattr(self, "v_level", checked_vector("DeckMotion.v_level", self.v_level))
        force_setattr(self, "a_level", checked_vector("DeckMotion.a_level", self.a_level))
        force_setattr(self, "cov_level", checked_covariance("DeckMotion.cov_level", self.cov_level, 6, estimated=True))
        force_setattr(self, "cov_tilt", checked_covariance("DeckMotion.cov_tilt", self.cov_tilt, 4, estimated=True))

    @property
    def tilt_rad(self) -> float:
        """The angle between the deck and the horizon, rad."""
        return math.acos(max(-1.0, min(1.0, math.cos(self.roll_rad) * math.cos(self.pitch_rad))))
