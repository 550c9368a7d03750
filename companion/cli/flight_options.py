"""Options of the commands that simulate flights: how the pad is perceived, and what differs from scenario and settings."""

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path

from companion.cli.options import option
from companion.settings.capabilities import installed_vehicles, vehicle_kind
from companion.settings.load import find_file, shipped
from companion.settings.model import Settings
from companion.settings.overrides import warn_of_idle
from estimator.contracts.errors import BadInput
from sitl.flight.one_flight import PERCEPTIONS
from sitl.scenario.overrides import Overridable
from sitl.scenario.scenario import Scenario
from sitl.scenario.settings import rig_for

ARDRONE = "ardrone2"
"""The shipped vehicle that flies by itself, without an autopilot."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options to a parser."""
    add_settings(parser)
    option(
        parser,
        "--perception LEVEL",
        f"how the service perceives the pad: {', '.join(PERCEPTIONS)} (default: pixels, rendered frames)",
        default="pixels",
    )
    option(
        parser,
        "--perception-model FILE",
        "error model of --perception model or truth, from python -m sitl.study.perception (default: the one of vision.method)",
    )
    others = ", ".join(name for name in shipped("vehicles") if name != ARDRONE)
    flown = (
        f"fly this vehicle instead of the scenario's: ardrone, {others}, or a vehicle file; all but an AR.Drone by an autopilot"
    )
    option(parser, "--vehicle NAME", f"{flown} (default: arducopter)")
    option(
        parser,
        "--wrong-model SIGMA",
        "let the seed draw by how much the vehicle differs from its file, in standard deviations of what an owner's "
        "identification leaves; 0 for not at all (default: as the scenario says, 1 in weather_2 to weather_6)",
        dest="set",
        default=[],
        action="append",
        type="wrong_model.sigma={}".format,
    )


def add_settings(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose the settings, and change keys of them and of the scenario."""
    whose = "settings file to fly with: its camera and pad are the simulated world's too"
    option(parser, "--config FILE", f"{whose} (default: the profile sim with the scenario's camera and pad)")
    meaning = "give a key of scenario or settings another value, as in wind.speed_m_s=4; may be repeated"
    option(parser, "--set KEY=VALUE", meaning, default=[], action="append")


def chosen(args: argparse.Namespace, scenario: Scenario, *, by_autopilot: bool = False) -> Overridable:
    """Return scenario and settings as `--config` and `--set` have them, with the keys that the world replaced.

    Raises:
        BadInput: as `sitl.scenario.settings.rig_for`, and as `Overridable.with_values`.
    """
    rig = rig_for(scenario, args.config, by_autopilot=by_autopilot)
    own = args.config is not None
    given = Overridable(rig.scenario, rig.settings, own=own)
    overrides = [given.parse(text, "--set") for text in args.set]
    return Overridable(*given.with_values(overrides, "--set"), own=own, replaced=rig.replaced)


def notice(config: str | None, replaced: Iterable[str]) -> str:
    """Return the line that names the keys of a person's file that have another value here; empty if there are none."""
    keys = ", ".join(dict.fromkeys(replaced))
    return f"decklander: {config}: replaced by the simulation: {keys}\n" if config is not None and keys else ""


def choose_vehicle(args: argparse.Namespace) -> None:
    """Let `--vehicle` replace the scenario's vehicle; one with an autopilot is flown by it, ArduCopter's unless another is named.

    Where no vehicle that flies by itself is installed, ArduCopter flies the scenario's.

    Raises:
        BadInput: there is no such vehicle, or it is not installed, or `--set` names one too.
    """
    if args.vehicle is None:
        alone = any(kind.flight for kind in installed_vehicles()) or vars(args).get("follow") is not None
        args.autopilot = args.autopilot or (None if alone else "arducopter")
        return
    if any(one.startswith("vehicle.file=") for one in args.set):
        raise BadInput("--vehicle sets vehicle.file: give one of them")
    name = ARDRONE if args.vehicle == "ardrone" else args.vehicle
    find_file(name, "vehicles", Path(), "--vehicle")
    args.set = [f"vehicle.file={name}", *args.set]
    if name == ARDRONE:
        vehicle_kind("ardrone")
    else:
        args.autopilot = args.autopilot or "arducopter"


def warn(args: argparse.Namespace, points: list[Settings], replaced: Iterable[str], place: str = "a simulated flight") -> None:
    """Name on standard error what the world replaced, and what was given and cannot act in a flight by these settings."""
    sys.stderr.write(notice(args.config, replaced))
    blind, truth = args.perception in ("model", "truth"), args.perception == "truth"
    places = {place: True, "a flight without frames, as by --perception model": blind, "a flight by --perception truth": truth}
    warn_of_idle(points, [*args.set, *vars(args).get("vary", ())], places)
