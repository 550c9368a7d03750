"""Fly one scenario once, in virtual time: the same scenario, seed, settings and perception give the same ending to the bit.

`simulate`, the benches and campaigns all fly by `fly`.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial

import msgspec
from msgspec import Struct, structs

from companion.base.health import Health
from companion.base.observer import Observer
from companion.guidance.pilot import Pilot
from companion.settings.load import load
from companion.settings.model import CameraSettings, PadSettings, Settings
from companion.settings.vessel import VesselOptions
from drivers.mavlink.options import GimbalOptions
from estimator.contracts.errors import BadInput, refused
from estimator.contracts.estimates import PathName
from sitl.camera.render_worker import render_worker
from sitl.flight.afterwards import cpu_s
from sitl.flight.ending import Ending
from sitl.flight.stepped import Timing, new_flight
from sitl.perception.levels import perceive
from sitl.perception.port import LEVELS, Level
from sitl.scenario.scenario import Scenario, vehicle_model
from sitl.world.truth import Truth

Perception = Level
"""Perception of the pad.

`pixels` renders frames for the real detectors, `model` draws detections from an error model, `truth` gives guidance the truth
with an error model of the filter.
"""
PERCEPTIONS: tuple[str, ...] = LEVELS
TRUTH_EACH = 4
"""Number of 5 ms steps between two samples of the truth."""


def perception_level(text: str) -> Perception:
    """Return the level of perception of this name.

    Raises:
        BadInput: there is none; the message names those that exist.
    """
    for level in LEVELS:
        if text == level:
            return level
    raise BadInput(f"--perception: there is no level {text!r}; known are {', '.join(PERCEPTIONS)}")


def settings_for(scenario: Scenario, config: str | None, *, by_autopilot: bool = False) -> Settings:
    """Return the settings of a file, or without one the profile `sim` with the scenario's camera and pad.

    A file's flight begins by itself, whatever its `guidance.start`: nobody is there to order the landing.

    Args:
        by_autopilot: whether an autopilot flies, as for `companion.settings.load.load`.

    Raises:
        BadInput: as `companion.settings.load.load`, and as `following`.
    """
    settings = load("sim" if config is None else config, by_autopilot=by_autopilot)
    if config is not None:
        return msgspec.structs.replace(settings, guidance=msgspec.structs.replace(settings.guidance, start="automatic"))
    return following(scenario, settings, by_autopilot=by_autopilot)


def following(scenario: Scenario, settings: Settings, *, by_autopilot: bool = False) -> Settings:
    """Return the settings with what a scenario says of camera, pad, vehicle and the ship's reports.

    Where the scenario's ship reports her place, they fly to it. They know the places of her antenna and motion sensor, and where
    the pad's arrow points on her. They fly by the response that the vehicle's file names, on its feet; it is that of the
    vehicle's own loops, which an autopilot replaces by its own.

    Args:
        by_autopilot: as of `settings_for`.

    Raises:
        BadInput: as `sitl.scenario.scenario.vehicle_model`, or one of those places is too far from the pad.
    """
    rendezvous = msgspec.structs.replace(settings.guidance.rendezvous, enabled=scenario.vessel.reports_place)
    vehicle = vehicle_model(scenario)
    follow = settings.guidance.follow_deck
    if not by_autopilot:
        follow = msgspec.structs.replace(follow, response=vehicle.response)
    feet = vehicle.feet
    cone = msgspec.structs.replace(settings.guidance.cone, feet_below_m=feet.below_m, feet_aside_m=feet.half_base_m)
    gimbal = GimbalOptions(scenario.gimbal.device_id, point_down=scenario.gimbal.given)
    yaw_rad = math.radians(scenario.vessel.pad_yaw_deg) % math.tau
    ekf = structs.replace(settings.estimator.ekf, pad_yaw_in_vessel_rad=yaw_rad)
    return msgspec.structs.replace(
        settings,
        vehicle=settings.vehicle.simulated(scenario.vehicle.generation, vehicle.loops.tilt_max_deg),
        camera=CameraSettings(scenario.camera.file, gimbal=gimbal),
        pad=PadSettings(scenario.pad.file),
        vessel=_placed(scenario, settings.vessel),
        estimator=structs.replace(settings.estimator, ekf=ekf),
        guidance=msgspec.structs.replace(settings.guidance, rendezvous=rendezvous, follow_deck=follow, cone=cone),
    )


def _placed(scenario: Scenario, known: VesselOptions) -> VesselOptions:
    """Return the ship's settings with the places of the scenario's antenna and motion sensor."""
    forward_m, right_m, down_m = scenario.vessel.reports_at_m
    ahead_m, aside_m, _ = scenario.vessel.motion_at_m
    # From zero, as a negative zero is another number in a campaign's digest.
    pad = {"pad_forward_m": 0.0 - forward_m, "pad_right_m": 0.0 - right_m, "pad_up_m": down_m}
    with refused("vessel.reports_at_m, vessel.motion_at_m", ValueError):
        sensor = structs.replace(known.motion_sensor, forward_m=ahead_m, right_m=aside_m)
        return structs.replace(known, motion_sensor=sensor, **pad)


class FlyOptions(Struct, frozen=True):
    """The rarer options of `fly`."""

    perception_model: str | None = None
    """The error model's file, or the name of a shipped one; None for the one of the settings' vision."""
    shadows: Sequence[PathName] = ()
    """Estimator paths that run beside the steering one; they do not change the flight."""
    on_start: Callable[[Health], None] | None = None
    """Receives the counters of the flight's health before the first step."""
    on_truth: Callable[[Truth], None] | None = None
    """Receives the true state every 20 ms, at every exposure of a frame, and at the end."""
    render_beside: bool = False
    """Frames are rendered in a process of their own. The same bits, sooner where a second core is idle."""
    overtime_s: float = 0.0
    """Further time beyond the scenario's for a flight whose guidance is still trying to land."""
    on_pilot: Callable[[Pilot], None] | None = None
    """Receives the service's pilot before the first step: what its estimator answers changes no flight."""


def fly(
    name: str,
    scenario: Scenario,
    seed: int,
    settings: Settings,
    perception: Perception = "pixels",
    observers: Sequence[Observer] = (),
    options: FlyOptions | None = None,
) -> Ending:
    """Fly a scenario once and return how it ended.

    Args:
        name: what the caller calls the scenario: the name of a shipped one or a path. It does not change the flight.
        seed: of all random numbers, 0 or more.
        perception: how the service perceives the pad.
        observers: receive what the daemon's observers would receive.

    Raises:
        BadInput: the settings name a camera or pad file with a fault; there is no such perception or error model, or it cannot
            represent a fault of the scenario.
        SetupImpossible: the simulated drone refuses a key of the configuration.
    """
    options = options or FlyOptions()
    scenario = msgspec.structs.replace(scenario, wrong_model=scenario.wrong_model.drawn(seed))
    seen_by = perceive(perception, options.perception_model)
    renew = partial(seen_by.pilot, settings, options.shadows)
    timing = Timing(overtime_s=options.overtime_s)
    began_s, pilot = cpu_s(), renew()
    flight = new_flight(scenario, seed, settings, pilot, observers=observers, timing=timing, renew=renew, perception=seen_by)
    flight.contained = True
    if options.on_start is None:
        flight.unwatched()
    else:
        options.on_start(flight.health)
    if options.on_pilot is not None:
        options.on_pilot(pilot)
    on_truth = options.on_truth
    with ExitStack() as stack:
        if options.render_beside and perception == "pixels":
            flight.worker = stack.enter_context(render_worker(flight.world.renderer))
        steps = exposures = 0
        while flight.step():
            steps += 1
            exposed, exposures = flight.exposures > exposures, flight.exposures
            if on_truth is not None and (exposed or steps % TRUTH_EACH == 0):
                on_truth(flight.world.truth())
        if on_truth is not None:
            on_truth(flight.world.truth())
        ending = flight.afterwards().ending(cpu_s() - began_s)
    return structs.replace(ending, scenario=name)
