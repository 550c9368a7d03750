"""The option `--page` of commands that fly a simulated drone: the operator page with a token of its own."""

from __future__ import annotations

import argparse
import socket
import sys
from pathlib import Path

from msgspec.structs import replace

from companion.parts.page.access import make_token
from companion.settings.model import Settings
from companion.settings.page import PageSettings
from estimator.contracts.errors import BadInput

_PORT = PageSettings().port


def add_argument(parser: argparse.ArgumentParser) -> None:
    """Add `--page` to the parser."""
    parser.add_argument(
        "--page",
        type=int,
        nargs="?",
        const=_PORT,
        metavar="PORT",
        help="serve the operator page on loopback and print its address; the landing begins by a button there, and the flight "
        f"goes on until Ctrl-C (default port: {_PORT})",
    )


def with_page(settings: Settings, port: int, folder: Path) -> Settings:
    """Return the settings with the page on this port, and print its address, which holds a token made for this run.

    The approach waits for the operator: whoever opens the page sees it from its beginning.

    Args:
        folder: where the token is written; its user's alone.

    Raises:
        BadInput: the port is no port, or is taken.
    """
    if not 1 <= port <= 65535:
        raise BadInput(f"--page: a port lies in 1..65535, got {port}")
    page = PageSettings(endpoint="http", port=port, token_file=str(folder / "page.token"))
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((page.host, port))
        except OSError as why:
            raise BadInput(f"--page: port {port} cannot be used ({why.strerror}); name another: --page PORT") from why
    token = make_token()
    Path(page.token_file).write_text(token)
    Path(page.token_file).chmod(0o600)
    sys.stderr.write(f"operator page: http://{page.host}:{port}/#token={token}\n")
    return replace(settings, page=page, guidance=replace(settings.guidance, start="signal"))
