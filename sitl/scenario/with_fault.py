"""A scenario with the faults of a shipped fault scenario, selected by a seed or by name."""

import math
from collections.abc import Callable
from functools import cache

import msgspec
import numpy as np

from companion.settings.load import shipped
from estimator.contracts.errors import BadInput
from sitl.faults.kinds import OperatorActs, ServiceKilled, VesselReports
from sitl.scenario.scenario import FAULTS, Scenario, load

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
        possible: tells whether a flight can have all faults of a scenario; only such ones are selected.
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
    title = f"{scenario.title}; {FAULTS}/{name}"[:120]
    faults = (*scenario.faults, *fault.faults)
    right = {name: getattr(fault, name) for name in ("expect", "unreached_contacts", "refusal", "because")}
    return msgspec.structs.replace(scenario, title=title, faults=faults, **right)


@cache
def _choices() -> list[tuple[str, Scenario]]:
    every = [(name, load(f"{FAULTS}/{name}")) for name in shipped(f"scenarios/{FAULTS}")]
    # A fault that has a vessel or a vehicle of its own needs it: a ship at anchor does not stop.
    usual = load("demo")
    return [(name, other) for name, other in every if other.vessel == usual.vessel and other.vehicle == usual.vehicle]
