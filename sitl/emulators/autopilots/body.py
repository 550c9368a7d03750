"""A motor-driven vehicle over a vessel on a sea, advanced step by step by the program that commands the motors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.time import NS_PER_S, MonoNs
from sitl.camera.camera import Exposure
from sitl.camera.driven_exposure import SimulatedExposure, Taken
from sitl.camera.film import Film
from sitl.camera.gimbal import SimulatedGimbal
from sitl.emulators.autopilots.motors import Motors, MotorVehicle
from sitl.scenario.scenario import Scenario, camera_model, pad_model
from sitl.vehicle.vehicle import DECK, SEA, VehiclePhase
from sitl.vessel.contact import Ground
from sitl.world.stage import air, airframe, deck_shape, film, flight_seeds, place, renderer, sea_and_vessel, wind
from sitl.world.truth import RenderedFrame

_CHUNK_S = 0.25
_SEA_S = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class BodyState:
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


@dataclass(frozen=True, slots=True)
class Landing:
    """The newest contact with a surface after flight."""

    t_s: float
    on_deck: bool
    on_pad: bool
    """Whether the vehicle is on deck with the body's origin over the pad's disc."""
    lateral_m: float
    """Distance from the pad's centre along the deck, m."""
    yaw_rad: float
    """Heading relative to the arrow, clockwise from above, rad."""
    speed_m_s: float
    """Closing speed into the deck, m/s."""
    slide_m_s: float
    """Speed along the deck, relative to it, m/s."""


class Body:
    """A motor-driven vehicle and its surroundings.

    Args:
        step_s: step of the physics, at most 5 ms.
        curve: curve of the motors, as the autopilot's settings assume it (see `thrust_fraction`).
    """

    def __init__(self, scenario: Scenario, seed: int, step_s: float, curve: float = 0.0) -> None:
        self.scenario, self.step_s = scenario, step_s
        self.pad, self.camera = pad_model(scenario), camera_model(scenario)
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
        self._tick = 0
        self._chunk: list[Ground] = []
        self._chunk_at = 0
        at = self.vessel.pad_at(0.0)
        self._ground = Ground.of(at.p_ned, at.v_ned, at.R_ned, at.w)
        self._sea = (0.0, 0.0)
        place(scenario, self._vehicle, self._ground, at.p_ned, at.R_ned)
        self._renderer: Film | None = None
        self.exposure: SimulatedExposure | None = None
        """The exposure of the camera where the service drives it."""
        self.gimbal = SimulatedGimbal(scenario.gimbal, step_s) if scenario.gimbal.given else None
        """What carries the camera; None for a camera that is fixed on the vehicle."""

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
        self._vehicle.motors = motors
        self._vehicle.step(self._ground)
        if self.gimbal is not None:
            self.gimbal.step(Rotation(self._vehicle.R_ned_body))

    def state(self) -> BodyState:
        """Return the body's state at the newest step."""
        v = self._vehicle
        rotation = Rotation(v.R_ned_body)
        return BodyState(self.t_s, v.p_ned, v.v_ned, rotation, v.w_body, v.f_body, self._range(rotation))

    @property
    def p_pad_ned(self) -> F64:
        """Position (3,) of the pad's centre, m."""
        return np.array(self._ground.p)

    @property
    def v_pad_ned(self) -> F64:
        """Velocity (3,) of the pad's centre, m/s."""
        return np.array(self._ground.v)

    @property
    def R_ned_pad(self) -> Rotation:
        return Rotation(np.array(self._ground.R))

    def landing(self) -> Landing | None:
        """The landing, or None before the first contact."""
        v = self._vehicle
        if v.touched_what not in (DECK, SEA):
            return None
        d, u = np.array(v.touched_d), np.array(v.touched_v)
        on_deck, lateral_m = v.touched_what == DECK, float(np.hypot(d[0], d[1]))
        on_pad = on_deck and lateral_m <= self.pad.disc_radius_m
        slide_m_s = float(np.hypot(u[0], u[1]))
        return Landing(v.touched_s, on_deck, on_pad, lateral_m, v.touched_yaw, float(u[2]), slide_m_s)

    @property
    def upright(self) -> bool:
        """Whether the vehicle can still fly: it is neither turned over nor in the water."""
        return self._vehicle.phase != VehiclePhase.EMERGENCY

    @property
    def flying(self) -> bool:
        """Whether its motors turn."""
        return self._vehicle.phase == VehiclePhase.FLYING

    @property
    def tick(self) -> int:
        """Number of steps since the start."""
        return self._tick

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

    def expose(self, light_fraction: float = 1.0) -> Callable[[], RenderedFrame]:
        """Fix the scene now and return a function that renders its frame. Only one such function may run at a time.

        Args:
            light_fraction: light on the scene against what the scenario says.
        """
        if self._renderer is None:
            seed = self._camera_seed
            self._renderer = film(self.scenario, renderer(self.scenario, self.waves, self.vessel, seed), seed)
        expose, shot = self._renderer.render, self.shot()
        taken = replace(Taken() if self.exposure is None else self.exposure.expose(), light_fraction=light_fraction)
        if self.gimbal is not None:
            shot = self.gimbal.turned(shot, self.camera.T_body_cam.t)
        rng = np.random.default_rng([self._camera_seed, self._tick])
        at, own_s, setting = MonoNs(round(self.t_s * NS_PER_S)), self.scenario.camera.exposure_s, taken.setting
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
