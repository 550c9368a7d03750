"""Contact forces of a moving deck, and buoyancy in the water, for a vehicle that touches them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimator.contracts.geometry import F64
from sitl.airframe import Airframe
from sitl.algebra import Flag, MathBackend, Num, Vec, cross, inverse_rotate, rotate, rpy_of
from sitl.sea import GRAVITY_M_S2

Rows = tuple[Vec, Vec, Vec]
DEEPEST_M = 0.3
"""Depth below the deck's plane beyond which a point is under the deck and not in contact. No fall reaches it in one step."""


@dataclass(frozen=True)
class DeckShape:
    """Outline of the deck around the pad's centre: a rectangle in the hull's axes whose fore end may taper to the stem."""

    fore_m: float
    aft_m: float
    port_m: float
    starboard_m: float
    taper_m: float = 0.0
    """Length over which the fore end tapers as in `sitl.surroundings.Deck.outline`, m; 0 for a square end."""
    pad_yaw_rad: float = 0.0
    """Angle of the arrow from the hull's axis, clockwise from above, rad."""

    def __post_init__(self) -> None:
        sides = (self.fore_m, self.aft_m, self.port_m, self.starboard_m)
        if not all(math.isfinite(s) for s in sides) or self.fore_m + self.aft_m <= 0 or self.port_m + self.starboard_m <= 0:
            raise ValueError(f"a deck needs a length and a width, got fore, aft, port, starboard = {sides}")

    @cached_property
    def _turned(self) -> tuple[float, float, float, float]:
        """Cosine and sine of the arrow's angle, and the middle and the half of the width, m."""
        middle, half = 0.5 * (self.starboard_m - self.port_m), 0.5 * (self.starboard_m + self.port_m)
        return math.cos(self.pad_yaw_rad), math.sin(self.pad_yaw_rad), middle, half

    def holds(self, x: Num, y: Num) -> Flag:
        """Return whether a point of the pad's plane (m along the arrow, m to starboard of it) lies on the deck."""
        c, s, middle, half = self._turned
        along = c * x - s * y
        across = s * x + c * y - middle
        inside = (along >= -self.aft_m) & (along <= self.fore_m) & (across <= half) & (across >= -half)
        if self.taper_m > 0.0:
            share = across / half
            inside = inside & (along <= self.fore_m - self.taper_m * (share * share) ** 1.1)
        return inside

    def coverage(self, m: MathBackend, x: Num, y: Num, radius_m: float) -> Num:
        """Return the share of a disc about a point of the pad's plane that lies over the deck.

        It is exact along a straight edge; at a corner the shares of the two edges are multiplied.
        """
        c, s, middle, half = self._turned
        along = c * x - s * y
        across = s * x + c * y - middle
        fore: Num = self.fore_m
        if self.taper_m > 0.0:
            aside = m.clip(across / half, -1.0, 1.0)
            fore = self.fore_m - self.taper_m * (aside * aside) ** 1.1
        share: Num = 1.0
        for inside in (fore - along, along + self.aft_m, half - across, half + across):
            d = m.clip(inside / radius_m, -1.0, 1.0)
            share = share * (0.5 + (d * m.sqrt(1.0 - d * d) + m.asin(d)) / math.pi)
        return share


@dataclass(slots=True)
class Ground:
    """The pad's frame (which is also the deck's) and the water under the vehicle at one instant."""

    p: Vec
    """Position of the pad's centre in ned, m."""
    v: Vec
    """Velocity of the pad's centre in ned, m/s."""
    R: Rows
    """Rows of R_ned_pad."""
    w: Vec
    """Angular velocity in the pad frame, rad/s."""
    sea_z: Num = 0.0
    """Height of the water's surface under the vehicle, m down."""
    sea_vz: Num = 0.0
    """Velocity of the water's surface under the vehicle, m/s down."""

    @staticmethod
    def of(p_ned: F64, v_ned: F64, R_ned_pad: F64, w_pad: F64, sea_z: Num = 0.0, sea_vz: Num = 0.0) -> Ground:
        """Return the ground for arrays (3,), (3,), (3, 3), (3,), or the same with a leading batch axis."""
        if p_ned.ndim == 1:
            a, b, c = R_ned_pad.tolist()
            return Ground(tuple(p_ned.tolist()), tuple(v_ned.tolist()), (tuple(a), tuple(b), tuple(c)), tuple(w_pad.tolist()),
                          sea_z, sea_vz)  # fmt: skip
        p, v, w = (np.ascontiguousarray(np.moveaxis(x, -1, 0)) for x in (p_ned, v_ned, w_pad))
        R = np.ascontiguousarray(np.moveaxis(R_ned_pad, (-2, -1), (0, 1)))
        rows = ((R[0, 0], R[0, 1], R[0, 2]), (R[1, 0], R[1, 1], R[1, 2]), (R[2, 0], R[2, 1], R[2, 2]))
        return Ground((p[0], p[1], p[2]), (v[0], v[1], v[2]), rows, (w[0], w[1], w[2]), sea_z, sea_vz)

    @staticmethod
    def nowhere() -> Ground:
        """Return a ground without deck or water within reach, for flights that meet neither."""
        far = 1e6
        return Ground((0.0, 0.0, far), (0.0,) * 3, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0,) * 3, far)


@dataclass(slots=True)
class Relative:
    """The body's motion relative to the deck, in the pad frame."""

    d: Vec
    """Vector from the pad's centre to the body's origin, m."""
    v: Vec
    """Velocity relative to the deck at that place, m/s."""
    R: Rows
    """Rows of R_pad_body."""
    w: Vec
    """Angular velocity relative to the deck, rad/s."""

    @property
    def height(self) -> Num:
        """Height over the deck's plane, m."""
        return -self.d[2]

    def yaw(self, m: MathBackend) -> Num:
        return rpy_of(m, self.R)[2]


def relative(ground: Ground, p: Vec, v: Vec, body: Rows, w_body: Vec) -> Relative:
    """Return the relative motion of a body at `p` with velocity `v` (ned), R_ned_body `body` and rates `w_body`."""
    d = inverse_rotate(ground.R, (p[0] - ground.p[0], p[1] - ground.p[1], p[2] - ground.p[2]))
    u = inverse_rotate(ground.R, (v[0] - ground.v[0], v[1] - ground.v[1], v[2] - ground.v[2]))
    carried = cross(ground.w, d)
    columns = [inverse_rotate(ground.R, (body[0][i], body[1][i], body[2][i])) for i in (0, 1, 2)]
    e, f, g = columns
    R = ((e[0], f[0], g[0]), (e[1], f[1], g[1]), (e[2], f[2], g[2]))
    t = rotate(R, w_body)
    return Relative(
        d,
        (u[0] - carried[0], u[1] - carried[1], u[2] - carried[2]),
        R,
        (t[0] - ground.w[0], t[1] - ground.w[1], t[2] - ground.w[2]),
    )


@dataclass(slots=True)
class ContactForce:
    """The force and torque that the feet exert on the body."""

    force: Vec
    """Force in the pad frame, N."""
    torque: Vec
    """Torque about the body's origin in the pad frame, N m."""
    touching: Num
    """Number of feet or corners in contact."""


def contact_force(m: MathBackend, shape: DeckShape, airframe: Airframe, r: Relative, step_s: float) -> ContactForce:
    """Return the contact force of the deck on the body.

    A spring and a damper act normal to the deck under each foot (and each upper corner of a body on its side), and friction acts
    along the deck. The friction would stop the foot within a few steps, but is at most the coefficient times the normal force: it
    neither chatters nor depends on a made-up slip speed. It cannot hold a body still on a slope for ever, so `Vehicle` ties a
    resting body to the deck.
    """
    feet = airframe.feet
    k = feet.stiffness_n_m / 4.0
    c = 2.0 * feet.damping_ratio * math.sqrt(feet.stiffness_n_m * airframe.mass_kg) / 4.0
    stop = 0.3 * airframe.mass_kg / (4.0 * step_s)
    fx: Num = 0.0
    fy: Num = 0.0
    fz: Num = 0.0
    tx: Num = 0.0
    ty: Num = 0.0
    tz: Num = 0.0
    touching: Num = 0.0
    b = feet.half_base_m
    corners = [(b, b, feet.below_m), (b, -b, feet.below_m), (-b, b, feet.below_m), (-b, -b, feet.below_m)]
    if m.any(r.R[2][2] < 0.7):
        corners += [(x, y, -feet.top_m) for x, y, _ in corners]
    for corner in corners:
        arm = rotate(r.R, corner)
        slip = cross(r.w, arm)
        vx, vy, vz = r.v[0] + slip[0], r.v[1] + slip[1], r.v[2] + slip[2]
        deep = r.d[2] + arm[2]
        down = (deep > 0.0) & (deep < DEEPEST_M) & shape.holds(r.d[0] + arm[0], r.d[1] + arm[1])
        normal = m.where(down, m.clip(k * deep + c * vz, 0.0, 1e6), 0.0)
        speed = m.sqrt(vx * vx + vy * vy)
        grip = m.clip(stop * speed, 0.0, feet.friction * normal) / m.clip(speed, 1e-9, 1e9)
        nx, ny, nz = -grip * vx, -grip * vy, -normal
        fx, fy, fz = fx + nx, fy + ny, fz + nz
        tx, ty, tz = tx + arm[1] * nz - arm[2] * ny, ty + arm[2] * nx - arm[0] * nz, tz + arm[0] * ny - arm[1] * nx
        touching = touching + m.where(down, 1.0, 0.0)
    return ContactForce((fx, fy, fz), (tx, ty, tz), touching)


def buoyancy(m: MathBackend, airframe: Airframe, wet: Flag, depth: Num, v: Vec, w: Vec, sea_vz: Num) -> tuple[Vec, Vec]:
    """Return the acceleration in ned and the torque in body of a vehicle that lies `depth` m deep in the water.

    The vehicle is full of foam, so it is buoyant, and it is heavily damped.
    """
    up = m.clip(depth / 0.06, 0.0, 3.0) * GRAVITY_M_S2
    ix, iy, iz = airframe.inertia_kg_m2
    return (
        (m.where(wet, -6.0 * v[0], 0.0), m.where(wet, -6.0 * v[1], 0.0), m.where(wet, -up - 12.0 * (v[2] - sea_vz), 0.0)),
        (m.where(wet, -8.0 * ix * w[0], 0.0), m.where(wet, -8.0 * iy * w[1], 0.0), m.where(wet, -8.0 * iz * w[2], 0.0)),
    )
