"""The control loops of a stand-in: from a wanted acceleration, climb and turn rate down to four motors."""

import math
from dataclasses import dataclass, field

import numpy as np

from estimator.contracts.geometry import F64
from estimator.contracts.motion import G_M_S2
from sitl.emulators.autopilots.body import BodyState
from sitl.emulators.autopilots.motors import Motors
from sitl.vehicle.airframe import Airframe

_RATE_P_1_S = 15.0
_TORQUE_MAX_N_M = 1.0
_YAW_MAX_N_M = 0.15
_WOUND_MAX_N_M = 0.6
_LEAST_LIFT = 0.5
_LIFT_FILTER_S = 0.016
"""Time constant of the filter of the vertical acceleration's error, 10 Hz (PSC_ACCZ_FLTE)."""
_LIFT_MAX_M_S2 = 6.0


def command_of(fraction: float, curve: float) -> float:
    """Return the motor command that gives this fraction of the largest thrust; the inverse of `motors.thrust_fraction`."""
    s = min(max(fraction, 0.0), 1.0)
    if curve == 0.0:
        return s
    b = 1.0 - curve
    return (-b + math.sqrt(b * b + 4.0 * curve * s)) / (2.0 * curve)


@dataclass(frozen=True, slots=True)
class LoopGains:
    """The gains of one stack's loops; each names the parameter that it stands for."""

    velocity_p: float
    """1/s: MPC_XY_VEL_P_ACC, PSC_VELXY_P."""
    velocity_i: float
    """1/s^2: MPC_XY_VEL_I_ACC, PSC_VELXY_I."""
    climb_p: float
    """1/s: MPC_Z_VEL_P_ACC, PSC_VELZ_P."""
    climb_i: float
    """1/s^2: MPC_Z_VEL_I_ACC, PSC_VELZ_I."""
    angle_p: float
    """1/s: MC_ROLL_P, ATC_ANG_RLL_P."""
    angle_lag_s: float
    """Lag of the wanted tilt before the attitude loop, whose rate is fed forward: ATC_INPUT_TC."""
    lean_max_rad: float
    rate_i: float
    """Torque that an angle which does not follow winds up, N m per rad and s: MC_ROLLRATE_I, ATC_RAT_RLL_I."""
    lift_p: float = 0.0
    """Lift over weight that one m/s^2 of missing vertical acceleration gives, times g: PSC_ACCZ_P over MOT_THST_HOVER. At 1 half
    of a wanted acceleration is flown at once. 0 for a stack that takes thrust for acceleration."""
    lift_i: float = 0.0
    """1/s: integral gain, PSC_ACCZ_I over MOT_THST_HOVER."""


PX4_GAINS = LoopGains(1.8, 0.4, 4.0, 2.0, 6.5, 0.0, math.radians(45.0), 1.0)
"""PX4's defaults. Source: parameter reference of PX4 1.16."""
COPTER_GAINS = LoopGains(2.0, 1.0, 5.0, 0.0, 4.5, 0.15, math.radians(30.0), 0.5, 1.0, 2.0)
"""ArduCopter's defaults. Source: parameter reference of ArduCopter 4.5."""


@dataclass(slots=True)
class Cascade:
    """The loops of one flight, and what they have wound up."""

    gains: LoopGains
    airframe: Airframe
    curve: float
    step_s: float
    wind_ned: F64 = field(default_factory=lambda: np.zeros(3))
    """Integral of the velocity loops, m/s^2."""
    thrust_fraction: float = 0.0
    """Newest collective thrust as a fraction of the largest."""
    _a_down: float = 0.0
    _lift: float = 0.0
    _lean: tuple[float, float] = (0.0, 0.0)
    _wound: tuple[float, float] = (0.0, 0.0)

    def reset(self) -> None:
        """Forget everything that was wound up, as autopilots do on the ground."""
        self.wind_ned, self._lean, self._wound = np.zeros(3), (0.0, 0.0), (0.0, 0.0)
        self.thrust_fraction = self._a_down = self._lift = 0.0

    def accelerations(self, s: BodyState, v_wanted: F64, a_wanted: F64) -> F64:
        """Return the acceleration that follows a velocity with an acceleration fed forward, (3,) m/s^2 ned."""
        g, error = self.gains, v_wanted - s.v_ned
        rate = np.array([g.velocity_i, g.velocity_i, g.climb_i])
        most = np.array([3.0, 3.0, 6.0])
        self.wind_ned = np.clip(self.wind_ned + self.step_s * rate * error, -most, most)
        p = np.array([g.velocity_p, g.velocity_p, g.climb_p])
        a = np.asarray(a_wanted + p * error + self.wind_ned)
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
        lift = max(G_M_S2 - float(a[2]), _LEAST_LIFT * G_M_S2)
        most = math.tan(g.lean_max_rad if lean_max_rad is None else lean_max_rad)
        forward, right = (c * a[0] + sn * a[1]) / lift, (-sn * a[0] + c * a[1]) / lift
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
        self._wound = (
            _within(self._wound[0] + self.step_s * g.rate_i * off[0], _WOUND_MAX_N_M),
            _within(self._wound[1] + self.step_s * g.rate_i * off[1], _WOUND_MAX_N_M),
        )
        ix, iy, iz = f.inertia_kg_m2
        w = s.w_body
        tx = _within(ix * _RATE_P_1_S * (g.angle_p * off[0] + rate[0] - w[0]) + self._wound[0], _TORQUE_MAX_N_M)
        ty = _within(iy * _RATE_P_1_S * (g.angle_p * off[1] + rate[1] - w[1]) + self._wound[1], _TORQUE_MAX_N_M)
        tz = _within(iz * 6.0 * (yaw_rate_rad_s - w[2]), _YAW_MAX_N_M)
        t, x, y = 0.25 * self.thrust_fraction * f.thrust_max_n, tx / (4 * f.arm_m), ty / (4 * f.arm_m)
        z = tz / (4 * f.yaw_torque_per_thrust_m)
        # front right, rear left, front left, rear right
        each = (t - x + y + z, t + x - y + z, t + x + y - z, t - x - y - z)
        one, two, three, four = (command_of(n / (f.thrust_max_n / 4), self.curve) for n in each)
        return (one, two, three, four)


def _within(value: float, most: float) -> float:
    return min(max(float(value), -most), most)
