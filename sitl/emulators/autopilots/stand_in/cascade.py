"""The control loops of a stand-in: from a wanted acceleration, climb and turn rate down to four motors."""

import math

import numpy as np
from msgspec import Struct, field

from estimator.contracts.geometry import F64
from estimator.contracts.motion import G_M_S2
from sitl.emulators.autopilots.body import BodyState
from sitl.vehicle.airframe import Airframe
from sitl.world.drives import Motors

_YAW_SHARE = 0.5  # of the largest torque about the vertical axis that the yaw loop takes
VELOCITY_S = 0.032
"""Time constant of the filter of the velocity's derivative, 5 Hz (MPC_VELD_LP, PSC_VELXY_FLTE)."""
_LIFT_FILTER_S = 0.016
"""Time constant of the filter of the vertical acceleration's error, 10 Hz (PSC_ACCZ_FLTE)."""
_LIFT_MAX_M_S2 = 6.0
"""Largest integral of the vertical acceleration's error: full thrust has some 10 m/s^2 to spare."""


def command_of(fraction: float, curve: float) -> float:
    """Return the motor command that gives this fraction of the largest thrust; the inverse of `motors.thrust_fraction`."""
    s = min(max(fraction, 0.0), 1.0)
    if curve == 0.0:
        return s
    b = 1.0 - curve
    return (-b + math.sqrt(b * b + 4.0 * curve * s)) / (2.0 * curve)


class FirstOrder(Struct):
    """A vector behind a filter of the first order, and its rate."""

    value: F64
    rate: F64 | float = 0.0

    def step(self, x: F64, step_s: float, time_s: float) -> None:
        """Take one more vector."""
        self.rate = (x - self.value) / time_s
        self.value = x - math.exp(-step_s / time_s) * (x - self.value)


class LoopGains(Struct, frozen=True):
    """The gains of one stack's loops; each names the parameter that it stands for."""

    velocity_p: float
    """1/s: MPC_XY_VEL_P_ACC, PSC_VELXY_P."""
    velocity_i: float
    """1/s^2: MPC_XY_VEL_I_ACC, PSC_VELXY_I."""
    climb_p: float
    """1/s: MPC_Z_VEL_P_ACC, PSC_VELZ_P."""
    climb_i: float
    """1/s^2: MPC_Z_VEL_I_ACC, PSC_VELZ_I."""
    velocity_i_max_m_s2: float
    """PSC_VELXY_IMAX. PX4's anti-windup has the tilt's limit instead."""
    velocity_d: float
    """MPC_XY_VEL_D_ACC, PSC_VELXY_D."""
    of_errors: bool
    """True if the filters and derivatives of velocity and rate act on their errors, so that what is wanted is fed forward once
    more; false if on what is measured alone."""
    angle_p: float
    """1/s: MC_ROLL_P, ATC_ANG_RLL_P."""
    angle_lag_s: float
    """Lag of the wanted tilt before the attitude loop, whose rate is fed forward: ATC_INPUT_TC."""
    lean_max_rad: float
    rate_p: float
    """Torque, in units of the mixer, that a missing rad/s gives: MC_ROLLRATE_P, ATC_RAT_RLL_P."""
    rate_i: float
    """1/s times that: MC_ROLLRATE_I, ATC_RAT_RLL_I."""
    rate_i_max: float
    """MC_RR_INT_LIM, ATC_RAT_RLL_IMAX."""
    rate_d: float
    """s times that: MC_ROLLRATE_D, ATC_RAT_RLL_D."""
    gyro_s: float
    """Time constant that stands for the filters of rate and derivative: IMU_GYRO_CUTOFF, INS_GYRO_FILTER."""
    unit: float
    """Share of its largest thrust by which a unit of torque changes each motor's."""
    lift_p: float = 0.0
    """Lift over weight that one m/s^2 of missing vertical acceleration gives, times g: PSC_ACCZ_P over MOT_THST_HOVER. At 1 half
    of a wanted acceleration is flown at once. 0 for a stack that takes thrust for acceleration."""
    lift_i: float = 0.0
    """1/s: integral gain, PSC_ACCZ_I over MOT_THST_HOVER."""


PX4_GAINS = LoopGains(
    velocity_p=1.8, velocity_i=0.4, velocity_i_max_m_s2=G_M_S2, climb_p=4.0, climb_i=2.0, velocity_d=0.2, of_errors=False,
    angle_p=6.5, angle_lag_s=0.0, lean_max_rad=math.radians(45.0),
    rate_p=0.15, rate_i=0.2, rate_i_max=0.3, rate_d=0.003, gyro_s=0.006, unit=math.sqrt(0.5),
)  # fmt: skip
"""PX4's defaults. Source: parameter reference of PX4 1.16; the unit: its allocation scales roll and pitch so that the squares of
their shares add up to half the number of motors (ControlAllocationPseudoInverse)."""
COPTER_GAINS = LoopGains(
    velocity_p=2.0, velocity_i=1.0, velocity_i_max_m_s2=10.0, climb_p=5.0, climb_i=0.0, velocity_d=0.5, of_errors=True,
    angle_p=4.5, angle_lag_s=0.15, lean_max_rad=math.radians(30.0),
    rate_p=0.135, rate_i=0.135, rate_i_max=0.5, rate_d=0.0036, gyro_s=0.011, unit=0.41, lift_p=1.0, lift_i=2.0,
)  # fmt: skip
"""ArduCopter's defaults. Source: parameter reference of ArduCopter 4.5; the unit: a factor of a half in the mixer, and 0.8 of a
motor's range between MOT_SPIN_MIN and MOT_SPIN_MAX."""


class Cascade(Struct):
    """The loops of one flight, and what they have wound up."""

    gains: LoopGains
    airframe: Airframe
    """The vehicle that the autopilot is set up for; six rotors are flown as four that give the same thrust and torque."""
    curve: float
    step_s: float
    wind_ned: F64 = field(default_factory=lambda: np.zeros(3))
    """Integral of the velocity loops, m/s^2."""
    thrust_fraction: float = 0.0
    """Newest collective thrust as a fraction of the largest."""
    _a_down: float = 0.0
    _lift: float = 0.0
    _lean: tuple[float, float] = (0.0, 0.0)
    _wound: F64 = field(default_factory=lambda: np.zeros(2))
    _v: FirstOrder = field(default_factory=lambda: FirstOrder(np.zeros(2)))
    _w: FirstOrder = field(default_factory=lambda: FirstOrder(np.zeros(2)))

    def reset(self) -> None:
        """Forget everything that was wound up, as autopilots do on the ground."""
        self.wind_ned, self._lean, self._wound = np.zeros(3), (0.0, 0.0), np.zeros(2)
        self.thrust_fraction = self._a_down = self._lift = 0.0

    def accelerations(self, s: BodyState, v_wanted: F64, a_wanted: F64) -> F64:
        """Return the acceleration that follows a velocity with an acceleration fed forward, (3,) m/s^2 ned."""
        g, error = self.gains, v_wanted - s.v_ned
        self._v.step((error if g.of_errors else -s.v_ned)[:2], self.step_s, VELOCITY_S)
        if g.of_errors:
            error = np.append(self._v.value, error[2])
        rate = np.array([g.velocity_i, g.velocity_i, g.climb_i])
        most = np.array([g.velocity_i_max_m_s2, g.velocity_i_max_m_s2, 6.0])
        self.wind_ned = np.clip(self.wind_ned + self.step_s * rate * error, -most, most)
        p = np.array([g.velocity_p, g.velocity_p, g.climb_p])
        a = np.asarray(a_wanted + p * error + self.wind_ned)
        a[:2] += g.velocity_d * self._v.rate
        if g.lift_p > 0.0:
            a_down = float((s.R_ned_body @ s.f_body)[2]) + G_M_S2
            self._a_down += (1.0 - math.exp(-self.step_s / _LIFT_FILTER_S)) * (a_down - self._a_down)
            missing = float(a[2]) - self._a_down
            self._lift = _within(self._lift + self.step_s * g.lift_i * missing, _LIFT_MAX_M_S2)
            a[2] = g.lift_p * missing + self._lift
        return a

    def motors(
        self, s: BodyState, a: F64, yaw_rate_rad_s: float, *, thrust_max: float = 1.0, thrust_min: float = 0.0,
        lean_max_rad: float | None = None,
    ) -> Motors:  # fmt: skip
        """Return the motors that tilt and lift for an acceleration, (3,) m/s^2 ned.

        Args:
            thrust_max, thrust_min: limits of the collective thrust, as fractions of the largest.
        """
        f, g = self.airframe, self.gains
        roll, pitch, yaw = s.R_ned_body.rpy_rad
        c, sn = math.cos(yaw), math.sin(yaw)
        most = math.tan(min(g.lean_max_rad if lean_max_rad is None else lean_max_rad, s.tilt_max_rad))
        forward, right = (c * a[0] + sn * a[1]) / G_M_S2, (-sn * a[0] + c * a[1]) / G_M_S2
        size = math.hypot(forward, right)
        cut = most / size if size > most else 1.0
        keep = math.exp(-self.step_s / g.angle_lag_s) if g.angle_lag_s > 0.0 else 0.0
        wanted = (math.atan(cut * right), -math.atan(cut * forward))
        before = self._lean
        roll_wanted, pitch_wanted = (keep * old + (1.0 - keep) * new for old, new in zip(before, wanted, strict=True))
        self._lean = roll_wanted, pitch_wanted
        fed = 1.0 / self.step_s if g.angle_lag_s > 0.0 else 0.0
        rate = (fed * (roll_wanted - before[0]), fed * (pitch_wanted - before[1]))
        thrust_n = f.mass_kg * (G_M_S2 - float(a[2])) / max(math.cos(roll) * math.cos(pitch), 0.5)
        self.thrust_fraction = min(max(thrust_n / f.thrust_max_n, thrust_min), thrust_max)
        off = (self._lean[0] - roll, self._lean[1] - pitch)
        tx, ty = self._torque(g.angle_p * np.array(off) + rate, s.w_body[:2])
        iz = f.inertia_kg_m2[2]
        tz = _within(iz * 6.0 * (yaw_rate_rad_s - s.w_body[2]), _YAW_SHARE * f.torque_max_n_m[2])
        t, x, y = 0.25 * self.thrust_fraction * f.thrust_max_n, tx / (4 * f.arm_m), ty / (4 * f.arm_m)
        z = tz / (4 * f.yaw_torque_per_thrust_m)
        # front right, rear left, front left, rear right
        each = (t - x + y + z, t + x - y + z, t + x + y - z, t - x - y - z)
        one, two, three, four = (command_of(n / (f.thrust_max_n / 4), self.curve) for n in each)
        return (one, two, three, four)

    def _torque(self, wanted_rad_s: F64, w_rad_s: F64) -> F64:
        """Return the torque about roll and pitch of the rate loop, (2,) N m."""
        g, unit_n_m = self.gains, self.gains.unit * self.airframe.arm_m * self.airframe.thrust_max_n
        self._w.step(wanted_rad_s - w_rad_s if g.of_errors else -w_rad_s, self.step_s, g.gyro_s)
        missing = self._w.value if g.of_errors else wanted_rad_s + self._w.value
        self._wound = np.clip(self._wound + self.step_s * g.rate_i * missing, -g.rate_i_max, g.rate_i_max)
        asked = unit_n_m * (g.rate_p * missing + self._wound + g.rate_d * self._w.rate)
        most = self.airframe.torque_max_n_m[0]
        return np.asarray(np.clip(asked, -most, most))


def _within(value: float, most: float) -> float:
    return min(max(float(value), -most), most)
