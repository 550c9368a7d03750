"""The option `--foxglove` of commands that fly a simulated drone: the flight live in Foxglove, on this machine alone."""

from __future__ import annotations

import argparse
import socket
import sys

from msgspec.structs import replace

from companion.settings.live import FoxgloveSettings
from companion.settings.model import Settings
from estimator.contracts.errors import BadInput

_PORT = FoxgloveSettings().port


def add_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--foxglove` to the parser."""
    parser.add_argument(
        "--foxglove",
        type=int,
        nargs="?",
        const=_PORT,
        metavar="PORT",
        help=f"serve the flight live to Foxglove or Lichtblick on loopback and print the address (default port: {_PORT})",
    )


def with_foxglove(settings: Settings, port: int) -> Settings:
    """Return the settings with live data on this port, and print its address.

    Raises:
        BadInput: the port is no port, or is taken.
    """
    if not 1 <= port <= 65535:
        raise BadInput(f"--foxglove: a port lies in 1..65535, got {port}")
    live = FoxgloveSettings(endpoint="websocket", port=port)
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((live.host, port))
        except OSError as why:
            raise BadInput(f"--foxglove: port {port} cannot be used ({why.strerror}); name another: --foxglove PORT") from why
    sys.stderr.write(f"live for Foxglove (Open connection, Foxglove WebSocket): ws://{live.host}:{port}\n")
    return replace(settings, foxglove=live)
