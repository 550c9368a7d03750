"""Rules for a pad's fiducials: each is read, distinguished from the others, and measured."""

import difflib
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.vision.camera.camera import shown
from estimator.vision.pad.fiducial import QUIET_CELLS, PaintedFiducial, cells_apart, dictionary_names, dictionary_of
from estimator.vision.pad.geometry import TOUCH_M, depth_in, rectangles_of
from estimator.vision.pad.markings import Rgb
from estimator.vision.pad.shapes import Lettering, PaintedDisc, PaintedPanel, Region, part_of
from estimator.vision.srgb import LUMA, linear_light

_LEAST_LUMINANCE = 0.1
"""Least luminance of the ground over that of a fiducial, full scale 1: with less, haze and shadows hide the cells."""
_NESTED_MOST = 0.6
"""Largest fiducial within a light cell of another one, in sides of that cell: a larger one makes the cell read as dark."""


def check_marker(region: PaintedFiducial, where: str) -> None:
    """Check the keys of one fiducial.

    Raises:
        BadInput: its dictionary, its id or its turn is not known.
    """
    names = dictionary_names()
    if region.dictionary not in names:
        like = difflib.get_close_matches(region.dictionary.upper(), names, 2, 0.3) or ["DICT_4X4_50", "DICT_APRILTAG_36h11"]
        raise BadInput(
            f"{where}.dictionary {shown(region.dictionary)} is none of OpenCV's aruco module: write for example "
            f"{' or '.join(like)}"
        )
    most = len(dictionary_of(region.dictionary).bytesList) - 1
    if not 0 <= region.id <= most:
        raise BadInput(f"{where}.id must be 0 to {most}, the ids of {region.dictionary}, got {region.id}")
    if region.turn_deg not in (0.0, 90.0, 180.0, 270.0):
        raise BadInput(
            f"{where}.turn_deg must be 0, 90, 180 or 270, got {region.turn_deg:g}: sides are measured along x and y alone; turn "
            "the whole pad on the deck instead"
        )


def check_fiducials(regions: Sequence[Region], paints: Mapping[str, Rgb], where: str) -> None:
    """Check a pad's fiducials against one another and against what they lie on.

    Raises:
        BadInput: one is there twice or cannot be distinguished from another, lies in another's border of light, off the disc or
            panel, or is not darker than it.
    """
    found = {i: region for i, region in enumerate(regions) if isinstance(region, PaintedFiducial)}
    if not found:
        return
    ground = next((r for r in regions if isinstance(r, PaintedDisc | PaintedPanel)), None)
    if ground is None:
        first = next(iter(found))
        raise BadInput(
            f"{where}: regions[{first}] (fiducial) lies on the bare deck, whose light is not known: paint a disc or a panel "
            "below it"
        )
    for i, fiducial in found.items():
        _check_ground(fiducial, ground, paints, f"{where}: regions[{i}]")
    for (i, a), (j, b) in combinations(found.items(), 2):
        _check_distinct(a, b, i, f"{where}: regions[{j}]")
    for i, fiducial in found.items():
        for j, other in enumerate(regions):
            if j != i and part_of(other) in ("letter", "fiducial"):
                _check_quiet(fiducial, other, j, f"{where}: regions[{i}]")


def quiet_square(fiducial: PaintedFiducial) -> F64:
    """Return the limits x0, x1, y0, y1 of a fiducial with the border of light that it needs, m."""
    return fiducial.square(QUIET_CELLS * fiducial.cell_m)


def _check_ground(fiducial: PaintedFiducial, ground: PaintedDisc | PaintedPanel, paints: Mapping[str, Rgb], where: str) -> None:
    x0, x1, y0, y1 = quiet_square(fiducial).tolist()
    inside = float(depth_in(ground, np.array([(x0, y0), (x0, y1), (x1, y0), (x1, y1)])).min())
    if inside < -TOUCH_M:
        raise BadInput(
            f"{where}: the fiducial of size_m {fiducial.size_m:g} at at_m {list(fiducial.at_m)} needs a border of one cell "
            f"({fiducial.cell_m:.4g} m) on the {part_of(ground)} and lacks {-inside:.3g} m: make the {part_of(ground)} larger or "
            "the fiducial smaller"
        )
    own, under = (float(linear_light(paints[r.paint]) @ LUMA) for r in (fiducial, ground))
    if under - own < _LEAST_LUMINANCE:
        raise BadInput(
            f"{where}.paint {shown(fiducial.paint)} is {under - own:.2f} of luminance darker than {shown(ground.paint)} below "
            f"it, at least {_LEAST_LUMINANCE:g} is needed: paint fiducials dark on light"
        )


def _check_distinct(a: PaintedFiducial, b: PaintedFiducial, first: int, where: str) -> None:
    one, other = a.cells(), b.cells()
    if one.shape != other.shape:
        return
    apart = cells_apart(one, other)
    named = f"{b.dictionary} {b.id}"
    if apart == 0:
        raise BadInput(f"{where} is {named}, which is there already as regions[{first}]: give each fiducial another id")
    corrected = dictionary_of(a.dictionary).maxCorrectionBits + dictionary_of(b.dictionary).maxCorrectionBits
    if a.dictionary != b.dictionary and apart <= corrected:
        raise BadInput(
            f"{where} ({named}) differs from regions[{first}] ({a.dictionary} {a.id}) in {apart} cells and may be read as that "
            "one: take both from one dictionary, or another id"
        )


def _check_quiet(fiducial: PaintedFiducial, other: Region, index: int, where: str) -> None:
    assert isinstance(other, Lettering)
    a = quiet_square(fiducial)
    apart = [(max(a[0], b[0]) - min(a[1], b[1]), max(a[2], b[2]) - min(a[3], b[3])) for b in rectangles_of([other])]
    if all(max(gap) >= -TOUCH_M for gap in apart):
        return
    if isinstance(other, PaintedFiducial) and _is_nested(other, fiducial):
        return
    raise BadInput(
        f"{where}: regions[{index}] reaches into the fiducial or its border of light, one cell ({fiducial.cell_m:.4g} m) wide: "
        f"move them apart; a fiducial within another one lies in the middle of a light cell and is at most {_NESTED_MOST:g} of it"
    )


def _is_nested(inner: PaintedFiducial, outer: PaintedFiducial) -> bool:
    """Return whether a fiducial lies in one light cell of another."""
    cells, cell_m = outer.cells(), outer.cell_m
    _, x1, y0, _ = outer.square().tolist()
    row, column = int((x1 - inner.at_m[0]) // cell_m), int((inner.at_m[1] - y0) // cell_m)
    if not (0 <= row < len(cells) and 0 <= column < len(cells)) or cells[row, column]:
        return False
    around = np.array([x1 - (row + 1) * cell_m, x1 - row * cell_m, y0 + column * cell_m, y0 + (column + 1) * cell_m])
    clear = (inner.square() - around) * np.array([1.0, -1.0, 1.0, -1.0])
    return bool(clear.min() >= QUIET_CELLS * inner.cell_m - TOUCH_M and inner.size_m <= _NESTED_MOST * cell_m + TOUCH_M)
