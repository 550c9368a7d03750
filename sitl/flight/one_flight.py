"""Fly one scenario once, in virtual time: the same scenario, seed, settings and perception give the same ending to the bit.

`simulate`, the benches and campaigns all fly by `fly`.
"""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial

import msgspec
from msgspec import Struct, structs

from companion.base.health import Health
from companion.base.observer import Observer
from companion.guidance.pilot import Pilot
from companion.settings.model import Settings
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import PathName
from sitl.camera.render_worker import render_worker
from sitl.flight.afterwards import cpu_s
from sitl.flight.ending import Ending
from sitl.flight.stepped import new_flight
from sitl.perception.levels import perceive
from sitl.perception.port import LEVELS, Level
from sitl.scenario.scenario import Scenario
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
    began_s, pilot = cpu_s(), renew()
    flight = new_flight(scenario, seed, settings, pilot, observers=observers, renew=renew, perception=seen_by)
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
