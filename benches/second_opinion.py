"""Measure what the learned second opinion adds: `python -m benches.second_opinion [--frames N] [--empty N] [--others N]`.

Frames with the thesis' pad by condition and height, without a pad, with other shipped pads than the one that is looked for, and
photographs with and without the real pad are searched to the end as in a flight without belief, and the two best candidates are
registered. Each gets the confidence of the verification alone, of the network alone, and the lesser of both. The tables have the
percentage of frames that are found and right at 0.5 ("!" for each that is found and wrong), the frames without the pad that reach
0.2 and 0.5, the area below the receiver operating characteristic, and the time of the second opinion in floors. None of these
frames was used for training. `--keep FILE` writes every candidate's figures, `--sheet DIR` the worst of both opinions as images.
"""

import argparse
import csv
import math
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benches.acquisition import floor_ms, sheet  # noqa: E402
from benches.verifier_examples import PADS, searched  # noqa: E402
from companion.settings.learned_file import second_opinion  # noqa: E402
from estimator.contracts.geometry import Rotation, Transform  # noqa: E402
from estimator.vision.camera import Camera  # noqa: E402
from estimator.vision.detect.pyramid import Pyramid  # noqa: E402
from estimator.vision.learned.second_opinion import Patch, SecondOpinion, lowered, patch_of, probability  # noqa: E402  # noqa: E402
from estimator.vision.pad import Pad  # noqa: E402
from tests.support.hard_light import HARD, hard_scene  # noqa: E402
from tests.support.pad_scenes import (  # noqa: E402
    CONDITIONS,
    DATA,
    HALF_HIDDEN,
    PadScene,
    empty_scene,
    load_camera,
    load_pad,
    pad_scene,
    photo_pose,
    visible_fraction,
)

HEIGHTS_M = (0.3, 0.5, 1.0, 3.0, 5.0, 10.0, 15.0, 20.0)
SCORES = ("verified", "learned", "both")
_SEED = 0x0DD
_ALIKE = {"thesis", "printed"}
"""Two drawings of the same pad."""


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One candidate of one frame."""

    group: str
    condition: str
    height_m: float
    frame: int
    right: bool
    verified: float
    learned: float
    patch: Patch

    def score(self, name: str) -> float:
        if name == "both":
            return lowered(self.verified, self.learned)
        return self.verified if name == "verified" else self.learned


class Frames:
    """Counts the frames of each group and condition, and the candidates in them."""

    def __init__(self, network: SecondOpinion) -> None:
        self.rows: list[Row] = []
        self.count: dict[tuple[str, str, float], int] = {}
        self._network, self._frame = network, 0

    def add(self, group: str, scene: PadScene, camera: Camera, pad: Pad, condition: str) -> None:
        key = group, condition, scene.height_m
        self.count[key] = self.count.get(key, 0) + 1
        self._frame += 1
        for _, patch, confidence, right in searched(scene, camera, pad, most=2, everything=False):
            learned = probability(self._network.of_patch(patch))
            self.rows.append(Row(group, condition, scene.height_m, self._frame, right, confidence, learned, patch))


def with_pad(frames: Frames, each: int) -> None:
    camera, pad = load_camera("sim"), load_pad("thesis")
    hard = [name for name in HARD if name not in CONDITIONS]
    for condition in (*CONDITIONS, *HALF_HIDDEN, *hard):
        for height_m in HEIGHTS_M:
            for k in range(each):
                rng = np.random.default_rng([_SEED, k, round(10 * height_m), *condition.encode()])
                if condition in hard:
                    scene, of = hard_scene(rng, camera, HARD[condition], height_m), HARD[condition].pad
                else:
                    scene, of = pad_scene(rng, camera, pad, height_m, condition), pad
                frames.add("pad", scene, camera, of, condition)
        print(condition, file=sys.stderr, flush=True)


def without_pad(frames: Frames, count: int) -> None:
    camera = load_camera("sim")
    for k in range(count):
        rng = np.random.default_rng([_SEED, k, 0xE3])
        height_m = float(np.exp(rng.uniform(math.log(0.25), math.log(30.0))))
        scene = replace(empty_scene(rng, camera, height_m), height_m=0.0)
        frames.add("none", scene, camera, load_pad("thesis"), "thesis")
        if k % 2 == 0:
            name = ("icao", "helideck", "h", "x")[k // 2 % 4]
            frames.add("none", scene, camera, load_pad(name), name)


def other_pads(frames: Frames, each: int) -> None:
    camera, names = load_camera("sim"), sorted(set(PADS))
    for shown in names:
        for wanted in names:
            if shown == wanted or {shown, wanted} == _ALIKE:
                continue
            for k in range(each):
                rng = np.random.default_rng([_SEED, k, names.index(shown), names.index(wanted)])
                height_m = float(np.exp(rng.uniform(math.log(0.5), math.log(12.0))))
                scene = pad_scene(rng, camera, load_pad(shown), height_m, ("plain", "light")[k % 2])
                frames.add("other pad", replace(scene, truth=None, height_m=0.0), camera, load_pad(wanted), wanted)
        print(shown, file=sys.stderr, flush=True)


def photographs(frames: Frames) -> None:
    """Add the photographs of the real pad, and those of the sea and of other things at two sizes, if they are here."""
    folder = DATA / "pad_photos"
    if not folder.exists():
        return
    camera, pad = load_camera("photos"), load_pad("printed")
    for row in csv.DictReader((folder / "pose.csv").read_text().splitlines()):
        truth = photo_pose(row)
        if visible_fraction(truth, camera, pad) >= 0.5:
            px = np.asarray(cv2.imread(str(folder / "images" / row["frame"])), np.uint8)
            frames.add("photograph", PadScene(px, truth, None, 0.0, 1.0, "photo"), camera, pad, "printed")
    mount = Transform(Rotation.from_rpy(0.0, 0.0, math.pi / 2), np.zeros(3))
    for path in sorted([*(DATA / "sea").glob("*.jpg"), *(DATA / "not_pads").glob("*.jpg")]):
        whole = np.asarray(cv2.imread(str(path)), np.uint8)
        for width in (320, 640):
            h = round(width * whole.shape[0] / whole.shape[1])
            px = np.asarray(cv2.resize(whole, (width, h), interpolation=cv2.INTER_AREA), np.uint8)
            lens = Camera(width, h, 0.8 * width, 0.8 * width, (width - 1) / 2, (h - 1) / 2, np.zeros(5), mount)
            for name in ("thesis", "icao", "h", "x"):
                scene = PadScene(px, None, Rotation.identity(), 0.0, 0.0, "photo")
                frames.add("strange photograph", scene, lens, load_pad(name), name)


def best(rows: list[Row], name: str) -> dict[int, Row]:
    """Return the best candidate of each frame by a score."""
    found: dict[int, Row] = {}
    for row in rows:
        if row.frame not in found or row.score(name) > found[row.frame].score(name):
            found[row.frame] = row
    return found


def area(rows: list[Row], name: str) -> float:
    """Return the area below the receiver operating characteristic of a score of candidates."""
    right, wrong = (np.array([r.score(name) for r in rows if r.right is of]) for of in (True, False))
    if not len(right) or not len(wrong):
        return math.nan
    order = np.searchsorted(np.sort(wrong), right) + np.searchsorted(np.sort(wrong), right, side="right")
    return float(order.mean() / (2 * len(wrong)))


def report(frames: Frames) -> Iterator[str]:
    rows = frames.rows
    yield f"{'found and right at 0.5, %, verified / both':24s}" + "".join(f"{f'{h:g} m':>10s}" for h in HEIGHTS_M)
    for condition in dict.fromkeys(c for g, c, _ in frames.count if g == "pad"):
        cells = ""
        for height_m in HEIGHTS_M:
            here = [r for r in rows if (r.group, r.condition, r.height_m) == ("pad", condition, height_m)]
            n = frames.count["pad", condition, height_m]
            share = [100 * sum(r.right and r.score(s) >= 0.5 for r in best(here, s).values()) / n for s in ("verified", "both")]
            wrong = [sum(not r.right and r.score(s) >= 0.5 for r in best(here, s).values()) for s in ("verified", "both")]
            cells += f"{'/'.join(f'{p:.0f}{chr(33) * w}' for p, w in zip(share, wrong, strict=True)):>10s}"
        yield f"{condition:24s}{cells}"
    groups: dict[str, list[Row]] = {"pad": [r for r in rows if r.group == "pad"]}
    groups |= {f"{g}: {c}": [r for r in rows if (r.group, r.condition) == (g, c)] for g, c, _ in frames.count if g != "pad"}
    yield f"{'frames':34s}{'n':>6s}" + "".join(f"{s:>10s}" for s in SCORES) + "   right at 0.5; wrong at 0.2, 0.5; highest wrong"
    for name, here in groups.items():
        n = sum(k for (g, c, _), k in frames.count.items() if g == name or f"{g}: {c}" == name)
        figures = []
        for s in SCORES:
            top = best(here, s).values()
            wrong_scores = [r.score(s) for r in top if not r.right]
            counts = sum(r.right and r.score(s) >= 0.5 for r in top), *(sum(v >= at for v in wrong_scores) for at in (0.2, 0.5))
            figures.append(f"{counts[0]}; {counts[1]}, {counts[2]}; {max(wrong_scores, default=0.0):.2f}")
        if any(cell != "0; 0, 0; 0.00" for cell in figures):
            yield f"{name:34s}{n:6d}   " + "   ".join(figures)
    searched_rows = [r for r in rows if r.group in ("pad", "none", "other pad")]
    for text, some in (
        ("all candidates", searched_rows),
        ("verified 0.1 or more", [r for r in searched_rows if r.verified >= 0.1]),
    ):
        both = ", ".join(f"{s} {area(some, s):.4f}" for s in SCORES)
        yield f"area, {text}: {sum(r.right for r in some)} right and {sum(not r.right for r in some)} wrong: {both}"


def cost(network: SecondOpinion) -> str:
    """Return the least processor time of a second opinion, in floors."""
    camera, pad = load_camera("sim"), load_pad("thesis")
    scene = pad_scene(np.random.default_rng([_SEED]), camera, pad, 3.0, "light")
    pyramid, least, floor = Pyramid(scene.px), math.inf, math.inf
    assert scene.truth is not None
    for _ in range(60):
        began = time.process_time_ns()
        patch = patch_of(pyramid, camera, pad, scene.truth)
        assert patch is not None
        network.of_patch(patch)
        least = min(least, (time.process_time_ns() - began) * 1e-6)
        floor = min(floor, floor_ms(scene.px))
    return f"a second opinion: {least:.2f} ms, {least / floor:.1f} floors"


def tile(row: Row) -> NDArray[np.uint8]:
    """Return a candidate's patch beside its drawing, with both opinions."""
    frame = np.where(row.patch.seen[:, :, None], row.patch.frame, np.uint8(255))
    pair = cv2.resize(np.hstack([frame, row.patch.drawn[:, :, :3]]), (384, 192), interpolation=cv2.INTER_NEAREST)
    canvas = np.zeros((230, 384, 3), np.uint8)
    canvas[:192] = pair
    text = f"{'right' if row.right else 'wrong'} {row.verified:.2f} {row.learned:.2f} {row.condition} {row.height_m:g}"
    cv2.putText(canvas, text, (3, 215), 0, 0.5, (255, 255, 255), 1)
    return canvas


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=4, help="at each height in each condition")
    parser.add_argument("--empty", type=int, default=400, help="frames without a pad")
    parser.add_argument("--others", type=int, default=4, help="frames of each pair of pads")
    parser.add_argument("--network", default="", help="ONNX file (default: the shipped one)")
    parser.add_argument("--keep", type=Path, help="write every candidate's figures as CSV")
    parser.add_argument("--sheet", type=Path, help="write the worst candidates of both opinions into this folder")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    network = second_opinion(args.network, "--network")
    frames = Frames(network)
    photographs(frames)
    other_pads(frames, args.others)
    without_pad(frames, args.empty)
    with_pad(frames, args.frames)
    print(cost(network))
    for line in report(frames):
        print(line)
    if args.keep is not None:
        with args.keep.open("w", newline="") as file:
            out = csv.writer(file)
            out.writerow(["group", "condition", "height_m", "frame", "right", "verified", "learned"])
            out.writerows([r.group, r.condition, r.height_m, r.frame, int(r.right), r.verified, r.learned] for r in frames.rows)
    if args.sheet is not None:
        args.sheet.mkdir(parents=True, exist_ok=True)
        rows = frames.rows
        lost = sorted((r for r in rows if r.right and r.verified >= 0.5), key=lambda r: r.learned)
        kept = sorted((r for r in rows if not r.right and r.verified >= 0.1), key=lambda r: -r.score("both"))
        taken = sorted((r for r in rows if not r.right and r.verified >= 0.1), key=lambda r: r.learned)
        for name, some in (("lost", lost), ("false_kept", kept), ("false_taken", taken)):
            if some:
                sheet([tile(r) for r in some[:20]], args.sheet / f"{name}.png")


if __name__ == "__main__":
    main()
