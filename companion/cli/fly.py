"""`decklander fly`: give orders to the running service, or fly by the keyboard."""

from __future__ import annotations

import argparse
import asyncio
import sys
from pathlib import Path

import msgspec

from companion.base import event_loop
from companion.base.orders import OperatorOrder
from companion.base.wire import FlightState
from companion.parts.operator.client import connected, line_of_state
from companion.parts.operator.socket_path import running
from companion.settings.load import load
from estimator.contracts.errors import BadInput

ORDERS = {
    order.value: order
    for order in (
        OperatorOrder.TAKE_OFF,
        OperatorOrder.HOLD,
        OperatorOrder.LAND,
        OperatorOrder.BEGIN,
        OperatorOrder.ABORT,
        OperatorOrder.EMERGENCY,
        OperatorOrder.RESET,
    )
}
"""The orders of one command line."""
_AWAITED = {"takeoff", "land", "begin"}
_STATE_TIMEOUT_S = 3.0


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander fly` to the parser."""
    parser = subparsers.add_parser(
        "fly",
        help="give orders to the running service, or fly by the keyboard",
        description="Give one order to the service that runs on this computer and print its answer, or, without an order, fly by "
        "the keyboard in this terminal. Exit code 0 if the order was accepted, 1 if it was refused or no service answers.",
    )
    parser.add_argument(
        "order",
        nargs="?",
        choices=(*ORDERS, "status"),
        metavar="ORDER",
        help=f"{', '.join(ORDERS)} or status; without it, fly by the keyboard",
    )
    parser.add_argument("--config", metavar="FILE", help="settings of the service, if several run on this computer")
    parser.add_argument(
        "--wait",
        type=float,
        metavar="S",
        help="after takeoff wait until it hovers, after land and begin until it is on the ground; exit code 1 after S seconds",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Give the order, or fly by the keyboard.

    Raises:
        BadInput: the options do not go together, or there is no terminal.
        Recoverable: no service answers.
    """
    if args.wait is not None and (args.order not in _AWAITED or not 0 < args.wait <= 3600):
        raise BadInput(f"--wait takes up to 3600 seconds, with one of {', '.join(sorted(_AWAITED))}")
    if args.order is None and not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise BadInput(f"there is no terminal to fly by; name an order: {', '.join(ORDERS)}, status")
    path = running(None if args.config is None else load(args.config))
    if args.order is None:
        from companion.cli.fly_keyboard import fly

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
            async with asyncio.timeout(_STATE_TIMEOUT_S):
                state = await states.get()
            _say(state, line_of_state(state), as_json=args.json)
            return 0
        answer = await client.order(ORDERS[args.order])
        reached = answer.accepted
        text = f"{args.order}: {answer.text}"
        if answer.accepted and args.wait is not None:
            client.watch()
            last = await _wait(states, args.order, args.wait)
            reached = last is None
            text += "; done" if last is None else f"; after {args.wait:g} s the vehicle is still {last}"
        _say({"order": args.order, "accepted": answer.accepted, "done": reached, "text": text}, text, as_json=args.json)
    return 0 if reached else 1


async def _wait(states: asyncio.Queue[FlightState], order: str, seconds: float) -> str | None:
    """Return None once the order's effect is reported, or the vehicle's last mode if that takes longer."""
    mode, flew = "not heard", False
    try:
        async with asyncio.timeout(seconds):
            while True:
                state = await states.get()
                mode = state.mode or mode
                flew = flew or state.flying is True
                up = state.flying is True and state.mode != "taking_off"
                down = state.flying is False and (order == "land" or flew)
                if up if order == "takeoff" else down:
                    return None
    except TimeoutError:
        return mode


def _say(data: object, text: str, *, as_json: bool) -> None:
    sys.stdout.write((msgspec.json.encode(data).decode() if as_json else text) + "\n")
