"""Map a gamepad's events to stick positions and orders: a file says which axis and button means what. No I/O.

Orders come from edges: a button that is held, or held when the gamepad is plugged in, gives none. A stick counts only once it was
near its centre, because some gamepads report an end of the range until they are first moved.
"""

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar, Literal, get_args

from msgspec import Meta, Struct

from drivers.gamepad.device import AXES, BUTTONS, EV_ABS, EV_KEY, EV_SYN, SYN_DROPPED, SYN_REPORT, AxisRange, InputEvent
from estimator.contracts.keys import CheckedOptions, choice, number, text
from estimator.contracts.time import MonoNs, seconds_between

Stick = Literal["climb", "turn", "forward", "right"]
ButtonOrder = Literal["takeoff", "land", "emergency", "reset", "manual", "begin", "stay", "abort", "hold"]
STICKS: tuple[Stick, ...] = get_args(Stick)
_BOUNCE_S = 0.08
"""A button that is pressed again within this time bounced."""


class StickAxis(Struct, frozen=True, forbid_unknown_fields=True):
    """The axis of one stick.

    Raises:
        ValueError: there is no such axis.
    """

    axis: Annotated[str, text("the kernel's name of the axis, ABS_...", 20)]
    invert: Annotated[
        bool, choice("whether the axis grows against the stick's meaning, as an upright axis does: it grows downwards")
    ] = False

    def __post_init__(self) -> None:
        if self.axis not in AXES:
            raise ValueError(f"there is no axis {self.axis!r}{_near(self.axis, AXES)}")


class StickAxes(Struct, frozen=True, forbid_unknown_fields=True):
    """The axes of the four sticks."""

    climb: StickAxis
    turn: StickAxis
    forward: StickAxis
    right: StickAxis


class GamepadMapping(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """A mapping file: the sticks' axes and their response, and the orders of the buttons.

    Raises:
        ValueError: an axis, a button or an order is unknown, an axis has two meanings, or a number is out of range.
    """

    name: Annotated[str, text("the name of the mapping", 80)]
    sticks: StickAxes
    buttons: Annotated[dict[str, str], Meta(description="the order of each button, by the kernel's name of the button, BTN_...")]
    dead_zone: Annotated[float, number("deflection below which a stick is centred", "1", 0.01, 0.5)] = 0.1
    exponent: Annotated[float, number("curve of a stick: 1 is straight, 2 is soft around the centre", "1", 0.5, 4.0)] = 1.5
    limit: Annotated[float, number("position that full deflection gives", "1", 0.05, 1.0)] = 1.0
    orders_max_hz: ClassVar[int] = 10
    """Orders that are taken in one second; more are dropped and counted, but for emergency."""

    def __post_init__(self) -> None:
        super().__post_init__()
        axes = [getattr(self.sticks, stick).axis for stick in STICKS]
        if twice := [axis for axis in axes if axes.count(axis) > 1]:
            raise ValueError(f"the axis {twice[0]} has two meanings")
        orders = get_args(ButtonOrder)
        for button, order in self.buttons.items():
            if button not in BUTTONS:
                raise ValueError(f"there is no button {button!r}{_near(button, BUTTONS)}")
            if order not in orders:
                raise ValueError(f"buttons.{button} must be one of {', '.join(orders)}, found {order!r}")


@dataclass(frozen=True, slots=True)
class GamepadMemory:
    """Memory of the mapping for one gamepad."""

    deflections: Mapping[str, float]
    """The deflection of each stick, -1 to 1, before dead zone and curve."""
    live: frozenset[str] = frozenset()
    """The sticks that were near their centre since the gamepad was plugged in."""
    pressed_at: Mapping[int, MonoNs] = field(default_factory=dict)
    """Time of the last press of each button."""
    given_at: tuple[MonoNs, ...] = ()
    """Times of the orders of the last second."""
    dropped: bool = False
    """The kernel has dropped events; those up to the next report are incomplete."""
    stale: bool = False
    """The axes must be read again, because events were dropped."""
    bounced: int = 0
    """Orders that were left out, because a button bounced or there were too many."""


def start(mapping: GamepadMapping, ranges: Mapping[int, AxisRange]) -> GamepadMemory:
    """Return the memory of a gamepad that was just plugged in, or whose axes were read again."""
    found: dict[str, float] = {stick: _deflection(mapping, stick, ranges, None) for stick in STICKS}
    return GamepadMemory(found, frozenset(stick for stick in STICKS if abs(found[stick]) <= mapping.dead_zone))


def _deflected(
    mapping: GamepadMapping, memory: GamepadMemory, stick: str, ranges: Mapping[int, AxisRange], value: int
) -> GamepadMemory:
    """Return the memory after an axis has moved; a stick is live once it was in the middle."""
    deflection = _deflection(mapping, stick, ranges, value)
    live = memory.live | {stick} if abs(deflection) <= mapping.dead_zone else memory.live
    return replace(memory, deflections={**memory.deflections, stick: deflection}, live=live)


def gamepad_step(
    mapping: GamepadMapping, memory: GamepadMemory, events: Iterable[InputEvent], ranges: Mapping[int, AxisRange], now: MonoNs
) -> tuple[GamepadMemory, tuple[str, ...]]:
    """Process events; return the next memory and the orders that were given, in their order.

    Args:
        ranges: the ranges of the gamepad's axes by code.
    """
    orders: list[str] = []
    buttons = {BUTTONS[name]: order for name, order in mapping.buttons.items()}
    sticks = {AXES[getattr(mapping.sticks, stick).axis]: stick for stick in STICKS}
    for event in events:
        if event.kind == EV_SYN and event.code == SYN_DROPPED:
            memory = replace(memory, dropped=True)
        elif event.kind == EV_SYN and event.code == SYN_REPORT and memory.dropped:
            memory = replace(memory, dropped=False, stale=True)
        elif memory.dropped:
            continue
        elif event.kind == EV_ABS and event.code in sticks:
            memory = _deflected(mapping, memory, sticks[event.code], ranges, event.value)
        elif event.kind == EV_KEY and event.value == 1 and event.code in buttons:
            most_hz = math.inf if buttons[event.code] == "emergency" else mapping.orders_max_hz
            memory, given = _press(memory, event.code, now, most_hz)
            orders += [buttons[event.code]] if given else []
    return memory, tuple(orders)


def positions(mapping: GamepadMapping, memory: GamepadMemory) -> dict[str, float]:
    """Return the position of each stick, -1 to 1, with dead zone, curve and limit."""
    return {stick: _curve(mapping, memory.deflections[stick]) if stick in memory.live else 0.0 for stick in STICKS}


def _press(memory: GamepadMemory, code: int, now: MonoNs, most_hz: float) -> tuple[GamepadMemory, bool]:
    before = memory.pressed_at.get(code)
    given_at = tuple(at for at in memory.given_at if seconds_between(at, now) < 1.0)
    left_out = (before is not None and seconds_between(before, now) < _BOUNCE_S) or len(given_at) >= most_hz
    pressed_at = {**memory.pressed_at, code: now}
    if left_out:
        return replace(memory, pressed_at=pressed_at, given_at=given_at, bounced=memory.bounced + 1), False
    return replace(memory, pressed_at=pressed_at, given_at=(*given_at, now)), True


def _deflection(mapping: GamepadMapping, stick: str, ranges: Mapping[int, AxisRange], value: int | None) -> float:
    """Return the deflection of a stick; 0 if the gamepad lacks its axis."""
    axis: StickAxis = getattr(mapping.sticks, stick)
    found = ranges.get(AXES[axis.axis])
    if found is None or found.maximum <= found.minimum:
        return 0.0
    at = found.value if value is None else value
    deflection = min(1.0, max(-1.0, 2.0 * (at - found.minimum) / (found.maximum - found.minimum) - 1.0))
    return -deflection if axis.invert else deflection


def _curve(mapping: GamepadMapping, deflection: float) -> float:
    beyond = (abs(deflection) - mapping.dead_zone) / (1.0 - mapping.dead_zone)
    if beyond <= 0.0:
        return 0.0
    size = min(1.0, math.pow(beyond, mapping.exponent)) * mapping.limit
    return size if deflection > 0 else -size


def _near(word: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(word, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else f"; known are {', '.join(known)}"
