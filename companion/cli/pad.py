"""`decklander pad`: list and check pads, print one or a calibration board to scale."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from companion.cli import board_option, pad_check
from companion.settings.load import SHIPPED, find_file, read_toml, shipped
from companion.tools.print_pad.drawing import board_drawing, pad_drawing
from companion.tools.print_pad.pdf import pdf
from companion.tools.print_pad.sheets import PAPERS, sheets
from companion.tools.print_pad.svg import svg
from estimator.contracts.errors import BadInput
from estimator.vision.pad import Pad
from estimator.vision.regions import part_of


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander pad` to the parser."""
    p = subparsers.add_parser(
        "pad", help="list, check or print pads", description="List and check pads, print one or a calibration board to scale."
    )
    actions = p.add_subparsers(dest="action", required=True, metavar="ACTION")
    actions.add_parser("list", help="list the shipped pads", description="List the shipped pads.")
    pad_check.add_parser(actions)
    _add_print(actions)


def _add_print(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    p = actions.add_parser(
        "print",
        help="print a pad or a calibration board to scale",
        description="Print a pad or a calibration board to scale. Print at 100 % and measure the ruler on each sheet. Cut at "
        "the marks, which lie in the middle of each overlap, and join the sheets edge to edge.",
    )
    p.add_argument(
        "pad", nargs="?", default="thesis", metavar="PAD", help="pad file, or the name of a shipped one (default: %(default)s)"
    )
    p.add_argument("--out", required=True, metavar="FILE", help="file to write: .pdf (all sheets) or .svg (one file per sheet)")
    p.add_argument(
        "--paper", default="a4", choices=[*PAPERS, "full"], help="paper size; full is one sheet as large as needed (default: a4)"
    )
    p.add_argument(
        "--margin-mm", type=float, default=10.0, metavar="MM", help="margin that the printer cannot reach (default: 10)"
    )
    p.add_argument("--overlap-mm", type=float, default=10.0, metavar="MM", help="overlap of neighbouring sheets (default: 10)")
    p.add_argument("--board", choices=["charuco", "chessboard"], help="print a calibration board instead of the pad")
    board_option.add(p)


def run(args: argparse.Namespace) -> int:
    """List, check or print; return 0.

    Raises:
        BadInput: see the actions.
    """
    match args.action:
        case "list":
            for name in shipped("pads"):
                pad = _pad(SHIPPED / "pads" / f"{name}.toml")
                parts = ", ".join(dict.fromkeys(part_of(region) for region in pad.regions))
                lamps = f", {len(pad.lamps)} lamps" if pad.lamps else ""
                only = "" if pad.lamps or pad.is_identifiable_by_paint else " (not detected: print and paint only)"
                sys.stdout.write(f"{name:10s} {2 * pad.disc_radius_m:5.2f} m across: {parts}{lamps}{only}\n")
            return 0
        case "check":
            return pad_check.run(args)
        case _:
            return _print(args)


def _pad(file: Path) -> Pad:
    return Pad.from_mapping(read_toml(file), str(file))


def _print(args: argparse.Namespace) -> int:
    """Write the sheets; return 0.

    Raises:
        BadInput: the pad, the board, the paper or the file's name is wrong.
    """
    if args.board is not None:
        drawing = board_drawing(board_option.board(args, args.board))
    else:
        drawing = pad_drawing(_pad(find_file(args.pad, "pads", Path(), "PAD")))
    out = Path(args.out)
    if out.suffix.lower() not in (".pdf", ".svg"):
        raise BadInput(f"--out must end in .pdf or .svg, got {args.out!r}")
    pages = sheets(drawing, args.paper, args.margin_mm, args.overlap_mm)
    if args.board is not None and len(pages) > 1:
        raise BadInput(
            f"the board ({drawing.width_mm:g} x {drawing.height_mm:g} mm) does not fit on one sheet of "
            f"{args.paper} with its margins, and a glued one is not flat: take smaller squares or larger paper"
        )
    try:
        if out.suffix.lower() == ".pdf":
            out.write_bytes(pdf(drawing, pages))
            written = [out]
        else:
            alone = len(pages) == 1
            written = [out if alone else out.with_stem(f"{out.stem}_r{p.row + 1}c{p.column + 1}") for p in pages]
            for path, page in zip(written, pages, strict=True):
                path.write_text(svg(drawing, page), encoding="utf-8")
    except OSError as why:
        raise BadInput(f"{out}: {why.strerror or why}") from why
    size = f"{drawing.width_mm:g} x {drawing.height_mm:g} mm"
    sys.stdout.write(
        f"{drawing.name}, {size}: {len(pages)} sheet{'s' if len(pages) > 1 else ''} in {', '.join(map(str, written))}\n"
    )
    return 0
