"""The world of a vehicle whose motors a program commands, as the program's physics has it, and times without a service."""

import math
from collections.abc import Awaitable, Callable

import numpy as np
from msgspec import Struct, field

from estimator.contracts.geometry import F64, Rotation, known_rotation, wrap_pi
from estimator.contracts.time import MonoNs, after
from sitl.emulators.autopilots.station import OperatorView
from sitl.faults.faulty_streams import FlightFaults
from sitl.scenario.scenario import Scenario
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.drives import MotorDrive, Motors
from sitl.world.truth import Touchdown
from sitl.world.world import World

Settle = Callable[[], Awaitable[None]]
"""Awaited after each step, before a program gets its state; the program's time stands still until it returns."""
_RANGE_MAX_M = 40.0
"""Reach of the rangefinder (RNGFND1_MAX_CM of our parameters)."""
_DOWN_MIN = 0.3
"""Least share of down in the range's ray."""


async def at_once() -> None:
    """Settle nothing."""


class BodyState(Struct, frozen=True, eq=False):
    """The true state that a physics backend sends to an autopilot."""

    t_s: float
    p_ned: F64
    """(3,) position from the world's origin on the still water, m."""
    v_ned: F64
    """(3,) velocity, m/s."""
    R_ned_body: Rotation
    w_body: F64
    """(3,) angular velocity, rad/s."""
    f_body: F64
    """(3,) specific force, m/s^2."""
    range_m: float | None
    """Distance along the body's down axis to the deck or the still water, m; None beyond 40 m and if the axis points upwards."""
    battery: float = 1.0
    """Charge of the battery, 0 to 1."""
    pressure_pa: float = 101_325.0
    """Air pressure that a barometer reads."""
    tilt_max_rad: float = math.inf
    """Largest tilt that a fault leaves it."""


class Body(World):
    """The world of one vehicle that motors drive; the flight begins with the order to land (`begin`).

    Args:
        step_s: step of the physics, at most 5 ms.
        curve: curve of the motors, as the autopilot's settings assume it (see `thrust_fraction`).
        start: as of `World`, and so `faults` and `stands`.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        step_s: float,
        curve: float = 0.0,
        start: MonoNs = MonoNs(0),  # noqa: B008
        faults: FlightFaults | None = None,
        *,
        stands: bool = False,
    ) -> None:
        self.step_s, self._motors = step_s, MotorDrive(step_s, curve)
        self._state: tuple[int, BodyState] | None = None
        super().__init__(scenario, seed, start, self._motors, faults, stands=stands)

    def step(self, motors: Motors) -> None:
        """Advance by one step with these motor commands."""
        self._motors.newest = motors
        self._motors.arrive(self.vehicle, self.at)
        self.advance(after(self.at, self.step_s))
        if self.gimbal is not None:
            self.gimbal.step(Rotation(self.vehicle.R_ned_body))

    @property
    def reached(self) -> bool:
        """True if a service's commands reach the vehicle."""
        return super().reached and not self.faults.service_gone

    def state(self) -> BodyState:
        """Return the body's state at the newest step."""
        if self._state is None or self._state[0] != self._tick:
            v = self.vehicle
            rotation = known_rotation(v.R_ned_body)
            range_m, pressure_pa = self._range_m(rotation), self._sensors.read(self.at).pressure_pa
            self._state = self._tick, BodyState(
                self.t_s, v.p_ned, v.v_ned, rotation, v.w_body, v.f_body, range_m, self.battery, pressure_pa,
                self._strain.tilt_max_rad,
            )  # fmt: skip
        return self._state[1]

    @property
    def height_m(self) -> float:
        """Height over the pad's centre, m."""
        return float(self.pad_motion().p_ned[2] - self.vehicle.p[2])

    @property
    def v_pad_ned(self) -> F64:
        """Velocity (3,) of the pad's centre, m/s."""
        return self.pad_motion().v_ned

    @property
    def landing(self) -> Touchdown | None:
        """The newest contact; None before the first."""
        return self.contacts[-1] if self.contacts else None

    @property
    def upright(self) -> bool:
        """True if the vehicle can still fly: it is neither turned over nor in the water."""
        return self.phase is not VehiclePhase.EMERGENCY

    @property
    def flying(self) -> bool:
        """True if its motors turn."""
        return self.phase is VehiclePhase.FLYING

    def _range_m(self, rotation: Rotation) -> float | None:
        down, pad, p = rotation.matrix[:, 2], self.pad_motion(), self.vehicle.p_ned
        if down[2] < _DOWN_MIN:
            return None
        normal = pad.R_ned[:, 2]
        reach = float((pad.p_ned - p) @ normal) / float(down @ normal)
        on_deck = pad.R_ned.T @ (p + down * reach - pad.p_ned)
        if not (reach > 0 and self.vehicle.shape.holds(float(on_deck[0]), float(on_deck[1]))):
            reach = (self._physics.sea_z - float(p[2])) / float(down[2])
        return reach if 0.0 <= reach <= _RANGE_MAX_M else None


_STOPPED_M_S = 0.3
"""Speed over the ground below which a vehicle has stopped."""


class Silence(Struct, eq=False):
    """One time without a service."""

    at_s: float
    """Its begin, s after the order to land."""
    phase: str | None
    """Phase of guidance in which the service was killed."""
    height_m: float
    """Height over the deck then, m."""
    lasted_s: float = 0.0
    modes: list[str] = field(default_factory=list)
    """Modes of the autopilot in their order, as a ground station received them."""
    sank_m: float = 0.0
    """Largest loss of altitude, m."""
    lowest_m: float = 0.0
    """Least height over the deck, m."""
    moved_m: float = 0.0
    """Distance over the ground from where it began to where it ended, m."""
    stopped_s: float | None = None
    """Time until its velocity over the ground fell below 0.3 m/s and stayed there, s; None if it did not."""
    touched: bool = False
    """True if it touched anything."""
    _p_ned: F64 | None = None
    _contacts: int = 0

    def step(self, since_s: float, state: BodyState, height_m: float, mode: str, contacts: int) -> None:
        """Note the true state.

        Args:
            since_s: time since its begin, s.
            height_m: height over the deck, m.
            mode: the autopilot's mode, as a ground station received it.
            contacts: number of contacts so far.
        """
        if self._p_ned is None:
            self._p_ned, self.lowest_m, self._contacts = state.p_ned.copy(), height_m, contacts
        self.touched = contacts > self._contacts
        moved = state.p_ned - self._p_ned
        self.lasted_s, self.moved_m = since_s, float(np.hypot(moved[0], moved[1]))
        self.sank_m, self.lowest_m = max(self.sank_m, float(moved[2])), min(self.lowest_m, height_m)
        if not self.modes or self.modes[-1] != mode:
            self.modes.append(mode)
        if float(np.linalg.norm(state.v_ned)) >= _STOPPED_M_S:
            self.stopped_s = None
        elif self.stopped_s is None:
            self.stopped_s = since_s

    def as_json(self) -> dict[str, object]:
        """Return plain values; lengths in m, times in s."""
        return {
            "phase": self.phase,
            "at_s": round(self.at_s, 2),
            "lasted_s": round(self.lasted_s, 2),
            "modes": list(self.modes),
            "height_m": round(self.height_m, 3),
            "lowest_m": round(self.lowest_m, 3),
            "sank_m": round(self.sank_m, 3),
            "moved_m": round(self.moved_m, 2),
            "stopped_s": None if self.stopped_s is None else round(self.stopped_s, 2),
            "touched": self.touched,
        }

    def in_words(self) -> str:
        """Return a line for people."""
        stopped = "did not stop" if self.stopped_s is None else f"stopped after {self.stopped_s:.1f} s"
        touched = ", touched the deck" if self.touched else ""
        return (
            f"service killed at {self.at_s:.1f} s in {self.phase}, {self.height_m:.2f} m over the deck, back after "
            f"{self.lasted_s:.1f} s: {' -> '.join(self.modes)}, sank {self.sank_m:.2f} m, at least {self.lowest_m:.2f} m over "
            f"the deck, moved {self.moved_m:.1f} m over the ground, {stopped}{touched}"
        )


def view_of(body: Body) -> OperatorView:
    """Return the view at the newest step; the landing begins where the scenario's `start` says."""
    v, start, pad = body.vehicle, body.scenario.start, body.pad_motion()
    yaw = Rotation(v.R_ned_body).rpy_rad[2]
    heading = Rotation(pad.R_ned).rpy_rad[2] + math.radians(start.heading_deg)
    to_pad = Rotation.from_rpy(0.0, 0.0, heading) @ np.array([start.pad_forward_m, start.pad_right_m, start.height_m])
    level = Rotation.from_rpy(0.0, 0.0, yaw).inv
    # The ship's steady velocity, without the motion of the pad on the waves.
    v_start = body.vessel.way_at(body.t_s)
    return OperatorView(
        level @ (pad.p_ned - to_pad - v.p_ned),
        level @ v_start,
        level @ (v_start - v.v_ned),
        yaw,
        wrap_pi(heading - yaw),
        body.height_m,
        level @ body.v_pad_ned,
        not start.with_vessel,
    )
