"""Measure how often the pad is found in a whole frame, by height and condition, with which calibration, and in what time.

`python -m benches.acquisition [--frames N] [--seed S] [--failures DIR] [--write DIR]` from the repository's root. A candidate is
registered and verified as the pad tracker does it. A pad counts as found if the result keeps the verification's claim (centre,
range, heading) with a confidence of 0.5 or more. Times are of acquisition alone, processor time on one thread, beside a floor
measured in between: one BGR to HSV conversion and one inRange of a frame of the same size. Half of the frames have no pad, and no
frame was used to fit the verification; `--write` leaves the reliability diagram of all of them as reliability.png. On the
photographs of the real pad, without attitude, the corners of the H are compared with hand labels.
"""

import argparse
import csv
import itertools
import math
import sys
import time
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from estimator.contracts.geometry import F64  # noqa: E402
from estimator.contracts.samples import Attitude  # noqa: E402
from estimator.contracts.time import MonoNs, Stamp  # noqa: E402
from estimator.vision.by_paint import WORTH_A_TRY  # noqa: E402
from estimator.vision.camera import Camera  # noqa: E402
from estimator.vision.detect.acquire import PadCandidate, acquire  # noqa: E402
from estimator.vision.detect.pyramid import FrameView, Pyramid  # noqa: E402
from estimator.vision.pad import Pad  # noqa: E402
from estimator.vision.pad_pose import PadPose  # noqa: E402
from estimator.vision.pose import Orientation  # noqa: E402
from estimator.vision.register.fit_verification import calibrated  # noqa: E402
from estimator.vision.register.registration import RegistrationOptions, register  # noqa: E402
from estimator.vision.verified import CLOSE, SURE, verified  # noqa: E402
from tests.support.pad_claims import keeps_claim  # noqa: E402
from tests.support.pad_scenes import (  # noqa: E402
    CONDITIONS,
    DATA,
    PadScene,
    empty_scene,
    load_camera,
    load_pad,
    pad_scene,
    photo_pose,
    visible_fraction,
)

HEIGHTS_M = (0.2, 0.3, 0.5, 0.8, 1.5, 3.0, 5.0, 10.0, 15.0, 20.0, 30.0)
BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.85, 0.95, 1.001)


def floor_ms(px: np.ndarray) -> float:
    """Return the time of one conversion to HSV and one mask, ms."""
    began = time.process_time_ns()
    cv2.inRange(cv2.cvtColor(px, cv2.COLOR_BGR2HSV), (52, 217, 38), (68, 255, 153))
    return (time.process_time_ns() - began) * 1e-6


def image_of(px: np.ndarray, camera: Camera, pad: Pad, truth: PadPose | None, best: PadCandidate | None, text: str) -> np.ndarray:
    """Return the frame with the candidate drawn in magenta; a far pad is enlarged."""
    im = px.copy()
    if best is not None:
        for points in (
            pad.circle(pad.disc_radius_m),
            pad.circle(pad.markings.ring_radius_m),
            pad.markings.h_corners(),
            pad.markings.arrowhead(),
        ):
            uv = camera.project(best.pose.points(points))
            if np.isfinite(uv).all():
                cv2.polylines(im, [np.clip(uv, -4000, 4000).astype(np.int32)], True, (255, 0, 255), 1)
    if truth is not None and truth.t_cam_pad[2] > 4.0:
        uv = camera.project(truth.t_cam_pad[None])[0]
        half = int(12 + 700 / truth.t_cam_pad[2])
        im = cv2.getRectSubPix(im, (2 * half, round(1.125 * half)), (float(uv[0]), float(uv[1])))
    im = cv2.resize(im, (480, 270), interpolation=cv2.INTER_NEAREST if im.shape[1] < 480 else cv2.INTER_AREA)
    cv2.putText(im, text, (3, 14), 0, 0.45, (0, 0, 255), 1)
    return im


def sheet(images: list[np.ndarray], path: Path) -> None:
    images = images[:40]
    while len(images) % 4:
        images.append(np.zeros_like(images[0]))
    cv2.imwrite(str(path), np.vstack([np.hstack(images[i : i + 4]) for i in range(0, len(images), 4)]))


def orientation_of(scene: PadScene) -> Orientation:
    if scene.R_level_body is None:
        return Orientation.of(None, math.radians(2.0))
    stamp = Stamp(MonoNs(0), MonoNs(0), 0.0, "sim")
    return Orientation.of(Attitude(stamp, scene.R_level_body, np.eye(3) * math.radians(1.0) ** 2), math.radians(2.0))


def registered(scene: PadScene, candidates: list[PadCandidate], camera: Camera, pad: Pad) -> tuple[float, bool] | None:
    """Register the candidates; return the best one's confidence, and whether it keeps the verification's claim."""
    out: list[tuple[float, bool]] = []
    orientation, pyramid = orientation_of(scene), Pyramid(scene.px)
    for c in candidates[:2]:
        if c.score < WORTH_A_TRY:
            break
        of = verified(FrameView(pyramid, camera, pad), c.pose, orientation, CLOSE, cut=c.cut)
        if of is not None:
            right = scene.truth is not None and keeps_claim(of.found.pose, scene.truth, camera, pad, of.found.yaw_ambiguous)
            out.append((calibrated(of.confidence), right))
            if of.confidence >= SURE:
                break
    return max(out, default=None)


def reliability(score: F64, right: NDArray[np.bool_], frames: int, path: Path) -> None:
    """Draw the fraction of right frames over the confidence, with 95 % intervals (Wilson, JASA 22, 1927)."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (top, low) = plt.subplots(2, 1, figsize=(5, 6), height_ratios=(3, 1), sharex=True, constrained_layout=True)
    top.plot((0, 1), (0, 1), "k--", lw=0.8)
    called, share, below, above, counts = [], [], [], [], []
    for a, b in itertools.pairwise(BINS):
        of = (score >= a) & (score < b)
        n = int(of.sum())
        counts.append(n)
        if n == 0:
            continue
        p = float(right[of].mean())
        middle, half = (p + 1.92 / n) / (1 + 3.84 / n), 1.96 * math.sqrt(p * (1 - p) / n + 0.96 / n**2) / (1 + 3.84 / n)
        called.append(float(score[of].mean()))
        share.append(p)
        below.append(max(0.0, p - (middle - half)))
        above.append(max(0.0, middle + half - p))
    top.errorbar(called, share, yerr=(below, above), fmt="o-", ms=4, lw=1.2, capsize=3)
    top.set_ylabel("share that is right")
    top.set_title(f"best registration of {frames} frames")
    top.grid(alpha=0.3)
    edges = np.array(BINS)
    low.bar(edges[:-1], counts, width=np.diff(edges), align="edge", edgecolor="white")
    low.set_yscale("log")
    low.set_ylabel("frames")
    low.set_xlabel("confidence")
    figure.savefig(path, dpi=90)
    plt.close(figure)


def photographs(failures: Path | None) -> None:
    folder = DATA / "pad_photos"
    if not folder.exists():
        print("photographs: not here")
        return
    camera, pad = load_camera("photos"), load_pad("printed")
    found = half_in_view = 0
    took, bad, corner_px, range_off = [], [], [], []
    with (folder / "corner_labels.csv").open() as file:
        # The labels run around the H in the opposite direction.
        labels = {row[0]: np.array(row[1:25], float).reshape(12, 2)[::-1] for row in itertools.islice(csv.reader(file), 1, None)}
    with (folder / "pose.csv").open() as file:
        for row in csv.DictReader(file):
            truth = photo_pose(row)
            px = np.asarray(cv2.imread(str(folder / "images" / row["frame"])), np.uint8)
            began = time.process_time_ns()
            candidates = acquire(px, camera, pad)
            took.append((time.process_time_ns() - began) * 1e-6)
            best = candidates[0] if candidates else None
            if visible_fraction(truth, camera, pad) < 0.5:
                continue
            half_in_view += 1
            good = best is not None and best.score >= 0.5 and keeps_claim(best.pose, truth, camera, pad, best.yaw_ambiguous)
            found += good
            if not good:
                bad.append(image_of(px, camera, pad, None, best, row["frame"]))
            result = None if best is None else register(px, camera, pad, best.pose, None, RegistrationOptions(coarse=False))
            if result is not None:
                ways = [result.pose, result.pose.turned(math.pi)][: 2 if result.yaw_ambiguous else 1]
                off = [np.hypot(*(camera.project(way.points(pad.markings.h_corners())) - labels[row["frame"]]).T) for way in ways]
                corner_px.append(min(float(np.median(d)) for d in off))
                range_off.append(100 * float(np.linalg.norm(result.pose.t_cam_pad - truth.t_cam_pad)) / truth.range_m)
    print(
        f"photographs with half of the pad in view: {found} of {half_in_view} found, "
        f"median {np.median(took):.1f} ms, no attitude; "
        f"{len(corner_px)} registered, corners of the H off the labels by {np.median(corner_px):.2f} px (median), "
        f"{np.percentile(corner_px, 95):.2f} (95 %); place off the labels' by {np.median(range_off):.2f} % of range, "
        f"{np.percentile(range_off, 95):.2f} % (95 %)"
    )
    if failures is not None and bad:
        sheet(bad, failures / "photographs.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=5, help="at each height in each condition")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--failures", type=Path, help="write sheets of failed frames into this folder")
    parser.add_argument("--write", type=Path, metavar="DIR", help="write reliability.png there")
    parser.add_argument("--attitude", choices=("mixed", "known", "none"), default="mixed")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    camera, pad = load_camera("sim"), load_pad("thesis")
    rng = np.random.default_rng([args.seed, 0xAC0])
    found: dict[tuple[str, float], list[bool]] = defaultdict(list)
    took: dict[float, list[float]] = defaultdict(list)
    floors: list[float] = []
    called: list[tuple[float, bool]] = []
    bad: list[np.ndarray] = []

    def look(scene: PadScene) -> tuple[PadCandidate | None, float, tuple[float, bool] | None]:
        R = scene.R_level_body if args.attitude != "none" else None
        began = time.process_time_ns()
        candidates = acquire(scene.px, camera, pad, R)
        ms = (time.process_time_ns() - began) * 1e-6
        sure = registered(scene, candidates, camera, pad)
        if sure is not None:
            called.append(sure)
        return (candidates[0] if candidates else None), ms, sure

    acquire(np.zeros((360, 640, 3), np.uint8), camera, pad)
    for height in HEIGHTS_M:
        for condition in CONDITIONS:
            for _ in range(args.frames):
                scene = pad_scene(rng, camera, pad, height, condition)
                while args.attitude == "known" and scene.R_level_body is None:
                    scene = pad_scene(rng, camera, pad, height, condition)
                best, ms, sure = look(scene)
                floors.append(floor_ms(scene.px))
                good = sure is not None and sure[1] and sure[0] >= 0.5
                found[condition, height].append(good)
                took[height].append(ms)
                if not good and best is not None:
                    output = "none" if sure is None else f"{sure[0]:.2f} {'right' if sure[1] else 'wrong'}"
                    reported = "" if scene.R_level_body else "no attitude"
                    text = f"{condition} {height} {output} vis {scene.visible:.2f} {reported}"
                    bad.append(image_of(scene.px, camera, pad, scene.truth, best, text))
                elif not good:
                    bad.append(image_of(scene.px, camera, pad, scene.truth, None, f"{condition} {height} none"))
    empty_ms = []
    for _ in range(len(HEIGHTS_M) * len(CONDITIONS) * args.frames):
        scene = empty_scene(rng, camera, float(np.exp(rng.uniform(math.log(0.3), math.log(30)))))
        empty_ms.append(look(scene)[1])
    floor = float(np.median(floors))
    print("found, %    " + "".join(f"{h:>7g} m" for h in HEIGHTS_M) + "     all")
    for condition in CONDITIONS:
        rates = [100 * float(np.mean(found[condition, h])) for h in HEIGHTS_M]
        print(f"{condition:12s}" + "".join(f"{r:8.0f} " for r in rates) + f"{np.mean(rates):8.1f}")
    print(
        "ms, median  " + "".join(f"{np.median(took[h]):8.1f} " for h in HEIGHTS_M) + f"  without a pad {np.median(empty_ms):.1f}"
    )
    print(
        "ms, 95 %    "
        + "".join(f"{np.percentile(took[h], 95):8.1f} " for h in HEIGHTS_M)
        + f"                {np.percentile(empty_ms, 95):.1f}"
    )
    print("over floor  " + "".join(f"{np.median(took[h]) / floor:8.1f} " for h in HEIGHTS_M) + f"  floor {floor:.2f} ms")
    score, right_ = np.array([c[0] for c in called]), np.array([c[1] for c in called])
    print("called      n   right   (best registration of each frame, with and without a pad)")
    for low, high in itertools.pairwise(BINS):
        k = (score >= low) & (score < high)
        if k.any():
            print(f"{low:.2f}-{min(high, 1):.2f} {int(k.sum()):6d}  {right_[k].mean():.3f}   (mean called {score[k].mean():.3f})")
    if args.write is not None:
        reliability(score, right_, len(score), args.write / "reliability.png")
    photographs(args.failures)
    if args.failures is not None:
        args.failures.mkdir(parents=True, exist_ok=True)
        for i in range(0, len(bad), 40):
            sheet(bad[i : i + 40], args.failures / f"failures_{i // 40}.png")


if __name__ == "__main__":
    main()
