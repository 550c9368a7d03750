"""Measure the search in hard conditions: `python -m benches.search [--frames N] [--seed S] [--only CONDITIONS]`.

A cell has the percentage of frames in which a search without a belief finds the pad, sure and right, by condition and height:
first of searches to the end, then of searches within the budget of a flight, over at most three frames. A candidate is registered
and verified as the pad tracker does it, and keeps the verification's claim with a confidence of 0.5 or more; "!" marks a sure one
that does not. Then follow the processor times of the search in one frame of a flight, median and largest, in floors (one BGR to
HSV conversion and one inRange of a frame of the same size, measured in between). Frames of the row `empty` hold no pad.
"""

import argparse
import math
import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benches.acquisition import floor_ms, registered  # noqa: E402
from estimator.vision.camera import Camera  # noqa: E402
from estimator.vision.detect.acquire import FRESH_SEARCH, acquire, search  # noqa: E402
from estimator.vision.detect.pyramid import FrameView, Pyramid  # noqa: E402
from estimator.vision.pad import Pad  # noqa: E402
from estimator.vision.tracker_config import FRAME_WORK  # noqa: E402
from tests.support.hard_light import HARD, hard_scene  # noqa: E402
from tests.support.pad_scenes import PadScene, empty_scene, load_camera, load_pad  # noqa: E402

HEIGHTS_M = (0.3, 1.0, 3.0, 5.0, 10.0, 15.0)


def sure_within(scene: PadScene, camera: Camera, pad: Pad, budget: float, frames: int) -> tuple[bool, bool, list[float]]:
    """Search a scene; return whether something is sure, whether it is right, and the time of each frame, ms."""
    memory, took = FRESH_SEARCH, []
    for _ in range(frames):
        began = time.process_time_ns()
        found = search(FrameView(Pyramid(scene.px), camera, pad), scene.R_level_body, memory=memory, budget=budget)
        took.append((time.process_time_ns() - began) * 1e-6)
        memory = found.memory
        best = registered(scene, found.candidates, camera, pad)
        if best is not None and best[0] >= 0.5:
            return True, best[1], took
    return False, False, took


def cell(name: str, height_m: float, frames: int, seed: int, pad_name: str = "") -> str:
    camera, hard = load_camera("sim"), HARD["plain" if name == "empty" else name]
    hard = replace(hard, pad=load_pad(pad_name)) if pad_name else hard
    pad = hard.pad
    right, wrong, took, floors = [0, 0], 0, [], []
    for k in range(frames):
        rng = np.random.default_rng([seed, k, round(10 * height_m)])
        scene = empty_scene(rng, camera, height_m) if name == "empty" else hard_scene(rng, camera, hard, height_m)
        for i, (budget, most) in enumerate(((math.inf, 1), (FRAME_WORK, 3))):
            sure, good, ms = sure_within(scene, camera, pad, budget, most)
            right[i] += sure and good
            wrong += sure and not good
            floors.append(floor_ms(scene.px))
            took += ms if i else []
    unit = float(np.median(floors))
    both = "/".join(f"{100 * n / frames:.0f}" for n in right)
    return f"{both + '!' * min(2, wrong):>10s}{np.median(took) / unit:4.0f}{max(took) / unit:4.0f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=8, help="at each height in each condition")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pad", default="", help="name of a shipped pad in place of each condition's")
    parser.add_argument("--only", help="conditions, with commas in between")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    names = args.only.split(",") if args.only else [*HARD, "empty"]
    acquire(np.zeros((360, 640, 3), np.uint8), load_camera("sim"), HARD["plain"].pad)
    print(" " * 16 + "".join(f"{f'{h:g} m':>18s}" for h in HEIGHTS_M))
    for name in names:
        print(f"{name:16s}" + "".join(cell(name, h, args.frames, args.seed, args.pad) for h in HEIGHTS_M), flush=True)


if __name__ == "__main__":
    main()
