"""A motor-driven vehicle over a vessel on a sea, advanced step by step by the program that commands the motors."""

import math
from collections.abc import Awaitable, Callable, Sequence

import msgspec
import numpy as np
from msgspec import Struct, field, structs
from numpy.typing import NDArray

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import NS_PER_S, Clock, MonoNs
from sitl.camera.camera import Exposure
from sitl.camera.film import Film, SimulatedExposure, Taken
from sitl.camera.gimbal import SimulatedGimbal
from sitl.camera.render_worker import RenderWorker
from sitl.core.library import Number, Numbers
from sitl.emulators.autopilots.station import OperatorView
from sitl.faults.fault import Corruptions, FaultTimer
from sitl.faults.kinds import LightFalls, LowBattery, charge_left
from sitl.scenario.scenario import Scenario, pad_model
from sitl.vehicle.airframe import Airframe
from sitl.vehicle.vehicle import DECK, SEA, Vehicle, VehiclePhase
from sitl.vessel.contact import Ground, Vec
from sitl.vessel.vessel import Mounted
from sitl.world.stage import (
    air,
    airframe,
    deck_shape,
    drift_of,
    film,
    flight_seeds,
    place,
    renderer,
    sea_and_vessel,
    true_camera,
    wind,
)
from sitl.world.truth import RenderedFrame, Touchdown, Truth, touchdown_of

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


Settle = Callable[[], Awaitable[None]]
"""Awaited after each step, before a program gets its state; the program's time stands still until it returns."""
_CHUNK_S = 0.25
_SEA_S = 0.02


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


class Body:
    """A motor-driven vehicle and its surroundings, which the levels of perception take for a world.

    Args:
        step_s: step of the physics, at most 5 ms.
        curve: curve of the motors, as the autopilot's settings assume it (see `thrust_fraction`).
        clock: stamps the true states; None for the time since the start.
        faults: the faults that are active now; None for none.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        step_s: float,
        curve: float = 0.0,
        clock: Clock | None = None,
        faults: FaultTimer | None = None,
    ) -> None:
        scenario = msgspec.structs.replace(scenario, wrong_model=scenario.wrong_model.drawn(seed))
        self.scenario, self.seed, self.step_s, self._clock = scenario, seed, step_s, clock
        self.faults = FaultTimer(()) if faults is None else faults
        self.corruptions = Corruptions(self.faults, seed)
        self._motion: tuple[int, Mounted] | None = None
        self._truth: tuple[int, Truth] | None = None
        self.pad, self.camera = pad_model(scenario), true_camera(scenario)
        seeds = flight_seeds(seed)
        self._camera_seed = seeds.camera
        self.waves, self.vessel = sea_and_vessel(scenario, [seeds.sea])
        shape = deck_shape(self.vessel.hull, np.radians(scenario.vessel.pad_yaw_deg))
        self._vehicle = MotorVehicle(
            airframe(scenario), shape, step_s, seeds.flight, wind(scenario), air(scenario, self.vessel.hull)
        )
        if self._vehicle.airframe.layout != "quad_x":
            raise BadInput("--autopilot flies four rotors in an X; the scenario's vehicle has another layout")
        self._vehicle.curve = curve
        self._tick, self._flown_s = 0, 0.0
        self._chunk: list[Ground] = []
        self._chunk_at = 0
        at = self.vessel.pad_at(0.0)
        self._ground = Ground.of(at.p_ned, at.v_ned, at.R_ned, at.w)
        self._sea = (0.0, 0.0)
        place(scenario, self._vehicle, self._ground, at, drift_of(self.vessel) if scenario.vessel.motion else np.zeros(2))
        self._renderer: Film | None = None
        self.exposure: SimulatedExposure | None = None
        """The exposure of the camera where the service drives it."""
        self.gimbal = SimulatedGimbal(scenario.gimbal, step_s) if scenario.gimbal.given else None
        """Gimbal of the camera; None for a camera that is fixed on the vehicle."""

    @property
    def t_s(self) -> float:
        """Time since the start, s."""
        return self._tick * self.step_s

    def step(self, motors: Motors) -> None:
        """Advance by one step with these motor commands."""
        self._tick += 1
        self._ground = self._deck()
        every = max(round(_SEA_S / self.step_s), 1)
        if self._tick % every == 1 or every == 1:
            p = np.array([self._vehicle.p[0], self._vehicle.p[1]])
            now, then = self.waves.elevation(p, np.array([self.t_s, self.t_s + _SEA_S]))[0]
            self._sea = (-float(now), -float(then - now) / _SEA_S)
        self._ground.sea_z, self._ground.sea_vz = self._sea
        self._flown_s += self.step_s if self.flying else 0.0
        self._vehicle.motors = motors if self.battery > 0.0 else _NONE
        self._vehicle.step(self._ground)
        if self.gimbal is not None:
            self.gimbal.step(Rotation(self._vehicle.R_ned_body))

    @property
    def battery(self) -> float:
        """Charge of the battery, 0 to 1; nothing turns the motors at 0."""
        s = self.scenario.sensors
        return charge_left(s.battery_start - self._flown_s / s.battery_life_s, self.faults.on(LowBattery), s.battery_life_s)

    def state(self) -> BodyState:
        """Return the body's state at the newest step."""
        v = self._vehicle
        rotation = Rotation(v.R_ned_body)
        return BodyState(self.t_s, v.p_ned, v.v_ned, rotation, v.w_body, v.f_body, self._range(rotation), self.battery)

    @property
    def p_pad_ned(self) -> F64:
        """Position (3,) of the pad's centre, m."""
        return np.array(self._ground.p)

    @property
    def height_m(self) -> float:
        """Height over the pad's centre, m."""
        return float(self._ground.p[2] - self._vehicle.p[2])

    @property
    def v_pad_ned(self) -> F64:
        """Velocity (3,) of the pad's centre, m/s."""
        return np.array(self._ground.v)

    @property
    def R_ned_pad(self) -> Rotation:
        return Rotation(np.array(self._ground.R))

    def landing(self) -> Touchdown | None:
        """Return the newest contact with a surface after flight, by the time since the start; None before the first."""
        v = self._vehicle
        return self.touchdown(MonoNs(round(v.touched_s * NS_PER_S)), None) if v.touched_what in (DECK, SEA) else None

    def touchdown(self, at: MonoNs, guidance_phase: str | None) -> Touchdown:
        """Return the newest contact, which began at an instant and in a phase of guidance that the caller knows."""
        radius_m = self.pad.disc_radius_m
        return touchdown_of(self._vehicle, at, radius_m, VehiclePhase.FLYING, guidance_phase, motors=True)

    @property
    def upright(self) -> bool:
        """True if the vehicle can still fly: it is neither turned over nor in the water."""
        return self._vehicle.phase != VehiclePhase.EMERGENCY

    @property
    def flying(self) -> bool:
        """True if its motors turn."""
        return self._vehicle.phase == VehiclePhase.FLYING

    def pad_motion(self) -> Mounted:
        """Return the pad's true motion at the newest step, with shapes (3,) and (3, 3)."""
        if self._motion is None or self._motion[0] != self._tick:
            self._motion = self._tick, self.vessel.pad_at(self.t_s)
        return self._motion[1]

    def pad_ahead(self, ahead_s: F64) -> Mounted:
        """Return the pad's true motion at (H,) s after the newest step."""
        return self.vessel.pad(self.t_s + ahead_s)

    def truth(self) -> Truth:
        """Return the true state at the newest step; contacts are not noted here."""
        if self._truth is None or self._truth[0] != self._tick:
            self._truth = self._tick, self._true_state()
        return self._truth[1]

    def _true_state(self) -> Truth:
        s, pad = self.state(), self.pad_motion()
        phase = VehiclePhase.FLYING if self.flying else VehiclePhase.LANDED if self.upright else VehiclePhase.EMERGENCY
        at = MonoNs(round(self.t_s * NS_PER_S)) if self._clock is None else self._clock.now()
        return Truth(
            at, s.p_ned, s.v_ned, s.R_ned_body, pad.p_ned, pad.v_ned, Rotation(pad.R_ned), phase, None,
            a_body_ned=s.R_ned_body @ s.f_body + [0.0, 0.0, G_M_S2], w_body=s.w_body, w_pad=pad.w, battery=s.battery,
        )  # fmt: skip

    def shot(self) -> Exposure:
        """Return the scene as it is now."""
        v, g = self._vehicle, self._ground
        return Exposure(
            t_s=self.t_s,
            R_ned_body=Rotation(v.R_ned_body),
            p_body_ned=v.p_ned,
            R_ned_pad=Rotation(np.array(g.R)),
            p_pad_ned=np.array(g.p),
            v_body_ned=v.v_ned,
            w_body=v.w_body,
            v_pad_ned=np.array(g.v),
            w_pad=np.array(g.w),
        )

    def expose(
        self, worker: RenderWorker | None = None, camera: Callable[[Exposure | None, int], NDArray[np.uint8]] | None = None
    ) -> Callable[[], RenderedFrame]:
        """Fix the scene now and return a function that makes its frame. Only one such function may run at a time.

        Args:
            worker: is not used: the frames of a body are rendered in this process.
            camera: replaces the renderer; it receives the scene, None while the lens is covered, and the number of the step.
        """
        at, own_s = MonoNs(round(self.t_s * NS_PER_S)), self.scenario.camera.exposure_s
        if camera is not None:
            px = camera(None if self.faults.active("lens_covered") else self.shot(), self._tick)
            return lambda: RenderedFrame(px, at, own_s)
        if self._renderer is None:
            seed = self._camera_seed
            self._renderer = film(self.scenario, renderer(self.scenario, self.waves, self.vessel, seed), seed)
        if self.faults.active("lens_covered"):
            dark = np.zeros((self.camera.height, self.camera.width, 3), np.uint8)
            return lambda: RenderedFrame(dark, at, own_s)
        expose, shot = self._renderer.render, self.shot()
        light = math.prod(fault.fraction for fault, _ in self.faults.on(LightFalls))
        taken = structs.replace(Taken() if self.exposure is None else self.exposure.expose(), light_fraction=light)
        if self.gimbal is not None:
            shot = self.gimbal.turned(shot, self.camera.T_body_cam.t)
        rng = np.random.default_rng([self._camera_seed, self._tick])
        setting = taken.setting
        exposure_s, gain = (own_s, 0.0) if setting is None else (setting.exposure_s, setting.gain)
        return lambda: RenderedFrame(expose(shot, rng, taken), at, exposure_s, gain=gain)

    def _deck(self) -> Ground:
        i = self._tick - self._chunk_at - 1
        if i >= len(self._chunk):
            self._chunk_at = self._tick - 1
            count = max(round(_CHUNK_S / self.step_s), 1)
            pads = self.vessel.pad((self._chunk_at + 1 + np.arange(count)) * self.step_s)
            self._chunk = [Ground.of(pads.p_ned[0, n], pads.v_ned[0, n], pads.R_ned[0, n], pads.w[0, n]) for n in range(count)]
            i = 0
        return self._chunk[i]

    def _range(self, rotation: Rotation) -> float | None:
        down = rotation.matrix[:, 2]
        if down[2] < 0.3:
            return None
        normal = np.array(self._ground.R)[:, 2]
        to_pad = np.array(self._ground.p) - self._vehicle.p_ned
        reach = float(to_pad @ normal) / float(down @ normal)
        place_on_deck = np.array(self._ground.R).T @ (self._vehicle.p_ned + down * reach - np.array(self._ground.p))
        if not (reach > 0 and self._vehicle.shape.holds(float(place_on_deck[0]), float(place_on_deck[1]))):
            reach = float(self._ground.sea_z - self._vehicle.p_ned[2]) / float(down[2])
        return reach if 0.0 <= reach <= 40.0 else None


_STOPPED_M_S = 0.3


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
    state, start = body.state(), body.scenario.start
    yaw = state.R_ned_body.rpy_rad[2]
    heading = body.R_ned_pad.rpy_rad[2] + math.radians(start.heading_deg)
    to_pad = Rotation.from_rpy(0.0, 0.0, heading) @ np.array([start.pad_forward_m, start.pad_right_m, start.height_m])
    level = Rotation.from_rpy(0.0, 0.0, yaw).inv
    # The ship's steady velocity, without the motion of the pad on the waves.
    v_start = body.vessel.way_at(body.t_s)
    return OperatorView(
        level @ (body.p_pad_ned - to_pad - state.p_ned),
        level @ v_start,
        level @ (v_start - state.v_ned),
        yaw,
        wrap_pi(heading - yaw),
        body.height_m,
        level @ body.v_pad_ned,
        not start.with_vessel,
    )
