"""Options that describe a calibration board, shared by the command that prints it and the one that uses it."""

import argparse
import re

from companion.cli.options import option
from companion.tools.calibrate.board import Board, BoardKind
from estimator.contracts.errors import BadInput


def add(parser: argparse.ArgumentParser) -> None:
    """Add the options that describe a calibration board."""
    option(parser, "--squares CxR", "number of squares, or of an AprilGrid's tags, across and down (default: 7x10, of tags 6x6)")
    option(
        parser,
        "--square-mm MM",
        "side of a square, or the distance from one tag to the next, as measured on the print (default: %(default)s)",
        default=25.0,
    )
    option(
        parser,
        "--marker-mm MM",
        "side of a ChArUco marker (default: 0.72 of a square) or of a tag (default: the distance / 1.3)",
        type=float,
    )


def board(args: argparse.Namespace, kind: BoardKind) -> Board:
    """Return the board that the options describe.

    Raises:
        BadInput: no such board.
    """
    squares = args.squares or ("6x6" if kind == "aprilgrid" else "7x10")
    match = re.fullmatch(r"(\d{1,3})[xX](\d{1,3})", squares)
    if match is None:
        raise BadInput(f"--squares must be two numbers such as 7x10, got {squares!r}")
    usual_mm = args.square_mm / 1.3 if kind == "aprilgrid" else 0.72 * args.square_mm
    marker_mm = usual_mm if args.marker_mm is None else args.marker_mm
    return Board(kind, int(match[1]), int(match[2]), args.square_mm / 1000.0, marker_mm / 1000.0)
