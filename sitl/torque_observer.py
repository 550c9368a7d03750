"""The torque that the attitude loops did not ask for, as a weak rotor's, so that they can make up for it.

The loops know the torque that they asked for, and the gyro says how the body turned. The difference is a disturbance. Added to
what the loops ask for, it acts as an integral that holds nothing while the vehicle does as it is told: without a disturbance the
loops are those of the thesis' simulator.

Source: Smeur, Chu & de Croon, Adaptive incremental nonlinear dynamic inversion for attitude control of micro air vehicles,
Journal of Guidance, Control, and Dynamics 39(3), 2016, section III, whose increment of the torque is the same sum.
"""

from __future__ import annotations

from sitl.airframe import Airframe
from sitl.algebra import Flag, MathBackend, Num, Vec


class TorqueObserver:
    """Estimate the angular acceleration that a vehicle's loops did not ask for, of one vehicle or of B.

    Args:
        zero: a float, or a (B,) array.
    """

    def __init__(self, airframe: Airframe, step_s: float, zero: Num) -> None:
        self._airframe, self._step_s = airframe, step_s
        self._share = step_s / (step_s + airframe.loops.disturbance_s)
        x, y, z = (most / inertia for most, inertia in zip(airframe.torque_max_n_m, airframe.inertia_kg_m2, strict=True))
        self._most = x, y, z
        self._w: Vec = (zero, zero, zero)
        self.rad_s2: Vec = (zero, zero, zero)
        """The estimate about the body's axes, rad/s^2."""

    def step(self, m: MathBackend, w: Vec, torque_n_m: Vec, free: Flag) -> Vec:
        """Note one step of the physics and return the estimate, rad/s^2.

        Args:
            w: rad/s in body, after the step.
            torque_n_m: torque that the motors should have given during the step.
            free: whether nothing but air touches the vehicle and its motors turn; otherwise the estimate stays as it is.
        """
        (wx, wy, wz), (ix, iy, iz) = self._w, self._airframe.inertia_kg_m2
        gyroscopic = ((iz - iy) * wy * wz, (ix - iz) * wz * wx, (iy - ix) * wx * wy)
        self._w = w
        share = m.where(free, self._share, 0.0)

        def axis(i: int, inertia: float) -> Num:
            unasked = (w[i] - (wx, wy, wz)[i]) / self._step_s - (torque_n_m[i] - gyroscopic[i]) / inertia
            was = self.rad_s2[i]
            return m.clip(was + share * (unasked - was), -self._most[i], self._most[i])

        self.rad_s2 = axis(0, ix), axis(1, iy), axis(2, iz)
        return self.rad_s2
