"""The pad as data: the regions that it is painted with, in order, their paints, and its lamps.

Everything else is derived from them: edges and coverage for registration, maps for alignment, the rendered pad, the printed one
and the overlay. A file with lengths or shapes that no pad has is refused: path, value and cure in one line. Axes: x along the
arrow, y to starboard of it, z into the deck; metres from the centre. The lamps keep rules, so that a dark frame shows how the pad
is turned.
"""

from __future__ import annotations

import difflib
import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Annotated, Any, Literal, get_args

import msgspec
import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import asdict

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera, shown
from estimator.vision.fiducial import PaintedFiducial
from estimator.vision.pad_rules import Markings, Rgb, check_marker, check_regions, markings_of
from estimator.vision.regions import (
    PaintedArrowhead,
    PaintedLetter,
    PaintedPolygon,
    PaintedRing,
    PaintedStroke,
    PaintedTriangle,
    Region,
    borders_of,
    circle,
    depth_in,
    sheet_of,
    sides_meet,
)

FEWEST, MOST = 5, 40
"""Numbers of lamps of a pad that has any: with four in view a pad could not be distinguished from four other lights."""
_WIDTH_LEAST = 0.2
"""Least extent of the lamps across their longest line, as a part of that: of a row of lamps the far side is not distinguished."""
_ALIKE = 0.25
"""Part of the distance between two lamps by which a turned pattern must miss a lamp, or the pattern looks the same."""


class Lamp(Struct, frozen=True, forbid_unknown_fields=True):
    """A lamp that shines upwards from the pad."""

    at_m: tuple[float, float]
    """Its place: along the arrow and to starboard, from the pad's centre."""
    radius_m: Annotated[float, Meta(ge=0.001, le=0.2)] = 0.012
    """Radius of what shines."""


def places_of(lamps: Sequence[Lamp]) -> F64:
    """Return the places of lamps, (N, 2) m."""
    return np.array([lamp.at_m for lamp in lamps], dtype=float).reshape(-1, 2)


def check_lamps(lamps: Sequence[Lamp], where: str) -> None:
    """Check that lamps make a pattern that can be distinguished from any other heading of it.

    Raises:
        BadInput: too few, two in one place, all in a line, or a pattern that looks the same after a turn.
    """
    if not lamps:
        return
    if len(lamps) < FEWEST:
        raise BadInput(f"{where}: lamps has {len(lamps)}: fewer than {FEWEST} are taken for any lights on a deck: add some")
    for (i, a), (j, b) in combinations(enumerate(lamps), 2):
        if math.dist(a.at_m, b.at_m) < a.radius_m + b.radius_m:
            raise BadInput(f"{where}: lamps[{j}] at {list(b.at_m)} touches lamps[{i}] at {list(a.at_m)}: take one out")
    places = places_of(lamps)
    long, wide = np.linalg.svd(places - places.mean(axis=0), compute_uv=False).tolist()
    if wide < _WIDTH_LEAST * long:
        raise BadInput(f"{where}: the lamps lie in a line: place some of them beside it")
    for n in range(2, len(lamps) + 1):
        if _looks_alike(places, math.tau / n):
            raise BadInput(
                f"{where}: the lamps look the same after a turn by {360 / n:g} degrees: leave one out, or move one, so that "
                "their heading is known"
            )


def _looks_alike(places: F64, angle_rad: float) -> bool:
    """Return whether each lamp lies near another one's place after a turn about the pad's centre."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    turned = places @ np.array([[c, s], [-s, c]])
    off = np.linalg.norm(turned[:, None] - places[None], axis=2).min(axis=1)
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    nearest = float(apart[~np.eye(len(places), dtype=bool)].min())
    return bool(np.all(off < _ALIKE * nearest))


CENTRE_PX = 0.1
"""Assumed standard deviation of the centre of a lamp's spot."""
_RESOLVED_PX = 3.0
"""Least distance of two lamps that are two spots."""


@dataclass(frozen=True, slots=True)
class LampAccuracy:
    """The Cramer-Rao bound of one frame from straight above, its tilt known."""

    height_m: float
    lamps: int
    """Number of lamps in view."""
    spots: int
    """Number of spots that they make in the frame."""
    lateral_m: float
    """Standard deviation along the worse direction."""
    range_m: float
    yaw_rad: float
    """All three are infinite with fewer than two spots."""


def lamp_accuracy(lamps: tuple[Lamp, ...], camera: Camera, height_m: float) -> LampAccuracy:
    """Return the accuracy of one frame at a height over the pad's centre, by spots whose centres are known to `CENTRE_PX`."""
    focal_px = 0.5 * (camera.fx + camera.fy)
    places = places_of(lamps)
    uv = focal_px / height_m * places
    # The top of the frame is ahead: x of the pad is up, y to the right.
    seen = (np.abs(uv[:, 0]) < 0.5 * camera.height) & (np.abs(uv[:, 1]) < 0.5 * camera.width)
    spots = _resolved(uv[seen])
    if len(spots) < 2:
        return LampAccuracy(height_m, int(seen.sum()), len(spots), math.inf, math.inf, math.inf)
    scale, none = focal_px / height_m, np.zeros(len(spots))
    along = np.stack([none + scale, none, -spots[:, 0] / height_m, -spots[:, 1]], axis=1)
    across = np.stack([none, none + scale, -spots[:, 1] / height_m, spots[:, 0]], axis=1)
    J = np.concatenate([along, across])
    cov = np.linalg.inv(J.T @ J) * CENTRE_PX**2
    lateral_m = math.sqrt(float(np.linalg.eigvalsh(cov[:2, :2])[-1]))
    return LampAccuracy(height_m, int(seen.sum()), len(spots), lateral_m, math.sqrt(cov[2, 2]), math.sqrt(cov[3, 3]))


def _resolved(uv: F64) -> F64:
    """Return the middles of the spots that lamps at these places make, (S, 2) px: those nearer than can be resolved are one."""
    spots: list[list[F64]] = []
    for place in uv:
        near = next((spot for spot in spots if any(np.linalg.norm(place - other) < _RESOLVED_PX for other in spot)), None)
        if near is None:
            spots.append([place])
        else:
            near.append(place)
    return np.array([np.mean(spot, axis=0) for spot in spots]).reshape(-1, 2)


SMALLEST_M, LARGEST_M = 0.001, 20.0
"""Limits of a length. The largest bounds memory: edges are sampled every few millimetres."""
_TOUCH_M = 1e-6

_SHAPES: dict[object, type[Struct]] = {kind.__struct_config__.tag: kind for kind in get_args(Region)}
Channel = Annotated[int, Meta(ge=0, le=255)]


TOLD_BY_PARTS, TOLD = 0.3, 5.0
"""Least support of drawings with disc, ring and lettering, whose parts distinguish them, and of other drawings."""
RARE = 1e-4
"""Chance of a false pad in a frame of a search above which a pad is not flown to."""


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
    regions: Annotated[tuple[Region, ...], Meta(min_length=1, max_length=40)]
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
        BadInput: see `estimator.vision.pad.Pad.from_mapping`.
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


def _check_lengths(region: Region, where: str) -> None:
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


def _check_shape(region: Region, where: str) -> None:
    match region:
        case PaintedRing() if not region.inner_m < region.outer_m:
            raise BadInput(f"{where}: inner_m must be less than outer_m, got {region.inner_m:g} and {region.outer_m:g}")
        case PaintedArrowhead() if region.depth_m >= region.tip_m:
            raise BadInput(
                f"{where}.depth_m must be less than tip_m, got {region.depth_m:g}: an arrowhead lies ahead of the centre"
            )
        case PaintedLetter():
            across, along = (2.0 if region.letter == "H" else 1.0), (2.0 if region.letter == "L" else 1.0)
            bar = region.bar_m or region.stroke_m
            if across * region.stroke_m >= region.width_m or along * bar >= region.length_m:
                raise BadInput(
                    f"{where}: stroke_m {region.stroke_m:g} or bar_m {bar:g} leaves no room in a letter of "
                    f"{region.length_m:g} x {region.width_m:g} m"
                )
        case PaintedFiducial():
            check_marker(region, where)
        case PaintedTriangle() if region.stroke_m >= 0.9 * region.inscribed_m():
            raise BadInput(
                f"{where}.stroke_m {region.stroke_m:g} leaves no room in a triangle of side_m {region.side_m:g}: its sides are "
                f"{region.inscribed_m():.3g} m from the centre"
            )
        case PaintedStroke():
            if not math.dist(region.from_m, region.to_m) >= SMALLEST_M:
                raise BadInput(f"{where}: from_m and to_m must differ, got {region.from_m} and {region.to_m}")
        case PaintedPolygon():
            check_polygon(region, where)


def check_polygon(region: PaintedPolygon, where: str) -> None:
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
            or depth_in(rest, points).min() <= _TOUCH_M
            or np.any(depth_in(PaintedPolygon("", hole), rest.corners()) > 0.0)
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
    turns = np.abs(before[:, 0] * way[:, 1] - before[:, 1] * way[:, 0]) > _TOUCH_M * length
    return bool(np.all(length >= SMALLEST_M) and np.all(turns)) and not sides_meet(points)


@dataclass(frozen=True, slots=True)
class Pad:
    """A pad: its name, its paints, and its regions from the lowest to the topmost.

    Raises:
        BadInput: see `from_mapping`.
    """

    name: str
    paints: tuple[tuple[str, Rgb], ...]
    """Names and sRGB values of the paints."""
    regions: tuple[Region, ...]
    size_sigma_m: float = 0.0
    """Sigma of the painted sizes against those of the regions, m: the tolerance of print and deck."""
    lamps: tuple[Lamp, ...] = ()
    """Lamps that shine upwards; their pattern shows its heading."""
    ground: str = ""
    """The paint of the sheet or the deck around; empty where it is not known."""
    calibration: Calibration | None = None
    """Rate at which clutter is taken for it; None if unknown."""
    accept_false_pads: bool = False
    """True if it is flown to although clutter is taken for it too often."""
    reversible: bool = False
    """True if its light may be reversed, as a thermal camera shows it."""
    sheet: Region | None = None
    """The region of the file that is the ground of all others; None if the file has none."""
    markings: Markings = field(init=False, compare=False, repr=False)
    """The sizes of the parts that detection knows by name."""
    _hash: int = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "markings", markings_of(self.regions, dict(self.paints), self.ground))
        # A pad is the key of caches that every frame uses.
        drawn = self.name, self.paints, self.regions, self.size_sigma_m, self.lamps, self.ground
        object.__setattr__(self, "_hash", hash((*drawn, self.calibration)))

    def __hash__(self) -> int:
        return self._hash

    @staticmethod
    def from_mapping(data: Mapping[str, Any], where: str = "pad") -> Pad:
        """Build a pad from the keys of a pad file (configs/pads/*.toml).

        Raises:
            BadInput: a key is missing, unknown, of the wrong type or out of range, regions cross or hide one another, or a paint
                does not stand out from the one below. The text names `where`, the key, the value and what to do.
        """
        file: PadFile = pad_file(data, where)
        paints = tuple((name, (rgb[0], rgb[1], rgb[2])) for name, rgb in file.paints.items())
        sheet = sheet_of(file.regions)
        regions, ground = (file.regions, file.ground) if sheet is None else (file.regions[1:], sheet.paint)
        known = file.calibration, file.accept_false_pads, file.polarity == "any", sheet
        return Pad(file.name, paints, regions, file.size_sigma_m, file.lamps, ground, *known)

    @property
    def fingerprint(self) -> str:
        """Fingerprint of this drawing, 12 hexadecimal digits."""
        drawn = msgspec.json.encode((self.paints, self.regions, self.ground))
        return hashlib.sha256(drawn).hexdigest()[:12]

    @property
    def least_support(self) -> float:
        """Support at which a find is as likely to be clutter: by its calibration, otherwise as for pads of its kind."""
        if self.calibration is not None:
            return self.calibration.least_support
        return TOLD_BY_PARTS if self.markings.is_searched_by_parts else TOLD

    @property
    def clutter_log_odds(self) -> float:
        """Log-odds against a find of a drawing that clutter is taken for too often to be flown to; 0 where that is accepted."""
        if self.calibration is None or self.accept_false_pads:
            return 0.0
        return math.log(max(1.0, self.calibration.chance / RARE))

    @property
    def is_calibrated(self) -> bool:
        """True if it is known how often clutter is taken for this drawing."""
        return self.calibration is not None and self.calibration.drawing == self.fingerprint

    @property
    def is_identifiable_by_paint(self) -> bool:
        """True if its paint is enough to identify it among other things on decks; if not, only its lamps are searched."""
        if self.accept_false_pads or not self.is_calibrated or self.calibration is None:
            return self.accept_false_pads or self.has_known_parts or not self.lamps
        return self.calibration.chance <= RARE

    @property
    def has_known_parts(self) -> bool:
        """True if it is of the kinds that verification was fitted to: disc, ring and lettering, fiducials, an H or X alone."""
        return self.markings.is_searched_by_parts or bool(self.markings.fiducials) or self.markings.is_letter_alone

    def check_for_detection(self, where: str) -> None:
        """Check that clutter is rarely taken for this pad, or that it has lamps.

        Raises:
            BadInput: its calibration says that it is taken too often, and its file does not accept that.
        """
        if not self.lamps and not self.is_identifiable_by_paint and self.calibration is not None:
            raise BadInput(
                f"{where}: clutter is taken for this pad in {1000.0 * self.calibration.chance:.3g} of 1,000 frames that are "
                f"searched (limit for flight: {1000.0 * RARE:g}): paint a disc or a frame around it, a ring, or more parts that "
                "differ, then decklander pad check; or set accept_false_pads = true"
            )

    @property
    def disc_radius_m(self) -> float:
        """Radius of the disc about the centre that holds all of the pad."""
        return self.markings.outer_radius_m

    def rgb(self, region: Region) -> Rgb:
        """Return the colour of a region, sRGB 0..255."""
        return dict(self.paints)[region.paint]

    def borders(self) -> tuple[F64, ...]:
        """Return the closed lines around all that is painted or lit, (N, 3) m each."""
        lines = [line for region in self.regions for line in borders_of(region)]
        lines += [np.array(lamp.at_m) + circle(lamp.radius_m, 12) for lamp in self.lamps]
        return tuple(np.pad(line, ((0, 0), (0, 1))) for line in lines)

    def circle(self, radius_m: float, n: int = 72) -> F64:
        """Return (n, 3) m: points of a circle about the centre, clockwise seen from above, starting at the arrow."""
        return np.pad(circle(radius_m, n), ((0, 0), (0, 1)))
