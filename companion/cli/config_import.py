"""`decklander config import`: make a settings file of another landing program's."""

import argparse
import sys
from pathlib import Path

from companion.cli.options import option
from companion.cli.outputs import SETTINGS, output

DESCRIPTION = (
    "Make a settings file of another landing program's, with a pad file beside it. Read are vision_landing.conf "
    "and the JSON of two extensions of BlueOS, rmackay9's and Wingxtra's. Each key that is not taken is printed."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the action."""
    option(parser, "foreign FILE", "the other program's file", type=Path)
    output(parser, "--out FILE", "settings file to write (.toml)", SETTINGS, required=True)
    option(parser, "--tag-mm MM", "side of the tag's dark square, where the file does not say it", type=float)


def run(args: argparse.Namespace) -> int:
    """Write the files and return 0.

    Raises:
        BadInput: as for `companion.tools.others_settings.write`.
    """
    from companion.tools.others_settings import write  # a pad's tags need OpenCV, and the other actions of config do not

    tag_m = None if args.tag_mm is None else args.tag_mm / 1000.0
    left = write(args.foreign, args.out, tag_m)
    sys.stdout.write(f"{args.out}: written\n" + "".join(f"{args.foreign}: {line}\n" for line in left))
    return 0
