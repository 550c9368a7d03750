"""`decklander ros2`: publish a flight in ROS 2 while it is flown."""

from __future__ import annotations

import argparse
import asyncio
import sys
from typing import TYPE_CHECKING

from companion.cli.options import option
from estimator.contracts.errors import BadInput

if TYPE_CHECKING:
    from companion.tools.ros2.node import RosBridge


DESCRIPTION = (
    "Publish the service's live data ([http] foxglove) as standard messages of ROS 2, the same topics as "
    "'record export --format ros2' (docs/ros2.md), until interrupted. Needs the extra ros2, and ROS 2 for this Python. Exit "
    "code 1 if --seconds pass without a connection to the service."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    option(parser, "url", "address (default: %(default)s)", nargs="?", default="ws://127.0.0.1:8480/live")
    option(parser, "--token-file FILE", "read the port's token from this file", default="")
    option(parser, "--config FILE", "settings of the service, for its camera: its mount and /camera/camera_info")
    option(parser, "--seconds S", "stop after this many seconds", type=float)


def run(args: argparse.Namespace) -> int:
    """Publish until interrupted or until `--seconds` have passed.

    Returns:
        0, or 1 if the service was never reached.

    Raises:
        BadInput: an option is wrong, the extra or ROS is missing, or the token is refused.
    """
    from companion.settings import files
    from companion.settings.load import camera_model, load
    from companion.tools.ros2.messages import require_rosbags

    require_rosbags("decklander ros2")
    if args.seconds is not None and not 0 < args.seconds < 1e9:
        raise BadInput(f"--seconds must be more than 0, got {args.seconds}")
    token = files.token(args.token_file, "ros2", "--token-file")
    settings = None if args.config is None else load(args.config)
    camera, gimballed = (None, False) if settings is None else (camera_model(settings), settings.camera.gimbal.given)
    from companion.base import event_loop
    from companion.tools.ros2.node import LiveClient, RosBridge, RosNode, wanted

    client = LiveClient(args.url, None if token is None else token.decode(), wanted, _note)
    node = RosNode("decklander")
    bridge = RosBridge(client, node, camera, _note, gimballed=gimballed)
    try:
        event_loop.run(_bounded(bridge, args.seconds))
    finally:
        node.close()
        total, skipped = bridge.published.total(), bridge.skipped.total()
        _note(f"{total} messages on {len(bridge.published)} topics; {skipped} of the service not understood")
    return 0 if client.connections else 1


async def _bounded(bridge: RosBridge, seconds: float | None) -> None:
    try:
        async with asyncio.timeout(seconds):
            await bridge.run()
    except TimeoutError:
        pass


def _note(what: str) -> None:
    sys.stderr.write(f"decklander ros2: {what}\n")
    sys.stderr.flush()
