"""Render examples for the learned verification: `python -m benches.verifier_examples FOLDER [--chunks N] [--first N]`.

Half of the frames show a pad, half none. Pads are all shipped ones, and for a third of the frames the same in other paints;
lights, decks, hazes, grey cameras, dusk, blur and covers are random. Examples are what a search to the end proposes, registered,
and on frames with a pad poses near the true one, wrong poses, and the true pose of another pad. An example is right if its pose
keeps the verification's claim. A chunk is 50 frames with its own random numbers and one file; a file that is there is left as
it is.
"""

import argparse
import math
import multiprocessing
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benches.acquisition import orientation_of  # noqa: E402
from estimator.contracts.geometry import Rotation  # noqa: E402
from estimator.vision.camera import Camera  # noqa: E402
from estimator.vision.detect.acquire import acquire  # noqa: E402
from estimator.vision.detect.pyramid import FrameView, Pyramid  # noqa: E402
from estimator.vision.learned.second_opinion import SIDE, Patch, patch_of  # noqa: E402
from estimator.vision.pad import Pad  # noqa: E402
from estimator.vision.pad_information import alike_headings  # noqa: E402
from estimator.vision.pad_pose import PadPose  # noqa: E402
from estimator.vision.verified import CLOSE, verified  # noqa: E402
from tests.support.hard_light import dusk, grey, haze, infrared  # noqa: E402
from tests.support.pad_claims import keeps_claim  # noqa: E402
from tests.support.pad_scenes import CONDITIONS, HALF_HIDDEN, PadScene, empty_scene, load_camera, load_pad, pad_scene  # noqa: E402

PADS = ("thesis", "printed", "thesis", "icao", "helideck", "h", "x", "apriltag_nest", "aruco_board", "thesis")
"""The shipped pads, in the order in which frames take them; the one that search and verification were made for three times."""
CHUNK = 50
KINDS = ("searched", "near the truth", "wrong pose", "other pad")
_CANDIDATES = 3
_HEIGHTS_M = (0.25, 30.0)


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """A candidate with its truth and its source."""

    patch: Patch
    right: bool
    kind: int
    """Index into `KINDS`."""
    confidence: float
    """Confidence of the verification without learning; nan for a pose that no search proposed."""
    target: int
    """Index into `PADS` of the pad that was looked for."""
    height_m: float
    with_pad: bool


def repainted(name: str, seed: int) -> Pad:
    """Return a shipped pad in other paints, each unlike the ones before it; in its own with seed 0."""
    pad = load_pad(name)
    if seed == 0:
        return pad
    rng = np.random.default_rng([seed, 0x9A17])
    paints: list[tuple[int, int, int]] = []
    while len(paints) < len(pad.paints):
        grey_level = int(rng.integers(15, 245))
        rgb = (grey_level,) * 3 if rng.uniform() < 0.4 else tuple(int(c) for c in rng.integers(10, 250, 3))
        if all(math.dist(rgb, other) > 110.0 for other in paints):
            paints.append((rgb[0], rgb[1], rgb[2]))
    return replace(pad, paints=tuple((name, rgb) for (name, _), rgb in zip(pad.paints, paints, strict=True)))


def changed(px: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return the frame through haze, at dusk, by a grey or infrared camera, out of focus; half of them as they are."""
    ways = (haze(float(rng.uniform(0.12, 0.6))), grey, dusk(0.1, float(rng.uniform(4.0, 20.0))), infrared)
    if rng.uniform() < 0.5:
        px = ways[int(rng.integers(len(ways)))](px, rng)
    if rng.uniform() < 0.2:
        px = np.asarray(cv2.GaussianBlur(px, (0, 0), float(rng.uniform(0.5, 2.5))), np.uint8)
    return px


@lru_cache
def _headings(name: str) -> int:
    """Return in how many headings a shipped pad looks the same, in whatever paints."""
    return max(1, alike_headings(load_pad(name)))


def right_pose(pose: PadPose, truth: PadPose, camera: Camera, pad: Pad, ambiguous: bool) -> bool:
    """Return whether a pose keeps the claim at any of the headings at which the pad looks the same."""
    turns = _headings(pad.name)
    return any(keeps_claim(pose.turned(math.tau * k / turns), truth, camera, pad, ambiguous) for k in range(turns))


def searched(
    scene: PadScene, camera: Camera, pad: Pad, most: int = _CANDIDATES, everything: bool = True
) -> Iterator[tuple[PadPose, Patch, float, bool]]:
    """Yield pose, patch, confidence and whether it is right of what a search proposes, registered as the pad tracker does it."""
    pyramid, orientation = Pyramid(scene.px), orientation_of(scene)
    for c in acquire(scene.px, camera, pad, scene.R_level_body, sure=2.0 if everything else 0.9)[:most]:
        of = verified(FrameView(pyramid, camera, pad), c.pose, orientation, CLOSE, cut=c.cut)
        patch = None if of is None else patch_of(pyramid, camera, pad, of.found.pose, of.cut)
        if of is not None and patch is not None:
            ok = scene.truth is not None and right_pose(of.found.pose, scene.truth, camera, pad, of.found.yaw_ambiguous)
            yield of.found.pose, patch, of.confidence, ok


def near(truth: PadPose, rng: np.random.Generator, pad: Pad) -> PadPose:
    """Return a pose as far from the true one as a registration may be."""
    shift = np.append(rng.normal(0.0, 0.012 * pad.disc_radius_m / 0.39, 2), 0.0) + truth.t_cam_pad * rng.normal(0.0, 0.008)
    return PadPose(truth.R_cam_pad @ Rotation.from_rotvec(rng.normal(0.0, math.radians(1.5), 3)), truth.t_cam_pad + shift)


def wrong(truth: PadPose, rng: np.random.Generator, pad: Pad) -> PadPose:
    """Return a pose that is off by a part of the pad, in size, or in heading."""
    way = int(rng.integers(3))
    if way == 0:
        a, far = rng.uniform(0.0, math.tau), pad.disc_radius_m * rng.uniform(0.2, 1.5)
        return PadPose(truth.R_cam_pad, truth.points(far * np.array([[math.cos(a), math.sin(a), 0.0]]))[0])
    if way == 1:
        return PadPose(truth.R_cam_pad, truth.t_cam_pad * math.exp(rng.choice([-1.0, 1.0]) * rng.uniform(0.18, 0.8)))
    least = math.radians(22.0)
    return truth.turned(float(rng.uniform(least, math.tau / _headings(pad.name) - least)))


def drawn_from_truth(
    scene: PadScene, camera: Camera, pad: Pad, target: int, rng: np.random.Generator
) -> Iterator[tuple[Patch, bool, int, int]]:
    """Yield patch, whether it is right, kind and target of poses that are made from the true one."""
    assert scene.truth is not None
    pyramid = Pyramid(scene.px)

    def seen_as(pose: PadPose, of: int, right: bool, kind: str) -> Iterator[tuple[Patch, bool, int, int]]:
        patch = patch_of(pyramid, camera, pad if of == target else load_pad(PADS[of]), pose)
        if patch is not None:
            yield patch, right, KINDS.index(kind), of

    if scene.visible > 0.3:
        for _ in range(2):
            yield from seen_as(near(scene.truth, rng, pad), target, True, "near the truth")
    for _ in range(3):
        yield from seen_as(wrong(scene.truth, rng, pad), target, False, "wrong pose")
    for other in rng.integers(len(PADS), size=2).tolist():
        if PADS[other] != PADS[target] and {PADS[other], PADS[target]} != {"thesis", "printed"}:
            yield from seen_as(near(scene.truth, rng, pad), other, False, "other pad")


def examples(chunk: int) -> list[Example]:
    """Return the examples of a chunk."""
    cv2.setNumThreads(1)
    camera, out = load_camera("sim"), []
    # A few pads for each chunk, since their drawings take longer to prepare than a frame.
    rng = np.random.default_rng([chunk, 0x1EA2])
    few = [(int(t), repainted(PADS[t], int(rng.integers(1, 1000)))) for t in rng.integers(len(PADS), size=3)]
    for i in range(CHUNK):
        rng = np.random.default_rng([chunk, i, 0x1EA2])
        height_m = float(np.exp(rng.uniform(*np.log(_HEIGHTS_M))))
        target, pad = few[int(rng.integers(len(few)))]
        if rng.uniform() < 0.65:
            pad = load_pad(PADS[target])
        with_pad = i % 2 == 0
        condition = str(rng.choice([*CONDITIONS, *HALF_HIDDEN]))
        scene = pad_scene(rng, camera, pad, height_m, condition) if with_pad else empty_scene(rng, camera, height_m)
        scene = replace(scene, px=changed(scene.px, rng))
        for _, patch, confidence, ok in searched(scene, camera, pad):
            out.append(Example(patch, ok, 0, confidence, target, height_m, with_pad))
        if scene.truth is not None:
            for patch, ok, kind, of in drawn_from_truth(scene, camera, pad, target, rng):
                out.append(Example(patch, ok, kind, math.nan, of, height_m, with_pad))
    return out


def write(folder: Path, chunk: int) -> int:
    """Write a chunk's examples, and return how many they are; 0 if they are there."""
    path = folder / f"chunk_{chunk:05d}.npz"
    if path.exists():
        return 0
    found = examples(chunk)
    np.savez(
        path,
        frame=np.array([e.patch.frame for e in found], np.uint8).reshape(-1, SIDE, SIDE, 3),
        seen=np.packbits(np.array([e.patch.seen for e in found], bool).reshape(-1, SIDE * SIDE), axis=1),
        drawn=np.array([e.patch.drawn for e in found], np.uint8).reshape(-1, SIDE, SIDE, 4),
        pixel=np.array([e.patch.pixel for e in found]),
        right=np.array([e.right for e in found], bool),
        kind=np.array([e.kind for e in found], np.uint8),
        confidence=np.array([e.confidence for e in found]),
        target=np.array([e.target for e in found], np.uint8),
        height_m=np.array([e.height_m for e in found]),
        with_pad=np.array([e.with_pad for e in found], bool),
    )
    return len(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--chunks", type=int, default=120)
    parser.add_argument("--first", type=int, default=0, help="chunk to begin with")
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    made = 0
    with multiprocessing.Pool(args.workers) as pool:
        for n in pool.imap_unordered(partial(write, args.folder), range(args.first, args.first + args.chunks)):
            made += n
            print(f"\r{made} examples", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)


if __name__ == "__main__":
    main()
