"""Options that describe a calibration board, shared by the command that prints it and the one that uses it."""

import argparse
import re

from companion.tools.calibrate.board import Board
from estimator.contracts.errors import BadInput


def add(parser: argparse.ArgumentParser) -> None:
    """Add the options that describe a calibration board."""
    parser.add_argument(
        "--squares", default="7x10", metavar="CxR", help="number of squares across and down (default: %(default)s)"
    )
    parser.add_argument(
        "--square-mm",
        type=float,
        default=25.0,
        metavar="MM",
        help="side of a square as measured on the print (default: %(default)s)",
    )
    parser.add_argument("--marker-mm", type=float, metavar="MM", help="side of a ChArUco marker (default: 0.72 of a square)")


def board(args: argparse.Namespace, kind: str) -> Board:
    """Return the board that the options describe.

    Raises:
        BadInput: no such board.
    """
    match = re.fullmatch(r"(\d{1,3})[xX](\d{1,3})", args.squares)
    if match is None:
        raise BadInput(f"--squares must be two numbers such as 7x10, got {args.squares!r}")
    marker_mm = 0.72 * args.square_mm if args.marker_mm is None else args.marker_mm
    return Board(
        "charuco" if kind == "charuco" else "chessboard",
        int(match[1]),
        int(match[2]),
        args.square_mm / 1000.0,
        marker_mm / 1000.0,
    )
