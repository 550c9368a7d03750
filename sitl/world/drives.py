"""Drives of a simulated vehicle: sticks for its own loops, as of an AR.Drone, or the motors that an autopilot commands."""

from collections.abc import Sequence

from msgspec import Struct

from estimator.contracts.time import NS_PER_S, MonoNs
from sitl.faults.corrupted import Corruptions
from sitl.scenario.scenario import Scenario, refuse_gimbal
from sitl.vehicle.airframe import Airframe
from sitl.vehicle.vehicle import MOTORS_TURN, Vehicle, VehiclePhase
from sitl.vessel.contact import Vec

Motors = tuple[float, float, float, float]
"""Commands 0..1 of the front right, rear left, front left and rear right motor: the order in which ArduPilot and PX4 number a
quad X."""
STILL: Motors = (0.0, 0.0, 0.0, 0.0)
_SPINS = 0.01
"""Least command that turns a motor."""


class Stick(Struct, frozen=True):
    """Stick fractions -1..1 with PCMD's signs. Without `progressive` the vehicle hovers and ignores the fractions."""

    roll: float = 0.0
    """Roll to the right."""
    pitch: float = 0.0
    """Pitch with the nose up, which flies backward."""
    gaz: float = 0.0
    """Climb, upward positive."""
    yaw: float = 0.0
    """Yaw, clockwise from above."""
    progressive: bool = False


class StickDrive:
    """The newest stick, which the vehicle's own loops fly.

    Args:
        corruptions: of the commands.
    """

    step_ns = 4_000_000
    """250 Hz, some fifteen steps to a radian of the stiffest spring."""

    def __init__(self, corruptions: Corruptions) -> None:
        self._corruptions = corruptions
        self.newest = Stick()

    def fits(self, scenario: Scenario) -> None:
        refuse_gimbal(scenario)

    def arrive(self, vehicle: Vehicle, at: MonoNs) -> None:
        s = self.newest
        roll, pitch, gaz = s.roll, s.pitch, s.gaz
        # Whole packets are late or doubled on their way here (`FaultyStream`).
        if any(fault.error not in ("late", "doubled") for fault, _ in self._corruptions.active("commands")):
            pitch, roll, gaz = self._corruptions.of("commands", (pitch, roll, gaz), at)
        vehicle.command(roll, pitch, gaz, s.yaw, s.progressive)

    def stop(self, vehicle: Vehicle) -> None:
        if vehicle.phase in MOTORS_TURN:
            vehicle.cut_motors()


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


class MotorDrive:
    """The motors of a quad X, or four in the place of more that give their thrust and torque.

    With every motor stopped, the vehicle may come to rest on the deck and move with it.

    Args:
        step_s: step of the physics, at most 5 ms.
        curve: curve of the motors, as the autopilot's settings assume it (see `thrust_fraction`).
    """

    def __init__(self, step_s: float, curve: float = 0.0) -> None:
        self.step_ns, self._curve = round(step_s * NS_PER_S), curve
        self.newest = STILL
        self._empty = False

    def fits(self, scenario: Scenario) -> None:
        pass

    def arrive(self, vehicle: Vehicle, at: MonoNs) -> None:
        motors = STILL if self._empty else self.newest
        if vehicle.phase != VehiclePhase.EMERGENCY:
            vehicle.phase = VehiclePhase.FLYING if max(motors) > _SPINS else VehiclePhase.LANDED
            # The rule of sticks changes flying to hovering unless the stick commands otherwise.
            vehicle.command(0.0, 0.0, 0.0, 0.0, True)
        vehicle.drive(*wrench(vehicle.airframe, motors, self._curve))

    def stop(self, vehicle: Vehicle) -> None:
        self._empty = True


Drive = StickDrive | MotorDrive
"""Commands a vehicle: `fits` refuses a scenario that it cannot fly, `arrive` gives the vehicle the newest command as it arrives,
`stop` stops the motors of an empty battery."""
