"""One vehicle over one vessel on one sea, in fixed steps: the same scenario, seed and commands give the same flight to the bit.

    world = World(load("demo"), seed=1)
    world.advance(MonoNs(40_000_000))
    world.stick(Stick(roll=0.1, progressive=True))
    world.readings(), world.render(), world.truth()

Commands take effect at the next step; requesting readings, frames or truth changes nothing.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import Any, Literal

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, known_rotation
from estimator.contracts.time import NS_PER_S, MonoNs, after
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.film import Film, SimulatedExposure, Taken
from sitl.camera.gimbal import SimulatedGimbal
from sitl.camera.picture_effects import PictureEffects
from sitl.camera.render_worker import RenderWorker
from sitl.core.abi import DL_EFFECT_NOISE, DL_FLIGHT_NOISE, DL_SENSOR_NOISE
from sitl.core.library import SIM
from sitl.faults.acts import OnFrame, OnVehicle
from sitl.faults.faulty_streams import FlightFaults
from sitl.faults.kinds import LightFalls, PictureFault, ShipFault
from sitl.faults.readings import FaultyReadings, SensorFault
from sitl.scenario.scenario import Scenario, pad_model, sea_of
from sitl.sea.sea import Waves
from sitl.sensors.sensors import FaultySensors, Readings, Sensors
from sitl.vehicle.airframe import StickLimits, rotors
from sitl.vehicle.vehicle import Vehicle, VehiclePhase
from sitl.vessel.contact import Ground
from sitl.vessel.vessel import Manoeuvre, Mounted
from sitl.world.drives import Drive, StickDrive
from sitl.world.drives import Stick as Stick
from sitl.world.stage import (
    air,
    airframe,
    deck_shape,
    drift_of,
    film,
    flight_seeds,
    limits,
    place,
    renderer,
    sea_and_vessel,
    true_camera,
    wind,
)
from sitl.world.truth import RenderedFrame, Touchdown, Truth, touchdown_of

_NOISE_WIDTHS = (DL_FLIGHT_NOISE, DL_FLIGHT_NOISE, DL_EFFECT_NOISE, DL_SENSOR_NOISE)
"""Numbers of a step's rows of noise, in the order in which the core takes them."""
_SEA_S = 0.02
"""Time from one look at the water's level to the next; in between it moves with its velocity."""


class Physics:
    """The steps of one vehicle.

    Args:
        waves: a batch of one.
    """

    def __init__(self, vehicle: Vehicle, sensors: Sensors, waves: Waves) -> None:
        self._vehicle, self._sensors = vehicle, sensors
        v, s = vehicle, sensors
        self._air = v.air_noise or v.noise
        self._effects = v.effect_noise or v.noise
        self._noises = tuple(dict.fromkeys((v.noise, self._air, self._effects, s.noise)))
        self._sea, core_waves = SIM.new("dl_sim_water", every=max(1, round(_SEA_S / vehicle.step_s))), waves.packed()
        self._flight = SIM.new(
            "dl_sim_flight", vehicle_params=v.params, vehicle=v.state, sensor_params=s.params, sensors=s.state,
            water=self._sea, waves=core_waves, harmonics=len(core_waves),
        )  # fmt: skip
        self._decks: NDArray[Any] = np.empty(0)
        self._first_deck: Any = None
        self._rows: list[Any] = []
        """The next rows of noise, as the core takes them."""
        self._ready = self._taken = 0
        """Number of these rows that lie ready, and of those that were taken since they were requested."""

    @property
    def sea_z(self) -> float:
        """Level of the water under the vehicle, down in ned, m."""
        sea = self._sea
        return float(sea.z + sea.vz * (sea.tick % sea.every) * self._vehicle.step_s)

    def run(self, decks: NDArray[Any], first: int, at_most: int) -> int:
        """Take steps over a deck, up to a contact with deck or water after flight; return how many.

        Args:
            decks: the deck at each step, as `decks_of` gives them.
            first: index of the next step's deck.
            at_most: how many steps to take, 1 or more; there are fewer where a block of noise ends.

        Raises:
            IndexError: there are not this many decks.
        """
        if decks is not self._decks:
            self._decks, self._first_deck = decks, SIM.array("dl_sim_deck", decks)
        if not 0 <= first <= len(decks) - at_most:
            raise IndexError(f"{at_most} steps from {first} on, but {len(decks)} decks")
        if self._ready == 0:
            for noise in self._noises:
                noise.used(self._taken)
            self._ready, self._taken = min([noise.prepare() for noise in self._noises]), 0
            self._rows = [noise.row for noise in (self._vehicle.noise, self._air, self._effects, self._sensors.noise)]
        self._vehicle.keep_limits()
        n = min(at_most, self._ready)
        done: int = SIM.lib.dl_sim_run(self._flight, n, self._first_deck + first, *self._rows)
        self._rows = [row + done * width for row, width in zip(self._rows, _NOISE_WIDTHS, strict=True)]
        self._ready -= done
        self._taken += done
        return done


def decks_of(pads: Mounted) -> NDArray[Any]:
    """Return one vessel's pad at T instants as the core's `dl_sim_deck`s, (T,)."""
    decks = np.empty(pads.p_ned.shape[1], SIM.dtype("dl_sim_deck"))
    decks["p"], decks["v"], decks["R"], decks["w"] = pads.p_ned[0], pads.v_ned[0], pads.R_ned[0].reshape(-1, 9), pads.w[0]
    return decks


_ORIGIN = MonoNs(0)
_CHUNK_S = 1.0
"""Time over which the deck's motion is computed at once."""
_PHASES = tuple(VehiclePhase)


class World:
    """A simulated flight.

    Args:
        start: this host's instant at which the world begins.
        drive: what commands the vehicle; None for sticks (`stick`), with which the flight begins at once.
        faults: those of a flight whose program was started again, in a new world; None for those of the scenario.
        stands: whether the vehicle stands on the pad first, from which it is flown to the scenario's start.

    Raises:
        BadInput: the drive does not fit the scenario.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        start: MonoNs = _ORIGIN,
        drive: Drive | None = None,
        faults: FlightFaults | None = None,
        *,
        stands: bool = False,
    ) -> None:
        self.scenario, self.seed = scenario, seed
        self.started = start
        """Instant at which the flight began: faults and contacts count from it on."""
        self._zero = start
        """Instant of the world's second 0."""
        self.pad, self.camera = pad_model(scenario), true_camera(scenario)
        self.faults = faults or FlightFaults(scenario.faults, seed)
        """The faults that are active now."""
        self.streams, self.corruptions = self.faults.streams, self.faults.corruptions
        self._sticks = StickDrive(self.corruptions)
        self._drive = drive or self._sticks
        self._step_s = self._drive.step_ns / NS_PER_S
        self._chunk = round(_CHUNK_S / self._step_s)
        seeds, frame = flight_seeds(seed), airframe(scenario)
        self._drive.fits(scenario)
        self._camera_seed = seeds.camera
        self.waves, self.vessel = sea_and_vessel(scenario, [seeds.sea])
        shape = deck_shape(self.vessel.hull, math.radians(scenario.vessel.pad_yaw_deg))
        self.vehicle = Vehicle(frame, shape, self._step_s, seeds.flight, wind(scenario), air(scenario, self.vessel.hull))
        """The vehicle; it takes orders at any time."""
        self.vehicle.limits = limits(scenario)
        self.vehicle.current = sea_of(scenario).current_ne_m_s
        wrong = scenario.wrong_model
        self._sensors = Sensors(scenario.sensors, self.vehicle, seeds.sensors, (wrong.accelerometer_scale, wrong.gyro_scale))
        self._tick = 0
        self.now = start
        """The latest instant requested; the physics is at most one step behind."""
        self._physics = Physics(self.vehicle, self._sensors, self.waves)
        at = self.vessel.pad_at(0.0)
        self._pads = Mounted(*(x[None, None] for x in (at.p_ned, at.v_ned, at.a_ned, at.R_ned, at.w)))
        """The pad's motion at the steps after `_pads_at`."""
        self._pads_at = -1
        self._decks = decks_of(self._pads)
        """The same as the core reads it: the next row is `_deck_next`, and those before `_deck_end` hold."""
        self._deck_next = self._deck_end = 0
        drift = drift_of(self.vessel) if scenario.vessel.motion else np.zeros(2)
        first = structs.replace(scenario.start, where="pad") if stands else scenario.start
        there = structs.replace(scenario, start=first)
        place(there, self.vehicle, Ground.of(at.p_ned, at.v_ned, at.R_ned, at.w), at, drift)
        self.guidance_phase: str | None = None
        """Phase of guidance if the flight's runner sets it, for faults that begin in a phase."""
        self._began_s, self._has_faults = 0.0, False
        self._faulty = FaultySensors(FaultyReadings(self.faults, seed, self.corruptions))
        self._strain = OnVehicle({}, scenario.sensors.battery_life_s)
        """Effect of the faults on the vehicle now."""
        self._manoeuvre = Manoeuvre(self.vessel, scenario.vessel.speed_m_s, 0.0)
        self._contacts: list[Touchdown] = []
        self._touched_s = math.nan
        """Time when the newest of them began, by the vehicle's own clock."""
        self._truth: tuple[tuple[int, float, int], Truth] | None = None
        """The newest truth that was requested, and of what it was made: step, phase, contacts."""
        self._newest_image: Callable[[], NDArray[np.uint8]] | None = None
        self._picture_effects: PictureEffects | None = None
        self._renderer: Renderer | Film | None = None
        self.exposure: SimulatedExposure | None = None
        """The exposure of the camera where the service drives it."""
        self.gimbal = SimulatedGimbal(scenario.gimbal, self._step_s) if scenario.gimbal.given else None
        """Gimbal of the camera; None for a camera that is fixed on the vehicle."""
        self.on_failsafe: Callable[[Literal["land", "hold"]], None] = lambda takes: None
        """Receives the mode that an autopilot's own failsafe takes."""
        if drive is None:
            self.begin()

    def begin(self) -> None:
        """Begin the flight now: faults act and contacts count from here on."""
        self.started, self._began_s, self._has_faults = self.at, self.t_s, bool(self.faults)
        self._contacts.clear()
        self._apply_faults()

    @property
    def phase(self) -> VehiclePhase:
        phase: int = self.vehicle.state.phase
        return _PHASES[phase]

    @property
    def limits(self) -> StickLimits:
        """The values at full stick; its fields may be set at any time."""
        return self.vehicle.limits

    @property
    def at(self) -> MonoNs:
        """Instant of the newest step of the physics."""
        return MonoNs(self._zero + self._tick * self._drive.step_ns)

    def wait(self, seconds: float) -> None:
        """Let a time pass in which nothing moves."""
        self._zero, self.now = after(self._zero, seconds), after(self.now, seconds)

    def stick(self, stick: Stick) -> None:
        """Apply a stick command, which holds until the next one."""
        self._sticks.newest = stick
        self._sticks.arrive(self.vehicle, self.at)

    @property
    def contacts(self) -> tuple[Touchdown, ...]:
        """Every contact since the flight began, in order."""
        return tuple(self._contacts)

    @property
    def reached(self) -> bool:
        """True if commands reach the vehicle."""
        return not self.streams.commands.silent

    def advance(self, to: MonoNs) -> None:
        """Run the physics up to `to`; an instant in the past changes nothing."""
        while (left := (to - self._zero) // self._drive.step_ns - self._tick) > 0:
            if self._deck_next == self._deck_end:
                self._move_deck()
            if self._has_faults:
                self._tick += 1  # what begins acts from this step on
                self._apply_faults()
                self._run(1)
            else:
                self._tick += self._run(left)
        if self.battery <= 0.0:
            self._drive.stop(self.vehicle)
        self.now = max(self.now, to)

    @property
    def battery(self) -> float:
        """Charge of the battery, 0 to 1; nothing turns the motors at 0."""
        return max(0.0, min(float(self._sensors.state.battery), self._strain.charge_max))

    def readings(self) -> Readings:
        """Return the sensors' readings of the newest step."""
        true = self._sensors.read(self.at)
        return structs.replace(self._faulty.distorted(true), battery_fraction=self.battery) if self._has_faults else true

    def render(self) -> RenderedFrame:
        """Return the bottom camera's frame; the newest step is the middle of its exposure."""
        return self.expose()()

    @property
    def renderer(self) -> Renderer | Film:
        """The renderer of the bottom camera."""
        if self._renderer is None:
            made = renderer(self.scenario, self.waves, self.vessel, self._camera_seed)
            self._renderer = made if self.exposure is None else film(self.scenario, made, self._camera_seed)
        return self._renderer

    @property
    def _effects(self) -> PictureEffects:
        if self._picture_effects is None:
            self._picture_effects = PictureEffects(self.camera, self.pad, self.renderer.light, self._camera_seed)
        return self._picture_effects

    def expose(
        self, worker: RenderWorker | None = None, camera: Callable[[Exposure | None, int], NDArray[np.uint8]] | None = None
    ) -> Callable[[], RenderedFrame]:
        """Fix the scene now, and return the call that makes the frame.

        The call may run in another thread while the world goes on. One such call at a time.

        Args:
            worker: renders the frame from now on; the function then waits for it.
            camera: replaces the renderer: it receives the scene, or None while the lens is covered, and the number of the step,
                and returns the image at once.
        """
        at, exposure_s = self.at, self.scenario.camera.exposure_s
        taken = Taken() if self.exposure is None else self.exposure.expose()
        gain = 0.0
        if taken.setting is not None:
            exposure_s, gain = taken.setting.exposure_s, taken.setting.gain
        acts = OnFrame(np.random.default_rng([self._camera_seed, self._tick, 2]).random)
        for fault, _ in self.faults.now:
            fault.on_frame(acts)
        error_s = self.scenario.wrong_model.video_delay_s + acts.stamp_s
        if "frame_stamps" in self.corruptions.signals:
            error_s += self.corruptions.of("frame_stamps", (self.t_s,), at)[0] - self.t_s
        frozen = acts.frozen and self._newest_image is not None
        image, true_view = (self._newest_image, False) if frozen else self._image(worker, camera, taken, acts)
        assert image is not None
        self._newest_image = image
        return lambda: RenderedFrame(image(), at, exposure_s, error_s, true_view, gain)

    def _image(
        self,
        worker: RenderWorker | None,
        camera: Callable[[Exposure | None, int], NDArray[np.uint8]] | None,
        taken: Taken,
        acts: OnFrame,
    ) -> tuple[Callable[[], NDArray[np.uint8]], bool]:
        """Return the function that makes the image of the present scene, and whether that is the camera's true view."""
        if acts.covered and camera is not None:
            black = camera(None, self._tick)
            return lambda: black, False
        if acts.covered:
            rng = np.random.default_rng([self._camera_seed, self._tick])
            dark = rng.integers(0, 8, (self.camera.height, self.camera.width, 3), dtype=np.uint8)
            return lambda: dark, False
        shot, in_place = self._scene(acts), not (acts.forward_m or acts.right_m)
        if camera is not None:
            seen = camera(shot, self._tick)
            return lambda: seen, in_place
        made, wrong = self._developed(shot, worker, taken, acts.drawn)
        if not wrong:
            return cache(made), in_place
        own, effects = np.random.default_rng([self._camera_seed, self._tick, 3]), self._effects
        return cache(lambda: effects.drawn(made(), wrong, shot, own)), in_place and not acts.pad_hidden

    def _developed(
        self, shot: Exposure, worker: RenderWorker | None, taken: Taken, wrong: list[PictureFault]
    ) -> tuple[Callable[[], NDArray[np.uint8]], list[PictureFault]]:
        """Return the function that renders a scene, and the faults that are drawn into its image."""
        rng = np.random.default_rng([self._camera_seed, self._tick])
        if worker is not None:
            return worker.order(shot, rng), wrong
        if self.exposure is None or not isinstance(self.renderer, Film):
            return self.renderer.order(shot, rng), wrong
        # A driven exposure meets the light that is left.
        left = math.prod(fault.fraction for fault in wrong if isinstance(fault, LightFalls))
        others = [fault for fault in wrong if not isinstance(fault, LightFalls)]
        return self.renderer.order(shot, rng, structs.replace(taken, light_fraction=left)), others

    def _scene(self, acts: OnFrame) -> Exposure:
        """Return the scene of the camera, shifted as a fault says."""
        v, pad = self.vehicle, self.pad_motion()
        p_body_ned = v.p_ned
        if acts.forward_m or acts.right_m:
            # The scene stays where it is and the camera looks from beside its true place: every part is seen shifted alike.
            p_body_ned = p_body_ned - pad.R_ned @ np.array([acts.forward_m, acts.right_m, 0.0])
        shot = Exposure(
            t_s=self.t_s,
            R_ned_body=known_rotation(v.R_ned_body),
            p_body_ned=p_body_ned,
            R_ned_pad=known_rotation(pad.R_ned),
            p_pad_ned=pad.p_ned,
            v_body_ned=v.v_ned,
            w_body=v.w_body,
            v_pad_ned=pad.v_ned,
            w_pad=pad.w,
        )
        return shot if self.gimbal is None else self.gimbal.turned(shot, self.camera.T_body_cam.t)

    def truth(self) -> Truth:
        """Return the true state at the newest step."""
        of = self._tick, self.vehicle.phase, len(self._contacts)
        if self._truth is None or self._truth[0] != of:
            self._truth = of, self._true_state()
        return self._truth[1]

    def _true_state(self) -> Truth:
        v, pad = self.vehicle, self.pad_motion()
        return Truth(
            at=self.at,
            p_body_ned=v.p_ned,
            v_body_ned=v.v_ned,
            R_ned_body=known_rotation(v.R_ned_body),
            p_pad_ned=pad.p_ned,
            v_pad_ned=pad.v_ned,
            R_ned_pad=known_rotation(pad.R_ned),
            phase=self.phase,
            touchdown=self._contacts[-1] if self._contacts else None,
            contacts=tuple(self._contacts),
            a_body_ned=v.a_ned,
            w_body=v.w_body,
            battery=self.battery,
            w_pad=pad.w,
        )

    def pad_ahead(self, ahead_s: F64) -> Mounted:
        """Return the pad's true motion at (H,) s after the newest step."""
        times: F64 = self.t_s + ahead_s
        return self._manoeuvre.pad_ahead(self.t_s, times) if self._manoeuvre else self.vessel.pad(times)

    def pad_motion(self) -> Mounted:
        """Return the pad's true motion at the newest step, with shapes (3,) and (3, 3)."""
        n, pads = self._tick - self._pads_at - 1, self._pads
        return Mounted(pads.p_ned[0, n], pads.v_ned[0, n], pads.a_ned[0, n], pads.R_ned[0, n], pads.w[0, n])

    @property
    def t_s(self) -> float:
        """Seconds since the world began."""
        return self._tick * self._step_s

    def _run(self, at_most: int) -> int:
        """Take this many steps of the physics, or fewer: up to a contact, which is noted; return how many."""
        v = self.vehicle
        done = self._physics.run(self._decks, self._deck_next, min(at_most, self._deck_end - self._deck_next))
        self._deck_next += done
        if v.state.touched_what and v.touched_s != self._touched_s:
            self._touched_s = v.touched_s
            self._contacts.append(self._contact())
        return done

    def _move_deck(self) -> None:
        """Compute the deck's motion at the next steps, many at once."""
        times = self._step_s * np.arange(self._tick + 1, self._tick + 1 + self._chunk, dtype=np.float64)
        self._pads = pads = self._manoeuvre.pad(times) if self._manoeuvre else self.vessel.pad(times)
        self._decks = decks_of(pads)
        self._pads_at, self._deck_next, self._deck_end = self._tick, 0, self._chunk

    def hold(self, fault: SensorFault) -> None:
        """Keep the sensors' readings of this instant for a fault that repeats them."""
        self._faulty.hold(fault, self._sensors.read(self.at))

    def manoeuvre(self, fault: ShipFault) -> None:
        """Let the vessel do what a fault says, from now on."""
        self._manoeuvre.begin(fault, self.t_s)
        self._deck_end = min(self._deck_end, self._deck_next + 1)

    def _apply_faults(self) -> None:
        v, faults = self.vehicle, self.faults
        for begun in faults.update(self.t_s - self._began_s, self.over_deck_m, self.guidance_phase):
            begun.on_begin(self)
        self._strain = strain = OnVehicle({rotor.name: 1.0 for rotor in rotors(v.airframe)}, self._strain.battery_life_s)
        for fault, since_s in faults.now:
            fault.on_vehicle(strain, since_s)
        v.extra_wind, v.rotor_health = strain.wind_ned, tuple(strain.thrust.values())
        v.flow_works, v.tilt_max_rad = strain.flow_works, min(v.airframe.loops.tilt_max_rad, strain.tilt_max_rad)
        if "commands" in self.corruptions.signals:
            self._drive.arrive(v, self.at)

    @property
    def over_deck_m(self) -> float:
        """Height of the body's origin over the deck's plane, m."""
        pad = self.pad_motion()
        p, g, R = self.vehicle.p, pad.p_ned.tolist(), pad.R_ned.tolist()
        return -float(sum(R[i][2] * (p[i] - g[i]) for i in range(3)))

    def _contact(self) -> Touchdown:
        """Return the contact of the newest step of the physics."""
        v = self.vehicle
        at, phase = MonoNs(self._zero + round(v.touched_s * NS_PER_S)), _PHASES[int(v.touched_phase)]
        motors = phase not in (VehiclePhase.LANDED, VehiclePhase.EMERGENCY)
        return touchdown_of(v, at, self.pad.disc_radius_m, phase, self.guidance_phase, motors=motors)
