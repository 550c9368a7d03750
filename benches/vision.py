"""Compare our methods with marker detectors on the same poses, noise and size, by height, and ours with the Cramer-Rao bound.

    python -m benches.vision --frames 40 --write docs

One thread, 640x360, f = 374.67 px, the renderer's sensor noise and blur, an even grey floor, 1.5 degrees of tilt that is known.
The markers' black squares are inscribed in the pad's disc (552 mm), with a white margin of one cell outside it. Figures are of
the vector from camera to pad, written with the true attitude; lateral is the root mean square of the two horizontal axes'
standard deviations, the camera being up to a tenth of its height aside, so that a range error shows there by a tenth. Times are
processor time, medians, and as ratios to a floor measured in the same run: one BGR to HSV conversion and one inRange of the whole
frame; the thesis' three share one time. A frame counts as found when the error is below a tenth of the height. An H alone
leaves its heading open by half a turn, which is not counted as error. A method without a row finds nothing at that height.

The last table is README's, of the same run: ArUco, AprilTag, the thesis' methods and our whole look side by side by the median
distance between the measured and the true place, where the first table has standard deviations and the bias apart, and the time;
below nine finds in ten frames it says how many. The thesis' cell has its best method's.
"""

import math
import os
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import cv2  # noqa: E402
import numpy as np  # noqa: E402
from numpy.typing import NDArray  # noqa: E402
from pupil_apriltags import Detector  # noqa: E402

from benches.options import described, parsed  # noqa: E402
from benches.search import floor_ms  # noqa: E402
from estimator.contracts.estimates import Method, Sighting  # noqa: E402
from estimator.contracts.geometry import F64, Rotation, wrap_pi  # noqa: E402
from estimator.contracts.samples import Attitude, Frame  # noqa: E402
from estimator.vision.camera.camera import Camera  # noqa: E402
from estimator.vision.camera.pose import PadPose  # noqa: E402
from estimator.vision.options import TrackerOptions  # noqa: E402
from estimator.vision.register.registration import RegistrationOptions, register  # noqa: E402
from estimator.vision.srgb import LINEAR_LIGHT  # noqa: E402
from estimator.vision.thesis.detection import detect  # noqa: E402
from estimator.vision.thesis.segmentation import COLOUR_SETS  # noqa: E402
from estimator.vision.track.config import TrackerConfig  # noqa: E402
from estimator.vision.track.memory import TrackerMemory  # noqa: E402
from estimator.vision.track.tracker import track  # noqa: E402
from sitl.camera.camera import Exposure  # noqa: E402
from sitl.camera.light import Sensor  # noqa: E402
from tests.support.bound import information, sigmas  # noqa: E402
from tests.support.pad_images import STAMP  # noqa: E402
from tests.support.pad_scenes import acquire  # noqa: E402
from tests.support.pad_views import PLAIN, RenderedView, Stage  # noqa: E402
from tests.support.plain_light import FLAT  # noqa: E402
from tests.support.shipped import shipped_camera, shipped_pad  # noqa: E402

U8 = NDArray[np.uint8]
Place = tuple[F64, float | None, bool] | None
"""The vector from the lens to the pad in `level`, the heading, and whether half a turn is left open; None if not found."""
HEIGHTS_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0)
FINE = 6
"""Subsamples along a pixel's side for the markers' frames."""
OTHERS = "## Other benches"
"""Heading of the page's rest, which is left as it is."""
FLOOR_LIGHT, WHITE_LIGHT, BLACK_LIGHT = 0.16, 0.8, 0.02
_CLOSE = RegistrationOptions(coarse=False)
SIGMA_DECK_RAD = 1e-5
"""The deck is level, and every method knows it."""
THESIS: tuple[Method, ...] = ("ellipse", "arrow", "corners")
ARUCO, APRILTAG, LOOK = "ArUco, sub-pixel", "AprilTag", "whole look, searched"
COLUMNS = {"ArUco (OpenCV, sub-pixel)": (ARUCO,), "AprilTag": (APRILTAG,), "the thesis' methods": THESIS, "Decklander": (LOOK,)}
_TAGS = Detector(families="tag36h11", nthreads=1, quad_decimate=1.0)
"""The detector of the whole run; it is never destroyed, because its destructor corrupts the heap."""


@dataclass
class Tally:
    """Errors of one method at one height."""

    tried: int = 0
    d_m: list[F64] = field(default_factory=list)
    yaw_rad: list[float] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)

    def add(self, found: Place, view: RenderedView, ms: float) -> None:
        self.tried += 1
        self.ms.append(ms)
        if found is None:
            return
        d, yaw, either_way = found
        off = d - truth(view)
        if np.linalg.norm(off) > 0.1 * view.pose.range_m + 0.02:
            return
        self.d_m.append(off)
        if yaw is not None:
            turned = wrap_pi(yaw - view.yaw_rad)
            self.yaw_rad.append(math.remainder(turned, math.pi) if either_way else turned)

    def row(self, floor_ms: float) -> list[str]:
        """Return the cells: found, lateral std, range std, range bias (mm), heading std (deg), ms, ratio."""
        n = len(self.d_m)
        share = f"{100 * n / max(1, self.tried):.0f} %"
        took = float(np.median(self.ms)) if self.ms else math.nan
        if n < 3:
            return [share, "", "", "", "", f"{took:.1f}", f"{took / floor_ms:.0f}"]
        d = 1e3 * np.array(self.d_m)
        std, mean = d.std(axis=0), d.mean(axis=0)
        lateral = math.sqrt(0.5 * (std[0] ** 2 + std[1] ** 2))
        yaw = f"{math.degrees(float(np.std(self.yaw_rad))):.3f}" if len(self.yaw_rad) > 2 else ""
        return [share, *(f"{x:.3g}" for x in (lateral, std[2], mean[2])), yaw, f"{took:.1f}", f"{took / floor_ms:.0f}"]


def R_level_cam(view: RenderedView, camera: Camera) -> Rotation:
    return Rotation.from_rpy(view.roll_rad, view.pitch_rad, 0.0) @ camera.T_body_cam.R


def truth(view: RenderedView) -> F64:
    """Return the vector from the lens to the pad in `level`, (3,) m, without the mount, which is the same for all."""
    return in_level(view, shipped_camera("sim"), view.pose.t_cam_pad)


def in_level(view: RenderedView, camera: Camera, t_cam: F64) -> F64:
    return np.asarray(R_level_cam(view, camera) @ t_cam)


def of_pose(view: RenderedView, camera: Camera, pose: PadPose) -> tuple[F64, float]:
    arrow = (R_level_cam(view, camera) @ pose.R_cam_pad).matrix[:, 0]
    return in_level(view, camera, pose.t_cam_pad), -math.atan2(arrow[1], arrow[0])


class MarkerScene:
    """Frames of a square marker where the pad would be."""

    def __init__(self, cells: NDArray[np.uint8], side_m: float, camera: Camera, sensor: Sensor, seed: int) -> None:
        self.side_m = side_m
        n = cells.shape[0]
        sheet = np.full((n + 2, n + 2), WHITE_LIGHT, np.float32)
        sheet[1:-1, 1:-1] = np.where(cells > 127, WHITE_LIGHT, BLACK_LIGHT)
        self._sheet: NDArray[np.float32] = np.asarray(np.kron(sheet, np.ones((32, 32), np.float32)), np.float32)
        self._half_m = 0.5 * side_m * (n + 2) / n
        self._camera, self._sensor = camera, sensor
        self._rng = np.random.default_rng(seed)

    def image(self, pose: PadPose) -> U8:
        """Return the image, (H, W, 3), with the marker's top edge toward the arrow."""
        h = self._half_m
        corners = np.array([(h, -h, 0.0), (h, h, 0.0), (-h, h, 0.0), (-h, -h, 0.0)])
        uv = self._camera.project(pose.points(corners))
        size = self._sheet.shape[0]
        # Pixel centres are whole numbers: the outer edges of the first and last texel lie half a texel out.
        sheet = np.array([(-0.5, -0.5), (size - 0.5, -0.5), (size - 0.5, size - 0.5), (-0.5, size - 0.5)])
        fine = (uv + 0.5) * FINE - 0.5
        M = cv2.getPerspectiveTransform(sheet.astype(np.float32), fine.astype(np.float32))
        wide = (self._camera.width * FINE, self._camera.height * FINE)
        light = np.full(wide[::-1], FLOOR_LIGHT, np.float32)
        texel_px = float(np.linalg.norm(fine[1] - fine[0])) / size
        blurred: NDArray[Any] = cv2.GaussianBlur(self._sheet, (0, 0), 0.35 / texel_px) if texel_px < 0.5 else self._sheet
        cv2.warpPerspective(blurred, M, wide, light, cv2.INTER_LINEAR, cv2.BORDER_TRANSPARENT)
        light = cv2.resize(light, (self._camera.width, self._camera.height), interpolation=cv2.INTER_AREA)
        light = cv2.GaussianBlur(light, (0, 0), self._sensor.psf_sigma_px)
        sigma = np.sqrt(light / self._sensor.full_well_e + (self._sensor.read_noise_e / self._sensor.full_well_e) ** 2)
        bgr = light[..., None] + sigma[..., None] * self._rng.standard_normal((*light.shape, 3)).astype(np.float32)
        bgr = np.clip(bgr, 0.0, 1.0)
        coded = np.where(bgr <= 0.0031308, 12.92 * bgr, 1.055 * bgr ** (1 / 2.4) - 0.055)
        return np.asarray(np.round(255 * coded), np.uint8)


def pnp(uv: F64, side_m: float, view: RenderedView, camera: Camera) -> Place:
    """Solve the pose from the four corners, clockwise from the corner at the arrow's port side."""
    h = side_m / 2
    square = np.array([(-h, h, 0), (h, h, 0), (h, -h, 0), (-h, -h, 0)])
    _, rvec, tvec = cv2.solvePnP(square, uv.astype(float), camera.K, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    R = cv2.Rodrigues(rvec)[0]
    up = R_level_cam(view, camera).matrix @ R[:, 1]
    return in_level(view, camera, np.asarray(tvec[:, 0], float)), -math.atan2(up[1], up[0]), False


def bound(stage: Stage, height_m: float) -> F64:
    """Return the least standard deviations with the camera over the centre: (4,) x, y, range in m and heading in rad."""
    h, mount, sensor = height_m, stage.camera.T_body_cam, stage.sensor
    renderer = stage.renderer
    p_pad = np.array([0.0, 0.0, -2.0])

    def light(delta: F64) -> F64:
        R = Rotation.from_rpy(0.0, 0.0, 0.4)
        R_ned_pad = Rotation.from_rpy(0.0, 0.0, float(delta[3]))
        at = p_pad + np.array([0.0, 0.0, -1.0]) * h - R.matrix @ mount.t
        shot = Exposure(0.0, R, at, R_ned_pad, p_pad + delta[:3])
        return renderer.radiance(shot).astype(float)

    step_m = 0.05 * h / stage.camera.fx
    steps = [step_m, step_m, step_m * max(1.0, h / stage.pad.disc_radius_m), step_m / stage.pad.disc_radius_m]
    moves = np.diag(steps)
    mean = light(np.zeros(4))
    table = LINEAR_LIGHT
    code = np.searchsorted(table, np.clip(mean, 0.0, 1.0)).clip(1, 255)
    rounding = (table[code] - table[code - 1]) ** 2 / 12.0
    # The floor moves with the pad but is no part of it.
    view = stage.view(h, tilt_rad=0.0, lateral=0.0, yaw_rad=0.4)
    rim = camera_mask(stage, view.pose, 1.0 + 4.0 * h / stage.camera.fx / stage.pad.disc_radius_m)
    var = np.maximum(mean, 0.0) / sensor.full_well_e + (sensor.read_noise_e / sensor.full_well_e) ** 2 + rounding
    before, after = [light(-m)[rim] for m in moves], [light(m)[rim] for m in moves]
    return sigmas(information(before, after, steps, var[rim]))


def camera_mask(stage: Stage, pose: PadPose, times: float) -> np.ndarray:
    """Return (H, W) whether a pixel sees a point within this many times the disc's radius."""
    mask = np.zeros((stage.camera.height, stage.camera.width), np.uint8)
    uv = stage.camera.project(pose.points(stage.pad.circle(times * stage.pad.disc_radius_m, 180)))
    cv2.fillPoly(mask, [np.round(uv).astype(np.int32)], 1)
    return mask.astype(bool)


class Peers:
    """The pad and the markers in its place under one camera, and the methods that look for them."""

    def __init__(self, seed: int) -> None:
        camera, pad, sensor = shipped_camera("sim"), shipped_pad("thesis"), Sensor(exposure_s=0.0)
        self.stage = Stage(camera, pad, PLAIN, FLAT, sensor, seed)
        self._side_m = pad.disc_radius_m * math.sqrt(2)
        codes, tags = map(cv2.aruco.getPredefinedDictionary, (cv2.aruco.DICT_5X5_50, cv2.aruco.DICT_APRILTAG_36h11))
        self._markers = [
            MarkerScene(np.asarray(cv2.aruco.generateImageMarker(of, 7, cells), np.uint8), self._side_m, camera, sensor, its_seed)
            for of, cells, its_seed in ((codes, 7, seed), (tags, 8, seed + 1))
        ]
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        self._aruco = cv2.aruco.ArucoDetector(codes, parameters)
        self._look = TrackerConfig(camera, pad, TrackerOptions(deck_tilt_sigma_deg=math.degrees(SIGMA_DECK_RAD)))

    def looks(self, view: RenderedView) -> dict[tuple[str, ...], Callable[[], list[Place]]]:
        """Return what looks at a view, by the names of the methods that it finds a place by."""
        camera, pad, px, orientation = self.stage.camera, self.stage.pad, view.px, view.orientation()
        level = Rotation.from_rpy(view.roll_rad, view.pitch_rad, 0.0)
        frame, attitude = Frame(STAMP, 0, px), Attitude(STAMP, level, 1e-8 * np.eye(3))
        start, mount = self.stage.start(view, 0.5), level @ camera.T_body_cam.t
        square, tag = (cv2.cvtColor(scene.image(view.pose), cv2.COLOR_BGR2GRAY) for scene in self._markers)

        def seen(s: Sighting | None) -> Place:
            return None if s is None else (s.d_body_pad_level - mount, s.yaw_rad, s.yaw_ambiguous)

        def by_thesis() -> list[Place]:
            found = detect(frame, attitude, camera, pad, COLOUR_SETS["simulator"], sigma_deck_rad=SIGMA_DECK_RAD)
            return [seen(found.methods[name]) for name in THESIS]

        def registered(first: PadPose) -> list[Place]:
            found = register(px, camera, pad, first, orientation, _CLOSE)
            return [None if found is None else (*of_pose(view, camera, found.pose), found.yaw_ambiguous)]

        def searched() -> list[Place]:
            candidates = acquire(px, camera, pad, level)
            return registered(candidates[0].pose) if candidates else [None]

        def by_aruco() -> list[Place]:
            corners, ids, _ = self._aruco.detectMarkers(square)
            return [None if ids is None else pnp(corners[0][0], self._side_m, view, camera)]

        def by_apriltag() -> list[Place]:
            # Its corners begin at the lower left and its pixel (0.5, 0.5) is the first one's centre.
            places = [np.roll(found.corners[::-1], 2, axis=0) - 0.5 for found in _TAGS.detect(tag)]
            return [pnp(places[0], self._side_m, view, camera) if places else None]

        return {
            THESIS: by_thesis, ("registration, tracked",): lambda: registered(start), ("registration, searched",): searched,
            (LOOK,): lambda: [seen(track(self._look, TrackerMemory(), frame, attitude)[0].selected)],
            (ARUCO,): by_aruco, (APRILTAG,): by_apriltag,
        }  # fmt: skip


def at_height(height_m: float, frames: int, seed: int) -> tuple[dict[str, Tally], float, F64]:
    """Return the tallies by method, the floor in ms, and the bound (x, y, range in m, heading in rad)."""
    peers, tallies, floor = Peers(seed), defaultdict[str, Tally](Tally), list[float]()
    for _ in range(frames):
        view = peers.stage.view(height_m)
        for names, look in peers.looks(view).items():
            look()  # The first look at a frame waits for memory.
            began = time.process_time_ns()
            places = look()
            ms = (time.process_time_ns() - began) * 1e-6
            for name, place in zip(names, places, strict=True):
                tallies[name].add(place, view, ms)
        floor.append(min(floor_ms(view.px) for _ in range(40)))
    return tallies, float(np.median(floor)), bound(peers.stage, height_m)


def cell(tallies: list[Tally]) -> str:
    """Return error, time and, if few, finds of the tally with the least error."""
    often = [tally for tally in tallies if 2 * len(tally.d_m) >= tally.tried]
    found = [(float(np.median(np.linalg.norm(tally.d_m, axis=1))), tally) for tally in often]
    ms = f"{np.median(tallies[0].ms):.1f} ms"
    if not found:
        return f"not found, {ms}"
    error_m, best = min(found, key=lambda pair: pair[0])
    few = "" if 10 * len(best.d_m) >= 9 * best.tried else f", {100 * len(best.d_m) / best.tried:.0f} % found"
    return f"{1e3 * error_m:{'.0f' if error_m > 0.1 else '.2g'}} mm, {ms}{few}"


HEADER = ["height m", "method", "found", "lateral mm", "range mm", "range bias mm", "heading deg", "ms", "x floor"]


def main() -> None:
    parser = described(__doc__)
    parser.add_argument("--frames", type=int, default=20, help="frames at each height")
    parser.add_argument("--heights", default=",".join(map(str, HEIGHTS_M)), help="metres, with commas")
    parser.add_argument("--write", type=Path, metavar="DIR", help="write benchmarks.md there")
    args = parsed(parser, "--frames 1 --heights 1")
    cv2.setNumThreads(1)
    rows: list[list[str]] = []
    peers = ["| height | " + " | ".join(COLUMNS) + " |", "|" + "---|" * (1 + len(COLUMNS))]
    heights = [float(h) for h in args.heights.split(",")]
    for height_m in heights:
        tallies, floor_ms, best = at_height(height_m, args.frames, seed=1)
        peers.append(f"| {height_m:g} m | {' | '.join(cell([tallies[name] for name in names]) for names in COLUMNS.values())} |")
        for name, tally in tallies.items():
            rows.append([f"{height_m:g}", name, *tally.row(floor_ms)])
        lateral = 1e3 * math.hypot(best[0], best[1]) / math.sqrt(2)
        rows.append(
            [f"{height_m:g}", "bound", "", f"{lateral:.2g}", f"{1e3 * best[2]:.2g}", "0", f"{math.degrees(best[3]):.2g}", "", ""]
        )
        for row in rows[-len(tallies) - 1 :]:
            print("  ".join(f"{cell:>14}" if i != 1 else f"{cell:<24}" for i, cell in enumerate(row)), flush=True)
    print("\n".join(peers), flush=True)
    if args.write is not None:
        write(args.write, rows, peers, args.frames)


def write(folder: Path, rows: list[list[str]], peers: list[str], frames: int) -> None:
    lines = [
        "# Benchmarks: vision", "", f"Made by `python -m benches.vision --frames {frames} --write docs`.", "",
        *(__doc__ or "").strip().splitlines()[4:], "",
        "| " + " | ".join(HEADER) + " |", "|" + "---|" * len(HEADER),
        *("| " + " | ".join(row) + " |" for row in rows if row[2] != "0 %"), "",
        f"The machine's load meanwhile was {os.getloadavg()[2]:.1f} on {os.cpu_count()} cores; where it is above one a core, "
        "processor times come out longer than on a machine at rest, ratios less so.", "", *peers, "",
        OTHERS + (folder / "benchmarks.md").read_text(encoding="utf-8").split(OTHERS)[1],
    ]  # fmt: skip
    (folder / "benchmarks.md").write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    os._exit(0)
