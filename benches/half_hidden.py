"""Measure how often a pad is found whose half is hidden: `python -m benches.half_hidden [--frames N] [--seed S]`.

Half of the pad is under an opaque patch, beyond the frame's edge, or in deep shadow, on the decks and in the lights of
`pad_scenes`; near the deck the frame hides more of it. A cell has the percentage of frames in which a search without a belief,
to the end, finds the pad, sure and right (as in `benches.acquisition`), then that within three frames of a flight's budget, then
that of registrations that start at the true pose: what the verification alone would leave; "!" marks a search that was sure and
wrong. OpenCV's own find of the largest of nested ellipses is beside it, which has no size and so no wrong range.
"""

import argparse
import math
import sys
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benches.acquisition import image_of, orientation_of, sheet  # noqa: E402
from benches.real import by_contours  # noqa: E402
from benches.search import sure_within  # noqa: E402
from estimator.vision.detect.acquire import acquire  # noqa: E402
from estimator.vision.detect.pyramid import FrameView, Pyramid  # noqa: E402
from estimator.vision.tracker_config import FRAME_WORK  # noqa: E402
from estimator.vision.verified import SURE, verified  # noqa: E402
from tests.support.hard_light import Hard, hard_scene  # noqa: E402
from tests.support.pad_claims import keeps_claim  # noqa: E402
from tests.support.pad_scenes import HALF_HIDDEN, PadScene, load_camera, load_pad  # noqa: E402

HALVES = {name: Hard(load_pad("thesis"), name, lambda px, _: px) for name in HALF_HIDDEN}
HEIGHTS_M = (0.3, 0.5, 1.0, 3.0, 5.0, 10.0, 15.0)


def scene_of(name: str, height_m: float, seed: int, k: int) -> PadScene:
    rng = np.random.default_rng([seed, k, round(10 * height_m), list(HALVES).index(name)])
    return hard_scene(rng, load_camera("sim"), HALVES[name], height_m)


def cell(name: str, height_m: float, frames: int, seed: int, bad: list[np.ndarray]) -> tuple[str, float, int]:
    """Return a cell, the share of searches to the end that found the pad, and how many frames OpenCV's ellipses find it in."""
    camera, pad = load_camera("sim"), HALVES[name].pad
    right, wrong, theirs = [0, 0, 0], 0, 0
    for k in range(frames):
        scene = scene_of(name, height_m, seed, k)
        assert scene.truth is not None
        by = by_contours(scene.px)
        radius_px = camera.fx * pad.disc_radius_m / float(scene.truth.t_cam_pad[2])
        theirs += (
            by is not None and float(np.linalg.norm(by[0] - camera.project(scene.truth.t_cam_pad[None])[0])) < 0.25 * radius_px
        )
        for i, (budget, most) in enumerate(((math.inf, 1), (FRAME_WORK, 3))):
            sure, good, _ = sure_within(scene, camera, pad, budget, most)
            right[i] += sure and good
            wrong += sure and not good
            if i == 0 and not good:
                best = acquire(scene.px, camera, pad, scene.R_level_body)
                text = f"{name} {height_m:g} {'WRONG' if sure else 'missed'} {k}"
                bad.append(image_of(scene.px, camera, pad, scene.truth, best[0] if best else None, text))
        at = verified(FrameView(Pyramid(scene.px), camera, pad), scene.truth, orientation_of(scene))
        right[2] += (
            at is not None
            and at.confidence >= SURE
            and keeps_claim(at.found.pose, scene.truth, camera, pad, at.found.yaw_ambiguous)
        )
    text = "/".join(f"{100 * n / frames:.0f}" for n in right)
    return f"{text + '!' * min(3, wrong):>14s}", right[0] / frames, theirs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=20, help="at each height in each condition")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sheet", type=Path, help="write sheets of the frames without a right find into this folder")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    shares: list[list[float]] = []
    bad: list[np.ndarray] = []
    print(" " * 16 + "".join(f"{f'{h:g} m':>14s}" for h in HEIGHTS_M) + f"{'OpenCV':>10s}")
    for name in HALVES:
        cells = [cell(name, height_m, args.frames, args.seed, bad) for height_m in HEIGHTS_M]
        shares.append([share for _, share, _ in cells])
        theirs = sum(n for *_, n in cells) / (args.frames * len(HEIGHTS_M))
        print(f"{name:16s}" + "".join(text for text, *_ in cells) + f"{100 * theirs:10.0f}", flush=True)
    print(f"{'all':16s}" + "".join(f"{100 * share:>14.0f}" for share in np.mean(shares, axis=0)))
    if args.sheet is not None:
        args.sheet.mkdir(parents=True, exist_ok=True)
        for i in range(0, len(bad), 40):
            sheet(bad[i : i + 40], args.sheet / f"half_hidden_{i // 40}.png")


if __name__ == "__main__":
    main()
