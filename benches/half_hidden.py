"""Measure how often a pad is found whose half is hidden: `python -m benches.half_hidden [--frames N] [--seed S]`.

Half of the pad is under an opaque patch, beyond the frame's edge, or in deep shadow, on the decks and in the lights of
`pad_scenes`; near the deck the frame hides more of it. A cell has the percentage of frames in which a search without a belief,
to the end, finds the pad, sure and right (as in `benches.acquisition`), then that within three frames of a flight's budget, then
that of registrations that start at the true pose: what the verification alone would leave; "!" marks a search that was sure and
wrong.
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
from benches.search import sure_within  # noqa: E402
from estimator.vision.detect.acquire import acquire  # noqa: E402
from estimator.vision.detect.pyramid import FrameView, Pyramid  # noqa: E402
from estimator.vision.tracker_config import FRAME_WORK  # noqa: E402
from estimator.vision.verified import SURE, verified  # noqa: E402
from tests.support.pad_claims import keeps_claim  # noqa: E402
from tests.support.pad_scenes import HALF_HIDDEN, PadScene, load_camera, load_pad, pad_scene  # noqa: E402

HEIGHTS_M = (0.3, 0.5, 1.0, 3.0, 5.0, 10.0, 15.0)


def scene_of(condition: str, height_m: float, seed: int, k: int) -> PadScene:
    rng = np.random.default_rng([seed, k, round(10 * height_m), HALF_HIDDEN.index(condition)])
    return pad_scene(rng, load_camera("sim"), load_pad("thesis"), height_m, condition)


def cell(condition: str, height_m: float, frames: int, seed: int, bad: list[np.ndarray]) -> tuple[str, float]:
    """Return a cell, and the share of searches to the end that found the pad."""
    camera, pad = load_camera("sim"), load_pad("thesis")
    right, wrong = [0, 0, 0], 0
    for k in range(frames):
        scene = scene_of(condition, height_m, seed, k)
        for i, (budget, most) in enumerate(((math.inf, 1), (FRAME_WORK, 3))):
            sure, good, _ = sure_within(scene, camera, pad, budget, most)
            right[i] += sure and good
            wrong += sure and not good
            if i == 0 and not good:
                best = acquire(scene.px, camera, pad, scene.R_level_body)
                text = f"{condition} {height_m:g} {'WRONG' if sure else 'missed'} {k}"
                bad.append(image_of(scene.px, camera, pad, scene.truth, best[0] if best else None, text))
        assert scene.truth is not None
        of = verified(FrameView(Pyramid(scene.px), camera, pad), scene.truth, orientation_of(scene))
        right[2] += (
            of is not None
            and of.confidence >= SURE
            and keeps_claim(of.found.pose, scene.truth, camera, pad, of.found.yaw_ambiguous)
        )
    text = "/".join(f"{100 * n / frames:.0f}" for n in right)
    return f"{text + '!' * min(3, wrong):>14s}", right[0] / frames


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=20, help="at each height in each condition")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sheet", type=Path, help="write sheets of the frames without a right find into this folder")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    shares: list[list[float]] = []
    bad: list[np.ndarray] = []
    print(" " * 12 + "".join(f"{f'{h:g} m':>14s}" for h in HEIGHTS_M))
    for condition in HALF_HIDDEN:
        cells = [cell(condition, height_m, args.frames, args.seed, bad) for height_m in HEIGHTS_M]
        shares.append([share for _, share in cells])
        print(f"{condition:12s}" + "".join(text for text, _ in cells), flush=True)
    print(f"{'all':12s}" + "".join(f"{100 * share:>14.0f}" for share in np.mean(shares, axis=0)))
    if args.sheet is not None:
        args.sheet.mkdir(parents=True, exist_ok=True)
        for i in range(0, len(bad), 40):
            sheet(bad[i : i + 40], args.sheet / f"half_hidden_{i // 40}.png")


if __name__ == "__main__":
    main()
