"""The vehicle's step in plain floats: body, inner loops, contact, rest."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from sitl.sea.spectra import GRAVITY_M_S2
from sitl.vehicle.airframe import Airframe, StickLimits
from sitl.vehicle.disturbances import Wind
from sitl.vehicle.rotors import rotors
from sitl.vehicle.vehicle import DECK, SEA, VehiclePhase
from sitl.vessel.air import AirModel
from sitl.vessel.contact import DeckShape, Ground, Rows
from tests.sitl.oracle.air import Air
from tests.sitl.oracle.algebra import (
    Vec,
    clip,
    cross,
    inverse_rotate,
    product,
    quaternion_of_rpy,
    rotate,
    rotation_of,
    rpy_of,
    where,
)
from tests.sitl.oracle.contact import DEEPEST_M, Relative, buoyancy, contact_force, relative
from tests.sitl.oracle.disturbances import Disturbances
from tests.sitl.oracle.rotors import Thrusts, delivered, ground_effect, ground_effect_by_rotor, thrusts
from tests.sitl.oracle.torque_observer import TorqueObserver

Quaternion = tuple[float, float, float, float]
Command = tuple[float, float, float, float, bool]

_ZERO: Vec = (0.0, 0.0, 0.0)
_NONE: Command = (0.0, 0.0, 0.0, 0.0, False)


class PlainVehicle:
    """One vehicle, with the same numbers by the same names as `sitl.vehicle.vehicle.Vehicle`; its arguments are those too."""

    def __init__(
        self,
        airframe: Airframe,
        shape: DeckShape,
        step_s: float,
        seed: np.random.SeedSequence,
        wind: Wind | None = None,
        air: AirModel | None = None,
    ) -> None:
        self.airframe, self.shape, self.step_s = airframe, shape, step_s
        self.limits = StickLimits()
        self.wind = wind or Wind()
        self.extra_wind: Vec = _ZERO
        self._healthy: tuple[float, ...] = (1.0,) * len(rotors(airframe))
        self.rotor_health = self._healthy
        self.tilt_max_rad = airframe.loops.tilt_max_rad
        air_seed = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, 0xA12))
        self.air = None if air is None else Air(air, step_s, air_seed)
        self.current: tuple[float, float] = (0.0, 0.0)
        self.flow_works = True
        self._disturbances = Disturbances(self.wind, airframe.avionics, step_s, seed)
        self.seconds = 0.0
        av = airframe.avionics
        self._alpha = {s: 1.0 - math.exp(-step_s / s) if s > 0 else 1.0 for s in (airframe.motor_lag_s, av.flow_lag_s)}
        self.sticks: Command = _NONE
        self._pending = deque([_NONE] * round(airframe.command_delay_s / step_s))
        self.p = self.v = self.w = self.a = _ZERO
        self.q: Quaternion = (1.0, 0.0, 0.0, 0.0)
        self.thrust_n = 0.0
        self.torque_n_m: Vec = _ZERO
        self.flow: tuple[float, float] = (0.0, 0.0)
        self.integral: Vec = _ZERO
        self._unasked = TorqueObserver(airframe, step_s)
        self.z_hold = 0.0
        self.phase: float = VehiclePhase.LANDED
        self.tied = False
        self.attached_d: Vec = _ZERO
        self.attached_q: Quaternion = self.q
        self.contact_s = self.airborne_s = 0.0
        self.ditched = False
        self.touched_what = 0.0
        self.touched_s = self.touched_yaw = math.nan
        self.touched_d: Vec = (math.nan, math.nan, math.nan)
        self.touched_v: Vec = (math.nan, math.nan, math.nan)

    @property
    def tilt_error_rad(self) -> tuple[float, float]:
        return self._disturbances.tilt

    @property
    def rotors_n(self) -> Thrusts:
        return thrusts(self.airframe, self.thrust_n, self.torque_n_m)

    def step(self, ground: Ground) -> None:
        """Advance by `step_s` to the instant for which `ground` holds."""
        f, dt = self.airframe, self.step_s
        self.seconds += dt
        self._disturbances.step()
        self._pending.append(self.sticks)
        command = self._pending.popleft()
        rows = rotation_of(self.q)
        ahead = (self.p[0] + dt * self.v[0], self.p[1] + dt * self.v[1], self.p[2] + dt * self.v[2])
        r = relative(ground, ahead, self.v, rows, self.w)
        over = self.shape.holds(r.d[0], r.d[1]) & (r.d[2] < DEEPEST_M)
        height = where(over, -r.d[2], ground.sea_z - ahead[2])
        steered = (self.phase == VehiclePhase.HOVERING) | (self.phase == VehiclePhase.FLYING)
        self.phase = where(steered, where(command[4], (VehiclePhase.FLYING), (VehiclePhase.HOVERING)), self.phase)
        motors = (self.phase != VehiclePhase.LANDED) & (self.phase != VehiclePhase.EMERGENCY)
        self.tied = self.tied and not (motors)
        thrust, torque = self._loops(command, rows, r, over, ground)
        lag = self._alpha[f.motor_lag_s]
        self.thrust_n = self.thrust_n + lag * (where(motors, thrust, 0.0) - self.thrust_n)
        self.torque_n_m = _toward(
            self.torque_n_m,
            (where(motors, torque[0], 0.0), where(motors, torque[1], 0.0), where(motors, torque[2], 0.0)),
            lag,
        )
        lift, turn = self.thrust_n, self.torque_n_m
        if f.ground_effect == "rotors":
            cushion = ground_effect_by_rotor(f, self.shape, r, ground.sea_z - ahead[2])
            shares = tuple(h * k for h, k in zip(self.rotor_health, cushion, strict=True))
            lift, turn = delivered(f, lift, turn, shares)
        else:
            if self.rotor_health != self._healthy:
                lift, turn = delivered(f, lift, turn, self.rotor_health)
            lift = lift * ground_effect(f, height)

        g, u = self._disturbances.gust, self.extra_wind
        s: Vec = self.wind.v_ned
        if self.air is not None:
            s = self.air.step(ground, r, self.v, ground.sea_z - ahead[2], self.seconds)
        air = inverse_rotate(
            rows, (self.v[0] - g[0] - u[0] - s[0], self.v[1] - g[1] - u[1] - s[1], self.v[2] - g[2] - u[2] - s[2])
        )
        kx, ky, kz = f.drag_per_s
        accel = rotate(rows, (-kx * air[0], -ky * air[1], -kz * air[2] - lift / f.mass_kg))
        ax, ay, az = accel[0], accel[1], accel[2] + GRAVITY_M_S2
        touching: float = 0.0
        if bool(over & (height < 0.4)):
            contact = contact_force(self.shape, f, r, dt)
            touching = contact.touching
            force, moment = rotate(ground.R, contact.force), inverse_rotate(r.R, contact.torque)
            ax, ay, az = ax + force[0] / f.mass_kg, ay + force[1] / f.mass_kg, az + force[2] / f.mass_kg
            turn = (turn[0] + moment[0], turn[1] + moment[1], turn[2] + moment[2])
        depth = ahead[2] + f.feet.below_m - ground.sea_z
        wet = not over and depth > 0.0
        if bool(wet):
            b, t = buoyancy(f, wet, depth, self.v, self.w, ground.sea_vz)
            ax, ay, az = ax + b[0], ay + b[1], az + b[2]
            turn = (turn[0] + t[0], turn[1] + t[1], turn[2] + t[2])
        self._fly(ground, (ax, ay, az), turn)
        self._after(ground, r, rows, over, wet, touching, motors, height)

    def _loops(self, command: Command, rows: Rows, r: Relative, over: bool, ground: Ground) -> tuple[float, Vec]:
        """Thrust and torque asked for: stick or hover to attitude, attitude to torque, climb rate to thrust."""
        f, dt, limits = self.airframe, self.step_s, self.limits
        k, av = f.loops, f.avionics
        roll, pitch, gaz, yaw, _ = command
        flying = self.phase == VehiclePhase.FLYING
        c = clip(math.sqrt(rows[0][0] * rows[0][0] + rows[1][0] * rows[1][0]), 1e-6, 1.0)
        cos_psi, sin_psi = rows[0][0] / c, rows[1][0] / c
        error = self._disturbances.tilt
        phi = math.atan2(rows[2][1], rows[2][2]) + error[0]
        theta = math.atan2(-rows[2][0], c) + error[1]

        if self.flow_works:
            down = inverse_rotate(ground.R, (0.0, 0.0, 1.0))
            above = r.d[2] / down[2]
            below = (r.d[0] - above * down[0], r.d[1] - above * down[1], 0.0)
            carried = rotate(ground.R, cross(ground.w, below))
            seen = tuple(a - b - c for a, b, c in zip(self.v, ground.v, carried, strict=True))
            deck = over & av.flow_sees_deck
            noise = self._disturbances.flow
            current = self.current
            vx, vy = where(deck, seen[0], self.v[0] - current[0]), where(deck, seen[1], self.v[1] - current[1])
            measured_x = av.flow_scale * (cos_psi * vx + sin_psi * vy) + noise[0]
            measured_y = av.flow_scale * (cos_psi * vy - sin_psi * vx) + noise[1]
            lag = self._alpha[av.flow_lag_s]
            self.flow = (self.flow[0] + lag * (measured_x - self.flow[0]), self.flow[1] + lag * (measured_y - self.flow[1]))
        else:
            self.flow = (0.0, 0.0)
        ax, ay, az = self.a
        forward = cos_psi * ax + sin_psi * ay
        right = cos_psi * ay - sin_psi * ax
        ex, ey = -self.flow[0], -self.flow[1]
        top = k.velocity_i_max_m_s2
        gain = where(flying | (self.contact_s > 0.0), 0.0, k.velocity_i * dt)
        ix, iy = clip(self.integral[0] + gain * ex, -top, top), clip(self.integral[1] + gain * ey, -top, top)
        hold_x = k.velocity_p * ex - k.velocity_d * forward + ix
        hold_y = k.velocity_p * ey - k.velocity_d * right + iy
        top_tilt = self.tilt_max_rad
        tilt = min(limits.euler_angle_max_rad, top_tilt)
        phi_asked = where(flying, roll * tilt, clip(hold_y / GRAVITY_M_S2, -top_tilt, top_tilt))
        theta_asked = where(flying, pitch * tilt, clip(-hold_x / GRAVITY_M_S2, -top_tilt, top_tilt))
        rate_asked = where(flying, yaw * limits.yaw_rate_max_rad_s, 0.0)
        x_max, y_max, z_max = f.torque_max_n_m
        ix_, iy_, iz_ = f.inertia_kg_m2
        motors = (self.phase != VehiclePhase.LANDED) & (self.phase != VehiclePhase.EMERGENCY)
        ux, uy, uz = self._unasked.step(self.w, self.torque_n_m, motors & (self.contact_s <= 0.0))
        torque = (
            clip(ix_ * (k.tilt_p * (phi_asked - phi) - k.tilt_d * self.w[0] - ux), -x_max, x_max),
            clip(iy_ * (k.tilt_p * (theta_asked - theta) - k.tilt_d * self.w[1] - uy), -y_max, y_max),
            clip(iz_ * (k.yaw_rate_p * (rate_asked - self.w[2]) - uz), -z_max, z_max),
        )

        z, vz = self.p[2], self.v[2]
        holding = (self.phase == VehiclePhase.HOVERING) | (flying & (gaz < 1e-3) & (gaz > -1e-3))
        self.z_hold = where(holding, self.z_hold, z + 0.3 * vz)  # where it will have come to a stop
        hold = clip(k.height_p * (self.z_hold - z), -limits.vz_max_m_s, limits.vz_max_m_s)
        own = where(self.phase == VehiclePhase.LANDING, f.landing_speed_m_s, -f.take_off_speed_m_s)
        descent_rate_demand = where(holding, hold, where(flying, -gaz * limits.vz_max_m_s, own))
        e = descent_rate_demand - vz
        gain = where((self.contact_s > 0.0) | (self.phase == VehiclePhase.LANDED), 0.0, k.climb_i * dt)
        iz = clip(self.integral[2] + gain * e, -k.climb_i_max_m_s2, k.climb_i_max_m_s2)
        self.integral = (ix, iy, iz)
        descent_acceleration = k.climb_p * e - k.climb_d * az + iz
        thrust = f.mass_kg * (GRAVITY_M_S2 - descent_acceleration) / clip(rows[2][2], 0.5, 1.0)
        return clip(thrust, 0.0, f.thrust_max_n), torque

    def _fly(self, ground: Ground, a: Vec, turn: Vec) -> None:
        """Newton and Euler over one step; a tied body goes with the deck instead."""
        dt = self.step_s
        p, v, w, q = self.p, self.v, self.w, self.q
        v1: Vec = (v[0] + dt * a[0], v[1] + dt * a[1], v[2] + dt * a[2])
        h = 0.5 * dt
        p1: Vec = (p[0] + h * (v[0] + v1[0]), p[1] + h * (v[1] + v1[1]), p[2] + h * (v[2] + v1[2]))
        ix, iy, iz = self.airframe.inertia_kg_m2
        wx = w[0] + dt / ix * (turn[0] - (iz - iy) * w[1] * w[2])
        wy = w[1] + dt / iy * (turn[1] - (ix - iz) * w[2] * w[0])
        wz = w[2] + dt / iz * (turn[2] - (iy - ix) * w[0] * w[1])
        rate = math.sqrt(wx * wx + wy * wy + wz * wz) + 1e-12
        s = math.sin(h * rate) / rate
        q1 = product(q, (math.cos(h * rate), s * wx, s * wy, s * wz))
        size = 1.0 / math.sqrt(q1[0] * q1[0] + q1[1] * q1[1] + q1[2] * q1[2] + q1[3] * q1[3])
        q1 = (q1[0] * size, q1[1] * size, q1[2] * size, q1[3] * size)
        w1: Vec = (wx, wy, wz)
        tied = self.tied
        if bool(tied):
            cp, cv, cq, cw = self._carried(ground)
            p1, v1, w1 = _pick(tied, cp, p1), _pick(tied, cv, v1), _pick(tied, cw, w1)
            q1 = (
                where(tied, cq[0], q1[0]),
                where(tied, cq[1], q1[1]),
                where(tied, cq[2], q1[2]),
                where(tied, cq[3], q1[3]),
            )
        i = 1.0 / dt
        self.a = (i * (v1[0] - v[0]), i * (v1[1] - v[1]), i * (v1[2] - v[2]))
        self.p, self.v, self.w, self.q = p1, v1, w1, q1

    def _carried(self, ground: Ground) -> tuple[Vec, Vec, Quaternion, Vec]:
        """p, v, q, w of a body tied to the deck."""
        d = rotate(ground.R, self.attached_d)
        u = rotate(ground.R, cross(ground.w, self.attached_d))
        q = product(quaternion_of_rpy(*rpy_of(ground.R)), self.attached_q)
        return (
            (ground.p[0] + d[0], ground.p[1] + d[1], ground.p[2] + d[2]),
            (ground.v[0] + u[0], ground.v[1] + u[1], ground.v[2] + u[2]),
            q,
            inverse_rotate(rotation_of(self.attached_q), ground.w),
        )

    def _after(
        self, ground: Ground, r: Relative, rows: Rows, over: bool, wet: bool, touching: float, motors: bool, height: float
    ) -> None:
        """Timers, record of the contact, resting, changes of phase."""
        f, dt = self.airframe, self.step_s
        supported = (touching > 0.0) | self.tied
        if bool(supported | wet):
            first = (supported | wet) & (self.airborne_s > 0.3)
            if bool(first):
                self.touched_what = where(first, where(wet, SEA, DECK), self.touched_what)
                self.touched_s = where(first, self.seconds, self.touched_s)
                self.touched_d, self.touched_v = _pick(first, r.d, self.touched_d), _pick(first, r.v, self.touched_v)
                self.touched_yaw = where(first, r.yaw(), self.touched_yaw)
            self._rest(ground, r, touching, motors)
            self.ditched = self.ditched | wet
        self.airborne_s = where(supported | wet, 0.0, self.airborne_s + dt)
        self.contact_s = where(supported, self.contact_s + dt, clip(self.contact_s - dt, 0.0, f.motors_off_after_s))
        phase = self.phase
        phase = where((phase == VehiclePhase.LANDING) & (self.contact_s > f.motors_off_after_s), (VehiclePhase.LANDED), phase)
        phase = where((phase == VehiclePhase.TAKING_OFF) & (height > 0.9 * f.take_off_height_m), (VehiclePhase.HOVERING), phase)
        fell = (rows[2][2] < math.cos(f.tilt_cut_off_rad)) & motors
        self.phase = where(wet | fell, (VehiclePhase.EMERGENCY), phase)

    def _rest(self, ground: Ground, r: Relative, touching: float, motors: bool) -> None:
        """Tie what lies still with its motors off to the deck; untie what the deck throws off."""
        f = self.airframe
        if bool(self.tied):
            x, y, z = inverse_rotate(ground.R, (self.a[0], self.a[1], self.a[2] - GRAVITY_M_S2))
            slips = x * x + y * y > (f.feet.friction * clip(-z, 0.0, 1e3)) * (f.feet.friction * clip(-z, 0.0, 1e3))
            self.tied = self.tied and not (slips)
        v, w = r.v, r.w
        still = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2] < 9e-4) & (w[0] * w[0] + w[1] * w[1] + w[2] * w[2] < 0.04)
        ties = still and not (motors) and (touching >= 3.0) and not (self.tied)
        if bool(ties):
            d = inverse_rotate(ground.R, (self.p[0] - ground.p[0], self.p[1] - ground.p[1], self.p[2] - ground.p[2]))
            self.attached_d = _pick(ties, d, self.attached_d)
            w0, x0, y0, z0 = quaternion_of_rpy(*rpy_of(ground.R))
            q = product((w0, -x0, -y0, -z0), self.q)
            t = self.attached_q
            self.attached_q = (
                where(ties, q[0], t[0]),
                where(ties, q[1], t[1]),
                where(ties, q[2], t[2]),
                where(ties, q[3], t[3]),
            )
            self.tied = self.tied | ties


def _pick(flag: bool, yes: Vec, no: Vec) -> Vec:
    return (where(flag, yes[0], no[0]), where(flag, yes[1], no[1]), where(flag, yes[2], no[2]))


def _toward(x: Vec, target: Vec, share: float) -> Vec:
    return (x[0] + share * (target[0] - x[0]), x[1] + share * (target[1] - x[1]), x[2] + share * (target[2] - x[2]))
