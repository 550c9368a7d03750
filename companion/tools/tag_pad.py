"""Make a pad of fiducials, and the text of a pad file."""

from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct

from estimator.contracts.errors import BadInput
from estimator.vision.camera.camera import shown
from estimator.vision.pad.fiducial import PaintedFiducial, dictionary_names
from estimator.vision.pad.fiducial_rules import check_marker, quiet_square
from estimator.vision.pad.file import LARGEST_M, SMALLEST_M

FAMILY = "tag36h11"
"""The family where nothing says it."""
TURN_DEG = 0.5
"""Largest turn of a tag from quarters, degrees."""
_SHEET = 1.5
"""Side of a sheet whose size is not known, in that which the tags need: far from the border of most, it is not measured."""


class Board(Struct, frozen=True):
    """A board that was read."""

    keys: dict[str, Any]
    """The keys of a pad file."""
    remarks: tuple[str, ...]
    """Sentences that name things not taken or assumed."""


def painted(
    regions: Sequence[PaintedFiducial], name: str, where: str, sheet_m: tuple[float, float] | None, remarks: list[str]
) -> Board:
    """Return tags on a sheet, with a remark if the sheet is not known.

    Raises:
        BadInput: there is none, or an id is unknown.
    """
    if not regions:
        raise BadInput(f"{where}: it has no tags")
    for i, region in enumerate(regions):
        check_marker(region, f"{where}: tag {i}")
    if sheet_m is None:
        x, y = np.abs([quiet_square(region) for region in regions]).max(axis=0).reshape(2, 2).max(axis=1).tolist()
        sheet_m = round(2.0 * _SHEET * y, 3), round(2.0 * _SHEET * x, 3)
        remarks.append(
            f"the sheet is not in the file: {sheet_m[0]:g} x {sheet_m[1]:g} m is taken. Measure it across and along, for "
            "--size-mm of pad import or the pad's panel: one that is a few percent off makes the range as wrong"
        )
    panel = {"shape": "panel", "paint": "white", "length_m": sheet_m[1], "width_m": sheet_m[0]}
    tags = [{"shape": "fiducial", **msgspec.structs.asdict(region)} for region in regions]
    paints = {"white": [245, 245, 245], "black": [20, 20, 20]}
    return Board({"name": name, "ground": "", "paints": paints, "regions": [panel, *tags]}, tuple(remarks))


_KINDS = {name.removeprefix("DICT_").removeprefix("APRILTAG_").lower(): name for name in sorted(dictionary_names())}
"""OpenCV's dictionaries by the names that other programs give them, without "tag" before."""


def fiducial(
    family: str, number: int, size_m: float, where: str, right_up_m: tuple[float, float] = (0.0, 0.0), turn_deg: float = 0.0
) -> PaintedFiducial:
    """Return a tag as a region.

    Args:
        right_up_m: place of its middle on the drawing, to the right and up.
        turn_deg: its turn clockwise against OpenCV's drawing.

    Raises:
        BadInput: its family or turn is not read, or a number is no length.
    """
    kind = family.lower().removeprefix("tag")
    if kind not in _KINDS:
        raise BadInput(f"{where}: tags of the family {shown(family)} are not read: OpenCV has {', '.join(_KINDS)}")
    if not (SMALLEST_M <= size_m <= LARGEST_M and all(abs(at) <= LARGEST_M for at in right_up_m)):
        at = ", ".join(f"{v:g}" for v in right_up_m)
        raise BadInput(f"{where}: size {size_m:g} m at ({at}) m: lengths are {SMALLEST_M:g} to {LARGEST_M:g} m")
    quarters = round(turn_deg / 90.0)
    if not abs(turn_deg - 90.0 * quarters) <= TURN_DEG:
        raise BadInput(f"{where}: it is turned by {turn_deg % 90.0:.1f} degrees on the board: quarter turns alone are read")
    right_m, up_m = (round(at, 6) for at in right_up_m)
    return PaintedFiducial("black", _KINDS[kind], number, round(size_m, 6), (up_m, right_m), 90.0 * (quarters % 4))


def file_text(keys: dict[str, Any], comment: str) -> str:
    """Return a pad file's text."""
    lines = [
        f"# {comment}",
        f"name = {msgspec.json.encode(keys['name']).decode()}",
        f'ground = "{keys["ground"]}"',
        "",
        "[paints]",
    ]
    lines += [f"{name} = {rgb}" for name, rgb in keys["paints"].items()]
    for region in keys["regions"]:
        lines += ["", "[[regions]]", *(f"{key} = {msgspec.json.encode(value).decode()}" for key, value in region.items())]
    return "\n".join(lines) + "\n"
