"""The torque that the attitude loops did not ask for."""

from __future__ import annotations

from sitl.vehicle.airframe import Airframe
from tests.sitl.oracle.algebra import Vec, clip, where


class TorqueObserver:
    """Estimate the angular acceleration that a vehicle's loops did not ask for."""

    def __init__(self, airframe: Airframe, step_s: float) -> None:
        self._airframe, self._step_s = airframe, step_s
        self._share = step_s / (step_s + airframe.loops.disturbance_s)
        x, y, z = (most / inertia for most, inertia in zip(airframe.torque_max_n_m, airframe.inertia_kg_m2, strict=True))
        self._most = x, y, z
        self._w: Vec = (0.0, 0.0, 0.0)
        self.rad_s2: Vec = (0.0, 0.0, 0.0)
        """The estimate about the body's axes, rad/s^2."""

    def step(self, w: Vec, torque_n_m: Vec, free: bool) -> Vec:
        """Note one step of the physics and return the estimate, rad/s^2.

        Args:
            w: rad/s in body, after the step.
            torque_n_m: torque that the motors should have given during the step.
            free: whether nothing but air touches the vehicle and its motors turn; otherwise the estimate stays as it is.
        """
        (wx, wy, wz), (ix, iy, iz) = self._w, self._airframe.inertia_kg_m2
        gyroscopic = ((iz - iy) * wy * wz, (ix - iz) * wz * wx, (iy - ix) * wx * wy)
        self._w = w
        share = where(free, self._share, 0.0)

        def axis(i: int, inertia: float) -> float:
            unasked = (w[i] - (wx, wy, wz)[i]) / self._step_s - (torque_n_m[i] - gyroscopic[i]) / inertia
            was = self.rad_s2[i]
            return clip(was + share * (unasked - was), -self._most[i], self._most[i])

        self.rad_s2 = axis(0, ix), axis(1, iy), axis(2, iz)
        return self.rad_s2
