"""The true state of a simulated flight: its contacts and its rendered frames with what is wrong with them."""

import math
from typing import Literal

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.time import MonoNs
from sitl.vehicle.vehicle import SEA, Vehicle, VehiclePhase

Surface = Literal["pad", "deck", "water"]


class Touchdown(Struct, frozen=True, eq=False):
    """A contact with the deck or the water after 0.3 s or more in the air; shorter hops belong to the contact before."""

    at: MonoNs
    surface: Surface
    """`pad` where all feet are over the pad's disc, `deck` where one is beside it."""
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
    phase: VehiclePhase | None = VehiclePhase.LANDING
    """The vehicle's phase just before the contact; None if not known."""
    motors: bool | None = True
    """True if its motors were turning just before; None if not known."""
    guidance_phase: str | None = None
    """Phase of guidance just before the contact; None if not known."""
    centre_on_pad: bool = False
    """True if the body's origin is over the pad's disc, whatever its feet are."""
    tilt_rad: float = 0.0
    """Tilt against the deck."""
    over_rim_m: float = 0.0
    """Distance by which the farthest foot is beyond the pad's rim, negative inside it."""
    foot_speed_m_s: float = 0.0
    """Closing speed into the deck of the fastest foot that touches, by the motion just before."""

    @property
    def on_pad(self) -> bool:
        """True if it is on the pad."""
        return self.surface == "pad"


_TOUCHES_M = 0.01
"""Height over the deck up to which a foot counts as touching at the step of a contact, m: a tenth of a degree, or 1 m/s."""


def touchdown_of(
    vehicle: Vehicle, at: MonoNs, disc_radius_m: float, phase: VehiclePhase, guidance_phase: str | None, *, motors: bool
) -> Touchdown:
    """Return the newest contact of a vehicle; all but the vehicle is as in `Touchdown`."""
    d, v, w = np.array(vehicle.touched_d), np.array(vehicle.touched_v), np.array(vehicle.touched_w)
    R = np.array(vehicle.touched_rows).reshape(3, 3)
    arms = vehicle.airframe.feet.corners_m @ R.T
    feet, lateral_m = d + arms, math.hypot(d[0], d[1])
    over_rim_m = float(np.hypot(feet[:, 0], feet[:, 1]).max()) - disc_radius_m
    touching = feet[:, 2] >= feet[:, 2].max() - _TOUCHES_M
    on_deck: Surface = "pad" if over_rim_m <= 0.0 else "deck"
    return Touchdown(
        at=at,
        surface="water" if vehicle.touched_what == SEA else on_deck,
        p_body_pad=d,
        lateral_m=lateral_m,
        yaw_rad=math.atan2(R[1, 0], R[0, 0]),
        vertical_speed_m_s=float(v[2]),
        lateral_speed_m_s=math.hypot(v[0], v[1]),
        phase=phase,
        motors=motors,
        guidance_phase=guidance_phase,
        centre_on_pad=vehicle.touched_what != SEA and lateral_m <= disc_radius_m,
        tilt_rad=math.atan2(math.hypot(R[0, 2], R[1, 2]), R[2, 2]),
        over_rim_m=over_rim_m,
        foot_speed_m_s=float((v + np.cross(w, arms))[touching, 2].max()),
    )


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
    battery: float = 1.0
    """Charge of the battery, 0..1."""
    w_pad: F64 = field(default_factory=lambda: np.zeros(3))
    """(3,) turn rates of the pad in its own axes, rad/s."""

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
