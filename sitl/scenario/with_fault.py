"""A scenario with more faults: those of a shipped fault scenario, or faults that a seed draws.

What was drawn can be written as a scenario file, which flies the same to the bit.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from textwrap import shorten

import msgspec
import numpy as np

from companion.settings.load import shipped
from decklander.place import SHIPPED
from estimator.contracts.errors import BadInput
from sitl.faults.drawn import Drawable, draw
from sitl.faults.kinds import AnyFault, OperatorActs, ServiceKilled, VesselReports
from sitl.scenario.scenario import FAULTS, TITLE_MAX, Scenario, load, shipped_scenarios, signals_of, vehicle_model
from sitl.vehicle.airframe import rotors

VIRTUAL_ONLY = (ServiceKilled, OperatorActs, VesselReports)
"""Faults of what runs beside the drone, which no drone behind sockets can have."""


def real_time(scenario: Scenario) -> bool:
    """Return whether a drone behind sockets can have all faults of the scenario."""
    return all(fault.in_phase is None and not isinstance(fault, VIRTUAL_ONLY) for fault in scenario.faults)


def faulty(
    scenario: Scenario, seed: int, *, possible: Callable[[Scenario], bool] = real_time, name: str | None = None
) -> Scenario:
    """Return the scenario with the faults and the expectation of a shipped fault scenario, selected by the seed.

    Args:
        scenario: the scenario to which the faults are added.
        seed: selects the fault scenario.
        possible: returns whether a flight can have all faults of a scenario; only such ones are selected.
        name: the fault scenario to take instead; a seed selects another one when fault scenarios are added.

    Raises:
        BadInput: none of that name can be added to the scenario.
    """
    start = scenario.start
    highest_m = math.inf if start.where == "pad" else start.height_m
    choices = [
        (name, other)
        for name, other in _choices()
        if possible(other) and all((f.below_height_m or 0.0) <= highest_m for f in other.faults)
    ]
    if name is not None:
        choices = [choice for choice in choices if choice[0] == name.removeprefix(f"{FAULTS}/")]
        if not choices:
            raise BadInput(f"{FAULTS}/{name}: not a fault scenario that can be added to {scenario.title!r}")
    name, fault = choices[int(np.random.default_rng([seed, 0xFA]).integers(len(choices)))]
    title = _title(f"{scenario.title}; {FAULTS}/{name}")
    faults = (*scenario.faults, *fault.faults)
    right = {name: getattr(fault, name) for name in ("expect", "unreached_contacts", "refusal", "because")}
    return msgspec.structs.replace(scenario, title=title, faults=faults, **right)


@cache
def _choices() -> list[tuple[str, Scenario]]:
    every = [(name, load(f"{FAULTS}/{name}")) for name in shipped(f"scenarios/{FAULTS}")]
    # A fault that has a vessel or a vehicle of its own needs it: a ship at anchor does not stop.
    usual = load("demo")
    return [(name, other) for name, other in every if other.vessel == usual.vessel and other.vehicle == usual.vehicle]


def _title(text: str) -> str:
    """Return the text as a title: whole words, with dots where it is too long."""
    return shorten(text, TITLE_MAX, placeholder=" ...")


_OVER_FEET_M, _HIGHEST_M = 0.1, 8.0


def with_random_faults(scenario: Scenario, seed: int, level: str, *, autopilot: bool = False) -> Scenario:
    """Return the scenario with faults of one or two kinds that the seed draws; to land on the pad and to refuse are both right.

    Args:
        level: of perception: only drawn detections can be corrupted by themselves, and only a rendered pad can be another.
        autopilot: whether the stand-in of an autopilot flies it.

    Raises:
        BadInput: at the level `truth`, which has no filter that a fault could deceive.
    """
    if level == "truth":
        raise BadInput("--faults random: a corrupted signal deceives the filter, which --perception truth leaves out")
    signals = [s for s in signals_of(scenario.vessel, scenario.vehicle) if s != "sighting" or level == "model"]
    start = scenario.start
    highest_m = _HIGHEST_M if start.where == "pad" else start.height_m
    frame = vehicle_model(scenario).airframe()
    heights_m = min(frame.feet.below_m + _OVER_FEET_M, highest_m), highest_m
    names = [rotor.name for rotor in rotors(frame)]
    file = Path(scenario.pad.file)
    pad = file.stem if file.parent == SHIPPED / "pads" else str(file)
    there = Drawable(signals, heights_m, names, pad, level == "pixels", autopilot)
    return with_faults(scenario, draw(seed, there))


def with_faults(scenario: Scenario, faults: Sequence[AnyFault]) -> Scenario:
    """Return the scenario with these faults besides; it may land or refuse, and touch what it must while no service runs."""
    title = _title(f"{', '.join(fault.words for fault in faults)}: {scenario.title}")
    alone = any(isinstance(fault, ServiceKilled) for fault in faults)
    own = {"unreached_contacts": alone, "because": "whatever goes wrong, it lands on the pad or says why not"}
    return msgspec.structs.replace(scenario, title=title, faults=(*scenario.faults, *faults), expect="either", refusal="", **own)


def as_toml(name: str, faulty_one: Scenario, faults: Sequence[AnyFault], head: Sequence[str]) -> str:
    """Return a scenario file that adds faults to a scenario.

    Args:
        name: a shipped scenario or the path of one, which becomes the base.
        faulty_one: the scenario with the faults, as `with_faults` returns it.
        head: lines of the comment at its top.
    """
    base = name if name in shipped_scenarios() else str(Path(name).resolve())
    keys = ("expect", "unreached_contacts", "because")
    own = {"title": faulty_one.title, "base": base, **{key: getattr(faulty_one, key) for key in keys}}
    lines = [f"# {line}" for line in head] + [f"{key} = {_toml(value)}" for key, value in own.items()]
    for fault in faults:
        usual = {field.name: field.default for field in msgspec.structs.fields(type(fault))}
        output = {key: value for key, value in msgspec.structs.asdict(fault).items() if value != usual[key]}
        lines += ["", "[[faults]]", *(f"{key} = {_toml(value)}" for key, value in {"kind": fault.kind, **output}.items())]
    return "\n".join(lines) + "\n"


def _toml(value: str | float) -> str:
    # JSON's strings and numbers are TOML's, as long as no number is infinite.
    return msgspec.json.encode(value).decode()
