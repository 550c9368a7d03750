"""`decklander experiments`: fly the experiments of the thesis' chapter 5 again and write their tables and figures."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from pathlib import Path
from typing import Any

from companion.settings.load import SHIPPED, load, read_camera, read_toml
from companion.tools.report.drawing import require_drawing
from estimator.contracts.errors import BadInput, unusable
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from study.experiments.chapter5 import QUANTITIES, Chapter5, drifts, fly_chapter, lags
from study.experiments.photographs import read_photographs

PAGE = "experiments.md"


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `decklander experiments` to the parser."""
    parser = subparsers.add_parser(
        "experiments",
        help="fly the thesis' experiments again",
        description="Fly the experiments of the thesis' chapter 5 again in virtual time, and write a page with its tables and "
        "figures beside ours. It takes some minutes of CPU time. Exit code 0 if both landings end on the pad, else 1.",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("experiments"),
        metavar="DIR",
        help="write the page into this folder (default: experiments)",
    )
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed of all random numbers (default: 1)")
    parser.add_argument("--config", default="sim", metavar="FILE", help="settings file to fly with (default: the profile sim)")
    parser.add_argument(
        "--photos", type=Path, metavar="DIR", help="photographs of the printed pad: a folder with pose.csv and images/"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object with the tables")


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    if args.seed < 0:
        raise BadInput(f"--seed must be 0 or more, got {args.seed}")
    require_drawing("experiments")
    from study.experiments.page import draw, page

    settings = load(args.config)
    try:
        args.out.mkdir(parents=True, exist_ok=True)
    except OSError as why:
        raise unusable(f"--out {args.out}", why) from why
    photographs = None
    if args.photos is not None:
        _say(args, "5.2 the photographs of the real pad")
        photographs = read_photographs(args.photos, *_shipped())
    chapter = fly_chapter(settings, args.seed, lambda title: _say(args, title))
    words = ["decklander", "experiments", *(["--seed", str(args.seed)] if args.seed != 1 else [])]
    words += ["--photos", "DIR"] if args.photos is not None else []
    try:
        (args.out / PAGE).write_text(page(chapter, photographs, shlex.join(words)), encoding="utf-8")
        draw(chapter, args.out)
    except OSError as why:
        raise unusable(f"--out {args.out}", why) from why
    landed = [one.lateral_m for one in (chapter.landing, chapter.external) if one.outcome is not None]
    if args.json:
        sys.stdout.write(json.dumps(_tables(chapter)) + "\n")
    else:
        sys.stdout.write(f"written: {args.out / PAGE}\n")
    return 0 if len(landed) == 2 and all(off is not None and off < 0.39 for off in landed) else 1


def _say(args: argparse.Namespace, title: str) -> None:
    if not args.json:
        sys.stderr.write(f"{title} ...\n")


def _shipped() -> tuple[Camera, Pad]:
    """Return the camera of the photographs and the printed pad."""
    camera, pad = SHIPPED / "cameras" / "photos.toml", SHIPPED / "pads" / "printed.toml"
    return read_camera(camera), Pad.from_mapping(read_toml(pad), str(pad))


def _tables(chapter: Chapter5) -> dict[str, Any]:
    return {
        "hover": {
            quantity: [
                {"height_m": height_m, "method": method, **row._asdict()}
                for (height_m, method), row in chapter.hover.table(quantity).items()
            ]
            for quantity in QUANTITIES
        },
        "lags": [one._asdict() for one in lags(chapter.step)],
        "drifts": [one._asdict() for one in drifts(chapter.around)],
        "landings": [
            {
                "controller": name,
                "outcome": None if one.outcome is None else one.outcome.value,
                "lateral_m": one.lateral_m,
                "duration_s": one.duration_s,
            }
            for name, one in (("pid", chapter.landing), ("external", chapter.external))
        ],
    }
