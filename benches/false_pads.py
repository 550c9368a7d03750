"""Count false pads: `python -m benches.false_pads [--frames N] [--first CHUNK] [--rings] [--workers K]`.

The pad tracker of a flight that has not found the pad yet, with all methods and their fusion, processes rendered frames of sea,
wake, decks, orange rafts, green awnings, other helipads, an H without a ring and a ring without an H (in the pad's own colours
too, from 0.25 to 30 m, in all lights, with and without attitude), and photographs of sea and other things. The output is the
highest confidence of any frame and the time per frame. A chunk is 100 frames with its own random numbers, so that a long run can
be made in parts (`--first`). The exit code is 1 if any frame reaches 0.5.
"""

import math
import sys
import time
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from benches.options import described, mapping, parsed
from benches.real import STAMP
from benches.search import SIGMA_ATTITUDE_RAD
from estimator.contracts.geometry import Rotation, Transform
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.camera.camera import Camera
from estimator.vision.options import TrackerOptions
from estimator.vision.pad.pad import Pad
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track
from tests.support.hard_light import HARD, Hard
from tests.support.pad_scenes import DATA, PadScene, empty_scene, load_camera, load_pad, ring_scene

CHUNK = 100
LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9)


def scene_of(chunk: int, i: int, rings: bool = False) -> PadScene:
    rng = np.random.default_rng([chunk, i, 0xFA15E])
    scene, least_m = (ring_scene, 1.0) if rings else (empty_scene, 0.25)
    return scene(rng, load_camera("sim"), float(np.exp(rng.uniform(math.log(least_m), math.log(30.0)))))


def sure_of(px: NDArray[np.uint8], camera: Camera, pad: Pad, R_level_body: Rotation | None) -> float:
    """Return the confidence of the sighting in a frame, or 0 if there is none."""
    tracker = TrackerConfig(camera, pad, TrackerOptions("fused", "simulator"))
    attitude = None if R_level_body is None else Attitude(STAMP, R_level_body, np.eye(3) * SIGMA_ATTITUDE_RAD**2)
    seen, _ = track(tracker, TrackerMemory(), Frame(STAMP, 0, px), attitude)
    return 0.0 if seen.selected is None else seen.selected.confidence


def condition_of(name: str, pad: str) -> Hard:
    """Return a condition, with the shipped pad of a name in place of its own unless that is empty."""
    return replace(HARD[name], pad=load_pad(pad)) if pad else HARD[name]


def best_scores(
    chunk: int, condition: str = "plain", pad: str = "", rings: bool = False, frames: int = CHUNK
) -> tuple[list[float], float]:
    """Return the best score of each frame of a chunk, and the processor time per frame without rendering, ms."""
    cv2.setNumThreads(1)
    camera, hard = load_camera("sim"), condition_of(condition, pad)
    scores, took = [], 0
    for i in range(frames):
        scene = scene_of(chunk, i, rings)
        px = hard.change(scene.px, np.random.default_rng([chunk, i, 0xC4A9]))
        began = time.process_time_ns()
        scores.append(sure_of(px, camera, hard.pad, scene.R_level_body))
        took += time.process_time_ns() - began
    return scores, took * 1e-6 / frames


def photographs(hard: Hard, most: int) -> list[tuple[str, float]]:
    """Return (name, best score) of each photograph, of so many, over several frame sizes."""
    mount = Transform(Rotation.from_rpy(0.0, 0.0, math.pi / 2), np.zeros(3))
    out: list[tuple[str, float]] = []
    for path in sorted([*(DATA / "sea").glob("*.jpg"), *(DATA / "not_pads").glob("*.jpg")])[:most]:
        whole = np.asarray(cv2.imread(str(path)), np.uint8)
        for width in (320, 640, 960):
            h = round(width * whole.shape[0] / whole.shape[1])
            small = np.asarray(cv2.resize(whole, (width, h), interpolation=cv2.INTER_AREA), np.uint8)
            px = hard.change(small, np.random.default_rng([width, len(out)]))
            camera = Camera(width, h, 0.8 * width, 0.8 * width, (width - 1) / 2, (h - 1) / 2, np.zeros(5), mount)
            for R in (None, Rotation.identity()):
                out.append((f"{path.parent.name}/{path.name} at {width} px", sure_of(px, camera, hard.pad, R)))
    return out


def main() -> int:
    parser = described(__doc__)
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="chunk to begin with")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--rings", action="store_true", help="show in each frame a green disc with a ring, in glare")
    parser.add_argument("--condition", default="plain", choices=list(HARD), help="what changes each frame, and which pad")
    parser.add_argument("--pad", default="", help="name of a shipped pad in place of the condition's")
    args = parsed(parser, "--frames 4")
    chunks = range(args.first, args.first + max(1, args.frames // CHUNK))
    scores, took = list[float](), list[float]()
    work = partial(best_scores, condition=args.condition, pad=args.pad, rings=args.rings, frames=min(CHUNK, args.frames))
    with mapping(args.workers) as each:
        for chunk, (part, ms) in zip(chunks, each(work, chunks), strict=True):
            scores += part
            for i in np.flatnonzero(np.array(part) >= 0.5):
                print(f"\rchunk {chunk}, {i}: {part[i]:.2f}", file=sys.stderr)
            took.append(ms)
            print(f"\r{len(scores)} frames, {sum(s >= 0.5 for s in scores)} at 0.5 or more", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    all_ = np.array(scores)
    print(
        f"rendered without a pad: {len(all_)} frames, chunks {chunks.start} to {chunks.stop - 1}, {np.mean(took):.1f} ms each; "
        "confidence"
    )
    for level in LEVELS:
        print(f"  {level:.1f} or more: {int((all_ >= level).sum())}")
    order = np.argsort(-all_)[:24]
    print("  highest: " + ", ".join(f"{all_[k]:.2f} (chunk {chunks.start + k // CHUNK}, {k % CHUNK})" for k in order[:8]))
    seen = photographs(condition_of(args.condition, args.pad), args.frames)
    if seen:
        name, top = max(seen, key=lambda s: s[1])
        print(
            f"photographs without a pad: {len(seen)} looks, highest {top:.2f} ({name}), "
            f"{sum(s >= 0.5 for _, s in seen)} at 0.5 or more"
        )
    return int((all_ >= 0.5).any() or any(s >= 0.5 for _, s in seen))


if __name__ == "__main__":
    sys.exit(main())
