"""Measure how a pad is found and measured by its lamps at night: python -m benches.lamps [--frames 20] [--empty 300] [--seed 0].

Frames are rendered (tests/support/night_scenes.py): heights from 0.4 to 20 m, tilted by up to 15 degrees with an attitude that is
off by one degree at one sigma. Found from cold counts confidence 0.5, an error below a tenth of the height and a heading within
0.2 rad; tracked starts from the true place, off by 2 cm or 1 % of the height at one sigma, with a reach of three sigma as in
flight. NEES is of a sighting's four numbers, over four. "No pad" frames show 4 to 25 lights and no pad.
"""

import argparse
import math
import sys
import time
from dataclasses import dataclass, field

import cv2
import numpy as np

from benches.filter_steps import floor_s
from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera import Camera
from estimator.vision.lamp_sighting import REACH_PX as MOST_REACH_PX
from estimator.vision.lamp_sighting import detect_lamps
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from tests.support.night_scenes import NIGHTS, NightCondition, NightScene, level_errors, night_scene
from tests.support.pad_scenes import load_camera, load_pad

STAMP = Stamp(MonoNs(10**9), MonoNs(10**9), 0.0, "sim")
HEIGHTS_M = (0.4, 0.7, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0)
SURE = 0.5


@dataclass
class Row:
    """Result at one height."""

    height_m: float
    range_m: list[float] = field(default_factory=list)
    yaw_rad: list[float] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    searched_s: list[float] = field(default_factory=list)
    tracked_s: list[float] = field(default_factory=list)
    wrong: int = 0

    def look(self, rng: np.random.Generator, camera: Camera, pad: Pad, condition: NightCondition) -> tuple[bool, bool]:
        """Look at one frame from cold and from an estimate; return whether the pad was found."""
        scene = night_scene(rng, camera, pad, self.height_m, condition)
        frame = Frame(STAMP, 0, scene.px)
        reach_px = 3.0 * _sigma_m(self.height_m) * camera.fx / self.height_m
        start = _near(rng, scene.truth, self.height_m) if reach_px < MOST_REACH_PX else None
        began = time.thread_time()
        cold = detect_lamps(frame, camera, pad, scene.orientation)
        between = time.thread_time()
        warm = detect_lamps(frame, camera, pad, scene.orientation, start, reach_px)
        self.searched_s.append(between - began)
        self.tracked_s.append(time.thread_time() - between)
        if cold is not None and self._is_right(cold, scene, camera):
            off = level_errors(cold, scene, camera)
            lens = scene.R_level_body.matrix @ camera.T_body_cam.t
            self.range_m.append(float(np.linalg.norm(cold.d_body_pad_level - lens)) - scene.truth.range_m)
            self.nees.append(float(off @ np.linalg.solve(cold.cov, off)) / 4.0)
            self.yaw_rad.append(float(off[3]))
            return True, self._is_right(warm, scene, camera)
        return False, self._is_right(warm, scene, camera)

    def _is_right(self, seen: Sighting | None, scene: NightScene, camera: Camera) -> bool:
        if seen is None or seen.confidence < SURE:
            return False
        off = level_errors(seen, scene, camera)
        right = float(np.linalg.norm(off[:3])) < 0.1 * self.height_m and abs(float(off[3])) < 0.2
        self.wrong += not right
        return right

    def figures(self, floor: float) -> str:
        if not self.nees:
            return " | ".join(["none"] * 5)
        searched, tracked = (float(np.median(took)) / floor for took in (self.searched_s, self.tracked_s))
        spread = 1e3 * float(np.std(self.range_m)), math.degrees(float(np.std(self.yaw_rad)))
        return f"{spread[0]:.2g} | {spread[1]:.2g} | {np.mean(self.nees):.2g} | {searched:.1f} | {tracked:.1f}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--empty", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pad", default="lit")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    camera, pad, floor, wrong = load_camera("sim"), load_pad(args.pad), floor_s(), 0
    conditions = " | ".join(f"{c}: searched, tracked %" for c in NIGHTS)
    print(f"| height m | {conditions} | range mm | heading deg | NEES | floors searched | tracked |")
    print("|" + "---|" * (len(NIGHTS) + 6))
    for height_m in HEIGHTS_M:
        row, cells = Row(height_m), list[str]()
        for kind, condition in enumerate(NIGHTS):
            seeds = ([args.seed, kind, round(10 * height_m), n] for n in range(args.frames))
            found: F64 = np.array([row.look(np.random.default_rng(seed), camera, pad, condition) for seed in seeds], float)
            cells.append(", ".join(f"{100 * share:.0f}" for share in found.mean(axis=0)))
        print(f"| {height_m:g} | {' | '.join(cells)} | {row.figures(floor)} |", flush=True)
        wrong += row.wrong
    print(f"sure and wrong: {wrong} of {2 * len(HEIGHTS_M) * len(NIGHTS) * args.frames}")
    if args.empty:
        print(_empty(args.empty, args.seed, camera, pad))
    return 0


def _sigma_m(height_m: float) -> float:
    return max(0.02, 0.01 * height_m)


def _near(rng: np.random.Generator, truth: PadPose, height_m: float) -> PadPose:
    off = rng.normal(0.0, _sigma_m(height_m), 3)
    return PadPose(truth.R_cam_pad @ Rotation.from_rpy(0.0, 0.0, float(rng.normal(0, 0.03))), truth.t_cam_pad + off)


def _empty(n: int, seed: int, camera: Camera, pad: Pad) -> str:
    highest = list[float]()
    for i in range(n):
        rng = np.random.default_rng([seed, 77, i])
        scene = night_scene(rng, camera, pad, float(rng.choice(HEIGHTS_M)), "other lights", lit=False)
        seen = detect_lamps(Frame(STAMP, i, scene.px), camera, pad, scene.orientation)
        highest.append(0.0 if seen is None else seen.confidence)
    top = ", ".join(f"{c:.2g}" for c in sorted(highest)[::-1][:5])
    return f"{n} frames of other lights: {sum(c >= SURE for c in highest)} sure, highest {top}"


if __name__ == "__main__":
    sys.exit(main())
