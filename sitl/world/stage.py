"""Build the parts of the world for a scenario: seeds, vehicle, deck, wind, sea, vessel, camera."""

import dataclasses
import math
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from estimator.contracts.geometry import F64, Rotation, Transform
from estimator.vision.camera.camera import Camera
from sitl.camera.camera import Drops, Renderer
from sitl.camera.film import Automatics, Film
from sitl.camera.light import Light, Sensor
from sitl.camera.surroundings import Deck, Surroundings
from sitl.scenario.scenario import Scenario, camera_model, pad_model, sea_of, ship_model, vehicle_model, wind_of
from sitl.sea.sea import Waves
from sitl.vehicle.airframe import Airframe, Avionics, StickLimits
from sitl.vehicle.disturbances import Wind
from sitl.vehicle.vehicle import Vehicle
from sitl.vessel.air import AirModel
from sitl.vessel.contact import DeckShape, Ground
from sitl.vessel.seakeeping import Hull, Turn
from sitl.vessel.vessel import Mooring, Mounted, RecordedVessel, TurningVessel, Vessel


class Seeds(NamedTuple):
    """The seeds of the random parts of one flight."""

    flight: np.random.SeedSequence
    """Seed of the wind and of the vehicle's own errors."""
    sensors: np.random.SeedSequence
    sea: int
    camera: int
    link: np.random.SeedSequence
    """Seed of the times at which an AR.Drone's frames arrive."""


def flight_seeds(seed: int) -> Seeds:
    """Return independent seeds for the parts of a flight."""
    flight, sensors, sea, camera, link = np.random.SeedSequence(seed).spawn(5)
    return Seeds(flight, sensors, int(sea.generate_state(1)[0]), int(camera.generate_state(1)[0]), link)


def airframe(scenario: Scenario) -> Airframe:
    """Return the vehicle that a scenario requests, as far as it differs from its model; the inertia is scaled with the mass."""
    s, wrong, estimate = scenario.sensors, scenario.wrong_model, scenario.vehicle.airframe(vehicle_model(scenario))
    loops, (x, y, z) = estimate.loops, estimate.drag_per_s
    return replace(
        estimate,
        mass_kg=estimate.mass_kg + scenario.effects.unknown_mass_kg,
        loops=replace(
            loops,
            tilt_p=loops.tilt_p * wrong.tilt_frequency**2,
            tilt_d=loops.tilt_d * wrong.tilt_frequency * wrong.tilt_damping,
            tilt_gain=wrong.tilt_gain,
        ),
        drag_per_s=(x * wrong.drag, y * wrong.drag, z * wrong.drag),
        command_delay_s=max(0.0, estimate.command_delay_s + wrong.command_delay_s),
        effects=msgspec.structs.replace(scenario.effects, drag_per_m=scenario.effects.drag_per_m * wrong.drag),
        lift_share=wrong.thrust,
        downwash_share=wrong.downwash,
        avionics=Avionics(
            tilt_bias_sigma_rad=math.radians(s.tilt_bias_sigma_deg),
            tilt_drift_sigma_rad=math.radians(s.tilt_drift_sigma_deg),
            tilt_drift_time_s=s.tilt_drift_time_s,
            flow_scale=s.velocity_scale,
            flow_noise_sigma_m_s=s.velocity_noise_sigma_m_s,
            flow_noise_time_s=s.velocity_noise_time_s,
            flow_lag_s=s.velocity_lag_s,
            flow_sees_deck=s.velocity_over == "seen",
        ),
    )


def true_camera(scenario: Scenario) -> Camera:
    """Return the camera as it is, where focal length and mount differ from its file."""
    camera, wrong = camera_model(scenario), scenario.wrong_model
    turned = [math.radians(angle) for angle in (wrong.mount_roll_deg, wrong.mount_pitch_deg, wrong.mount_yaw_deg)]
    if wrong.focal_length == 1.0 and not any(turned):
        return camera
    mount = Transform(Rotation.from_rpy(*turned) @ camera.T_body_cam.R, camera.T_body_cam.t)
    return dataclasses.replace(camera, fx=camera.fx * wrong.focal_length, fy=camera.fy * wrong.focal_length, T_body_cam=mount)


def limits(scenario: Scenario) -> StickLimits:
    """Return the initial values that a full stick requests."""
    return scenario.vehicle.stick_limits(vehicle_model(scenario))


def deck_shape(ship: Hull, pad_yaw_rad: float) -> DeckShape:
    """Return the outline of a hull's whole deck about its pad."""
    x, y = ship.d_vessel_pad_m
    length, beam = (0.5 * size for size in ship.deck_m)
    return DeckShape(length - x, length + x, beam + y, beam - y, ship.bow_taper_m, pad_yaw_rad)


def wind(scenario: Scenario) -> Wind:
    """Return the steady wind with its gusts."""
    w = wind_of(scenario)
    return Wind(wind_from(w.speed_m_s, w.from_deg), w.sigma_m_s, w.time_s)


def air(scenario: Scenario, ship: Hull) -> AirModel | None:
    """Return the air, for scenarios that request more than a uniform wind with gusts; else None."""
    return wind_of(scenario).air(ship, math.radians(scenario.vessel.pad_yaw_deg))


def renderer(scenario: Scenario, waves: Waves, vessel: Vessel, seed: int) -> Renderer | Film:
    """Return what renders the frames of the camera over the scenario's deck and sea.

    Args:
        seed: of the water on the lens and of the packets that the video link loses.
    """
    c, s, d = scenario.camera, scenario.light, scenario.drops
    light = Light(**msgspec.structs.asdict(s))
    scene = Surroundings(
        deck=Deck.of(vessel.hull, math.radians(scenario.vessel.pad_yaw_deg)),
        waves=waves,
        wake_speed_m_s=scenario.vessel.speed_m_s,
    )
    sensor = Sensor(c.exposure_s, c.blur_sigma_px, c.full_well_e, c.read_noise_e, readout_s=c.readout_s)
    one_by_one = Renderer(
        true_camera(scenario),
        pad_model(scenario),
        scene,
        light,
        sensor,
        scenario.lamps,
        Drops(d, seed) if d.rain_per_minute > 0 or d.spray_per_minute > 0 else None,
    )
    if _automatics(scenario).any or scenario.video.bitrate_kbit_s > 0:
        return film(scenario, one_by_one, seed)
    return one_by_one


def film(scenario: Scenario, made: Renderer | Film, seed: int) -> Film:
    """Return what renders the frames one after the other, each taken under given conditions (`Taken`)."""
    if isinstance(made, Film):
        return made
    return Film(made, _automatics(scenario), scenario.video, seed)


def _automatics(scenario: Scenario) -> Automatics:
    c = scenario.camera
    return Automatics(c.exposure_lag_s, c.exposure_longest_s, c.white_balance_lag_s)


def sea_and_vessel(scenario: Scenario, seeds: list[int]) -> tuple[Waves, Vessel]:
    """Return B seas and the B vessels that ride on them, one for each seed."""
    v, ship = scenario.vessel, ship_model(scenario)
    waves = sea_of(scenario).waves(seeds)
    course: dict[str, Any] = {
        "heading_rad": math.radians(v.heading_deg),
        "speed_m_s": v.speed_m_s,
        "pad_yaw_rad": math.radians(v.pad_yaw_deg),
        "mooring": Mooring() if v.moored else None,
        "seeds": seeds,
    }
    if ship.recorded is not None:
        spare = ship.recorded.period_s if math.isinf(ship.recorded.lasts_s) else ship.recorded.lasts_s - scenario.duration_limit_s
        starts = [np.random.default_rng([seed, 0x4EC]).random() * spare if ship.random_start else 0.0 for seed in seeds]
        return waves, RecordedVessel(ship.hull, waves, ship.recorded, starts, **course)
    if v.turn_rate_deg_s != 0.0:
        turn = Turn(math.radians(v.turn_rate_deg_s), v.turn_at_s, v.turn_over_s)
        return waves, TurningVessel(ship.hull, waves, turn, **course)
    return waves, Vessel(ship.hull, waves, **course)


def drift_of(vessel: Vessel) -> F64:
    """Return the mean velocity of a vessel over its first seconds beyond that of its course, (2,) m/s north and east."""
    heading, speed = float(vessel.heading_rad[0]), float(np.ravel(vessel.speed_m_s)[0])
    course = speed * np.array([math.cos(heading), math.sin(heading)])
    return np.asarray(vessel.pad(np.linspace(0.0, 4.0, 41)).v_ned[0, :, :2].mean(axis=0)) - course


def place(scenario: Scenario, vehicle: Vehicle, ground: Ground, at: Mounted, drift_ne_m_s: F64) -> None:
    """Put the vehicle at the scenario's start position relative to the pad.

    Args:
        at: the pad's motion at the start, with shapes (3,) and (3, 3).
        drift_ne_m_s: (2,) mean velocity of a vessel that moves as recorded, north and east; zeros for others.
    """
    s, v = scenario.start, scenario.vessel
    yaw = math.radians(s.heading_deg)
    if s.where == "pad":
        vehicle.stand(ground, np.array([0.0, 0.0, -vehicle.airframe.feet.below_m]), yaw)
        return
    heading = math.atan2(at.R_ned[1, 0], at.R_ned[0, 0]) + yaw
    c, n = math.cos(heading), math.sin(heading)
    to_pad = (c * s.pad_forward_m - n * s.pad_right_m, n * s.pad_forward_m + c * s.pad_right_m, s.height_m)
    course = math.radians(v.heading_deg)
    speed = v.speed_m_s if s.with_vessel else 0.0
    north, east = sea_of(scenario).current_ne_m_s if s.with_vessel and not v.moored else (0.0, 0.0)
    along = np.array([speed * math.cos(course) + north, speed * math.sin(course) + east, 0.0])
    if s.with_vessel:
        along[:2] += drift_ne_m_s
    vehicle.place(at.p_ned - to_pad, along, heading)


def wind_from(speed_m_s: float, from_deg: float) -> tuple[float, float, float]:
    """Return the velocity of the air in ned, m/s, for a wind that blows from `from_deg`."""
    a = math.radians(from_deg)
    return (-speed_m_s * math.cos(a), -speed_m_s * math.sin(a), 0.0)
