"""`decklander fly`: give orders to the running service, or fly by the keyboard."""

from __future__ import annotations

import argparse
import asyncio
import os
import re
import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
from msgspec import Struct, field, structs

from companion.base import event_loop
from companion.base.orders import CENTRED, TWICE_S, OperatorOrder, StickPositions
from companion.cli.options import option, refuse_any
from companion.facts.wire import FlightState
from companion.parts.operator.client import OperatorClient, connected, in_time, line_of_state, running
from companion.settings.load import load
from estimator.contracts.errors import Recoverable

KEY_S = 0.5
"""The time after its last repetition at which a key's motion ends, s: a terminal sends a key again while it is held."""
TWICE: dict[str, tuple[OperatorOrder, str]] = {
    "E": (OperatorOrder.EMERGENCY, "CUT THE MOTORS"),
    "t": (OperatorOrder.TAKE_OFF, "take off"),
    "l": (OperatorOrder.LAND, "land here: "),
    "c": (OperatorOrder.CLEAR, "land although: "),
    "R": (OperatorOrder.RESET, "leave the emergency state"),
}
"""The keys that must be pressed twice: the order of each, and its words."""
_TICK_S = 0.05  # interval of keys and display
_STEP = 0.1  # change of the sticks' deflection by a key

MOTIONS: dict[str, tuple[str, float]] = {
    "w": ("climb", 1.0),
    "s": ("climb", -1.0),
    "d": ("turn", 1.0),
    "a": ("turn", -1.0),
    "up": ("forward", 1.0),
    "down": ("forward", -1.0),
    "right": ("right", 1.0),
    "left": ("right", -1.0),
}
"""The stick and the direction of each key."""
KEYS: dict[str, OperatorOrder] = {
    "b": OperatorOrder.BEGIN,
    "p": OperatorOrder.STAY,
    "x": OperatorOrder.ABORT,
    " ": OperatorOrder.HOLD,
}
HELP = (
    "m take or give back the hand   w/s up, down   a/d turn   arrows move   +/- faster, slower",
    "t t take off   l l land here   p stay over the pad   b begin the landing   x abort it   c c ignore the thing on it",
    "space hold   E E cut the motors   R R reset   q end",
)
_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
_KEY = re.compile(r"\x1b[\[O][0-9;]*([A-Z~])|\x1b|.", re.DOTALL)


def keys_in(text: str) -> Iterator[str]:
    """Yield the keys in what a terminal sent: characters, or the names of the arrow keys. Other keys are left out."""
    for found in _KEY.finditer(text):
        if found[1] is not None:
            if found[1] in _ARROWS:
                yield _ARROWS[found[1]]
        elif found[0] != "\x1b":
            yield found[0]


class KeyMotion(Struct, frozen=True):
    """The keys as sticks: the direction of each stick and the time until which it holds."""

    fraction: float = 0.5
    """Deflection of a stick while its key is held."""
    until_s: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Direction of each stick, and the time at which it ends, s."""

    def pressed(self, key: str, now_s: float) -> KeyMotion:
        """Return the motion after a key of `MOTIONS`, + or -."""
        if key in "+=":
            return structs.replace(self, fraction=min(1.0, round(self.fraction + _STEP, 3)))
        if key == "-":
            return structs.replace(self, fraction=max(_STEP, round(self.fraction - _STEP, 3)))
        stick, direction = MOTIONS[key]
        return structs.replace(self, until_s={**self.until_s, stick: (direction, now_s + KEY_S)})

    def sticks(self, now_s: float) -> StickPositions:
        """Return the positions of the sticks now; all are centred when no key is held."""
        held = {stick: direction * self.fraction for stick, (direction, until_s) in self.until_s.items() if now_s < until_s}
        return StickPositions(**held)


class _Keyboard:
    """One terminal session."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self.keys: asyncio.Queue[str] = asyncio.Queue(maxsize=256)
        self._motion = KeyMotion()
        self._state: FlightState | None = None
        self._hand = self._asking = False
        self._once: tuple[str, float] = "", 0.0
        """The newest key that must be pressed twice, and when it was, s."""

    def on_readable(self) -> None:
        """Read what the terminal sent."""
        try:
            text = os.read(sys.stdin.fileno(), 1024).decode(errors="ignore")
        except OSError:
            text = ""
        for key in keys_in(text) if text else ("closed",):
            if not self.keys.full():
                self.keys.put_nowait(key)

    def on_state(self, state: FlightState) -> None:
        """Take the newest state and draw it."""
        if self._hand and not state.yours and not self._asking:
            self.say(f"the hand is lost: {state.phase} {state.reason}".rstrip())
        self._hand, self._state = state.yours, state
        self._draw()

    def _draw(self) -> None:
        state = self._state
        words = "" if state is None else line_of_state(state)
        hand = f"HAND {100 * self._motion.fraction:.0f} %" if self._hand else "watching"
        width = os.get_terminal_size(sys.stdout.fileno()).columns if sys.stdout.isatty() else 100
        sys.stdout.write(f"\r{hand} | {words}"[: max(20, width)] + "\x1b[K")
        sys.stdout.flush()

    def say(self, text: str) -> None:
        """Print a line above the state."""
        sys.stdout.write(f"\r{text}\x1b[K\r\n")
        self._draw()

    async def tick(self, client: OperatorClient) -> None:
        """Send the sticks while this terminal has the hand."""
        while True:
            if self._hand:
                client.move(self._motion.sticks(self._loop.time()))
            await asyncio.sleep(_TICK_S)

    async def obey(self, client: OperatorClient) -> None:
        """Carry out keys until `q` or the end of the terminal."""
        while (key := await self.keys.get()) not in ("q", "closed", "\x03", "\x04"):
            if key in MOTIONS or key in "+=-":
                self._motion = self._motion.pressed(key, self._loop.time())
                if self._hand:
                    client.move(self._motion.sticks(self._loop.time()))
                elif key in MOTIONS:
                    self.say("press m to take the hand")
            elif key == "m":
                wanted = not self._hand
                if await self._give(client, OperatorOrder.MANUAL if wanted else OperatorOrder.RELEASE):
                    self._hand = wanted
                    self._motion = structs.replace(self._motion, until_s={})
            elif key in TWICE:
                await self._twice(key, client)
            elif key in KEYS:
                await self._give(client, KEYS[key])
            elif key == "?":
                for line in HELP:
                    self.say(line)
        if self._hand:
            client.move(CENTRED)
            await client.order(OperatorOrder.RELEASE)

    async def _twice(self, key: str, client: OperatorClient) -> None:
        (order, words), now_s, (before, at_s) = TWICE[key], self._loop.time(), self._once
        within_s = TWICE_S[order]
        self._once = key, now_s
        ignores_nothing = order is OperatorOrder.CLEAR and self._state and not self._state.bars
        if ignores_nothing or (before == key and now_s - at_s <= within_s):
            self._once = "", 0.0
            await self._give(client, order)
        else:
            state = self._state
            where = {OperatorOrder.LAND: state.below, OperatorOrder.CLEAR: state.bars}.get(order, "") if state else "not known"
            self.say(f"press {key} again within {within_s:g} s to {words}{where}")

    async def _give(self, client: OperatorClient, order: OperatorOrder) -> bool:
        self._asking = True
        try:
            answer = await client.order(order)
        finally:
            self._asking = False
        self.say(f"{order.value}: {answer.text}")
        if answer.accepted and order in _GIVES_BACK:
            self._hand = False
        return answer.accepted


async def fly(path: Path) -> int:
    """Fly by the keys of this terminal until `q`; return the exit code.

    Raises:
        Recoverable: the service is gone.
    """
    keyboard = _Keyboard()
    loop = asyncio.get_running_loop()
    with _single_keys():
        for line in HELP:
            keyboard.say(line)
        loop.add_reader(sys.stdin.fileno(), keyboard.on_readable)
        try:
            async with connected(path, keyboard.on_state) as client, asyncio.TaskGroup() as group:
                client.watch()
                ticking = group.create_task(keyboard.tick(client))
                await keyboard.obey(client)
                ticking.cancel()
        except* Recoverable as lost:
            raise lost.exceptions[0] from None
        finally:
            loop.remove_reader(sys.stdin.fileno())
            sys.stdout.write("\r\n")
    return 0


@contextmanager
def _single_keys() -> Iterator[None]:
    """Let the terminal send each key at once and without echo; put it back afterwards."""
    file = sys.stdin.fileno()
    before = termios.tcgetattr(file)
    try:
        tty.setcbreak(file)
        yield
    finally:
        termios.tcsetattr(file, termios.TCSADRAIN, before)


_NAMES = ("takeoff", "hold", "land", "stay", "begin", "abort", "emergency", "reset", "clear")
ORDERS = {name: OperatorOrder(name) for name in _NAMES}
"""The orders of one command line."""
_GIVES_BACK = frozenset(map(ORDERS.get, ("hold", "abort", "land", "stay", "begin", "emergency")))
_AWAITED = {"takeoff": None, "land": None, "begin": None, "emergency": 5.0, "reset": 5.0}
"""Orders whose effect may be awaited, and the time for which it is unbidden, s: an answer alone cuts no motors."""


DESCRIPTION = (
    "Give one order to the service that runs on this computer and print its answer. Without an order, fly by the "
    "keyboard in this terminal. Exit code 0 if the order was accepted, 1 if it was refused or no service answers."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    names = f"{', '.join(ORDERS)} or status; without it, fly by the keyboard"
    option(parser, "order ORDER", names, nargs="?", choices=(*ORDERS, "status"))
    option(parser, "--config FILE", "settings of the service, or its socket, if several run on this computer")
    option(
        parser,
        "--wait S",
        "after takeoff wait until it hovers, after land and begin until it is on the ground, after emergency and reset (5 s) "
        "until it reports that; exit code 1 after S seconds",
        type=float,
    )
    option(parser, "--here", "with land: do not ask where the pad is not surely below")
    option(parser, "--json", "print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Give the order, or fly by the keyboard.

    Raises:
        BadInput: the options do not go together, or there is no terminal.
        Recoverable: no service answers.
    """
    waits = args.wait is None or (args.order in _AWAITED and 0 < args.wait <= 3600)
    refuse_any(
        (not waits, f"--wait takes up to 3600 seconds, with one of {', '.join(sorted(_AWAITED))}"),
        (args.here and args.order != "land", "--here goes with land"),
        (args.order is None and not _at_terminal(), f"there is no terminal to fly by; name one of {', '.join(ORDERS)}, status"),
    )
    is_socket = args.config is not None and Path(args.config).is_socket()
    path = Path(args.config) if is_socket else running(None if args.config is None else load(args.config))
    if args.config is None:
        sys.stderr.write(f"to the service for {path.stem}\n")
    if args.order is None:
        return event_loop.run(fly(path))
    return event_loop.run(_once(args, path))


async def _once(args: argparse.Namespace, path: Path) -> int:
    states: asyncio.Queue[FlightState] = asyncio.Queue(maxsize=64)

    def on_state(state: FlightState) -> None:
        if not states.full():
            states.put_nowait(state)

    async with connected(path, on_state) as client:
        if args.order == "status":
            client.watch()
            state = await in_time(states.get())
            _say(state, line_of_state(state), as_json=args.json)
            return 0
        if args.order == "land" and not args.here:
            client.watch()
            state = await in_time(states.get())
            if state.flying is not False and not state.over_pad and not await _agreed(f"land here, {state.below}?", args):
                text = f"land: not ordered: {state.below}; to land there: --here"
                _say({"order": args.order, "accepted": False, "done": False, "text": text}, text, as_json=args.json)
                return 1
        answer = await client.order(ORDERS[args.order])
        reached = answer.accepted
        text = f"{args.order}: {answer.text}"
        wait_s = args.wait or _AWAITED.get(args.order)
        if answer.accepted and wait_s is not None:
            client.watch()
            last = await _wait(states, args.order, wait_s)
            reached = last is None
            text += "; done" if last is None else f"; NOT CONFIRMED: after {wait_s:g} s the vehicle is still {last}"
        _say({"order": args.order, "accepted": answer.accepted, "done": reached, "text": text}, text, as_json=args.json)
    return 0 if reached else 1


def _at_terminal() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty()


async def _agreed(question: str, args: argparse.Namespace) -> bool:
    """Ask the person at this terminal; where there is none, or a program reads the answer, the whole word of a script counts."""
    if args.json or not _at_terminal():
        sys.stderr.write(f"{question} There is no terminal to ask at: ordered\n")
        return True
    return (await asyncio.to_thread(input, f"{question} [y/N] ")).strip().lower() in ("y", "yes")


async def _wait(states: asyncio.Queue[FlightState], order: str, seconds: float) -> str | None:
    """Return None once the order's effect is reported, or the vehicle's last mode if that takes longer."""
    mode, flew = "unknown", False
    try:
        async with asyncio.timeout(seconds):
            while True:
                state = await states.get()
                mode = state.mode or mode
                flew = flew or state.flying is True
                up = state.flying is True and state.mode != "taking_off"
                down = state.flying is False and (order == "land" or flew)
                left = state.situation not in ("cutting", "emergency", "silent")
                if {"takeoff": up, "emergency": state.situation == "emergency", "reset": left}.get(order, down):
                    return None
    except TimeoutError:
        return mode


def _say(data: object, text: str, *, as_json: bool) -> None:
    sys.stdout.write((msgspec.json.encode(data).decode() if as_json else text) + "\n")
