"""`decklander ros2`: publish a flight in ROS 2 while it is flown."""

from __future__ import annotations

import argparse
import asyncio
import re
import sys
from functools import partial
from typing import TYPE_CHECKING, Any

from companion.cli.options import option
from drivers.extras import require
from drivers.ros2 import MIDDLEWARES
from estimator.contracts.errors import BadInput, Recoverable, in_words

if TYPE_CHECKING:
    from companion.settings.model import Settings
    from companion.tools.ros2.node import RosBridge, RosOrders


DESCRIPTION = (
    "Publish the service's live data ([http] foxglove) in ROS 2 until interrupted, in the domain ROS_DOMAIN_ID. "
    "The topics are those of 'record export --format ros2' (docs/ros2.md). Needs the extra ros2, and no ROS. "
    "Exit code 1 if --seconds pass without a connection to the service."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    option(parser, "url", "address (default: %(default)s)", nargs="?", default="ws://127.0.0.1:8480/live")
    option(parser, "--token-file FILE", "read the port's token from this file", default="")
    option(parser, "--config FILE", "settings of the service, for its camera: its mount and /camera/camera_info")
    option(parser, "--orders", "let ROS begin, hold, stay and abort, as a terminal of this user may")
    option(parser, "--namespace NAME", "begin of the topics' names (default: %(default)s)", default="decklander")
    meaning = "rclpy of the installed ROS, or DDS without ROS; auto is the first that is there (default: %(default)s)"
    option(parser, "--middleware", meaning, choices=MIDDLEWARES, default=MIDDLEWARES[0])
    option(parser, "--seconds S", "stop after this many seconds", type=float)


def run(args: argparse.Namespace) -> int:
    """Publish until interrupted or until `--seconds` have passed.

    Returns:
        0, or 1 if the service was never reached.

    Raises:
        BadInput: an option is wrong, the extra is missing, or the token is refused.
        Recoverable: the middleware cannot open its sockets.
    """
    from companion.settings import files
    from companion.settings.load import camera_model, load, pad_model
    from drivers.ros2 import open_node

    require("decklander ros2", "ros2", "rosbags")
    if not re.fullmatch(r"[A-Za-z]\w*(/[A-Za-z]\w*)*", args.namespace, re.ASCII):
        raise BadInput(f"--namespace must be names of letters, digits and _ with / between, got {args.namespace!r}")
    if args.seconds is not None and not 0 < args.seconds < 1e9:
        raise BadInput(f"--seconds must be more than 0, got {args.seconds}")
    token = files.Renewed(lambda: files.token(args.token_file, "--token-file"), "--token-file", args.token_file)
    settings = None if args.config is None else load(args.config)
    known: dict[str, Any] = {"camera": None}
    if settings is not None:
        drawn = (pad_model(settings).disc_radius_m, settings.guidance.cone.slope)
        known = {"camera": camera_model(settings), "gimballed": settings.camera.gimbal.given, "drawn": drawn}
    from companion.base import event_loop
    from companion.tools.ros2.messages import RosMessages
    from companion.tools.ros2.node import LiveClient, RosBridge, RosOrders
    from drivers.clock import SystemClock

    client = LiveClient(args.url, token, _note)
    node = open_node("decklander", args.middleware)
    bridge = RosBridge(client, node, args.namespace, partial(RosMessages, **known), _note)
    orders = RosOrders(node, args.namespace, SystemClock()) if args.orders else None
    try:
        event_loop.run(_bounded(bridge, orders, settings, args.seconds))
    finally:
        total, skipped = bridge.published.total(), bridge.skipped.total()
        if client.connections:
            _note(f"{total} messages on {len(bridge.published)} topics; {skipped} of the service not understood")
        lost = {**node.lost, **(orders.refused if orders else {})}
        if any(lost.values()):
            _note("lost messages and refused orders: " + ", ".join(f"{n} {why}" for why, n in sorted(lost.items())))
        node.close()
    return 0 if client.connections else 1


async def _bounded(bridge: RosBridge, orders: RosOrders | None, settings: Settings | None, seconds: float | None) -> None:
    try:
        async with asyncio.timeout(seconds), asyncio.TaskGroup() as group:
            group.create_task(bridge.run())
            if orders is not None:
                group.create_task(_obey(orders, settings))
    except TimeoutError:
        pass
    except BaseExceptionGroup as errors:
        raise errors.exceptions[0] from None


async def _obey(orders: RosOrders, settings: Settings | None) -> None:
    """Pass the orders on to the service's local socket, each as a terminal of its own."""
    from companion.parts.operator.client import connected, running
    from companion.tools.ros2.node import ORDERS

    while True:
        for name, request, age_s in orders.come():
            try:
                async with connected(running(settings)) as client:
                    answer = await client.order(ORDERS[name], age_s)
                accepted, text = answer.accepted, answer.text
            except (BadInput, Recoverable, ExceptionGroup) as why:
                accepted, text = False, f"refused: {in_words(why)}"
            request.answer(accepted, text)
            _note(f"{name}: {text}")
        await asyncio.sleep(0.02)


def _note(what: str) -> None:
    sys.stderr.write(f"decklander ros2: {what}\n")
    sys.stderr.flush()
