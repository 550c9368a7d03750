"""Contact forces of a moving deck, and buoyancy in the water."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sitl.sea.spectra import GRAVITY_M_S2
from sitl.vehicle.airframe import Airframe
from sitl.vessel.contact import DeckShape, Ground, Rows
from tests.sitl.oracle.algebra import Vec, clip, cross, inverse_rotate, rotate, rpy_of, where

DEEPEST_M = 0.3


def coverage(shape: DeckShape, x: float, y: float, radius_m: float) -> float:
    """Return the share of a disc about a point of the pad's plane that lies over the deck.

    It is exact along a straight edge; at a corner the shares of the two edges are multiplied.
    """
    c, s, middle, half = shape.turned
    along = c * x - s * y
    across = s * x + c * y - middle
    fore: float = shape.fore_m
    if shape.taper_m > 0.0:
        aside = clip(across / half, -1.0, 1.0)
        fore = shape.fore_m - shape.taper_m * (aside * aside) ** 1.1
    share: float = 1.0
    for inside in (fore - along, along + shape.aft_m, half - across, half + across):
        d = clip(inside / radius_m, -1.0, 1.0)
        share = share * (0.5 + (d * math.sqrt(1.0 - d * d) + math.asin(d)) / math.pi)
    return share


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
    def height(self) -> float:
        """Height over the deck's plane, m."""
        return -self.d[2]

    def yaw(
        self,
    ) -> float:
        return rpy_of(self.R)[2]


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
    touching: float
    """Number of feet or corners in contact."""


def contact_force(shape: DeckShape, airframe: Airframe, r: Relative, step_s: float) -> ContactForce:
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
    fx: float = 0.0
    fy: float = 0.0
    fz: float = 0.0
    tx: float = 0.0
    ty: float = 0.0
    tz: float = 0.0
    touching: float = 0.0
    b = feet.half_base_m
    corners = [(b, b, feet.below_m), (b, -b, feet.below_m), (-b, b, feet.below_m), (-b, -b, feet.below_m)]
    if bool(r.R[2][2] < 0.7):
        corners += [(x, y, -feet.top_m) for x, y, _ in corners]
    for corner in corners:
        arm = rotate(r.R, corner)
        slip = cross(r.w, arm)
        vx, vy, vz = r.v[0] + slip[0], r.v[1] + slip[1], r.v[2] + slip[2]
        deep = r.d[2] + arm[2]
        down = (deep > 0.0) & (deep < DEEPEST_M) & shape.holds(r.d[0] + arm[0], r.d[1] + arm[1])
        normal = where(down, clip(k * deep + c * vz, 0.0, 1e6), 0.0)
        speed = math.sqrt(vx * vx + vy * vy)
        grip = clip(stop * speed, 0.0, feet.friction * normal) / clip(speed, 1e-9, 1e9)
        nx, ny, nz = -grip * vx, -grip * vy, -normal
        fx, fy, fz = fx + nx, fy + ny, fz + nz
        tx, ty, tz = tx + arm[1] * nz - arm[2] * ny, ty + arm[2] * nx - arm[0] * nz, tz + arm[0] * ny - arm[1] * nx
        touching = touching + where(down, 1.0, 0.0)
    return ContactForce((fx, fy, fz), (tx, ty, tz), touching)


def buoyancy(airframe: Airframe, wet: bool, depth: float, v: Vec, w: Vec, sea_vz: float) -> tuple[Vec, Vec]:
    """Return the acceleration in ned and the torque in body of a vehicle that lies `depth` m deep in the water.

    The vehicle is full of foam, so it is buoyant, and it is heavily damped.
    """
    up = clip(depth / 0.06, 0.0, 3.0) * GRAVITY_M_S2
    ix, iy, iz = airframe.inertia_kg_m2
    return (
        (where(wet, -6.0 * v[0], 0.0), where(wet, -6.0 * v[1], 0.0), where(wet, -up - 12.0 * (v[2] - sea_vz), 0.0)),
        (where(wet, -8.0 * ix * w[0], 0.0), where(wet, -8.0 * iy * w[1], 0.0), where(wet, -8.0 * iz * w[2], 0.0)),
    )
