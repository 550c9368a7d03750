"""`decklander pad import`: make a pad file of a drawing, or of a photograph in which a person clicks the corners."""

from __future__ import annotations

import argparse
import json
import re
import secrets
import sys
import tomllib
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import cv2
import numpy as np

from companion.cli.options import option
from companion.tools.pads.trace import Picture, drawn, fault_of, file_text, photographed, read_svg, traced
from estimator.contracts.errors import BadInput, file_errors
from estimator.contracts.geometry import F64
from estimator.vision.pad import LARGEST_M, SMALLEST_M, Pad
from estimator.vision.regions import part_of


def add_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander pad import` to the parser."""
    p = actions.add_parser(
        "import",
        help="make a pad file of an SVG drawing or a photograph",
        description="Make a pad file of an SVG drawing, or of a photograph of a painted or printed pad. Up in the picture is "
        "along the arrow. The colour at the sheet's edge is that of the sheet or deck around. Look at the result with pad print, "
        "and judge it with pad check.",
    )
    option(p, "drawing FILE", ".svg, or a photograph (.jpg, .png)")
    option(p, "--out FILE", "pad file to write (.toml)", required=True)
    option(p, "--size-mm MM", "largest extent of all that is painted; with --corners WIDTHxLENGTH of the rectangle")
    option(p, "--corners PX", 'pixels "u,v u,v u,v u,v" of the corners of a rectangle on the pad in a photograph: fore '
        "left, fore right, aft right, aft left; `click` asks for them in a browser on this machine")  # fmt: skip
    option(p, "--sheet", "the rectangle is the sheet that the pad is printed on: nothing beyond it is painted")
    option(p, "--paints", "paints in a photograph, the ground's among them", default=2, choices=range(2, 6))
    option(p, "--name NAME", "name of the pad (default: the file's)")


def run(args: argparse.Namespace) -> int:
    """Write the pad's file; return 0.

    Raises:
        BadInput: a file cannot be read or written, an argument is wrong, or the drawing cannot be measured as a pad.
    """
    path, out = Path(args.drawing), Path(args.out)
    if out.suffix != ".toml":
        raise BadInput(f"--out must end in .toml, got {args.out!r}")
    size_m = _size_m(args.size_mm, args.corners is not None)
    with file_errors(str(path)):
        data = path.read_bytes()
    picture = _picture(path, data, size_m, args)
    keys = traced(picture, args.name or path.stem, str(path))
    text = file_text(keys, f"Made of {path.name} by decklander pad import.")
    pad = Pad.from_mapping(tomllib.loads(text), str(path))
    with file_errors(str(out)):
        out.write_text(text, encoding="utf-8")
    parts = ", ".join(dict.fromkeys(part_of(region) for region in pad.regions))
    sys.stdout.write(
        f"{out}: {pad.name}, {2000.0 * pad.disc_radius_m:.1f} mm across, {len(pad.regions)} regions ({parts}), "
        f"ground {pad.ground}\n"
    )
    return 0


def _picture(path: Path, data: bytes, size_m: tuple[float, float] | None, args: argparse.Namespace) -> Picture:
    if path.suffix.lower() == ".svg":
        if args.corners is not None:
            raise BadInput("--corners is for photographs: a drawing is seen from straight above")
        return drawn(read_svg(data.decode("utf-8", "replace"), str(path)), None if size_m is None else max(size_m), str(path))
    px = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if px is None:
        raise BadInput(f"{path}: neither an SVG drawing nor a picture that can be read")
    if size_m is None:
        raise BadInput(
            "--size-mm is needed with a photograph: the largest extent of the pad, or that of the rectangle of --corners"
        )
    if args.sheet and args.corners is None:
        raise BadInput("--sheet is a property of the rectangle of --corners: give them, too")
    corners = _clicked(path, data) if args.corners == "click" else _corners(args.corners)
    return photographed(np.asarray(px, np.uint8), corners, size_m, args.paints, str(path), sheet=args.sheet)


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


_MOST_BYTES = 4096
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
        tell: is given the address of the page, which nobody can guess.
    """
    secret, found = secrets.token_urlsafe(16), list[F64]()
    answers = {
        f"/{secret}/": (_PAGE.read_text(encoding="utf-8").replace("NAMES", json.dumps(_CORNERS)).encode(), "text/html"),
        f"/{secret}/photo": (photo, ""),
    }

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            body, kind = answers.get(self.path, (b"", ""))
            self._answer(HTTPStatus.OK if body else HTTPStatus.NOT_FOUND, body, kind)

        def do_POST(self) -> None:
            length = self.headers.get("Content-Length", "")
            if self.path != f"/{secret}/corners" or not length.isdecimal() or int(length) > _MOST_BYTES:
                return self._answer(HTTPStatus.NOT_FOUND)
            try:
                found.append(corners_of(self.rfile.read(int(length))))
            except ValueError as why:
                return self._answer(HTTPStatus.BAD_REQUEST, str(why).encode())
            return self._answer(HTTPStatus.OK)

        def _answer(self, status: HTTPStatus, body: bytes = b"", kind: str = "") -> None:
            self.send_response(status)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            if kind:
                self.send_header("Content-Type", kind)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        tell(f"http://127.0.0.1:{server.server_address[1]}/{secret}/")
        while not found:
            server.handle_request()
    return found[0]
