"""A pad's file, checked: a length or a shape that no pad has is refused with path, value and cure in one line."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal, get_args

import msgspec
import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import asdict

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.vision.camera.camera import shown
from estimator.vision.pad import shapes
from estimator.vision.pad.fiducial import PaintedFiducial
from estimator.vision.pad.fiducial_rules import check_marker
from estimator.vision.pad.geometry import TOUCH_M, depth_in, sheet_of, sides_meet
from estimator.vision.pad.lamps import MOST, Lamp, check_lamps
from estimator.vision.pad.rules import check_regions

SMALLEST_M = 0.001
"""Least length of a side or a width, m."""
LARGEST_M = 20.0
"""Largest length, m. It bounds memory: edges are sampled every few millimetres."""

_SHAPES: dict[object, type[Struct]] = {kind.__struct_config__.tag: kind for kind in get_args(shapes.Region)}
Channel = Annotated[int, Meta(ge=0, le=255)]


class Calibration(Struct, frozen=True, forbid_unknown_fields=True):
    """Result of `decklander pad check`, which searches clutter for a pad."""

    least_support: Annotated[float, Meta(gt=0.0, le=1000.0)]
    """Support of the drawing at which a find is as likely to be clutter.

    It is the explained share of the light, times the share that follows it.
    """
    chance: Annotated[float, Meta(ge=0.0, le=1.0)]
    """Chance of a false pad in a frame of 640x360 that is searched, with that."""
    least_px: Annotated[float, Meta(ge=0.0)] = 0.0
    """Radius in a frame from which the pad is found; 0 where it is not found at all sizes from one on."""
    drawing: str = ""
    """The drawing's fingerprint: another drawing is not calibrated."""


class PadFile(Struct, frozen=True, forbid_unknown_fields=True):
    """A pad's file: what is painted, from the lowest region to the topmost, and what is lit."""

    name: Annotated[str, Meta(min_length=1, max_length=60)]
    paints: dict[str, tuple[Channel, Channel, Channel]]
    """Red, green, blue of each paint by its name."""
    regions: Annotated[tuple[shapes.Region, ...], Meta(min_length=1, max_length=40)]
    lamps: Annotated[tuple[Lamp, ...], Meta(max_length=MOST)] = ()
    """Lamps that shine upwards, for nights."""
    size_sigma_m: Annotated[float, Meta(ge=0.0, le=0.05)] = 0.0
    """Sigma of what was painted or printed against the sizes in this file, m."""
    ground: str = ""
    """The paint of the sheet or the deck around; empty where it is not known."""
    calibration: Calibration | None = None
    polarity: Literal["drawn", "any"] = "drawn"
    """Light that it is searched in: "any" is for thermal cameras, which may reverse it, and clutter costs twice as much then."""
    accept_false_pads: bool = False
    """True if the pad is flown to although clutter is taken for it too often."""


def pad_file(data: Mapping[str, Any], where: str) -> PadFile:
    """Return a pad's file, checked.

    Raises:
        BadInput: see `estimator.vision.pad.pad.Pad.from_mapping`.
    """
    if "disc_radius_m" in data:
        raise BadInput(f'{where}: disc_radius_m is no key of a pad: write [[regions]] with shape = "disc", paint and radius_m')
    try:
        file = msgspec.convert(dict(data), PadFile, strict=True)
    except (msgspec.ValidationError, OverflowError, TypeError) as why:
        raise BadInput(f"{where}: {_explained(data, str(why))}") from why
    for i, region in enumerate(file.regions):
        _check_lengths(region, f"{where}: regions[{i}]")
        _check_shape(region, f"{where}: regions[{i}]")
        if region.paint not in file.paints:
            known = ", ".join(file.paints)
            raise BadInput(
                f"{where}: regions[{i}].paint {shown(region.paint)} is not in [paints], which has {shown(known)}; add it there"
            )
    for i, lamp in enumerate(file.lamps):
        _check_within(lamp.at_m, f"{where}: lamps[{i}].at_m")
    if file.ground and file.ground not in file.paints:
        known = ", ".join(file.paints)
        raise BadInput(f"{where}: ground {shown(file.ground)} is not in [paints], which has {shown(known)}; add it there")
    sheet = sheet_of(file.regions)
    if sheet is not None and file.ground not in ("", sheet.paint):
        raise BadInput(
            f"{where}: regions[0] is a sheet of paint {shown(sheet.paint)} below all others, and ground is {shown(file.ground)}: "
            "take one out"
        )
    try:
        check_regions(file.regions[sheet is not None :], file.paints, where, file.ground if sheet is None else sheet.paint)
    except BadInput as why:
        if sheet is None:
            raise
        # The rules count from the region above the sheet.
        raise BadInput(re.sub(r"regions\[(\d+)\]", lambda at: f"regions[{int(at[1]) + 1}]", str(why))) from why
    check_lamps(file.lamps, where)
    return file


def _explained(data: Mapping[str, Any], message: str) -> str:
    """Return msgspec's message in one line with the path and the value found there."""
    reason, _, place = message.rpartition(" - at `$")
    if not reason:
        return " ".join((_of_key(message, data, PadFile.__struct_fields__) or message).split())
    found: Any = data
    for key in re.findall(r"\w+", place):
        try:
            found = found[int(key)] if isinstance(found, list) else found[key]
        except (KeyError, IndexError, TypeError, ValueError):
            return f"{place.strip('.`')}: {reason}"
    value = "" if isinstance(found, Mapping) else f", got {shown(found)}"
    if isinstance(found, Mapping) and (shape := _SHAPES.get(found.get("shape"))) is not None:
        reason = _of_key(reason, found, ("shape", *shape.__struct_fields__)) or reason
    return " ".join(f"{place.strip('.`')}: {reason}{value}".split())


def _of_key(reason: str, table: Mapping[str, Any], known: tuple[str, ...]) -> str:
    """Return what is wrong with the keys of a table, or nothing if the reason is another one."""
    if missing := re.fullmatch(r"Object missing required field `(.*)`", reason):
        return f"{missing[1]} is missing"
    if re.fullmatch(r"Object contains unknown field `.*`", reason) is None:
        return ""
    unknown = next(key for key in table if key not in known)
    near = difflib.get_close_matches(str(unknown), known, n=1)
    return f"{unknown} is not a known key; " + (f"did you mean {near[0]}?" if near else f"known here are {', '.join(known)}")


def _check_lengths(region: shapes.Region, where: str) -> None:
    for key, value in asdict(region).items():
        if not key.endswith("_m") or value is None:
            continue
        if key in ("from_m", "to_m", "points_m", "at_m"):
            _check_within(value, f"{where}.{key}")
        elif key == "holes_m":
            for i, hole in enumerate(value):
                _check_within(hole, f"{where}.{key}[{i}]")
        elif not (math.isfinite(value) and SMALLEST_M <= value <= LARGEST_M):
            raise BadInput(f"{where}.{key} must be {SMALLEST_M:g} to {LARGEST_M:g} m, got {shown(value)}{_cure(value)}")


def _check_within(value: object, where: str) -> None:
    if not all(math.isfinite(v) and abs(v) <= LARGEST_M for v in np.ravel(np.asarray(value, dtype=float))):
        raise BadInput(f"{where} must be at most {LARGEST_M:g} m from the centre, got {shown(value)}{_cure(value)}")


def _cure(value: object) -> str:
    largest = float(np.max(np.abs(np.ravel(np.asarray(value, dtype=float)))))
    if not LARGEST_M < largest <= 1000.0 * LARGEST_M:
        return ""
    return f": is it in millimetres? Write metres, {largest / 1000.0:g} for {largest:g}"


def _check_shape(region: shapes.Region, where: str) -> None:
    match region:
        case shapes.PaintedRing() if not region.inner_m < region.outer_m:
            raise BadInput(f"{where}: inner_m must be less than outer_m, got {region.inner_m:g} and {region.outer_m:g}")
        case shapes.PaintedArrowhead() if region.depth_m >= region.tip_m:
            raise BadInput(
                f"{where}.depth_m must be less than tip_m, got {region.depth_m:g}: an arrowhead lies ahead of the centre"
            )
        case shapes.PaintedLetter():
            across, along = (2.0 if region.letter == "H" else 1.0), (2.0 if region.letter == "L" else 1.0)
            bar = region.bar_m or region.stroke_m
            if across * region.stroke_m >= region.width_m or along * bar >= region.length_m:
                raise BadInput(
                    f"{where}: stroke_m {region.stroke_m:g} or bar_m {bar:g} leaves no room in a letter of "
                    f"{region.length_m:g} x {region.width_m:g} m"
                )
        case PaintedFiducial():
            check_marker(region, where)
        case shapes.PaintedTriangle() if region.stroke_m >= 0.9 * region.inscribed_m():
            raise BadInput(
                f"{where}.stroke_m {region.stroke_m:g} leaves no room in a triangle of side_m {region.side_m:g}: its sides are "
                f"{region.inscribed_m():.3g} m from the centre"
            )
        case shapes.PaintedStroke():
            if not math.dist(region.from_m, region.to_m) >= SMALLEST_M:
                raise BadInput(f"{where}: from_m and to_m must differ, got {region.from_m} and {region.to_m}")
        case shapes.PaintedPolygon():
            check_polygon(region, where)


def check_polygon(region: shapes.PaintedPolygon, where: str) -> None:
    """Check a polygon's lines.

    Raises:
        BadInput: a line touches itself or another one, or has too short a side.
    """
    line = np.array(region.points_m, dtype=float).reshape(-1, 2)
    if not (3 <= len(line) <= 60 and is_simple(line)):
        raise BadInput(
            f"{where}.points_m must be 3 to 60 corners of a line that does not touch itself, sides of {SMALLEST_M} m at least"
        )
    for i, hole in enumerate(region.holes_m):
        points = np.array(hole, dtype=float).reshape(-1, 2)
        rest = msgspec.structs.replace(region, holes_m=region.holes_m[:i])
        if (
            not (3 <= len(points) <= 60 and is_simple(points))
            or depth_in(rest, points).min() <= TOUCH_M
            or np.any(depth_in(shapes.PaintedPolygon("", hole), rest.corners()) > 0.0)
        ):
            raise BadInput(
                f"{where}.holes_m[{i}] must be 3 to 60 corners of a line that does not touch itself and lies within the polygon, "
                "beside its other holes"
            )


def is_simple(points: F64) -> bool:
    """Return whether a closed line turns at each corner, and its sides meet their neighbours alone."""
    way = np.roll(points, -1, axis=0) - points
    before = np.roll(way, 1, axis=0)
    length = np.linalg.norm(way, axis=1)
    turns = np.abs(before[:, 0] * way[:, 1] - before[:, 1] * way[:, 0]) > TOUCH_M * length
    return bool(np.all(length >= SMALLEST_M) and np.all(turns)) and not sides_meet(points)
