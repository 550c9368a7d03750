"""The true state of a simulated flight: its contacts and its rendered frames with what is wrong with them."""

import math
from typing import Literal

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.time import MonoNs
from sitl.vehicle.vehicle import VehiclePhase


class Touchdown(Struct, frozen=True, eq=False):
    """A contact with the deck or the water after 0.3 s or more in the air; shorter hops belong to the contact before."""

    at: MonoNs
    surface: Literal["pad", "deck", "water"]
    """`pad` where the body's origin is over the pad's disc, `deck` beside it."""
    p_body_pad: F64
    """(3,) position of the body's origin in the pad frame, m."""
    lateral_m: float
    """Distance from the pad's centre, along the deck."""
    yaw_rad: float
    """Heading relative to the arrow, clockwise from above."""
    vertical_speed_m_s: float
    """Closing speed into the deck (into the water's mean level)."""
    lateral_speed_m_s: float
    """Speed along the deck, relative to the deck."""
    phase: VehiclePhase = VehiclePhase.LANDING
    """The vehicle's phase just before the contact."""
    motors: bool = True
    """True if its motors were turning just before."""
    guidance_phase: str | None = None
    """Phase of guidance just before the contact; None if not known."""

    @property
    def on_pad(self) -> bool:
        """True if it is on the pad."""
        return self.surface == "pad"


class RenderedFrame(Struct, frozen=True, eq=False):
    """One rendered frame."""

    px: NDArray[np.uint8]
    """(H, W, 3) BGR image."""
    exposed_at: MonoNs
    """Instant of the middle of the exposure."""
    exposure_s: float
    stamp_error_s: float = 0.0
    """Error of the stamp that is sent with the frame, s: the stamp minus `exposed_at`."""
    true_view: bool = True
    """True if the frame shows what the camera truly saw at `exposed_at`."""
    gain: float = 0.0
    """Amplification of a camera whose exposure is driven; else 0."""


class Truth(Struct, frozen=True, eq=False):
    """The true state of the world at one instant."""

    at: MonoNs
    p_body_ned: F64
    """(3,) position of the body, m."""
    v_body_ned: F64
    """(3,) velocity of the body, m/s."""
    R_ned_body: Rotation
    p_pad_ned: F64
    """(3,) position of the pad's centre, m."""
    v_pad_ned: F64
    """(3,) velocity of the pad's centre, m/s."""
    R_ned_pad: Rotation
    phase: VehiclePhase
    touchdown: Touchdown | None
    """The newest contact."""
    contacts: tuple[Touchdown, ...] = ()
    """All contacts so far, in order."""
    a_body_ned: F64 = field(default_factory=lambda: np.zeros(3))
    """(3,) acceleration of the body, m/s^2."""
    w_body: F64 = field(default_factory=lambda: np.zeros(3))
    """(3,) turn rates of the body, rad/s."""

    def _level(self, v_ned: F64) -> F64:
        yaw = self.R_ned_body.rpy_rad[2]
        c, s = math.cos(yaw), math.sin(yaw)
        north, east, down = v_ned.tolist()
        return np.array([c * north + s * east, c * east - s * north, down])

    @property
    def d_body_pad_level(self) -> F64:
        """(3,) vector from the body's origin to the pad's centre, m forward, right, down."""
        return self._level(self.p_pad_ned - self.p_body_ned)

    @property
    def v_pad_level(self) -> F64:
        """(3,) velocity of the pad minus that of the body, m/s."""
        return self._level(self.v_pad_ned - self.v_body_ned)

    @property
    def yaw_rad(self) -> float:
        """Heading of the body relative to the arrow, clockwise from above, rad, (-pi, pi]."""
        return wrap_pi(self.R_ned_body.rpy_rad[2] - self.R_ned_pad.rpy_rad[2])
