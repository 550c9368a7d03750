"""The settings of a scenario's flight: those of a file, or those of the simulator that follow the scenario."""

import math

import msgspec
from msgspec import structs

from companion.settings.load import load
from companion.settings.model import CameraSettings, PadSettings, Settings
from companion.settings.vessel import VesselOptions
from drivers.mavlink.options import GimbalOptions
from estimator.contracts.errors import refused
from sitl.scenario.scenario import Scenario, vehicle_model


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
