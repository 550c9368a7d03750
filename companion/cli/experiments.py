"""`decklander experiments`: fly the experiments of the thesis' chapter 5 again and write their tables and figures."""

import argparse
import shlex
import sys
from pathlib import Path
from typing import Any

from companion.cli.options import check_seed, option, print_result, require_drawing
from companion.cli.outputs import EXPERIMENTS, output
from companion.settings.load import load, pad_of_file, read_camera, write_whole
from decklander.place import SHIPPED
from estimator.contracts.errors import file_errors
from sitl.study.experiments.chapter5 import QUANTITIES, Chapter5, drifts, fly_chapter, hover_table, lags
from sitl.study.experiments.photographs import read_photographs

PAGE = "experiments.md"
_ON_PAD_M = 0.39
"""Radius of the thesis' pad."""

DESCRIPTION = (
    "Fly the experiments of the thesis' chapter 5 again in virtual time, and write a page with its tables and "
    "figures beside ours. It takes some minutes of CPU time. Exit code 0 if both landings end on the pad, else 1."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    output(parser, "--out DIR", "folder for the page (default: experiments)", EXPERIMENTS, default=Path("experiments"))
    option(parser, "--seed N", "seed of all random numbers (default: 1)", default=1)
    option(parser, "--config FILE", "settings file to fly with (default: the profile sim)", default="sim")
    option(parser, "--photos DIR", "photographs of the printed pad: a folder with pose.csv and images/", type=Path)
    option(parser, "--json", "print one JSON object with the tables")


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    check_seed(args)
    require_drawing("experiments")
    from sitl.study.experiments.page import draw, page

    settings = load(args.config)
    photographs = None
    if args.photos is not None:
        _say(args, "5.2 the photographs of the real pad")
        camera, pad = read_camera(SHIPPED / "cameras" / "photos.toml"), pad_of_file(SHIPPED / "pads" / "printed.toml")
        photographs = read_photographs(args.photos, camera, pad)
    chapter = fly_chapter(settings, args.seed, lambda title: _say(args, title))
    words = ["decklander", "experiments", *(["--seed", str(args.seed)] if args.seed != 1 else [])]
    words += ["--photos", "DIR"] if args.photos is not None else []
    with file_errors(f"--out {args.out}"):
        args.out.mkdir(parents=True, exist_ok=True)
        write_whole(args.out / PAGE, page(chapter, photographs, shlex.join(words)))
        draw(chapter, args.out)
    ways = {"the landing by guidance": chapter.landing, "the one by an external controller": chapter.external}
    missed = [
        f"{way} ended {'without an outcome' if one.outcome is None else one.outcome.value}"
        for way, one in ways.items()
        if one.outcome is None or one.lateral_m is None or one.lateral_m >= _ON_PAD_M
    ]
    why = "".join(f"\nexit code 1: {text}, not on the pad" for text in missed)
    print_result(args, _tables(chapter), f"written: {args.out / PAGE}{why}")
    return 1 if missed else 0


def _say(args: argparse.Namespace, title: str) -> None:
    if not args.json:
        sys.stderr.write(f"{title} ...\n")


def _tables(chapter: Chapter5) -> dict[str, Any]:
    return {
        "hover": {
            quantity: [
                {"height_m": height_m, "method": method, **row._asdict()}
                for (height_m, method), row in hover_table(chapter.hover, quantity).items()
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
