"""`decklander calibrate`: `camera` writes a camera file from images of a board, grades it, and lists what the images lack.

`mount`, `delay`, `readout` and `vehicle` are in `companion.cli.calibrate_flight`.
"""

from __future__ import annotations

import argparse
import math
import re
import shutil
import sys
from pathlib import Path
from typing import get_args

import numpy as np

from companion.base import event_loop
from companion.cli import board_option, calibrate_flight
from companion.cli.options import named_wait, option, print_result, require_drawing
from companion.cli.outputs import CAMERA_FILE, EXPORTED, FIGURES, check_output, output
from companion.settings.load import write_whole
from companion.tools.calibrate.board import BOARDS, Board, Collection
from companion.tools.calibrate.camera_file import FOREIGN, foreign, text
from companion.tools.calibrate.guide import (
    GRADES,
    Assessment,
    Guide,
    GuideState,
    add_file,
    assess,
    files_of,
    missing_before,
    watch,
)
from companion.tools.calibrate.solve import LEAST_VIEWS, LensChoice, Solution, solve
from companion.tools.calibrate.touchdown_cost import of_distance
from drivers.camera.images import PICTURES
from drivers.camera.options import FORMATS, CameraOptions, Size, check_size
from estimator.contracts.address import guarded
from estimator.contracts.errors import BadInput, file_errors, refused
from estimator.contracts.geometry import Rotation, Transform

_NO_BOARD = (
    "the board: no image shows it; check --board, --squares (squares, not inner corners) and --square-mm, "
    "and that all of it is in view"
)


DESCRIPTION = "Calibrate a camera, its mount and delay, and a vehicle."
_LACKS = 6  # lines of what the views lack


def add_arguments(outer: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    actions = outer.add_subparsers(dest="action", metavar="WHAT", required=True)
    _add_camera(actions)
    calibrate_flight.add_parsers(actions)


def _add_camera(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    p = actions.add_parser(
        "camera",
        help="measure intrinsics and distortion with a printed board",
        description="Measure intrinsics and distortion with images of a printed board (decklander pad print --board charuco). "
        "The result is graded: good; fair, if the numbers hold but parts of the image or of the tilts are not covered; poor, if "
        "the numbers do not hold. If the grade is worse than --accept, write no file, list what the images lack, and return exit "
        "code 1.",
    )
    option(p, "paths PATH", "images, folders of images, or videos", nargs="*")
    option(
        p,
        "--device NAME",
        "use a live camera instead: a V4L2 name or path, libcamera or libcamera:NAME for a Raspberry Pi's, or an address (rtsp://...)",
    )
    option(
        p,
        "--pipeline TEXT",
        "use a live camera by GStreamer instead: a pipeline up to raw frames, as nvarguscamerasrc ! nvvidconv",
    )
    option(p, "--size WxH", "frame size of the live camera, V4L2's or the pipeline's")
    option(p, "--rate HZ", "frame rate of the live camera (default: %(default)s)", default=30.0)
    option(p, "--format", "pixel format of the live camera (default: %(default)s)", default="auto", choices=["auto", *FORMATS])
    option(p, "--seconds S", "stop the live camera after this many seconds (default: %(default)s)", default=120.0)
    option(p, "--board", "kind of the printed board (default: %(default)s)", default="charuco", choices=BOARDS)
    board_option.add(p)
    output(p, "--out FILE", "camera file to write", CAMERA_FILE, required=True)
    option(
        p,
        "--export",
        "write the camera for others, too, beside FILE with the ending .ros.yaml, .opencv.yaml or .kalibr.yaml",
        default=[],
        choices=FOREIGN,
        action="append",
    )
    option(
        p,
        "--accept",
        "write the camera file if the grade is this or better; of a poor one the cost is printed (default: %(default)s)",
        default="good",
        choices=GRADES,
    )
    option(
        p,
        "--lens",
        "model of the lens; auto takes a fisheye where the views speak for it (default: %(default)s)",
        default="auto",
        choices=get_args(LensChoice),
    )
    output(p, "--figures DIR", "write coverage.png and residuals.png into this folder", FIGURES)
    option(p, "--position-m F,R,D", "position of the camera in the body: forward, right, down (default: 0,0,0)", default="0,0,0")
    option(
        p,
        "--rpy-deg R,P,Y",
        "mount of the camera: roll, pitch, yaw; 0,0,90 looks down with the nose at the image's top (default: 0,0,90)",
        default="0,0,90",
    )
    option(p, "--json", "print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    return _run_camera(args) if args.action == "camera" else calibrate_flight.run(args)


def _run_camera(args: argparse.Namespace) -> int:
    """Calibrate; return 0 if a camera file was written, 1 if the grade is worse than accepted.

    Raises:
        BadInput: an argument, an image or the board is wrong.
    """
    if args.figures is not None:
        require_drawing("--figures")
    position, rpy = _three(args.position_m, "--position-m"), _three(args.rpy_deg, "--rpy-deg")
    mount = Transform(Rotation.from_rpy(*(math.radians(a) for a in rpy)), np.array(position))
    out = args.out
    exported = {kind: out.with_suffix(f".{kind}.yaml") for kind in args.export}
    for path in exported.values():
        check_output(path, EXPORTED, "--export", [], force=args.force)
    collection = _gather(args, board_option.board(args, args.board))
    board, size = collection.board, collection.size or (0, 0)
    if len(collection.views) < LEAST_VIEWS:
        lacks = missing_before(collection.views, size) if collection.views else [_NO_BOARD]
        if collection.mirrored:
            lacks.insert(0, "a camera that does not mirror: turn off the horizontal flip of camera, driver or pipeline")
        _say(args, collection, None, Assessment(tuple(lacks), ()), written=False)
        return 1
    with named_wait(f"solving for the camera by {len(collection.views)} views", quiet=args.json):
        solution = solve(collection.views, board, size, mount, args.lens)
    if args.figures is not None:
        from companion.tools.calibrate import figures

        figures.write_coverage([f.view for f in solution.fits], size, args.figures / "coverage.png")
        figures.write_residuals(solution, args.figures / "residuals.png")
    found = assess(solution, size)
    accepted = GRADES.index(found.grade) <= GRADES.index(args.accept)
    if accepted:
        source = guarded(args.device or args.pipeline or f"{len(args.paths)} files or folders")
        with file_errors(f"--out {out}"):
            files = {path: foreign(solution.camera, kind) for kind, path in exported.items()}
            files[out] = text(solution, f"{source} ({board.kind} {board.columns}x{board.rows}, {found.grade})", rpy)
            for path, content in files.items():
                write_whole(path, content)
    _say(args, collection, solution, found, written=accepted)
    return 0 if accepted else 1


def _gather(args: argparse.Namespace, board: Board) -> Collection:
    if [bool(args.paths), args.device is not None, args.pipeline is not None].count(True) != 1:
        raise BadInput("give either images and videos, or --device, or --pipeline")
    quiet = args.json or not sys.stderr.isatty()

    def tell(collection: Collection) -> None:
        if not quiet:
            lacks = missing_before(collection.views, collection.size or (1, 1))
            line = f"{collection.image_count} images, {len(collection.views)} views; {lacks[0] if lacks else 'enough'}"
            sys.stderr.write(f"\r{line[:100]:<100}")

    if not args.paths:
        guide = Guide(board)
        event_loop.run(watch(*_camera(args), guide, ProgressBlock(quiet=quiet).show, args.seconds))
        return guide.collection
    files = files_of([Path(p) for p in args.paths])
    collection = Collection(board, moving=any(f.suffix.lower() not in PICTURES for f in files))
    for file in files:
        add_file(file, collection, tell)
    if not quiet:
        sys.stderr.write("\n")
    return collection


def _camera(args: argparse.Namespace) -> tuple[CameraOptions, Size | None]:
    if args.device is not None and "://" in args.device:
        return CameraOptions(source="stream", device=guarded(args.device)), None
    match = re.fullmatch(r"(\d+)[xX](\d+)", args.size or "")
    if match is None:
        raise BadInput(f"--size must be the image to calibrate, such as 640x480, got {args.size!r}")
    with refused("the camera", ValueError):
        size = check_size((int(match[1]), int(match[2])))
        if args.device is None:
            return CameraOptions(source="gstreamer", device=guarded(args.pipeline), rate_hz=args.rate), size
        kind, _, name = args.device.partition(":")
        if kind == "libcamera":
            return CameraOptions(source="libcamera", device=name, rate_hz=args.rate), size
        return CameraOptions(source="v4l2", device=args.device, format=args.format, rate_hz=args.rate), size


def _three(text: str, name: str) -> tuple[float, float, float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 3 or not all(math.isfinite(v) for v in values):
        raise BadInput(f"{name} must be three numbers with commas between, got {text!r}")
    return values[0], values[1], values[2]


def _say(
    args: argparse.Namespace, collection: Collection, solution: Solution | None, found: Assessment, *, written: bool
) -> None:
    lines = [f"{collection.image_count} images: {len(collection.views)} views, the board not found in {len(collection.without)}"]
    if again := collection.repeated:
        lines[0] += f"; {len(again)} do not count: it stands where another view has it, or moves ({again[0]} first)"
    if (board := collection.board) is not collection.given:
        given = f"{board.columns - 1}x{board.rows - 1}"
        lines.append(f"--squares {given}: the images show {given} inner corners, and are taken as {board.columns}x{board.rows}")
    if solution is not None:
        c, s = solution.camera, solution.sigma
        lines += [
            f"fx {c.fx:.2f} +- {s[0]:.2f}, fy {c.fy:.2f} +- {s[1]:.2f}, "
            f"cx {c.cx:.2f} +- {s[2]:.2f}, cy {c.cy:.2f} +- {s[3]:.2f} px",
            f"error {solution.rms_px:.3f} px rms over {len(solution.fits)} views, {len(solution.left_out)} left out; "
            f"distortion {solution.model}",
            _worth(solution, cost=found.grade == "poor"),
        ]
    if written:
        lines.append(f"{found.grade}: written to {args.out}" + ("; it would be better with:" if found.missing else ""))
    else:
        hint = "" if solution is None else f" (--accept {found.grade} writes it all the same)"
        lines.append(f"{found.grade}: nothing written{hint}; it lacks:")
    lines += [f"  - {lack}" for lack in found.missing]
    print_result(args, _record(args, collection, solution, found, written=written), "\n".join(lines))


def _worth(solution: Solution, *, cost: bool) -> str:
    """Return what the distances measured with a camera are worth, with what that costs at touchdown if that is wanted."""
    share = solution.distances_right_to
    if share >= 1.0:
        return "Distances are not known: these views tell no focal length, and no landing can be made with it"
    text = f"Distances are right to {100.0 * share:.2g} % (95 %)"
    height, aside = of_distance(share)
    if cost:
        text += (
            f": {height.touchdown_cm:.1f} cm of height and {aside.touchdown_cm:.1f} cm aside at touchdown, "
            f"{height.approach_cm:.0f} cm of height where the descent begins"
        )
    return text


def _record(
    args: argparse.Namespace, collection: Collection, solution: Solution | None, found: Assessment, *, written: bool
) -> dict[str, object]:
    record: dict[str, object] = {
        "good": found.grade == "good",
        "grade": found.grade,
        "missing": found.missing,
        "file": str(args.out) if written else None,
        "images": collection.image_count,
        "views": len(collection.views),
        "squares": [collection.board.columns, collection.board.rows],
        "without_board": collection.without,
        "repeated": collection.repeated,
    }
    if solution is not None:
        c, s = solution.camera, solution.sigma
        record |= {
            "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy, "distortion": c.distortion.tolist(),
            "sigma_fx_fy_cx_cy": s[:4].tolist(), "lens": c.lens, "distances_right_to": solution.distances_right_to,
            "rms_px": solution.rms_px, "model": solution.model, "left_out": [f.view.name for f in solution.left_out],
        }  # fmt: skip
    return record


def block(state: GuideState) -> list[str]:
    """Return the parts of the image that hold a corner (`#`), with what is known and missing beside them."""
    error = "" if state.rms_px is None else f", error {state.rms_px:.2f} px, {state.grade}"
    reported = [
        f"{state.images} images, {state.views} views{error}" + ("" if state.board_seen else "; the board is not in sight"),
        "nothing is missing" if not state.lacks else "show:",
        *(f"- {lack}" for lack in state.lacks[:_LACKS]),
    ]
    reported += [""] * (2 + _LACKS - len(reported))
    grid = ["".join("#" if count else "." for count in row) for row in state.cells]
    grid += [" " * len(state.cells[0])] * (len(reported) - len(grid))
    return [f"  {cells}   {line}" for cells, line in zip(grid, reported, strict=True)]


class ProgressBlock:
    """Draws the block over the one before. Draws nothing where standard error is no terminal."""

    def __init__(self, *, quiet: bool) -> None:
        self._quiet = quiet or not sys.stderr.isatty()
        self._drawn = 0

    def show(self, state: GuideState) -> None:
        if self._quiet:
            return
        width = shutil.get_terminal_size().columns - 1
        lines = [line[:width] for line in block(state)]
        up = f"\x1b[{self._drawn}A" if self._drawn else ""
        sys.stderr.write(up + "".join(f"\r{line}\x1b[K\n" for line in lines))
        sys.stderr.flush()
        self._drawn = len(lines)
