"""The quadcopter: a rigid body under rotor thrust, drag, wind and contact, flown by an AR.Drone's inner loops.

One vehicle in plain floats or B vehicles in arrays, by the same formulae (`sitl.algebra`). Body and gains are those of the
thesis' simulator, hector_quadrotor (Meyer et al., Comprehensive simulation of quadrotor UAVs using ROS and Gazebo, SIMPAR 2012).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from enum import IntEnum

import numpy as np

from estimator.contracts.geometry import F64
from sitl.air import Air
from sitl.airframe import Airframe, StickLimits
from sitl.algebra import (
    Arrays,
    Flag,
    Floats,
    MathBackend,
    Num,
    Vec,
    cross,
    inverse_rotate,
    product,
    quaternion_of_rpy,
    rotate,
    rotation_of,
    rpy_of,
)  # fmt: skip
from sitl.contact import DEEPEST_M, DeckShape, Ground, Relative, Rows, buoyancy, contact_force, relative
from sitl.disturbances import Disturbances, Wind
from sitl.rotors import Thrusts, delivered, ground_effect, ground_effect_by_rotor, rotors, thrusts
from sitl.sea import GRAVITY_M_S2
from sitl.torque_observer import TorqueObserver

Quaternion = tuple[Num, Num, Num, Num]
DECK, SEA = 1.0, 2.0
"""Codes of `Vehicle.touched_what`; 0 before any contact."""

_ZERO: Vec = (0.0, 0.0, 0.0)


class VehiclePhase(IntEnum):
    """What the vehicle is doing."""

    LANDED = 0
    TAKING_OFF = 1
    HOVERING = 2
    FLYING = 3
    LANDING = 4
    EMERGENCY = 5


class Vehicle:
    """One vehicle, or B of them.

    Args:
        step_s: length of a step; 2 to 5 ms keeps the feet's springs stable.
        seeds: of one vehicle, or a sequence of B; the b-th of a batch flies exactly as it would alone.

    State: `p` m and `v` m/s in ned, `q` of R_ned_body (w, x, y, z), `w` rad/s in body, `thrust_n`, `torque_n_m`;
    `a` m/s^2 is the mean acceleration over the last step. Every component is a float or a (B,) array.
    """

    def __init__(
        self,
        airframe: Airframe,
        shape: DeckShape,
        step_s: float,
        seeds: np.random.SeedSequence | Sequence[np.random.SeedSequence],
        wind: Wind | None = None,
    ) -> None:
        if not 0.0 < step_s <= 0.01:
            raise ValueError(f"step_s must lie in (0, 0.01] s, got {step_s!r}")
        self.airframe, self.shape, self.step_s = airframe, shape, step_s
        self.limits = StickLimits()
        self.wind = wind or Wind()
        self.extra_wind: Vec = _ZERO
        """m/s in ned, on top of the wind: a single gust as it passes."""
        self._healthy: tuple[float, ...] = (1.0,) * len(rotors(airframe))
        self.rotor_health = self._healthy
        """Share of its thrust that each rotor (in the order of `sitl.rotors.rotors`) delivers."""
        self.tilt_max_rad = airframe.loops.tilt_max_rad
        """Largest roll or pitch that any loop asks for."""
        self.air: Air | None = None
        """The air, where it is more than the uniform wind with its gusts."""
        self.current: tuple[float, float] = (0.0, 0.0)
        """Velocity of the water, m/s north and east, against which the optical flow measures beside the deck."""
        self.flow_works = True
        single = isinstance(seeds, np.random.SeedSequence)
        self._m: MathBackend = Floats() if single else Arrays()
        self.batch: int | None = None if isinstance(seeds, np.random.SeedSequence) else len(seeds)
        each = [seeds] if isinstance(seeds, np.random.SeedSequence) else list(seeds)
        self._disturbances = Disturbances(self.wind, airframe.avionics, step_s, each, single)
        zero = self._number(0.0)
        self._zero, self._never = zero, self._flag(False)
        self.seconds = 0.0
        av = airframe.avionics
        self._alpha = {s: 1.0 - math.exp(-step_s / s) if s > 0 else 1.0 for s in (airframe.motor_lag_s, av.flow_lag_s)}
        none = (zero, zero, zero, zero, self._never)
        self._command: tuple[Num, Num, Num, Num, Flag] = none
        self._pending = deque([none] * round(airframe.command_delay_s / step_s))
        self.p = self.v = self.w = self.a = (zero, zero, zero)
        self.q: Quaternion = (zero + 1.0, zero, zero, zero)
        self.thrust_n: Num = zero
        self.torque_n_m: Vec = (zero, zero, zero)
        self.flow: tuple[Num, Num] = (zero, zero)
        """m/s forward and right: the velocity the drone itself believes in."""
        self._integral = (zero, zero, zero)
        self._unasked = TorqueObserver(airframe, step_s, zero)
        self._z_hold: Num = zero
        self.phase: Num = zero
        self.tied: Flag = self._never
        """Standing still on the deck and carried with it."""
        self._attached_d: Vec = (zero, zero, zero)
        self._attached_q: Quaternion = self.q
        self.contact_s: Num = zero
        self.airborne_s: Num = zero
        self.ditched: Flag = self._never
        nan = zero + math.nan
        self.touched_what: Num = zero
        self.touched_s: Num = nan
        """Seconds since the first step of the newest contact after flight; nan before any."""
        self.touched_d: Vec = (nan, nan, nan)
        """m, body's origin from the pad's centre in the pad frame at that contact."""
        self.touched_v: Vec = (nan, nan, nan)
        """m/s against the deck (against the water) just before it, in the pad frame."""
        self.touched_yaw: Num = nan

    def _number(self, value: float) -> Num:
        return value if self.batch is None else np.full(self.batch, value)

    def _array(self, v: Vec) -> F64:
        """Return (3,) or (B, 3)."""
        return np.array(v) if self.batch is None else np.stack([np.asarray(x) for x in v], axis=-1)

    def _flag(self, value: bool) -> Flag:
        return value if self.batch is None else np.full(self.batch, value)

    def place(self, p_ned: F64, v_ned: F64, yaw_rad: float | F64) -> None:
        """Put it into the air, hovering and leaning against the steady wind: (3,) or (B, 3) m and m/s, and the heading."""
        self.p, self.v = self._vec(p_ned), self._vec(v_ned)
        yaw = self._number(0.0) + yaw_rad
        m, k, air = self._m, self.airframe.drag_per_s, self.wind.v_ned
        against_x, against_y = k[0] * (self.v[0] - air[0]), k[1] * (self.v[1] - air[1])
        c, s = m.cos(yaw), m.sin(yaw)
        forward, right = c * against_x + s * against_y, c * against_y - s * against_x
        self._integral = (forward, right, self._zero)
        self.q = quaternion_of_rpy(m, right / GRAVITY_M_S2, -forward / GRAVITY_M_S2, yaw)
        self.thrust_n = self.airframe.mass_kg * m.sqrt(against_x * against_x + against_y * against_y + GRAVITY_M_S2**2)
        self._z_hold = self.p[2]
        self.phase = self._number(float(VehiclePhase.HOVERING))
        self.airborne_s = self._number(1.0)

    def stand(self, ground: Ground, d_pad: F64, yaw_rad: float | F64) -> None:
        """Put it on the deck, motors off: (3,) or (B, 3) m from the pad's centre in the pad frame, heading against the arrow."""
        self._attached_d = self._vec(d_pad)
        self._attached_q = quaternion_of_rpy(self._m, self._zero, self._zero, self._number(0.0) + yaw_rad)
        self.tied = self._flag(True)
        self.phase = self._number(float(VehiclePhase.LANDED))
        self.thrust_n = self._zero
        self.airborne_s = self._zero
        self.p, self.v, self.q, self.w = self._carried(ground)
        self.a = (self._zero, self._zero, self._zero)

    def _vec(self, a: F64) -> Vec:
        if self.batch is None:
            x, y, z = np.asarray(a, dtype=float).tolist()
            return x, y, z
        b = np.broadcast_to(np.asarray(a, dtype=float), (self.batch, 3))
        return b[:, 0].copy(), b[:, 1].copy(), b[:, 2].copy()

    def command(self, roll: Num, pitch: Num, gaz: Num, yaw: Num, progressive: Flag) -> None:
        """Stick fractions -1..1 with PCMD's signs: right, nose up, up, clockwise; ignored without `progressive` (hover)."""
        m = self._m
        self._command = (
            m.clip(roll, -1.0, 1.0),
            m.clip(pitch, -1.0, 1.0),
            m.clip(gaz, -1.0, 1.0),
            m.clip(yaw, -1.0, 1.0),
            progressive,
        )

    def take_off(self, which: Flag = True) -> None:
        """Let those vehicles of `which` take off that are landed with their motors off."""
        self.phase = self._m.where((self.phase == VehiclePhase.LANDED) & which, float(VehiclePhase.TAKING_OFF), self.phase)

    def land(self, which: Flag = True) -> None:
        """Let those vehicles of `which` land that fly."""
        flies = (
            (self.phase == VehiclePhase.TAKING_OFF) | (self.phase == VehiclePhase.HOVERING) | (self.phase == VehiclePhase.FLYING)
        )
        self.phase = self._m.where(flies & which, float(VehiclePhase.LANDING), self.phase)

    def stay_up(self, which: Flag = True) -> None:
        """Let those vehicles of `which` that are landing hover instead."""
        self.phase = self._m.where((self.phase == VehiclePhase.LANDING) & which, float(VehiclePhase.HOVERING), self.phase)

    def cut_motors(self, which: Flag = True) -> None:
        """Stop the motors of the vehicles of `which` at once, in any phase."""
        self.phase = self._m.where(which, float(VehiclePhase.EMERGENCY), self.phase)

    def leave_emergency(self, which: Flag = True) -> None:
        """End the emergency of those vehicles of `which` that lie still on deck and not in the water."""
        rests = (self.phase == VehiclePhase.EMERGENCY) & self.tied & self._m.no(self.ditched)
        self.phase = self._m.where(rests & which, float(VehiclePhase.LANDED), self.phase)

    @property
    def p_ned(self) -> F64:
        """(3,) or (B, 3) m."""
        return self._array(self.p)

    @property
    def v_ned(self) -> F64:
        """(3,) or (B, 3) m/s."""
        return self._array(self.v)

    @property
    def R_ned_body(self) -> F64:
        """(3, 3) or (B, 3, 3)."""
        rows = rotation_of(self.q)
        return np.array(rows) if self.batch is None else np.stack([self._array(row) for row in rows], axis=-2)

    @property
    def w_body(self) -> F64:
        """(3,) or (B, 3) rad/s."""
        return self._array(self.w)

    @property
    def f_body(self) -> F64:
        """(3,) or (B, 3) m/s^2, specific force: at rest and level (0, 0, -9.81)."""
        x, y, z = self.a
        f = inverse_rotate(rotation_of(self.q), (x, y, z - GRAVITY_M_S2))
        return self._array(f)

    @property
    def gust(self) -> Vec:
        """m/s in ned, on top of the steady wind."""
        return self._disturbances.gust

    @property
    def tilt_error_rad(self) -> tuple[Num, Num]:
        """Error of the drone's own roll and pitch."""
        return self._disturbances.tilt

    @property
    def rotors_n(self) -> Thrusts:
        """Thrust of each rotor, in the order of `sitl.rotors.rotors`."""
        return thrusts(self.airframe, self.thrust_n, self.torque_n_m)

    def step(self, ground: Ground) -> None:
        """Advance by `step_s` to the instant for which `ground` holds."""
        m, f, dt = self._m, self.airframe, self.step_s
        self.seconds += dt
        self._disturbances.step()
        self._pending.append(self._command)
        command = self._pending.popleft()
        rows = rotation_of(self.q)
        ahead = (self.p[0] + dt * self.v[0], self.p[1] + dt * self.v[1], self.p[2] + dt * self.v[2])
        r = relative(ground, ahead, self.v, rows, self.w)
        over = self.shape.holds(r.d[0], r.d[1]) & (r.d[2] < DEEPEST_M)
        height = m.where(over, -r.d[2], ground.sea_z - ahead[2])
        steered = (self.phase == VehiclePhase.HOVERING) | (self.phase == VehiclePhase.FLYING)
        self.phase = m.where(steered, m.where(command[4], float(VehiclePhase.FLYING), float(VehiclePhase.HOVERING)), self.phase)
        motors = (self.phase != VehiclePhase.LANDED) & (self.phase != VehiclePhase.EMERGENCY)
        self.tied = self.tied & m.no(motors)
        thrust, torque = self._loops(command, rows, r, over, ground)
        lag = self._alpha[f.motor_lag_s]
        self.thrust_n = self.thrust_n + lag * (m.where(motors, thrust, 0.0) - self.thrust_n)
        self.torque_n_m = _toward(
            self.torque_n_m,
            (m.where(motors, torque[0], 0.0), m.where(motors, torque[1], 0.0), m.where(motors, torque[2], 0.0)),
            lag,
        )
        lift, turn = self.thrust_n, self.torque_n_m
        if f.ground_effect == "rotors":
            cushion = ground_effect_by_rotor(m, f, self.shape, r, ground.sea_z - ahead[2])
            shares = tuple(h * k for h, k in zip(self.rotor_health, cushion, strict=True))
            lift, turn = delivered(m, f, lift, turn, shares)
        else:
            if self.rotor_health != self._healthy:
                lift, turn = delivered(m, f, lift, turn, self.rotor_health)
            lift = lift * ground_effect(m, f, height)

        g, u = self.gust, self.extra_wind
        s: Vec = self.wind.v_ned
        if self.air is not None:
            s = self.air.step(ground, r, self.v, ground.sea_z - ahead[2], self.seconds)
        air = inverse_rotate(
            rows, (self.v[0] - g[0] - u[0] - s[0], self.v[1] - g[1] - u[1] - s[1], self.v[2] - g[2] - u[2] - s[2])
        )
        kx, ky, kz = f.drag_per_s
        accel = rotate(rows, (-kx * air[0], -ky * air[1], -kz * air[2] - lift / f.mass_kg))
        ax, ay, az = accel[0], accel[1], accel[2] + GRAVITY_M_S2
        touching: Num = self._zero
        if m.any(over & (height < 0.4)):
            contact = contact_force(m, self.shape, f, r, dt)
            touching = contact.touching
            force, moment = rotate(ground.R, contact.force), inverse_rotate(r.R, contact.torque)
            ax, ay, az = ax + force[0] / f.mass_kg, ay + force[1] / f.mass_kg, az + force[2] / f.mass_kg
            turn = (turn[0] + moment[0], turn[1] + moment[1], turn[2] + moment[2])
        depth = ahead[2] + f.feet.below_m - ground.sea_z
        wet = m.no(over) & (depth > 0.0)
        if m.any(wet):
            b, t = buoyancy(m, f, wet, depth, self.v, self.w, ground.sea_vz)
            ax, ay, az = ax + b[0], ay + b[1], az + b[2]
            turn = (turn[0] + t[0], turn[1] + t[1], turn[2] + t[2])
        self._fly(ground, (ax, ay, az), turn)
        self._after(ground, r, rows, over, wet, touching, motors, height)

    def _loops(
        self, command: tuple[Num, Num, Num, Num, Flag], rows: Rows, r: Relative, over: Flag, ground: Ground
    ) -> tuple[Num, Vec]:
        """Thrust and torque asked for: stick or hover to attitude, attitude to torque, climb rate to thrust."""
        m, f, dt, limits = self._m, self.airframe, self.step_s, self.limits
        k, av = f.loops, f.avionics
        roll, pitch, gaz, yaw, _ = command
        flying = self.phase == VehiclePhase.FLYING
        c = m.clip(m.sqrt(rows[0][0] * rows[0][0] + rows[1][0] * rows[1][0]), 1e-6, 1.0)
        cos_psi, sin_psi = rows[0][0] / c, rows[1][0] / c
        error = self.tilt_error_rad
        phi = m.atan2(rows[2][1], rows[2][2]) + error[0]
        theta = m.atan2(-rows[2][0], c) + error[1]

        if self.flow_works:
            seen = rotate(ground.R, r.v)
            deck = over & av.flow_sees_deck
            noise = self._disturbances.flow
            current = self.current
            vx, vy = m.where(deck, seen[0], self.v[0] - current[0]), m.where(deck, seen[1], self.v[1] - current[1])
            measured_x = av.flow_scale * (cos_psi * vx + sin_psi * vy) + noise[0]
            measured_y = av.flow_scale * (cos_psi * vy - sin_psi * vx) + noise[1]
            lag = self._alpha[av.flow_lag_s]
            self.flow = (self.flow[0] + lag * (measured_x - self.flow[0]), self.flow[1] + lag * (measured_y - self.flow[1]))
        else:
            self.flow = (self._zero, self._zero)
        ax, ay, az = self.a
        forward = cos_psi * ax + sin_psi * ay
        right = cos_psi * ay - sin_psi * ax
        ex, ey = -self.flow[0], -self.flow[1]
        top = k.velocity_i_max_m_s2
        gain = m.where(flying | (self.contact_s > 0.0), 0.0, k.velocity_i * dt)
        ix, iy = m.clip(self._integral[0] + gain * ex, -top, top), m.clip(self._integral[1] + gain * ey, -top, top)
        hold_x = k.velocity_p * ex - k.velocity_d * forward + ix
        hold_y = k.velocity_p * ey - k.velocity_d * right + iy
        top_tilt = self.tilt_max_rad
        tilt = min(limits.euler_angle_max_rad, top_tilt)
        phi_asked = m.where(flying, roll * tilt, m.clip(hold_y / GRAVITY_M_S2, -top_tilt, top_tilt))
        theta_asked = m.where(flying, pitch * tilt, m.clip(-hold_x / GRAVITY_M_S2, -top_tilt, top_tilt))
        rate_asked = m.where(flying, yaw * limits.yaw_rate_max_rad_s, 0.0)
        x_max, y_max, z_max = f.torque_max_n_m
        ix_, iy_, iz_ = f.inertia_kg_m2
        motors = (self.phase != VehiclePhase.LANDED) & (self.phase != VehiclePhase.EMERGENCY)
        ux, uy, uz = self._unasked.step(m, self.w, self.torque_n_m, motors & (self.contact_s <= 0.0))
        torque = (
            m.clip(ix_ * (k.tilt_p * (phi_asked - phi) - k.tilt_d * self.w[0] - ux), -x_max, x_max),
            m.clip(iy_ * (k.tilt_p * (theta_asked - theta) - k.tilt_d * self.w[1] - uy), -y_max, y_max),
            m.clip(iz_ * (k.yaw_rate_p * (rate_asked - self.w[2]) - uz), -z_max, z_max),
        )

        z, vz = self.p[2], self.v[2]
        holding = (self.phase == VehiclePhase.HOVERING) | (flying & (gaz < 1e-3) & (gaz > -1e-3))
        self._z_hold = m.where(holding, self._z_hold, z + 0.3 * vz)  # where it will have come to a stop
        hold = m.clip(k.height_p * (self._z_hold - z), -limits.vz_max_m_s, limits.vz_max_m_s)
        own = m.where(self.phase == VehiclePhase.LANDING, f.landing_speed_m_s, -f.take_off_speed_m_s)
        descent_rate_demand = m.where(holding, hold, m.where(flying, -gaz * limits.vz_max_m_s, own))
        e = descent_rate_demand - vz
        gain = m.where((self.contact_s > 0.0) | (self.phase == VehiclePhase.LANDED), 0.0, k.climb_i * dt)
        iz = m.clip(self._integral[2] + gain * e, -k.climb_i_max_m_s2, k.climb_i_max_m_s2)
        self._integral = (ix, iy, iz)
        descent_acceleration = k.climb_p * e - k.climb_d * az + iz
        thrust = f.mass_kg * (GRAVITY_M_S2 - descent_acceleration) / m.clip(rows[2][2], 0.5, 1.0)
        return m.clip(thrust, 0.0, f.thrust_max_n), torque

    def _fly(self, ground: Ground, a: Vec, turn: Vec) -> None:
        """Newton and Euler over one step; a tied body goes with the deck instead."""
        m, dt = self._m, self.step_s
        p, v, w, q = self.p, self.v, self.w, self.q
        v1: Vec = (v[0] + dt * a[0], v[1] + dt * a[1], v[2] + dt * a[2])
        h = 0.5 * dt
        p1: Vec = (p[0] + h * (v[0] + v1[0]), p[1] + h * (v[1] + v1[1]), p[2] + h * (v[2] + v1[2]))
        ix, iy, iz = self.airframe.inertia_kg_m2
        wx = w[0] + dt / ix * (turn[0] - (iz - iy) * w[1] * w[2])
        wy = w[1] + dt / iy * (turn[1] - (ix - iz) * w[2] * w[0])
        wz = w[2] + dt / iz * (turn[2] - (iy - ix) * w[0] * w[1])
        rate = m.sqrt(wx * wx + wy * wy + wz * wz) + 1e-12
        s = m.sin(h * rate) / rate
        q1 = product(q, (m.cos(h * rate), s * wx, s * wy, s * wz))
        size = 1.0 / m.sqrt(q1[0] * q1[0] + q1[1] * q1[1] + q1[2] * q1[2] + q1[3] * q1[3])
        q1 = (q1[0] * size, q1[1] * size, q1[2] * size, q1[3] * size)
        w1: Vec = (wx, wy, wz)
        tied = self.tied
        if m.any(tied):
            cp, cv, cq, cw = self._carried(ground)
            p1, v1, w1 = _pick(m, tied, cp, p1), _pick(m, tied, cv, v1), _pick(m, tied, cw, w1)
            q1 = (
                m.where(tied, cq[0], q1[0]),
                m.where(tied, cq[1], q1[1]),
                m.where(tied, cq[2], q1[2]),
                m.where(tied, cq[3], q1[3]),
            )
        i = 1.0 / dt
        self.a = (i * (v1[0] - v[0]), i * (v1[1] - v[1]), i * (v1[2] - v[2]))
        self.p, self.v, self.w, self.q = p1, v1, w1, q1

    def _carried(self, ground: Ground) -> tuple[Vec, Vec, Quaternion, Vec]:
        """p, v, q, w of a body tied to the deck."""
        m = self._m
        d = rotate(ground.R, self._attached_d)
        u = rotate(ground.R, cross(ground.w, self._attached_d))
        q = product(quaternion_of_rpy(m, *rpy_of(m, ground.R)), self._attached_q)
        return (
            (ground.p[0] + d[0], ground.p[1] + d[1], ground.p[2] + d[2]),
            (ground.v[0] + u[0], ground.v[1] + u[1], ground.v[2] + u[2]),
            q,
            inverse_rotate(rotation_of(self._attached_q), ground.w),
        )

    def _after(
        self, ground: Ground, r: Relative, rows: Rows, over: Flag, wet: Flag, touching: Num, motors: Flag, height: Num
    ) -> None:
        """Timers, record of the contact, resting, changes of phase."""
        m, f, dt = self._m, self.airframe, self.step_s
        supported = (touching > 0.0) | self.tied
        if m.any(supported | wet):
            first = (supported | wet) & (self.airborne_s > 0.3)
            if m.any(first):
                self.touched_what = m.where(first, m.where(wet, SEA, DECK), self.touched_what)
                self.touched_s = m.where(first, self.seconds, self.touched_s)
                self.touched_d, self.touched_v = _pick(m, first, r.d, self.touched_d), _pick(m, first, r.v, self.touched_v)
                self.touched_yaw = m.where(first, r.yaw(m), self.touched_yaw)
            self._rest(ground, r, touching, motors)
            self.ditched = self.ditched | wet
        self.airborne_s = m.where(supported | wet, 0.0, self.airborne_s + dt)
        self.contact_s = m.where(supported, self.contact_s + dt, m.clip(self.contact_s - dt, 0.0, f.motors_off_after_s))
        phase = self.phase
        phase = m.where(
            (phase == VehiclePhase.LANDING) & (self.contact_s > f.motors_off_after_s), float(VehiclePhase.LANDED), phase
        )
        phase = m.where(
            (phase == VehiclePhase.TAKING_OFF) & (height > 0.9 * f.take_off_height_m), float(VehiclePhase.HOVERING), phase
        )
        fell = (rows[2][2] < math.cos(f.tilt_cut_off_rad)) & motors
        self.phase = m.where(wet | fell, float(VehiclePhase.EMERGENCY), phase)

    def _rest(self, ground: Ground, r: Relative, touching: Num, motors: Flag) -> None:
        """Tie what lies still with its motors off to the deck; untie what the deck throws off."""
        m, f = self._m, self.airframe
        if m.any(self.tied):
            x, y, z = inverse_rotate(ground.R, (self.a[0], self.a[1], self.a[2] - GRAVITY_M_S2))
            slips = x * x + y * y > (f.feet.friction * m.clip(-z, 0.0, 1e3)) * (f.feet.friction * m.clip(-z, 0.0, 1e3))
            self.tied = self.tied & m.no(slips)
        v, w = r.v, r.w
        still = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2] < 9e-4) & (w[0] * w[0] + w[1] * w[1] + w[2] * w[2] < 0.04)
        ties = still & m.no(motors) & (touching >= 3.0) & m.no(self.tied)
        if m.any(ties):
            d = inverse_rotate(ground.R, (self.p[0] - ground.p[0], self.p[1] - ground.p[1], self.p[2] - ground.p[2]))
            self._attached_d = _pick(m, ties, d, self._attached_d)
            w0, x0, y0, z0 = quaternion_of_rpy(m, *rpy_of(m, ground.R))
            q = product((w0, -x0, -y0, -z0), self.q)
            t = self._attached_q
            self._attached_q = (
                m.where(ties, q[0], t[0]),
                m.where(ties, q[1], t[1]),
                m.where(ties, q[2], t[2]),
                m.where(ties, q[3], t[3]),
            )
            self.tied = self.tied | ties


def _pick(m: MathBackend, flag: Flag, yes: Vec, no: Vec) -> Vec:
    return (m.where(flag, yes[0], no[0]), m.where(flag, yes[1], no[1]), m.where(flag, yes[2], no[2]))


def _toward(x: Vec, target: Vec, share: float) -> Vec:
    return (x[0] + share * (target[0] - x[0]), x[1] + share * (target[1] - x[1]), x[2] + share * (target[2] - x[2]))
