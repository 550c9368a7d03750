"""Set real recordings beside the simulator and OpenCV: `python -m benches.real [--part NAME] [--every N] [--write DIR]`.

The recordings are of others, are not committed, and lie in `../shared/data`; a part whose files are missing says so. Frames are
searched as `decklander detect` does it, each on its own. A find is sure from a confidence of 0.5, and right within 8 % of the
range and a quarter of the disc beside its place. OpenCV's own is what a user writes in thirty lines: the largest of nested
contours, with an ellipse fitted to it, or its marker detector with sub-pixel corners. The simulator's frames show the same pad at
the same ranges by the same camera, in drawn light. `--every 4` takes every fourth frame; `--write` leaves evidence.md.
"""

import csv
import itertools
import json
import math
import re
import tempfile
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benches.options import described, parsed
from companion.cli.main import main as decklander
from drivers.nmea.sentences import NmeaReader
from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64, Rotation, Transform
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.pad import Pad
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track
from tests.support.mocap_flight import FLYING_S, load, run, sightings
from tests.support.pad_scenes import DATA, load_camera, load_pad, pad_scene

U8 = NDArray[np.uint8]
STAMP = Stamp(MonoNs(0), MonoNs(0), 0.0, "sim")
DOWN = Transform(Rotation.from_rpy(0.0, 0.0, math.pi / 2), np.zeros(3))
BINS = (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 1.01)
SURE, RIGHT_RANGE, RIGHT_PLACE, RIGHT_SIZE = 0.5, 0.08, 0.25, 0.25
USERS = Path(__file__).parents[1] / "tests" / "pads_of_users"
SHIPPED = ("thesis", "printed", "icao", "helideck", "hospital", "faa_triangle", "apriltag_nest", "aruco_board")
MARKER_M = 0.18
PULLED_S = 34.0
"""Time from which something pulls the drone aside, seconds: accelerometer and motion capture agree on up to 9 degrees of roll,
while the drone's own attitude shows none."""
LETTERED = 0.005
"""Share of an octagon that is light. A chair's caster of 11 px has none, and was once the only one beside a pad that is cut."""
OCTAGON = Camera(640, 480, 597.05, 596.62, 306.02, 221.99, np.array([0.107, 0.0548, -0.00735, 0.00446, 1.309]), DOWN)
AGH = Camera(1280, 720, 900.0, 900.0, 639.5, 359.5, np.zeros(5), DOWN)
MBZIRC = Camera(640, 360, 560.0, 560.0, 319.5, 179.5, np.zeros(5), DOWN)
"""Nobody calibrated these two: their focal lengths are guesses, and ranges are judged by the ring's size in the image."""
CYCLES = Camera(640, 360, 374.67, 374.67, 319.5, 179.5, np.zeros(5), DOWN)


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    data: str
    frames: str
    ours: str
    opencv: str = "-"
    simulator: str = "-"

    def cells(self) -> tuple[str, ...]:
        return self.data, self.frames, self.ours, self.opencv, self.simulator


class MissingDataError(Exception):
    """A part's recordings are not on this machine."""


def needed(*parts: str) -> Path:
    path = DATA.joinpath(*parts)
    if not path.exists():
        raise MissingDataError(f"../shared/data/{'/'.join(parts)} is not on this machine")
    return path


def image(path: Path) -> U8:
    px = cv2.imread(str(path))
    assert px is not None, path
    return np.asarray(px, np.uint8)


class Looks:
    """Count finds in images that are each searched on their own, by what they say and whether they are right."""

    def __init__(self, real: bool = False) -> None:
        self.said: list[tuple[float, bool]] = []
        if real:
            ALL_LOOKS.append(self)
        self.frames = self.right = self.wrong = 0

    def add(self, found: Sighting | None, is_right: Callable[[Sighting], bool]) -> bool:
        """Count one image, and return whether its find is sure and right."""
        good = found is not None and is_right(found)
        if found is not None:
            self.said.append((found.confidence, good))
        sure = found is not None and found.confidence >= SURE
        self.frames, self.right, self.wrong = self.frames + 1, self.right + (sure and good), self.wrong + (sure and not good)
        return sure and good


ALL_LOOKS: list[Looks] = []
"""Counts of real images, in the order of the parts."""


def curve_of(looks: list[Looks]) -> str:
    """Return for each bin of confidence the mean of what was said, the share that is right, and how many there are."""
    bins = []
    for low, high in itertools.pairwise(BINS):
        own = [one for each in looks for one in each.said if low <= one[0] < high]
        if own:
            said, good = np.mean(own, axis=0)
            bins.append(f"{said:.2f}: {good:.2f} of {len(own)}")
    return ", ".join(bins) or "no find"


def seen(px: U8, camera: Camera, pad: Pad, attitude: Attitude | None = None) -> Sighting | None:
    """Return the find in an image on its own, at any confidence."""
    return track(TrackerConfig(camera, pad), TrackerMemory(), Frame(STAMP, 0, px), attitude)[0].selected


def by_contours(px: U8) -> tuple[F64, float] | None:
    """Return the centre (px) and the mean radius of the largest ellipse that holds another one about the same centre."""
    grey = cv2.GaussianBlur(cv2.cvtColor(px, cv2.COLOR_BGR2GRAY), (5, 5), 0)
    binary = [cv2.Canny(grey, 30, 90)]
    binary += [cv2.adaptiveThreshold(grey, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY, n, 5) for n in (51, 151)]
    fits: list[tuple[float, float, float]] = []
    for contour in (c for b in binary for c in cv2.findContours(b, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0] if len(c) >= 60):
        (u, v), axes, turn_deg = cv2.fitEllipse(contour)
        if min(axes) < 16 or max(axes) > min(1.8 * min(axes), 3 * len(px)):
            continue
        c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
        along = (contour[:, 0] - (u, v)) @ np.array([[c, -s], [s, c]]) / (0.5 * np.array(axes))
        if np.sqrt(np.mean((np.hypot(*along.T) - 1.0) ** 2)) < 0.03:
            fits.append((u, v, 0.25 * (axes[0] + axes[1])))
    nested = [
        (r, u, v) for u, v, r in fits if any(math.hypot(u - a, v - b) < 0.08 * r and 0.25 * r < q < 0.93 * r for a, b, q in fits)
    ]
    if not nested:
        return None
    r, u, v = max(nested)
    return np.array([u, v]), r


def percent(found: Sighting, range_m: float) -> float:
    """Return the error of a find's range in percent."""
    return 100.0 * (float(np.linalg.norm(found.d_body_pad_level)) / range_m - 1.0)


def has_range(found: Sighting, range_m: float) -> bool:
    return abs(percent(found, range_m)) < 100 * RIGHT_RANGE


def share(n: int, of: int) -> str:
    return f"{100 * n / max(1, of):.0f} %"


def spread(off: list[float]) -> str:
    return f"{np.median(np.abs(off)):.2f} / {np.percentile(np.abs(off), 95):.2f} %" if off else "-"


def photographs(every: int) -> list[Row]:
    """Show the thesis' printed pad indoors; the truth is labelled by hand, with an error of 0.4 to 1.8 % of the range."""
    folder, camera, pad = needed("pad_photos"), load_camera("photos"), load_pad("printed")
    with (folder / "pose.csv").open() as file:
        rows = list(csv.DictReader(file))[::every]
    looks, drawn_looks, off, theirs, their_off, simulated_off = Looks(real=True), Looks(), [], 0, [], list[float]()
    for k, row in enumerate(rows):
        t_cam = np.array([float(row[f"t_cam_{axis}_m"]) for axis in "xyz"])
        px, range_m = image(folder / "images" / row["frame"]), float(np.linalg.norm(t_cam))

        def is_right(found: Sighting, t_cam: F64 = t_cam, range_m: float = range_m) -> bool:
            outline = next(f.uv_px for f in found.features if f.label == "disc")
            aside_px = float(np.linalg.norm(np.nanmean(outline, axis=0) - camera.project(t_cam[None])[0]))
            near = aside_px < RIGHT_PLACE * camera.fx * pad.disc_radius_m / float(t_cam[2])
            return near and abs(percent(found, range_m)) < 100 * RIGHT_RANGE

        found = seen(px, camera, pad)
        off += [percent(found, range_m)] if looks.add(found, is_right) and found is not None else []
        by = by_contours(px)
        if by is not None:
            # It takes the ring's outer edge for the pad: the rim of the disc hardly shows.
            e = 100.0 * (camera.fx * pad.markings.ring_outer_m / by[1] / float(t_cam[2]) - 1.0)
            theirs += abs(e) < 100 * RIGHT_RANGE
            their_off += [e] if abs(e) < 100 * RIGHT_RANGE else []
        scene = pad_scene(np.random.default_rng([31, k]), camera, pad, float(t_cam[2]), "light", 0.2)
        assert scene.truth is not None
        drawn, true_m = seen(scene.px, camera, pad), scene.truth.range_m
        if drawn_looks.add(drawn, partial(has_range, range_m=true_m)) and drawn is not None:
            simulated_off.append(percent(drawn, true_m))
    n = len(rows)
    return [
        Row("photographs of the thesis' pad, .5 to 4 m", str(n),
            f"{share(looks.right, n)} right, {looks.wrong} wrong; {spread(off)}",
            f"{share(theirs, n)}; {spread(their_off)}", f"{share(drawn_looks.right, n)}; {spread(simulated_off)}"),
    ]  # fmt: skip


def imported(drawing: Path, *words: str) -> Pad | None:
    """Return the pad that `decklander pad import` makes of a drawing or a photograph; None where it makes none."""
    with tempfile.TemporaryDirectory() as made:
        out = Path(made) / "pad.toml"
        try:
            code = decklander(["pad", "import", str(drawing), *words, "--out", str(out)])
        except SystemExit:
            code = 2
        return Pad.from_mapping(tomllib.loads(out.read_text()), drawing.stem) if code == 0 else None


def outline_of(found: Sighting) -> tuple[F64, float]:
    """Return the middle of a find's outline in the image and the radius of a circle of its area, px."""
    lines = {f.label: f.uv_px for f in found.features if len(f.uv_px) > 2}
    return shape_of(lines["ring"] if "ring" in lines else np.concatenate(list(lines.values())))


def shape_of(line: F64) -> tuple[F64, float]:
    hull = cv2.convexHull(line.astype(np.float32)).reshape(-1, 2)
    m = cv2.moments(hull)
    return np.array([m["m10"], m["m01"]]) / max(m["m00"], 1e-9), math.sqrt(max(m["m00"], 1e-9) / math.pi)


def lies_at(found: Sighting, centre: F64, radius: float) -> bool:
    """Return whether a find's outline has this place and size in the image."""
    place, size = outline_of(found)
    return float(np.linalg.norm(place - centre)) < RIGHT_PLACE * radius and abs(size / radius - 1.0) < RIGHT_SIZE


def lies_at_any(found: Sighting, shapes: list[tuple[F64, float]]) -> bool:
    return any(lies_at(found, *shape) for shape in shapes)


def agh(every: int) -> list[Row]:
    """Show a pad of rings and panels on grass; the camera is not calibrated, so only place and size in the image count.

    In six images the ellipse of the truth lies about the white sheet (set 1 gives 151 px for one of 496): OpenCV's own find of
    the ring, a third as large about the same place, judges there.
    """
    folder = needed("real_pads", "agh")
    pad = imported(folder / "landing_pad_marker.svg", "--size-mm", "420")
    if pad is None:
        return [Row("drone photographs of a user's pad (AGH)", "37", "not tried: no pad file can be made of its drawing")]
    with (folder / "truth.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["ring_cx_px"]][::every]
    looks, theirs, off = Looks(real=True), 0, []
    for row in rows:
        px = image(folder / "images" / row["image"])
        centre = np.array([float(row["ring_cx_px"]), float(row["ring_cy_px"])])
        radius = 0.25 * (float(row["ring_axis_1_px"]) + float(row["ring_axis_2_px"]))
        found, by = seen(px, AGH, pad), by_contours(px)
        if by is not None and by[1] < 0.5 * radius:
            centre, radius = by
        if looks.add(found, partial(lies_at, centre=centre, radius=radius)) and found is not None:
            off.append(100.0 * (outline_of(found)[1] / radius - 1.0))
        theirs += by is not None and bool(np.linalg.norm(by[0] - centre) < RIGHT_PLACE * radius)
    n = len(rows)
    return [
        Row("drone photographs of a user's pad (AGH), grass", str(n),
            f"{share(looks.right, n)} at their place, {looks.wrong} sure and wrong; size in the image {spread(off)}",
            share(theirs, n)),
    ]  # fmt: skip


def octagons(px: U8) -> list[tuple[F64, float]]:
    """Return the centres and radii, px, of dark shapes with eight sides and lettering: what a user writes for such a pad."""
    grey = cv2.GaussianBlur(cv2.cvtColor(px, cv2.COLOR_BGR2GRAY), (5, 5), 0)
    out = []
    for block in (51, 151, 301):
        binary = cv2.adaptiveThreshold(grey, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, block, 15)
        for contour in cv2.findContours(binary, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
            hull = cv2.convexHull(contour)
            area, sides = cv2.contourArea(hull), cv2.approxPolyDP(hull, 0.02 * cv2.arcLength(hull, True), True)
            if area > 300.0 and len(sides) == 8 and cv2.contourArea(contour) > 0.9 * area:
                inside = cv2.fillPoly(np.zeros_like(binary), [contour], 1) > 0
                if np.mean(binary[inside] == 0) > LETTERED:
                    out.append(shape_of(np.asarray(hull.reshape(-1, 2), float)))
    return out


def octagon(every: int) -> list[Row]:
    """Show a printed octagon whose pad file is made of one photograph, on floors, on a table, and with a finger over the lens.

    The others are judged by dark shapes with eight sides; images without one do not count.
    """
    folder = needed("real_pads", "octagon")
    first = folder / "images" / "samples_img_110.jpg"
    words = ("--sheet", "--corners", "184,97 357,118 371,350 144,338", "--size-mm", "210x297", "--paints", "2")
    pad = imported(first, *words)
    if pad is None:
        return [Row("photographs of a user's octagon", "294", "not tried: no pad file can be made of its photograph")]
    looks, off = Looks(real=True), []
    files = [
        path for path in [*sorted((folder / "images").glob("*.jpg")), *sorted((folder / "aruco").glob("*.jpg"))] if path != first
    ]
    files = files[::every]
    for path in files:
        px = image(path)
        shapes = octagons(px)
        if not shapes:
            continue
        h, w = px.shape[:2]
        camera = OCTAGON if h == OCTAGON.height else Camera(w, h, 0.8 * w, 0.8 * w, (w - 1) / 2, (h - 1) / 2, np.zeros(5), DOWN)
        found = seen(px, camera, pad)
        if looks.add(found, partial(lies_at_any, shapes=shapes)) and found is not None:
            size = outline_of(found)[1]
            off.append(min((100.0 * (size / radius - 1.0) for _, radius in shapes), key=abs))
    return [
        Row("a user's octagon, its pad file made of one photograph", str(looks.frames),
            f"{share(looks.right, looks.frames)} at their place, {looks.wrong} sure and wrong; size in the image {spread(off)}",
            f"judges: an octagon in {looks.frames} of {len(files)}"),
    ]  # fmt: skip


def strange(every: int) -> list[Row]:
    """Frames without any pad of ours: sure finds of every shipped pad, and of twenty pads as users draw them."""
    files = [*sorted(needed("not_pads").glob("*.jpg")), *sorted(needed("sea").glob("*.jpg"))]
    octagons = sorted(needed("real_pads", "octagon", "images").glob("*.jpg"))[::every]
    users = {file.stem: Pad.from_mapping(tomllib.loads(file.read_text()), file.stem) for file in sorted(USERS.glob("*.toml"))}
    out = []
    for title, pads, shown in (
        (f"{len(SHIPPED)} shipped pads", {name: load_pad(name) for name in SHIPPED}, [*files[::every], *octagons]),
        (f"{len(users)} users' pads, no octagons", users, files[::every]),
    ):
        false, looks = dict[str, int](), Looks(real=True)
        for path in shown:
            whole = image(path)
            size = 640, round(640 * whole.shape[0] / whole.shape[1])
            px = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.uint8)
            camera = Camera(640, len(px), 512.0, 512.0, 319.5, (len(px) - 1) / 2, np.zeros(5), DOWN)
            for name, pad in pads.items():
                before = looks.wrong
                looks.add(seen(px, camera, pad), lambda found: False)
                if looks.wrong > before:
                    false[name] = false.get(name, 0) + 1
        named = ", ".join(f"{name} {n}" for name, n in false.items()) or "none"
        out.append(Row(f"sea, grass, other pads, rooms; {title} each", str(len(shown)), f"sure of {looks.frames} looks: {named}"))
    return out


@lru_cache
def marker() -> Pad:
    region = {
        "shape": "fiducial",
        "dictionary": "DICT_6X6_250",
        "id": 0,
        "paint": "black",
        "size_m": MARKER_M,
        "at_m": [0.0, 0.0],
    }
    panel = {"shape": "panel", "paint": "white", "length_m": 0.23, "width_m": 0.23}
    paints = {"white": [245, 245, 245], "black": [20, 20, 20]}
    return Pad.from_mapping({"name": "marker", "paints": paints, "regions": [panel, region]}, "marker")


def aruco(every: int) -> list[Row]:
    """Show a marker of 18 cm beside a pad, a finger over a part of the lens; truth is OpenCV's, so only differences count."""
    folder = needed("real_pads", "octagon")
    with (folder / "attitude.csv").open() as file:
        tilts = {row["image"]: (float(row["roll_deg"]), float(row["pitch_deg"])) for row in csv.DictReader(file)}
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250), parameters)
    files = sorted((folder / "aruco").glob("*.jpg"))[::every]
    both, ours, theirs, off = 0, 0, 0, []
    h = MARKER_M / 2
    square = np.array([(-h, h, 0), (h, h, 0), (h, -h, 0), (-h, -h, 0)])
    for path in files:
        px = image(path)
        corners, ids, _ = detector.detectMarkers(cv2.cvtColor(px, cv2.COLOR_BGR2GRAY))
        read = ids is not None and 0 in ids
        roll, pitch = (math.radians(a) for a in tilts[f"aruco/{path.name}"])
        attitude = Attitude(STAMP, Rotation.from_rpy(roll, pitch, 0.0), np.eye(3) * math.radians(1.0) ** 2)
        found = seen(px, OCTAGON, marker(), attitude)
        found = found if found is not None and found.confidence >= SURE else None
        ours, theirs, both = ours + (found is not None), theirs + read, both + (found is not None and read)
        if read and found is not None:
            at = int(np.flatnonzero(np.ravel(ids) == 0)[0])
            flags = cv2.SOLVEPNP_IPPE_SQUARE
            _, _, t = cv2.solvePnP(square, corners[at][0].astype(float), OCTAGON.K, OCTAGON.distortion, flags=flags)
            off.append(100.0 * (float(np.linalg.norm(found.d_body_pad_level)) / float(np.linalg.norm(t)) - 1.0))
    n = len(files)
    return [
        Row("ArUco marker with attitude, blur, a finger", str(n),
            f"{share(ours, n)}, {ours - both} that OpenCV misses; range by OpenCV's {np.mean(off):+.2f} +- {np.std(off):.2f} %",
            share(theirs, n)),
    ]  # fmt: skip


def mbzirc(every: int) -> list[Row]:
    """Show another user's ring with an X to a search without attitude, by how aslant the labelled ellipse is.

    Frames whose label is left open do not count, nor do rings that the frame's edge cuts. Nobody measured ranges here.
    """
    folder = needed("real_pads", "mbzirc")
    pad = Pad.from_mapping(tomllib.loads((folder / "pad.toml").read_text()), "mbzirc")
    empty, labels = Looks(real=True), sorted(folder.glob("*/ground_truth.txt"))
    lines = [(file.parent, line.split("\t")) for file in labels for line in file.read_text().splitlines()]
    by: dict[str, Finds] = {f"below {most} deg": Finds() for most in (30, 50, 90)}
    for path, numbers in [(at / words[0], words[1:]) for at, words in lines if (at / words[0]).exists()][::every]:
        has, u, v, wide, high, _ = map(float, numbers)
        whole = 0.5 * high < u < MBZIRC.width - 0.5 * high and 0.5 * high < v < MBZIRC.height - 0.5 * high
        if has == 0.0:
            empty.add(seen(image(path), MBZIRC, pad), lambda found: False)
        elif has > 0.0 and u > 0.0 and whole:
            tilt_deg = math.degrees(math.acos(min(wide, high) / max(wide, high)))
            radius, found = 0.5 * math.sqrt(wide * high), seen(image(path), MBZIRC, pad)
            right = found is not None and lies_at(found, np.array([u, v]), radius)
            off = 100.0 * (outline_of(found)[1] / radius - 1.0) if found is not None and right else math.nan
            by[next(name for name in by if tilt_deg < float(name.split()[1]))].add(found, right, off)
    title = "a user's ring with an X (MBZIRC), aslant"
    rows = [Row(f"{title}: {name}", str(of.looks.frames), of.said("size in the image")) for name, of in by.items()]
    return [*rows, Row(f"{title}: without a pad", str(empty.frames), f"{empty.wrong} sure")]


class Finds:
    """Finds in one bin: how many are right, their errors, and these in their own covariance where that is known."""

    def __init__(self) -> None:
        self.looks, self.off, self.nees = Looks(), list[float](), list[F64]()

    def add(self, found: Sighting | None, right: bool, off: float, *nees: F64) -> None:
        if self.looks.add(found, lambda _: right):
            self.off.append(off)
            self.nees += nees

    def said(self, what: str) -> str:
        n, nees = self.looks, np.mean(self.nees, axis=0).tolist() if self.nees else ()
        end = "; NEES {:.1f}, {:.1f}".format(*nees) if nees else ""
        return f"{n.right} right, {n.frames - n.right - n.wrong} missed, {n.wrong} wrong; {what} {spread(self.off)}{end}"


def nees_of(found: Sighting, d: F64) -> F64:
    """Return the squared errors along the way to the pad and across it in their covariances, (2,)."""
    axes, e = np.linalg.svd(d[None])[2], found.d_body_pad_level - d
    parts = [(axis @ e, axis @ found.cov[:3, :3] @ axis.T) for axis in (axes[:1], axes[1:])]
    return np.array([float(off @ np.linalg.solve(cov, off)) for off, cov in parts])


def cycles(every: int) -> list[Row]:
    """Show path-traced decks by height; the truth is exact, and so the covariance can be judged.

    The attitude that is given is off by as much as it says: .3 degrees of roll and pitch, drawn for each frame.
    """
    folder, out = needed("cycles"), []
    for name, pad in (("thesis", load_pad("thesis")), ("logo", imported(folder / "logo" / "logo.svg"))):
        by, looks = {"all": Finds()}, Looks(real=True)
        for k, line in enumerate((folder / name / "truth.jsonl").read_text().splitlines()[::every]):
            true = json.loads(line)
            d, off = np.array(true["d"]), np.random.default_rng([67, k]).normal(0.0, 0.3, 2)
            tilts = (math.radians(true["roll_deg"] + off[0]), math.radians(true["pitch_deg"] + off[1]))
            at = Attitude(STAMP, Rotation.from_rpy(*tilts, 0.0), np.eye(3) * math.radians(0.3) ** 2)
            found = None if pad is None else seen(image(folder / name / true["source"]), CYCLES, pad, at)
            range_m = float(np.linalg.norm(d))
            right = looks.add(found, partial(has_range, range_m=range_m))
            height = next(h for h in (1, 3, 6, 20) if true["h"] < h)
            errors = (math.nan,) if found is None else (percent(found, range_m), nees_of(found, d))
            for of in ("all", f"below {height} m"):
                by.setdefault(of, Finds()).add(found, right, *errors)
        title = f"path-traced decks, {name}"
        out += [Row(f"{title}: {of}", str(finds.looks.frames), finds.said("range")) for of, finds in sorted(by.items())]
    return out


def boats(every: int) -> list[Row]:
    """Boats at sea by RTK: what the service's own reader makes of their sentences."""
    files = sorted(needed("sea_motion").glob("2*.txt"))[::every]
    lines, read = 0, 0
    for path in files:
        reader = NmeaReader()
        for k, line in enumerate(path.read_text().splitlines()):
            whole = line.startswith("$") and "*" in line
            lines += whole
            read += whole and bool(reader.samples((line + "\r\n").encode(), MonoNs(k * 50_000_000)))
    return [Row("boats at sea, RTK 5 Hz", f"{len(files)} runs", f"{share(read, lines)} of {lines} sentences give samples")]


def mocap(_: int) -> list[Row]:
    """Replay a real AR.Drone flight with motion capture; sightings are synthesised from it and levelled by the own attitude."""
    flight, cells = load(needed("flight_with_mocap")), []
    t, e, nees = run(flight, sightings(flight, 10.0, []), FLYING_S[1])
    for title, part in (("undisturbed", (t > 18.0) & (t < PULLED_S)), ("pulled", t > PULLED_S)):
        rms = 100.0 * np.sqrt(np.nanmean(e[part] ** 2, axis=0))
        cells.append(f"{title} {rms[0]:.1f}, {rms[1]:.1f}, {rms[2]:.1f} cm (NEES {np.nanmean(nees[part]):.1f}, 3 is right)")
    return [Row("AR.Drone 2.0 with motion capture, filter's error forward, right, down", "31 s", "; ".join(cells))]


PARTS: dict[str, Callable[[int], list[Row]]] = {
    "photographs": photographs, "agh": agh, "octagon": octagon, "strange": strange,
    "aruco": aruco, "mbzirc": mbzirc, "cycles": cycles, "boats": boats, "mocap": mocap,
}  # fmt: skip
HEADER = Row("data", "frames", "ours", "OpenCV's own", "the simulator's")
SAID = (
    "NEES is of the range (1 is right) and the bearing (2), a mean of few. The logo's imported file is wrong: its middle lies "
    "28 mm off, and one find of five is 4 % short. Frames aslant that no limit saw: [search](decisions/search.md)."
)
SOURCES = (
    ("photographs of the thesis' pad", "mfalang/autodrone", "cb267b19", "none stated"),
    ("drone photographs (AGH)", "vision-agh/drone_landing_static", "529ab0d", "none stated"),
    ("octagon, ArUco marker", "thinhhoang95/helipad-yolo", "d6a5cd4", "GPL-3.0"),
    ("ring with an X (MBZIRC 2017)", "castacks/mbzirc_dataset", "2d985d74", "BSD-3-Clause"),
    ("sea, shore, boats", "simenallum/msc_thesis", "", "none stated; of several authors"),
    ("grass, tags, other pads", "dukelin95/Drone-Landing", "", "none stated"),
    ("the same", "luisgaboardi/Drone-Landing-Classifier", "", "none stated"),
    ("the same", "venthur/python-ardrone", "", "MIT"),
    ("the same", "acbchiella/Helipad", "", "none stated"),
    ("boats at sea, RTK", "chongfengliu/Ocean-Disturbance-Data", "18e7211", "none stated"),
    ("AR.Drone 2.0 with motion capture", "tud-cor/ardrone2_dem_filter", "", "Apache-2.0"),
)
"""Each recording with the repository of its author on GitHub, the commit where it is noted, and the licence."""


def sources() -> list[str]:
    """Return the table of where each recording comes from."""
    head = ["| recording | author and repository on GitHub | commit | licence |", "|---|---|---|---|"]
    rows = (
        f"| {what} | [{of}](https://github.com/{of}) | {commit or 'not noted'} | {terms} |" for what, of, commit, terms in SOURCES
    )
    made = "The path-traced decks were rendered for this by Blender's Cycles."
    return [*head, *rows, "", f"{made} Where no licence is stated, ask the author before you use it."]


NOT_AVAILABLE = (
    "landings of ours on a real deck, or with any real autopilot in the air",
    "a real frame of a thermal, near-infrared or fisheye camera",
    "pictures of a lit pad at night", "an AR.Drone's video of a pad with its navdata", "flights with a Vicon truth of the pad",
)  # fmt: skip


def table(rows: list[Row]) -> list[str]:
    lines = ["| " + " | ".join(HEADER.cells()) + " |", "|" + "---|" * len(HEADER.cells())]
    return [*lines, *("| " + " | ".join(row.cells()) + " |" for row in rows)]


def write_part(page: Path, text: str) -> None:
    """Put a text in the place of a page's part with its heading (the first part has any), or at the end."""
    first, *rest = re.split(r"^(?=##+ )", page.read_text(encoding="utf-8") if page.exists() else "", flags=re.MULTILINE)
    parts = {part.partition("\n")[0]: part for part in (first, *rest)}
    heading = text.partition("\n")[0]
    parts[heading if heading.startswith("## ") else next(iter(parts))] = text
    page.write_text("\n\n".join(part.strip() for part in parts.values()) + "\n", encoding="utf-8")


def main() -> None:
    parser = described(__doc__)
    parser.add_argument("--part", action="append", choices=PARTS, help="only this one; may be repeated")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="every Nth frame (default: all)")
    parser.add_argument("--write", type=Path, metavar="DIR", help="write evidence.md there")
    args = parsed(parser, "--every 400 --part photographs --part aruco --part mbzirc")
    cv2.setNumThreads(1)
    rows: list[Row] = []
    for name in args.part or PARTS:
        try:
            made = PARTS[name](args.every)
        except MissingDataError as why:
            made = [Row(name, "0", f"skipped: {why}")]
        rows += made
        for row in made:
            print(" | ".join(row.cells()), flush=True)
    curve = Row(
        "confidence of all finds above: said, right", str(sum(len(looks.said) for looks in ALL_LOOKS)), curve_of(ALL_LOOKS)
    )
    rows.append(curve)
    print(" | ".join(curve.cells()), flush=True)
    if args.write is not None:
        of = f" --every {args.every}" if args.every > 1 else ""
        lines = [
            "# Evidence: real recordings", "",
            f"Made by `python -m benches.real{of} --write docs`. The recordings are others' and not part of this repository;",
            "their sources stand below.",
            "Errors are of the range, median / 95th percentile.", "", *table(rows), "",
            SAID, "", *sources(), "",
            "What was not available, so nothing here speaks of it:", "", *(f"- {what}" for what in NOT_AVAILABLE), "",
            "The same on rendered frames, by height: [benchmarks.md](benchmarks.md); limits: [limits.md](limits.md).", "",
        ]  # fmt: skip
        args.write.mkdir(parents=True, exist_ok=True)
        write_part(args.write / "evidence.md", "\n".join(lines))


if __name__ == "__main__":
    main()
