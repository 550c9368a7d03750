"""`decklander pad`: list, import and check pads, print one or a calibration board to scale."""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import re
import secrets
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from http import HTTPStatus
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from aiohttp import web

from companion.cli import board_option
from companion.cli.options import WorkProgress, named_wait, option, print_result
from companion.cli.outputs import PAD_FILE, PREVIEW, SHEETS, check_output, output
from companion.settings.load import find_file, pad_of_file, read_camera, read_text, shipped, write_whole
from companion.tools.calibrate.board import BOARDS
from companion.tools.calibrate.guide import files_of, read_image
from companion.tools.pad_price import MOUNT, VIEWS, Price, price
from companion.tools.pads.boards import BOARD_FILES, board
from companion.tools.pads.photograph import fault_of, photographed
from companion.tools.pads.pictures import check_pictures, lines
from companion.tools.pads.svg import read_svg
from companion.tools.pads.trace import Picture, drawn, traced
from companion.tools.print_pad.sheets import PAPERS, board_drawing, pad_drawing, pdf, sheets, svg
from companion.tools.tag_pad import file_text
from decklander.place import SHIPPED
from drivers.camera import images
from drivers.extras import require
from drivers.files import Largest, bytes_of
from estimator.contracts.errors import BadInput, file_errors, refused
from estimator.contracts.geometry import F64
from estimator.contracts.text import text_of
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.drawing import EdgeKind, edges_of
from estimator.vision.pad.file import LARGEST_M, SMALLEST_M, Calibration
from estimator.vision.pad.geometry import outlines_of
from estimator.vision.pad.information import NOISE, PadAccuracy, accuracy, alike_headings, confusable_turns
from estimator.vision.pad.lamps import CENTRE_PX, LampAccuracy, lamp_accuracy
from estimator.vision.pad.pad import RARE, Pad
from estimator.vision.pad.shapes import part_of
from estimator.vision.srgb import LUMA, linear_light

_MOST_BYTES = 4096  # longest request that is read
_LEAST_CONTRAST = 0.05
"""Least luminance between a deck and what is painted on it, full scale 1: less drowns in wear, ripples and shadows."""
_LEAST_RADIUS_PX = 5.0
"""Least radius of a pad that is searched for: below it the parts merge into a spot."""
_FOCAL = 0.8
"""Guessed focal length of a camera without a file, in widths of its pictures: places and sizes in them hardly depend on it."""
_LETTER_RADIUS_PX = 20.0
"""Least radius of a letter on the bare deck: below it the edges merge, and it resembles other small bright things."""


def _add_import(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander pad import` to the parser."""
    p = actions.add_parser(
        "import",
        help="make a pad file of an SVG drawing, a photograph or a board of tags",
        description="Make a pad file of an SVG drawing, of a photograph of a painted or printed pad, or of a board of tags: "
        "Landmark's landing-target.json, tags.yaml of apriltag_ros. Up in the picture is along the arrow. The colour at the "
        "sheet's edge is that of the sheet or deck around. Look at the result with pad print, and judge it with pad check.",
    )
    option(p, "drawing FILE", ".svg, a photograph (.jpg, .png), or a board (.json, .yaml)")
    output(p, "--out FILE", "pad file to write (.toml)", PAD_FILE, required=True)
    option(p, "--size-mm MM", "largest extent of all that is painted; with --corners WIDTHxLENGTH of the rectangle, "
        "and of a board that of its sheet, about its centre")  # fmt: skip
    option(p, "--extent", "whose size and middle are meant in a drawing that is of one colour up to its sheet's edge: the whole "
        "sheet's, or of what lies on it (default: the sheet's middle)", choices=("sheet", "paint"))  # fmt: skip
    option(p, "--corners PX", 'pixels "u,v u,v u,v u,v" of the corners of a rectangle on the pad in a photograph: fore '
        "left, fore right, aft right, aft left; `click` asks for them in a browser on this machine")  # fmt: skip
    option(p, "--sheet", "the rectangle is the sheet that the pad is printed on: nothing beyond it is painted")
    option(p, "--paints", "paints in a photograph, the ground's among them", default=2, choices=range(2, 6))
    option(p, "--name NAME", "name of the pad (default: the file's)")
    option(p, "--target NAME", "bundle or tag that is the pad, in a board's file that has several")
    option(p, "--family NAME", "family of a board's tags, where its file does not say it (default: tag36h11)")
    option(p, "--tags-turned", "each tag of a board was painted half a turn round from how its file has it")


def _import(args: argparse.Namespace) -> int:
    """Write the pad's file; return 0.

    Raises:
        BadInput: a file cannot be read or written, an argument is wrong, or the drawing cannot be measured as a pad.
    """
    path, out = Path(args.drawing), args.out
    require("decklander pad import", "pads", "resvg_py")
    shown, remarks = out.with_suffix(".preview.png"), tuple[str, ...]()
    check_output(shown, PREVIEW, "--out", [path], force=args.force)
    if path.suffix.lower() in BOARD_FILES:
        chosen = _size_m(args.size_mm, of_rectangle=True), args.family, args.target
        text = text_of(bytes_of(path, Largest.BOARD), str(path))
        found = board(text, args.name or path.stem, str(path), *chosen, turned=args.tags_turned)
        keys, remarks = found.keys, found.remarks
    else:
        size_m = _size_m(args.size_mm, args.corners is not None)
        keys, remarks = traced(_picture(path, size_m, args), args.name or path.stem, str(path))
    text = file_text(keys, f"Made of {path.name} by decklander pad import.")
    try:
        pad = Pad.from_mapping(tomllib.loads(text), str(path))
    except BadInput as why:
        photo = path.suffix.lower() not in (".svg", *BOARD_FILES)
        raise BadInput(f"{why}{f'; or its paints are not the {args.paints} of --paints' * photo}") from why
    import resvg_py

    drawing = pad_drawing(pad)
    png = resvg_py.svg_to_bytes(svg(drawing, sheets(drawing, "full")[0]), width=800, dpi=96.0)
    with file_errors(str(out)):
        write_whole(out, text)
        write_whole(shown, png)
    corners = np.concatenate([line for region in pad.regions for line in outlines_of(region)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    along, across = (1000.0 * (high - low)).tolist()
    fore, right = (500.0 * (low + high)).tolist()
    middle = f"its middle lies {fore:+.0f} mm fore and {right:+.0f} mm right of the pad's"
    parts, n = ", ".join(dict.fromkeys(part_of(region) for region in pad.regions)), len(pad.regions)
    sys.stdout.write(
        f"{out}: {pad.name}, {2000.0 * pad.disc_radius_m:.1f} mm across, {n} region{'s' * (n != 1)} ({parts})"
        + (f", ground {pad.ground}" if pad.ground else "")
        + f"\n{out}: what lies on the ground is {across:.0f} mm wide and {along:.0f} mm long, {middle}\n"
        + f"{shown}: what was understood, look at it\n"
        + "".join(f"{path}: {remark}\n" for remark in remarks)
    )
    return 0


def _picture(path: Path, size_m: tuple[float, float] | None, args: argparse.Namespace) -> Picture:
    if path.suffix.lower() == ".svg":
        if args.corners is not None:
            raise BadInput("--corners is for photographs: a drawing is seen from straight above")
        drawing = read_svg(text_of(bytes_of(path, Largest.DRAWING), str(path)), str(path))
        with named_wait(f"drawing {path}"):
            return drawn(drawing, None if size_m is None else max(size_m), str(path), args.extent)
    data = bytes_of(path, Largest.PICTURE)
    with refused(f"{path}: neither an SVG drawing nor a picture that can be read", images.ImageRefused, cv2.error):
        px, see_through = images.as_shown(data)
    if see_through:
        sys.stderr.write(f"decklander: {path}: what is transparent in it is taken as white\n")
    if size_m is None:
        raise BadInput("--size-mm is needed with a photograph: the pad's largest extent, or that of the rectangle of --corners")
    if args.sheet and args.corners is None:
        raise BadInput("--sheet is a property of the rectangle of --corners: give them, too")
    corners = _clicked(path, data) if args.corners == "click" else _corners(args.corners)
    with named_wait(f"separating the paints of {path}"):
        return photographed(px, corners, size_m, args.paints, str(path), sheet=args.sheet)


def _size_m(text: str | None, of_rectangle: bool) -> tuple[float, float] | None:
    if text is None:
        return None
    parts = text.lower().split("x")
    try:
        sizes = [float(part) / 1000.0 for part in parts]
    except ValueError:
        sizes = []
    if len(sizes) != (2 if of_rectangle else 1) or not all(SMALLEST_M <= size <= LARGEST_M for size in sizes):
        wanted = "WIDTHxLENGTH of the rectangle" if of_rectangle else "one length"
        raise BadInput(f"--size-mm must be {wanted} in mm, {1000 * SMALLEST_M:g} to {1000 * LARGEST_M:g}, got {text!r}")
    return sizes[0], sizes[-1]


def _clicked(path: Path, data: bytes) -> np.ndarray:
    at = clicked(data, lambda page: print(f"{path}: click the four corners at {page}", flush=True))
    places = " ".join(f"{u:.1f},{v:.1f}" for u, v in at)
    sys.stdout.write(f'--corners "{places}"\n')
    return at


def _corners(text: str | None) -> np.ndarray | None:
    if text is None:
        return None
    values = re.findall(r"[-+]?\d+(?:\.\d+)?", text)
    if len(values) != 8:
        raise BadInput(f'--corners must be four places "u,v u,v u,v u,v" in px, got {text!r}')
    return np.array(values, float).reshape(4, 2)


_CORNERS = ("fore left", "fore right", "aft right", "aft left")
_PAGE = Path(__file__).with_name("pad_corners.html")


def corners_of(body: bytes) -> F64:
    """Return the places, (4, 2) px, that a browser sent.

    Raises:
        ValueError: they are not four pairs of finite numbers, or no rectangle's.
    """
    try:
        at = np.array(json.loads(body), float)
    except (TypeError, ValueError, RecursionError):
        at = np.empty(0)
    if at.shape != (4, 2) or not np.isfinite(at).all():
        raise ValueError("four pairs of numbers are wanted")
    fault = fault_of(at)
    if fault is not None:
        raise ValueError(f"the corners {fault}")
    return at


def clicked(photo: bytes, tell: Callable[[str], None]) -> F64:
    """Serve a photograph to a browser on this machine until a person has clicked four corners; return them, (4, 2) px.

    Args:
        photo: as the browser reads it, JPEG or PNG.
        tell: is given the address of the page, which cannot be guessed.
    """
    return asyncio.run(_four_corners(photo, tell))


async def _four_corners(photo: bytes, tell: Callable[[str], None]) -> F64:
    found: asyncio.Future[F64] = asyncio.get_running_loop().create_future()
    page = _PAGE.read_text(encoding="utf-8").replace("NAMES", json.dumps(_CORNERS))

    async def corners(request: web.Request) -> web.Response:
        try:
            at = corners_of(await request.read())
        except ValueError as why:
            return web.Response(status=HTTPStatus.BAD_REQUEST, text=str(why))
        if not found.done():
            found.set_result(at)
        return web.Response()

    async def shown(request: web.Request) -> web.Response:
        answer = web.Response(body=photo) if request.path.endswith("photo") else web.Response(text=page, content_type="text/html")
        answer.headers["Cache-Control"] = "no-store"
        return answer

    app, base = web.Application(client_max_size=_MOST_BYTES), f"/{secrets.token_urlsafe(16)}/"
    app.add_routes([web.get(base, shown), web.get(f"{base}photo", shown), web.post(f"{base}corners", corners)])
    runner = web.AppRunner(app, access_log=None)
    await runner.setup()
    try:
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        tell(f"http://127.0.0.1:{runner.addresses[0][1]}{base}")
        return await found
    finally:
        await runner.cleanup()


_PAD = "thesis"
"""The pad that is printed where none is named."""
DESCRIPTION = "List and check pads, make one of a drawing or photograph, print one or a calibration board to scale."


def add_arguments(p: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    actions = p.add_subparsers(dest="action", required=True, metavar="ACTION")
    actions.add_parser("list", help="list the shipped pads", description="List the shipped pads.")
    _add_check(actions)
    _add_import(actions)
    _add_print(actions)


def _add_print(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    p = actions.add_parser(
        "print",
        help="print a pad or a calibration board to scale",
        description="Print a pad or a calibration board to scale. Print at 100 % and measure the ruler on each sheet. Cut at "
        "the marks, which lie in the middle of each overlap, and join the sheets edge to edge.",
    )
    option(p, "pad PAD", f"pad file, or the name of a shipped one (default: {_PAD})", nargs="?")
    output(p, "--out FILE", "file to write: .pdf (all sheets) or .svg (one file per sheet)", SHEETS, required=True)
    option(p, "--paper", "paper size; full: one sheet as large as needed (default: a4)", default="a4", choices=[*PAPERS, "full"])
    option(p, "--margin-mm MM", "margin that the printer cannot reach (default: 10)", default=10.0)
    option(p, "--overlap-mm MM", "overlap of neighbouring sheets (default: 10)", default=10.0)
    option(p, "--board", "print a calibration board instead of the pad", choices=BOARDS)
    board_option.add(p)


def shipped_pads() -> dict[str, str]:
    """Return what each shipped pad is, by its name: how large, and its parts."""
    out = {}
    for name in shipped("pads"):
        pad = pad_of_file(SHIPPED / "pads" / f"{name}.toml")
        parts = ", ".join(dict.fromkeys(part_of(region) for region in pad.regions))
        lamps = f", {len(pad.lamps)} lamps" if pad.lamps else ""
        only = "" if pad.lamps or pad.is_identifiable_by_paint else " (not detected: print and paint only)"
        out[name] = f"{2 * pad.disc_radius_m:5.2f} m across: {parts}{lamps}{only}"
    return out


def run(args: argparse.Namespace) -> int:
    """List, check or print; return 0.

    Raises:
        BadInput: see the actions.
    """
    if args.action != "list":
        return {"check": _check, "import": _import, "print": _print}[args.action](args)
    width = max(map(len, shipped("pads")))
    sys.stdout.writelines(f"{name:{width}} {described}\n" for name, described in shipped_pads().items())
    return 0


def _print(args: argparse.Namespace) -> int:
    """Write the sheets; return 0.

    Raises:
        BadInput: the pad, the board, the paper or the file's name is wrong.
    """
    if args.board is not None and args.pad is not None:
        raise BadInput(f"--board {args.board} prints a calibration board and no pad: leave {args.pad} out")
    if args.board is not None:
        drawing = board_drawing(board_option.board(args, args.board))
    else:
        drawing = pad_drawing(pad_of_file(find_file(args.pad or _PAD, "pads", Path(), "PAD")))
    out = args.out
    pages = sheets(drawing, args.paper, args.margin_mm, args.overlap_mm)
    if args.board is not None and len(pages) > 1:
        raise BadInput(
            f"the board ({drawing.width_mm:g} x {drawing.height_mm:g} mm) does not fit on one sheet of "
            f"{args.paper} with its margins, and a glued one is not flat: take smaller squares or larger paper"
        )
    whole = out.suffix.lower() == ".pdf"
    alone = whole or len(pages) == 1
    written = [out] if alone else [out.with_stem(f"{out.stem}_r{p.row + 1}c{p.column + 1}") for p in pages]
    for path in written:
        check_output(path, SHEETS, "--out", [], force=args.force)
    with file_errors(str(out)):
        if whole:
            write_whole(out, pdf(drawing, pages))
        else:
            for path, page in zip(written, pages, strict=True):
                write_whole(path, svg(drawing, page))
    size = f"{drawing.width_mm:g} x {drawing.height_mm:g} mm"
    sys.stdout.write(
        f"{drawing.name}, {size}: {len(pages)} sheet{'s' if len(pages) > 1 else ''} in {', '.join(map(str, written))}\n"
    )
    return 0


_HEIGHTS_M = (0.3, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0)
_DECKS = {
    "grey steel": (128, 128, 128), "dark non-slip": (58, 60, 62), "deck green": (40, 80, 60), "red lead": (120, 50, 40),
    "concrete": (180, 176, 168),
}  # fmt: skip
_NAMES = {
    EdgeKind.DISC: "disc", EdgeKind.RING: "ring", EdgeKind.ARROW: "arrowhead", EdgeKind.H: "lettering",
    EdgeKind.UPPER: "upper lettering",
}  # fmt: skip


def _add_check(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    p = actions.add_parser(
        "check",
        help="check a pad's file, and print how well it can be measured",
        description="Check a pad's file. Print how accurately it can be measured by height (Cramer-Rao bound of one frame) and "
        "how it stands out from decks. Print also whether its heading is unique, and how often clutter resembles it; the "
        "confidence that follows from clutter is written into the file. With --picture, print instead which parts of the file "
        "these pictures of the pad show. Exit code 0; 1 if pictures do not show all of it; 2 if the file is refused.",
    )
    option(p, "pad PAD", "pad file, or the name of a shipped one")
    option(p, "--picture FRAME", "picture of the pad, or a folder of them", nargs="+", type=Path)
    option(p, "--camera FILE", "camera file, or the name of a shipped one (default: sim; for pictures a guess)")
    option(p, "--views N", "search N generated views without the pad, and write what that tells into the pad's file (default: "
        f"{VIEWS} for a pad file without a calibration of its drawing, else none)", type=int)  # fmt: skip
    option(p, "--json", "print one JSON object")


def _check(args: argparse.Namespace) -> int:
    """Print the findings; return 0.

    Raises:
        BadInput: the pad or the camera is missing or has a fault.
    """
    file = find_file(args.pad, "pads", Path(), "PAD")
    pad = pad_of_file(file)
    if args.picture is not None:
        return _check_pictures(args, pad)
    args.camera = args.camera or "sim"
    camera = read_camera(find_file(args.camera, "cameras", Path(), "--camera"))
    if args.views is not None and not (args.views == 0 or 50 <= args.views <= 100_000):
        raise BadInput(f"--views must be 50 to 100000, or 0 for none, got {args.views}")
    needed = 0 if pad.is_calibrated or SHIPPED in file.parents else VIEWS
    views, found_in = needed if args.views is None else args.views, None
    if views:
        pad, found_in = _priced(pad, file, views)
    deck = linear_light(_DECKS["grey steel"])
    bounds = [accuracy(pad, camera, height_m, deck) for height_m in _HEIGHTS_M]
    by_lamps = [lamp_accuracy(pad.lamps, camera, height_m) for height_m in _HEIGHTS_M] if pad.lamps else []
    headings, contrasts, lowest = alike_headings(pad), _contrasts(pad), _lowest(pad)
    farthest_m = 0.5 * (camera.fx + camera.fy) * pad.disc_radius_m / _LEAST_RADIUS_PX
    warnings = [*_heading_warnings(headings), *_confusion_warnings(pad), *_deck_warnings(lowest), *_price_warnings(pad)]
    if pad.markings.is_letter_alone:
        far_m = 0.5 * (camera.fx + camera.fy) * pad.disc_radius_m / _LETTER_RADIUS_PX
        warnings.append(
            "its letter lies on the bare deck: any of these proportions is taken for it, and it is found from cold to "
            f"{far_m:.1f} m where it is wholly in view"
        )
    if args.json:
        found: dict[str, Any] = {
            "pad": pad.name, "radius_m": pad.disc_radius_m, "alike_headings": headings, "contrasts": contrasts,
            "deck_contrasts": lowest, "farthest_m": farthest_m, "bounds": [_record(b) for b in bounds],
            "by_lamps": [_record(b) for b in by_lamps], "warnings": warnings,
            "clutter": _price_record(found_in, pad) if pad.calibration is not None else None,
        }  # fmt: skip
        sys.stdout.write(json.dumps(found) + "\n")
        return 0
    regions = "1 region" if len(pad.regions) == 1 else f"{len(pad.regions)} regions"
    lines = [f"{pad.name}: {2 * pad.disc_radius_m:.3g} m across, {regions}", ""]
    lines.append(
        f"what one frame can tell at best ({args.camera}, {100 * NOISE:g} % noise, straight above, tilt known), one sigma:"
    )
    lines.append(f"{'height':>9} {'radius':>9} {'in view':>8} {'lateral':>10} {'range':>10} {'heading':>9}")
    lines += [_line(bound) for bound in bounds]
    lines += [f"its radius falls below {_LEAST_RADIUS_PX:g} px at {farthest_m:.0f} m", ""]
    if by_lamps:
        lines.append(f"the same by its {len(pad.lamps)} lamps at night, their centres known to {CENTRE_PX:g} px:")
        lines.append(f"{'height':>9} {'in view':>9} {'spots':>8} {'lateral':>10} {'range':>10} {'heading':>9}")
        lines += [*map(_lamp_line, by_lamps), ""]
    if pad.calibration is not None:
        lines += [*_price_lines(pad, found_in), ""]
    lines += [f"{name}: luminance {value:+.2f} of what it lies on" for name, value in contrasts.items()]
    lines += [f"on {name}: luminance {value:+.2f} at the outer edge" for name, value in lowest.items()]
    lines += [f"warning: {warning}" for warning in warnings] or ["no warnings"]
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


def _check_pictures(args: argparse.Namespace, pad: Pad) -> int:
    """Print which borders of a pad pictures show; return 0 if they show all of them, else 1.

    Raises:
        BadInput: a picture or the camera is missing or has a fault, or a picture is not of the camera's size.
    """
    known = None if args.camera is None else read_camera(find_file(args.camera, "cameras", Path(), "--camera"))
    pictures = {}
    for file in files_of(args.picture):
        px = read_image(file)
        h, w = px.shape[:2]
        camera = known or Camera(w, h, _FOCAL * w, _FOCAL * w, 0.5 * (w - 1), 0.5 * (h - 1), np.zeros(5), MOUNT)
        if (camera.width, camera.height) != (w, h):
            raise BadInput(f"{file}: {w}x{h} px, but {args.camera} is of a camera of {camera.width}x{camera.height} px")
        pictures[str(file)] = px, camera
    found = check_pictures(pad, pictures, WorkProgress("searching pictures", "pictures").take)
    print_result(args, found, "\n".join(lines(found)))
    return 0 if found["all_shown"] and any(one["found"] for one in found["pictures"]) else 1


def _record(bound: PadAccuracy | LampAccuracy) -> dict[str, float | None]:
    """Return a bound as JSON: null for what cannot be measured."""
    known = {name: value if math.isfinite(value) else None for name, value in asdict(bound).items()}
    yaw = known.pop("yaw_rad")
    return {**known, "yaw_deg": None if yaw is None else math.degrees(yaw)}


def _lamp_line(b: LampAccuracy) -> str:
    if not math.isfinite(b.range_m):
        return f"{b.height_m:7.1f} m {b.lamps:9d} {b.spots:8d} {'none':>10} {'none':>10} {'none':>9}"
    return (
        f"{b.height_m:7.1f} m {b.lamps:9d} {b.spots:8d} {1000 * b.lateral_m:7.3f} mm {1000 * b.range_m:7.2f} mm "
        f"{math.degrees(b.yaw_rad):7.3f} deg"
    )


def _line(b: PadAccuracy) -> str:
    yaw = f"{math.degrees(b.yaw_rad):7.3f} deg" if math.isfinite(b.yaw_rad) else f"{'none':>9}"
    return (
        f"{b.height_m:7.1f} m {b.radius_px:6.1f} px {100 * b.in_view:6.0f} % {1000 * b.lateral_m:7.3f} mm "
        f"{1000 * b.range_m:7.2f} mm {yaw}"
    )


def _contrasts(pad: Pad) -> dict[str, float]:
    """Return the luminance of each part against the known paint below it."""
    edges, names = edges_of(pad), _NAMES | ({} if pad.markings.triangle is None else {EdgeKind.ARROW: "triangle"})
    return {
        names[kind]: float(edges.contrast[at].mean()) for kind in EdgeKind if (at := (edges.kind == kind) & ~edges.bare).any()
    }


def _lowest(pad: Pad) -> dict[str, float]:
    """Return the luminance of what meets the bare deck against each kind of deck; a pad with a rim is seen by its rim."""
    marks, edges = pad.markings, edges_of(pad)
    rim = marks.colours.rim
    inside = [rim] if rim is not None else np.unique(edges.inside_rgb[edges.bare], axis=0).tolist()
    lights = [float(linear_light(rgb) @ LUMA) for rgb in inside]
    return {name: min((light - float(linear_light(rgb) @ LUMA) for light in lights), key=abs) for name, rgb in _DECKS.items()}


def _heading_warnings(headings: int) -> list[str]:
    if headings == 0:
        return ["it looks the same from all sides: no heading is measured; paint a letter or an arrowhead"]
    if headings > 1:
        turn = {2: "half a turn", 4: "a quarter turn"}.get(headings, f"1/{headings} of a turn")
        return [f"it looks the same after {turn}: its heading is ambiguous until a track resolves it; paint an arrowhead"]
    return []


def _confusion_warnings(pad: Pad) -> list[str]:
    turns = sorted({round(abs(math.degrees(turn))) for turn in confusable_turns(pad)})
    if not turns:
        return []
    named = " or ".join(f"{turn} degrees" for turn in turns)
    return [f"it looks nearly the same after a turn by {named}: where a search cannot tell these apart, the pad is doubted"]


def _deck_warnings(lowest: dict[str, float]) -> list[str]:
    faint = [name for name, value in lowest.items() if abs(value) < _LEAST_CONTRAST]
    return [f"its outer edge hardly stands out from {', '.join(faint)}: paint a rim around it"] if faint else []


def _priced(pad: Pad, file: Path, views: int) -> tuple[Pad, Price]:
    """Search clutter for a pad, write its calibration into its file unless that ships, and return both.

    Raises:
        BadInput: the file cannot be written.
    """
    others = {name: pad_of_file(SHIPPED / "pads" / f"{name}.toml") for name in shipped("pads")}
    found = price(pad, others, views, WorkProgress("searching views without and with the pad", "views").take)
    if SHIPPED not in file.resolve().parents:
        _write(file, found.calibration)
    return replace(pad, calibration=found.calibration), found


def _write(file: Path, found: Calibration) -> None:
    table = (
        "[calibration]\n# By decklander pad check, for this drawing alone.\n"
        f"least_support = {found.least_support}\nchance = {found.chance}\n"
        f'least_px = {found.least_px}\ndrawing = "{found.drawing}"\n'
    )
    with file_errors(str(file)):
        text = read_text(file)
        bare = re.sub(r"\n*^\[calibration\]\n(?:(?!\[).*\n?)*", "\n", text, flags=re.MULTILINE).rstrip("\n")
        write_whole(file, f"{bare}\n\n{table}")


def _price_lines(pad: Pad, found: Price | None) -> Iterator[str]:
    """Yield what is printed of a pad's price; without one, what its file says."""
    known = pad.calibration
    assert known is not None
    if found is not None:
        half, nine = found.per_1000
        chance = f"{half:.3g} false pads in 1,000 frames of a search at confidence .5, {nine:.3g} at .9"
        yield f"in {found.views} generated views without the pad: {chance}"
        yield "found where it was drawn in: " + ", ".join(f"{100 * share:.0f} % at {r:g} px" for r, share in found.found.items())
        if found.taken_for:
            yield f"it is seen in {', '.join(found.taken_for)}, too"
    else:
        yield f"by its file: {1000.0 * known.chance:.3g} false pads in 1,000 frames of a search at confidence .5"
    where = f"from a radius of {known.least_px:g} px on" if known.least_px else "at no size: it hardly shows on some decks"
    yield f"found {where}"
    yield "what decides: " + ", ".join(f"{name} {100 * share:.0f} %" for name, share in _deciding(pad).items())


def _price_warnings(pad: Pad) -> list[str]:
    """Return what a user should know about a calibrated pad."""
    known = pad.calibration
    if known is None or known.chance <= RARE:
        return []
    fate = (
        "its file accepts that"
        if pad.accept_false_pads
        else "it is refused for flight unless its file has accept_false_pads = true"
    )
    return [f"clutter is taken for it in {1000.0 * known.chance:.3g} of 1,000 frames (limit: {1000.0 * RARE:g}): {fate}"]


def _price_record(found: Price | None, pad: Pad) -> dict[str, Any]:
    """Return a pad's price as JSON."""
    known = pad.calibration
    assert known is not None
    out: dict[str, Any] = {"chance": known.chance, "least_support": known.least_support, "least_px": known.least_px}
    out["decided_by"] = _deciding(pad)
    if found is not None:
        shares = {f"{radius:g}": share for radius, share in found.found.items()}
        out |= {"views": found.views, "false_per_1000": list(found.per_1000), "found": shares, "taken_for": list(found.taken_for)}
    return out


def _deciding(pad: Pad) -> dict[str, float]:
    """Return by kind of edge the share of the drawing's support: length times squared contrast, the largest first."""
    edges = edges_of(pad)
    grey = linear_light(dict(pad.paints)[pad.ground] if pad.ground else (128, 128, 128)) @ LUMA
    contrast = np.where(edges.bare, linear_light(edges.inside_rgb) @ LUMA - grey, edges.contrast)
    each = {name: float((edges.spacing_m * contrast**2)[edges.kind == kind].sum()) for kind, name in _NAMES.items()}
    total = sum(each.values()) or 1.0
    return {name: round(value / total, 3) for name, value in sorted(each.items(), key=lambda of: -of[1]) if value > 0.0}
