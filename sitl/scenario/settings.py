"""The settings that fly in a simulated world: a person's own rig, or the profile `sim`, and the keys that the world replaces.

A person's file keeps all that is his: camera file, pad and gimbal, which the world takes over, the limits, the law and the parts
of the service. What the world alone knows is replaced (`in_world`): vehicle, links, ship, and where frames come from.
"""

import math
from collections.abc import Iterator

from msgspec import Struct, structs

from companion.settings.capabilities import CAPABILITIES
from companion.settings.load import from_file, load, read_toml
from companion.settings.model import PadSettings, Settings, in_file
from companion.settings.overrides import leaves, plain
from companion.settings.vessel import VesselOptions
from decklander.place import SHIPPED
from drivers.mavlink.options import SIMULATED_LINK, autopilot_of
from estimator.contracts.errors import BadInput, refused
from sitl.scenario.scenario import Scenario, vehicle_model

SHIP_WIRES = next(capability.keys for capability in CAPABILITIES if capability.extra == "ship")
"""Keys of the ship's wires: the simulated ship reports to the service itself."""


class Rig(Struct, frozen=True):
    """A scenario and the settings that fly in it."""

    scenario: Scenario
    settings: Settings
    replaced: tuple[str, ...] = ()
    """Keys of the person's file that have another value in the world."""


def rig_for(scenario: Scenario, config: str | None, *, by_autopilot: bool = False) -> Rig:
    """Return the settings of a file with a world of its camera and pad, or without one the profile `sim` in the scenario's.

    An AR.Drone's flight begins by itself, whatever its file's `guidance.start`: nobody is there to order the landing.

    Args:
        by_autopilot: whether an autopilot flies.

    Raises:
        BadInput: the file is of another kind of vehicle; or as `companion.settings.load.load`, and as `following`.
    """
    if config is None:
        return Rig(scenario, following(scenario, _profile(by_autopilot=by_autopilot)))
    own = load(config)
    if by_autopilot != (autopilot_of(own.vehicle) is not None):
        fix = f"--autopilot does not fly {own.vehicle.name}" if by_autopilot else "give --autopilot arducopter or px4"
        raise BadInput(f'{config}: vehicle.kind is "{own.vehicle.kind}": {fix}')
    scenario = _with_rig(scenario, own)
    settings = in_world(scenario, own)
    if not by_autopilot:
        settings = structs.replace(settings, guidance=structs.replace(settings.guidance, start="automatic"))
    return Rig(scenario, settings, tuple(replaced_keys(own, settings)))


def settings_for(scenario: Scenario, config: str | None, *, by_autopilot: bool = False) -> Settings:
    """Return the settings of `rig_for`; without a file the scenario stays as it is."""
    return rig_for(scenario, config, by_autopilot=by_autopilot).settings


def replaced_keys(own: Settings, flown: Settings) -> Iterator[str]:
    """Yield the keys, as a settings file has them, whose values differ."""
    before = dict(leaves(plain(own)))
    yield from (in_file(key) for key, value in leaves(plain(flown)) if before.get(key) != value)


def _profile(*, by_autopilot: bool) -> Settings:
    """Return the shipped profile `sim`; for an autopilot with that as its vehicle."""
    if not by_autopilot:
        return load("sim")
    data = read_toml(SHIPPED / "sim.toml")
    return from_file({**data, "vehicle": {"kind": "mavlink", "links": SIMULATED_LINK}}, "sim")


def _with_rig(scenario: Scenario, own: Settings) -> Scenario:
    """Return the scenario with what a world takes over from a person's rig: camera, gimbal, pad and the AR.Drone's generation."""
    vehicle, gimbal = scenario.vehicle, scenario.gimbal
    if own.vehicle.generation:
        vehicle = structs.replace(vehicle, generation=own.vehicle.generation)
    if own.camera.gimbal.device_id != gimbal.device_id:
        gimbal = structs.replace(gimbal, device_id=own.camera.gimbal.device_id)
    return structs.replace(
        scenario,
        camera=structs.replace(scenario.camera, file=own.camera.file),
        pad=structs.replace(scenario.pad, file=own.pad.file),
        vehicle=vehicle,
        gimbal=gimbal,
    )


def in_world(scenario: Scenario, settings: Settings) -> Settings:
    """Return the settings with all that a simulated world replaces: the one list of these keys.

    They are where frames come from, the links of an autopilot with its ids and key, the ship's wires, where on the ship antenna,
    motion sensor and arrow are, the vehicle's feet, and the scenario's camera, pad, gimbal and generation of AR.Drone.

    Raises:
        BadInput: as `sitl.scenario.scenario.vehicle_model`, or one of the ship's places is too far from the pad.
    """
    flown = vehicle_model(scenario)
    feet, vehicle = flown.feet, settings.vehicle.simulated(scenario.vehicle.generation, flown.loops.tilt_max_deg)
    for table, _, key in (wire.partition(".") for wire in SHIP_WIRES):
        if hasattr(getattr(settings, table, None), key):
            settings = structs.replace(settings, **{table: structs.replace(getattr(settings, table), **{key: ""})})
    gimbal = structs.replace(settings.camera.gimbal, device_id=scenario.gimbal.device_id, point_down=scenario.gimbal.given)
    # Frames come stamped right, and from no device.
    camera = structs.replace(
        settings.camera, file=scenario.camera.file, source="vehicle", device="", latency_s=0.0, gimbal=gimbal
    )
    cone = structs.replace(settings.guidance.cone, feet_below_m=feet.below_m, feet_aside_m=feet.half_base_m)
    yaw_rad = math.radians(scenario.vessel.pad_yaw_deg) % math.tau
    ekf = structs.replace(settings.estimator.ekf, pad_yaw_in_vessel_rad=yaw_rad)
    return structs.replace(
        settings,
        vehicle=vehicle,
        camera=camera,
        pad=PadSettings(scenario.pad.file),
        vessel=_placed(scenario, settings.vessel),
        estimator=structs.replace(settings.estimator, ekf=ekf),
        guidance=structs.replace(settings.guidance, cone=cone),
    )


def following(scenario: Scenario, settings: Settings) -> Settings:
    """Return the simulator's own settings with all that a scenario says of what they describe.

    They are those of `in_world`. Where the scenario's ship reports her place, they fly to it. An AR.Drone flies by the response
    that the vehicle's file names, which is that of its own loops; an autopilot has its own loops.

    Raises:
        BadInput: as `in_world`.
    """
    settings, vehicle = in_world(scenario, settings), vehicle_model(scenario)
    rendezvous = structs.replace(settings.guidance.rendezvous, enabled=scenario.vessel.reports_place)
    follow = settings.guidance.follow_deck
    if autopilot_of(settings.vehicle) is None:
        follow = structs.replace(follow, response=vehicle.response)
    return structs.replace(settings, guidance=structs.replace(settings.guidance, rendezvous=rendezvous, follow_deck=follow))


def _placed(scenario: Scenario, known: VesselOptions) -> VesselOptions:
    """Return the ship's settings with the places of the scenario's antenna and motion sensor."""
    forward_m, right_m, down_m = scenario.vessel.reports_at_m
    ahead_m, aside_m, _ = scenario.vessel.motion_at_m
    # From zero, as a negative zero is another number in a campaign's digest.
    pad = {"pad_forward_m": 0.0 - forward_m, "pad_right_m": 0.0 - right_m, "pad_up_m": down_m}
    with refused("vessel.reports_at_m, vessel.motion_at_m", ValueError):
        sensor = structs.replace(known.motion_sensor, forward_m=ahead_m, right_m=aside_m)
        return structs.replace(known, motion_sensor=sensor, **pad)
