"""Measure ellipse, arrow and corners: `python -m benches.vision_methods [--frames N]` from the repository's root.

It makes the thesis' tables 5.1 to 5.4 on rendered frames, tries the photographs of the real pad, and times a frame by stage.
Rendered frames have the thesis' camera and pad, 1 to 2 degrees of tilt with the attitude given, sensor noise, blur, worn paint
and uneven light. Times are processor time on one thread, the smallest of several rounds, beside a floor measured in between: one
BGR to HSV conversion and one inRange of a frame of the same size.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from estimator.contracts.estimates import Method, Sighting  # noqa: E402
from estimator.contracts.geometry import F64, Rotation, wrap_pi  # noqa: E402
from estimator.contracts.samples import Attitude, Frame  # noqa: E402
from estimator.contracts.time import MonoNs, Stamp  # noqa: E402
from estimator.vision.camera import Camera  # noqa: E402
from estimator.vision.pad import Pad  # noqa: E402
from estimator.vision.pose import Marks, Orientation, OrientedCamera, solve  # noqa: E402
from estimator.vision.thesis.arrow import find_arrow  # noqa: E402
from estimator.vision.thesis.blob import U8  # noqa: E402
from estimator.vision.thesis.corners import find_corners  # noqa: E402
from estimator.vision.thesis.detection import detect  # noqa: E402
from estimator.vision.thesis.ellipse import find_disc  # noqa: E402
from estimator.vision.thesis.segmentation import COLOUR_SETS, SIMULATOR, ColourSet, HsvRange, Segmentation, segment  # noqa: E402
from sitl.camera.camera import Exposure, Renderer  # noqa: E402

HEIGHTS_M = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
METHODS: tuple[Method, ...] = ("ellipse", "arrow", "corners", "selected")
PHOTOS = ROOT / "../shared/data/pad_photos"
STAMP = Stamp(MonoNs(0), MonoNs(0), 0.0, "sim")
BY_HAND = ColourSet(
    "by hand",
    HsvRange((50, 80, 30), (80, 255, 130)),
    HsvRange((4, 110, 80), (22, 255, 255)),
    HsvRange((0, 0, 150), (180, 60, 255)),
)
"""Limits read off the photographs."""


def shipped_camera(name: str) -> Camera:
    return Camera.from_mapping(tomllib.loads((ROOT / "configs" / "cameras" / f"{name}.toml").read_text()))


def shipped_pad(name: str) -> Pad:
    return Pad.from_mapping(tomllib.loads((ROOT / "configs" / "pads" / f"{name}.toml").read_text()))


def flights(height_m: float, frames: int, renderer: Renderer, seed: int) -> Iterator[tuple[Frame, Attitude, F64, float]]:
    """Yield frames over the pad with their attitude, the true vector from body to pad in `level`, and the true heading."""
    rng = np.random.default_rng((seed, round(100 * height_m)))
    for i in range(frames):
        tilt, towards = math.radians(rng.uniform(1.0, 2.0)), rng.uniform(-math.pi, math.pi)
        heading = rng.uniform(-math.pi, math.pi)
        R_ned_body = Rotation.from_rpy(tilt * math.cos(towards), tilt * math.sin(towards), heading)
        # As in the thesis the vehicle hovers over the pad. Here its position is corrected for the camera's mounting and the tilt,
        # so that the pad stays near the middle of the frame at every height.
        axis = R_ned_body.matrix[:, 2]
        camera_ahead = R_ned_body @ renderer.camera.T_body_cam.t
        p_pad = np.array([0.0, 0.0, -1.0])
        p_cam = p_pad - axis * (height_m / axis[2]) + np.append(rng.normal(0.0, 0.03 * min(1.0, height_m), 2), 0.0)
        p_body = p_cam - camera_ahead
        pad_yaw = rng.uniform(-math.pi, math.pi)
        shot = Exposure(float(i), R_ned_body, p_body, Rotation.from_rpy(0.0, 0.0, pad_yaw), p_pad)
        frame = Frame(STAMP, i, renderer.render(shot, rng))
        d_level = Rotation.from_rpy(0.0, 0.0, -heading) @ (p_pad - p_body)
        yield frame, Attitude(STAMP, R_ned_body, np.eye(3) * 1e-8), d_level, wrap_pi(heading - pad_yaw)


def error(s: Sighting, d: F64, yaw_rad: float) -> F64:
    """Return the error (4,): mm forward, right, down and degrees of heading; the nearer heading if two are possible."""
    off = math.nan
    if s.yaw_rad is not None:
        off = wrap_pi(s.yaw_rad - yaw_rad)
        if s.yaw_ambiguous and abs(off) > math.pi / 2:
            off = wrap_pi(off + math.pi)
    return np.append((s.d_body_pad_level - d) * 1e3, math.degrees(off))


def rendered(frames: int, seed: int) -> None:
    camera, pad = shipped_camera("sim"), shipped_pad("thesis")
    renderer = Renderer(camera, pad)
    print(f"rendered frames, {frames} at each height: mean and std, mm and degrees")
    print(f"{'height':>6} {'method':<9} {'avbl':>5} {'forward':>15} {'right':>15} {'down':>17} {'heading':>13} {'nees':>6}")
    for height_m in HEIGHTS_M:
        seen: dict[str, list[F64]] = {m: [] for m in METHODS}
        nees: dict[str, list[float]] = {m: [] for m in METHODS}
        for frame, attitude, d, yaw_rad in flights(height_m, frames, renderer, seed):
            view = detect(frame, attitude, camera, pad, SIMULATOR, sigma_deck_rad=0.0)
            for name, s in (*view.methods.items(), ("selected", view.selected)):
                if s is not None:
                    e = error(s, d, yaw_rad)
                    seen[name].append(e)
                    nees[name].append(float(e[:3] @ np.linalg.solve(s.cov[:3, :3] * 1e6, e[:3])))
        for name in METHODS:
            if not seen[name]:
                print(f"{height_m:6.1f} {name:<9} {0:4.0f}%")
                continue
            e = np.array(seen[name])
            mean, std = e.mean(axis=0), e.std(axis=0)
            cells = [f"{mean[k]:7.2f} {std[k]:7.2f}" for k in range(2)] + [f"{mean[2]:8.2f} {std[2]:8.2f}"]
            known = e[~np.isnan(e[:, 3]), 3]
            cells.append(f"{known.mean():6.2f} {known.std():6.2f}" if known.size else f"{'-':>13}")
            print(f"{height_m:6.1f} {name:<9} {100 * len(e) / frames:4.0f}% {' '.join(cells)} {np.mean(nees[name]):6.1f}")


def photographs() -> None:
    if not PHOTOS.is_dir():
        print("photographs: not here, skipped")
        return
    camera, pad = shipped_camera("photos"), shipped_pad("printed")
    with (PHOTOS / "pose.csv").open() as text:
        rows = list(csv.DictReader(text))
    print(f"\n{len(rows)} photographs of the printed pad: position against pose.csv in % of range, heading in degrees")
    print(
        f"{'limits':<10} {'tilt':<6} {'method':<9} {'found':>6} {'median':>7} {'p95':>7} {'worst':>7} {'heading':>8} {'worst':>6}"
    )
    for measured in (True, False):
        # As in `decklander detect`: of the three colour sets of the thesis, the one with the most confident result.
        for name, sets in (("indoor", [COLOUR_SETS["indoor"]]), ("by hand", [BY_HAND]), ("auto", list(COLOUR_SETS.values()))):
            off: dict[str, list[tuple[float, float]]] = {m: [] for m in METHODS}
            for row in rows:
                frame, attitude, d, yaw_rad = photograph(row, camera)
                looks = [detect(frame, attitude if measured else None, camera, pad, colours) for colours in sets]
                best = max(looks, key=lambda seen: -1.0 if seen.selected is None else seen.selected.confidence)
                for method, s in (*best.methods.items(), ("selected", best.selected)):
                    if s is not None:
                        e = error(s, d, yaw_rad)
                        off[method].append((float(np.linalg.norm(e[:3]) / np.linalg.norm(d) / 10.0), abs(float(e[3]))))
            for method in METHODS if measured else ("selected",):
                if not off[method]:
                    print(f"{name:<10} {'told' if measured else 'level':<6} {method:<9} {0:5.0f}%")
                    continue
                rel, head = np.array(off[method]).T
                head = head[~np.isnan(head)]
                turn = f"{np.median(head):8.2f} {head.max():6.1f}" if head.size else f"{'-':>8}"
                print(
                    f"{name:<10} {'told' if measured else 'level':<6} {method:<9} {100 * len(rel) / len(rows):5.0f}% "
                    f"{np.median(rel):7.2f} {np.percentile(rel, 95):7.2f} {rel.max():7.2f} {turn}"
                )


def photograph(row: dict[str, str], camera: Camera) -> tuple[Frame, Attitude, F64, float]:
    """Return one photograph with the tilt, position and heading of its reference."""
    px = cv2.imread(str(PHOTOS / "images" / row["frame"]))
    if px is None:
        raise SystemExit(f"{row['frame']}: not a frame that can be read")
    R_cam_pad = Rotation.from_rotvec([float(row[f"rvec_{k}"]) for k in "xyz"])
    t = np.array([float(row[f"t_cam_{k}_m"]) for k in "xyz"])
    roll, pitch, yaw = (R_cam_pad.inv @ camera.T_body_cam.R.inv).rpy_rad
    R_level_body = Rotation.from_rpy(roll, pitch, 0.0)
    attitude = Attitude(STAMP, R_level_body, np.eye(3) * math.radians(0.3) ** 2)
    return Frame(STAMP, 0, np.asarray(px, np.uint8)), attitude, (R_level_body @ camera.T_body_cam.R) @ t, yaw


def stages(rounds: int, seed: int) -> None:
    camera, pad = shipped_camera("sim"), shipped_pad("thesis")
    renderer = Renderer(camera, pad)
    print("\nms a frame by stage, one thread; ratio is look() over the floor")
    print(f"{'height':>6} {'floor':>6} {'segment':>8} {'ellipse':>8} {'arrow':>7} {'corners':>8} {'poses':>6} {'look':>6} ratio")
    for height_m in HEIGHTS_M:
        frame, attitude, _, _ = next(flights(height_m, 1, renderer, seed))
        view = OrientedCamera(camera, Orientation.of(attitude))
        seg = segment(frame.px, SIMULATOR)
        if seg is None:
            print(f"{height_m:6.1f} nothing green")
            continue
        disc, arrow, corners = (
            find_disc(seg, view, pad),
            find_arrow(seg, view, pad, seg.orangeness()),
            find_corners(seg, view, pad),
        )
        marks = [found.marks for found in (disc, arrow, corners) if found is not None]

        times = smallest(
            rounds,
            [
                partial(floor_of, frame.px),
                partial(segment, frame.px, SIMULATOR),
                partial(find_disc, seg, view, pad),
                partial(arrow_of, seg, view, pad),
                partial(find_corners, seg, view, pad),
                partial(poses_of, marks, view),
                partial(detect, frame, attitude, camera, pad, SIMULATOR),
            ],
        )
        floor, segmented, e, a, c, p, whole = times
        print(
            f"{height_m:6.1f} {floor:6.2f} {segmented:8.2f} {e:8.2f} {a:7.2f} {c:8.2f} {p:6.2f} {whole:6.2f} {whole / floor:5.1f}"
        )


def floor_of(px: U8) -> None:
    cv2.inRange(cv2.cvtColor(px, cv2.COLOR_BGR2HSV), (52, 217, 38), (68, 255, 153))


def arrow_of(seg: Segmentation, view: OrientedCamera, pad: Pad) -> None:
    find_arrow(seg, view, pad, seg.orangeness())


def poses_of(marks: list[Marks], view: OrientedCamera) -> None:
    for m in marks:
        solve(m, view)


def smallest(rounds: int, calls: list[Callable[[], object]]) -> list[float]:
    """Return the processor time of each call, ms: the smallest of `rounds`, the calls taking turns."""
    best = [math.inf] * len(calls)
    for _ in range(rounds):
        for i, call in enumerate(calls):
            began = time.process_time()
            call()
            best[i] = min(best[i], (time.process_time() - began) * 1e3)
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=60, help="rendered frames at each height")
    parser.add_argument("--rounds", type=int, default=40, help="of the timing")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    rendered(args.frames, args.seed)
    photographs()
    stages(args.rounds, args.seed)


if __name__ == "__main__":
    main()
