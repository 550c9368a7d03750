"""A stand-in for the autopilot programs: a plain cascade from a place to fly to down to four motors."""

import math
from dataclasses import dataclass, field

import numpy as np

from estimator.contracts.geometry import F64, Rotation
from sitl.emulators.autopilots.motors import Motors
from sitl.emulators.autopilots.stand_in.cascade import command_of
from sitl.vehicle.airframe import Airframe


@dataclass
class Cascade:
    """Position to velocity to tilt to torque, and the mixer of a quad X."""

    airframe: Airframe
    curve: float
    dt_s: float = 0.0025
    most_m_s2: float = 3.0
    """Limit of the commanded horizontal acceleration; 1 m/s^2 is 6 degrees of tilt."""
    against_wind: F64 = field(default_factory=lambda: np.zeros(3))

    def motors(self, p: F64, v: F64, body: Rotation, w: F64, p_wanted: F64, v_wanted: F64) -> Motors:
        """Return the motors for a state in ned and body axes, holding the nose where it is."""
        f = self.airframe
        v_asked = v_wanted + np.clip(0.8 * (p_wanted - p), -1.0, 1.0)
        self.against_wind = np.clip(self.against_wind + 0.6 * self.dt_s * (v_asked - v), -2.0, 2.0)
        most = np.array([self.most_m_s2, self.most_m_s2, 3.0])
        a = np.clip(2.0 * (v_asked - v) + self.against_wind, -most, most)
        roll, pitch, yaw = body.rpy_rad
        forward = math.cos(yaw) * a[0] + math.sin(yaw) * a[1]
        right = -math.sin(yaw) * a[0] + math.cos(yaw) * a[1]
        thrust = f.mass_kg * (9.80665 - a[2]) / max(math.cos(roll) * math.cos(pitch), 0.5)
        ix, iy, iz = f.inertia_kg_m2
        tx = ix * (60.0 * (right / 9.8 - roll) - 14.0 * w[0])
        ty = iy * (60.0 * (-forward / 9.8 - pitch) - 14.0 * w[1])
        tz = iz * (-3.0 * w[2])
        t, x, y = 0.25 * thrust, tx / (4 * f.arm_m), ty / (4 * f.arm_m)
        z = tz / (4 * f.yaw_torque_per_thrust_m)
        # front right, rear left, front left, rear right
        each = (t - x + y + z, t + x - y + z, t + x + y - z, t - x - y - z)
        a0, b0, c0, d0 = (command_of(n / (f.thrust_max_n / 4), self.curve) for n in each)
        return (a0, b0, c0, d0)
