"""A vehicle flown by four motor commands instead of its own control loops."""

from collections.abc import Sequence

from sitl.core.library import Number, Numbers
from sitl.vehicle.airframe import Airframe
from sitl.vehicle.vehicle import Vehicle, VehiclePhase
from sitl.vessel.contact import Ground, Vec

Motors = tuple[float, float, float, float]
"""Commands 0..1 of the front right, rear left, front left and rear right motor: the order in which ArduPilot and PX4 number a
quad X."""

_SPINS = 0.01
_NONE: Motors = (0.0, 0.0, 0.0, 0.0)


def thrust_fraction(command: float, curve: float) -> float:
    """Return the thrust as a fraction of the largest thrust for a command of 0..1: linear for a `curve` of 0, quadratic for 1.

    Source: ArduPilot's MOT_THST_EXPO and PX4's THR_MDL_FAC describe a motor in this way; the autopilot inverts its configured
    curve.
    """
    c = min(max(command, 0.0), 1.0)
    return (1.0 - curve) * c + curve * c * c


def wrench(airframe: Airframe, motors: Sequence[float], curve: float) -> tuple[float, Vec]:
    """Return the thrust, N, and the torque about the body's axes, N m.

    The front right and rear left propellers turn counter-clockwise seen from above, so their drag torque turns the nose
    clockwise.
    """
    most_n = airframe.thrust_max_n / 4.0
    fr, rl, fl, rr = (most_n * thrust_fraction(c, curve) for c in motors)
    arm, drag = airframe.arm_m, airframe.yaw_torque_per_thrust_m
    return fr + rl + fl + rr, (arm * (fl + rl - fr - rr), arm * (fl + fr - rl - rr), drag * (fr + rl - fl - rr))


class MotorVehicle(Vehicle):
    """A `Vehicle` whose thrust and torque come from `motors`."""

    motors: Motors = _NONE
    curve: float = 0.0
    _motor_driven = Number("params", "motor_driven")
    _driven_n = Number("state", "driven_n")
    _driven_n_m = Numbers("state", "driven_n_m")

    def step(self, ground: Ground) -> None:
        """Advance by one step. With every motor stopped, the vehicle may come to rest on the deck and move with it."""
        if self.phase != VehiclePhase.EMERGENCY:
            self.phase = VehiclePhase.FLYING if max(self.motors) > _SPINS else VehiclePhase.LANDED
            # The inherited rule changes flying to hovering unless the stick commands otherwise.
            self.command(0.0, 0.0, 0.0, 0.0, True)
        self._motor_driven = 1
        self._driven_n, self._driven_n_m = wrench(self.airframe, self.motors, self.curve)
        super().step(ground)
