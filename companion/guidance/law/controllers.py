"""The controllers by name: those of the core and of capabilities, and any that an installed package offers.

A package offers one as an entry point of the group `decklander.controllers`, under the name that the setting
`guidance.controller` then holds: a function that takes a `ControllerSetup` and returns a `Controller`.
"""

from collections.abc import Callable
from typing import Any

from msgspec import Struct, structs

from companion.guidance.controller import Controller, FieldOfView
from companion.guidance.law.follow_deck import FollowDeck
from companion.guidance.law.pid import PidController
from companion.settings.capabilities import load_offered, names_offered, of_packages, offered
from companion.settings.guidance import GuidanceOptions, Response
from estimator.contracts.errors import BadInput, refused

GROUP = "decklander.controllers"


class ControllerSetup(Struct, frozen=True):
    """Parts from which a controller is made."""

    guidance: GuidanceOptions
    response: Response
    view: FieldOfView | None = None
    over_ground: bool = False
    """True if the vehicle's driver takes velocities over the ground and adds the deck's own to them."""


def make_controller(setup: ControllerSetup) -> Controller[Any]:
    """Return the controller that `guidance.controller` names.

    Raises:
        BadInput: there is none of that name, it cannot be loaded, or it finds no gains for the vehicle's response.
    """
    name = setup.guidance.controller
    make = _OWN.get(name) or OFFERED.get(name) or _offered(name)
    with refused(f"guidance.controller {name!r}", ValueError):
        return make(setup)


def make_follow_deck(setup: ControllerSetup) -> FollowDeck:
    """Return the law that follows the deck, within the limits of its options."""
    o = setup.guidance.follow_deck
    tilt, climb = setup.response.tilt, setup.response.climb
    response = Response(
        structs.replace(tilt, max_deg=min(tilt.max_deg, o.tilt_max_deg)),
        structs.replace(climb, max_m_s=min(climb.max_m_s, o.climb_max_m_s)),
    )
    return FollowDeck(
        response,
        1.0 / setup.guidance.rate_hz,
        setup.view if o.keep_in_view else None,
        fallback=PidController(setup.guidance.pid, heaves=not setup.over_ground),
        over_ground=setup.over_ground,
    )


_OWN: dict[str, Callable[[ControllerSetup], Controller[Any]]] = {
    "follow_deck": make_follow_deck,
    "pid": lambda setup: PidController(setup.guidance.pid, heaves=not setup.over_ground),
}


OFFERED: dict[str, Callable[[ControllerSetup], Controller[Any]]] = {}
"""Controllers that a program of its own offers in this process, before it flies; as an installed package's, without a package."""


def _offered(name: str) -> Callable[[ControllerSetup], Controller[Any]]:
    found: Callable[[ControllerSetup], Controller[Any]]
    if name in names_offered("controllers"):
        found = offered("controllers", name, f'guidance.controller = "{name}"')
        return found
    of_others = of_packages(GROUP)
    if name not in of_others:
        known = ", ".join(sorted({*_OWN, *names_offered("controllers"), *of_others}))
        raise BadInput(f"guidance.controller: there is no controller {name!r}; known are {known}")
    found = load_offered(of_others[name], f"guidance.controller: {name!r}")
    return found
