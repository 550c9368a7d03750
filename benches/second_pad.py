"""Count tracked looks at another pad, 1.1 m aside: `python -m benches.second_pad [--looks N] [--seed S]`.

The second pad is the first one's picture, moved over the deck and turned: in the same paint and light. The pad tracker looks
for the first one at 0.8 to 15 m, in all conditions of `pad_scenes` but those in which the frame's edge cuts the pad, with a
prediction as in `benches.tracked`. A sighting of the tracked pad that reaches the estimator (`estimator.min_confidence`) and lies
nearer to the second pad than to the first went over; of these shows the second one what lies nearer to it by its own covariance,
too. Then follows how many sightings, with those that are reported as elsewhere, the check of a place (`estimator.integrity`) lets
into the filter of a flight that followed the first pad half a second before although they are nearer to the second.
"""

import argparse
import math
import sys
from pathlib import Path

import cv2
import numpy as np
from msgspec.structs import replace

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benches.tracked import STAMP, expected  # noqa: E402
from estimator.contracts.estimates import RelativeState, Sighting  # noqa: E402
from estimator.contracts.geometry import F64  # noqa: E402
from estimator.contracts.samples import Attitude, Frame  # noqa: E402
from estimator.contracts.time import MonoNs, Stamp  # noqa: E402
from estimator.integrity.guard import IntegrityGuard, admit_sighting, judged  # noqa: E402
from estimator.options import EstimatorOptions  # noqa: E402
from estimator.vision.camera import Camera  # noqa: E402
from estimator.vision.options import TrackerOptions  # noqa: E402
from estimator.vision.pad_pose import PadPose  # noqa: E402
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track  # noqa: E402
from tests.support.pad_scenes import CONDITIONS, PadScene, load_camera, load_pad, pad_scene  # noqa: E402

ASIDE_M, REACH_M = 1.1, 0.41
HEIGHTS_M = (0.8, 15.0)


def with_second_pad(scene: PadScene, camera: Camera, rng: np.random.Generator) -> tuple[np.ndarray, F64]:
    """Return the frame with a second pad, and its place in `cam`, (3,) m."""
    assert scene.truth is not None
    way, turn = rng.uniform(0.0, math.tau, 2)
    shift = ASIDE_M * np.array([math.cos(way), math.sin(way)])
    c, s = math.cos(turn), math.sin(turn)
    on_deck = np.array([[c, -s, shift[0]], [s, c, shift[1]], [0.0, 0.0, 1.0]])
    plane = camera.K @ np.c_[scene.truth.R_cam_pad.matrix[:, :2], scene.truth.t_cam_pad]
    a = np.linspace(0.0, math.tau, 200)
    disc = PadPose(scene.truth.R_cam_pad, scene.truth.t_cam_pad).points(
        np.stack([shift[0] + REACH_M * np.cos(a), shift[1] + REACH_M * np.sin(a), 0.0 * a], axis=1)
    )
    covered = np.zeros(scene.px.shape[:2], np.uint8)
    if np.all(disc[:, 2] > 0.05):
        cv2.fillPoly(covered, [np.clip(camera.project(disc), -8000, 8000).astype(np.int32)], 255)
    moved = cv2.warpPerspective(scene.px, plane @ on_deck @ np.linalg.inv(plane), scene.px.shape[1::-1], flags=cv2.INTER_CUBIC)
    px = np.where(covered[:, :, None] > 0, moved, scene.px)
    return np.asarray(px, np.uint8), scene.truth.points(np.append(shift, 0.0)[None])[0]


def is_admitted(seen: Sighting, attitude: Attitude, belief: RelativeState, first_level: F64) -> bool:
    """Return whether the check of its place lets a sighting into the filter of a flight that follows the first pad."""
    guard = IntegrityGuard()
    for ago_ms in range(1000, 490, -33):
        at = MonoNs(STAMP.measured_at - 1_000_000 * ago_ms)
        before = replace(seen, stamp=Stamp(at, at, 0.0, "sim"), d_body_pad_level=first_level)
        guard, _ = admit_sighting(guard, before, attitude, None)
        guard = judged(guard, before, attitude, is_fused=True)
    return admit_sighting(guard, seen, attitude, belief)[1] is None


def squares(seen: Sighting, d_level: F64) -> float:
    """Return the squared distance of a place from a sighting, in standard deviations of the sighting."""
    apart = seen.d_body_pad_level - d_level
    return float(apart @ np.linalg.solve(seen.cov[:3, :3], apart))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--looks", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    camera = load_camera("sim")
    least = EstimatorOptions().min_confidence
    tracker = TrackerConfig(camera, load_pad("thesis"), TrackerOptions(colours="simulator"))
    names = [name for name in CONDITIONS if name != "cut"]
    looks = right = in_view = shown = reported = admitted = 0
    over: list[str] = []
    k = 0
    while looks < args.looks:
        rng = np.random.default_rng([args.seed, k, 0x2AD])
        height_m = math.exp(rng.uniform(*np.log(HEIGHTS_M)))
        name = names[k % len(names)]
        k += 1
        scene = pad_scene(rng, camera, tracker.pad, height_m, name)
        if scene.R_level_body is None:
            continue
        assert scene.truth is not None
        looks += 1
        px, second = with_second_pad(scene, camera, rng)
        uv = camera.project(second[None])[0]
        in_view += bool(0 < uv[0] < camera.width and 0 < uv[1] < camera.height)
        belief, attitude, first_level = expected(scene, scene.R_level_body, tracker, rng, max(0.02, 0.004 * height_m))
        mount = camera.T_body_cam
        second_level = scene.R_level_body @ (mount.R @ second + mount.t)
        found = track(tracker, TrackerMemory(), Frame(STAMP, 0, px), attitude, belief)[0]
        for seen in (found.selected, found.elsewhere):
            if seen is None or seen.confidence < least:
                continue
            off, off_second = (float(np.linalg.norm(seen.d_body_pad_level - d)) for d in (first_level, second_level))
            if off_second < off:
                admitted += is_admitted(seen, attitude, belief, first_level)
            if seen is found.elsewhere:
                reported += off_second < off
                continue
            if off_second < off:
                over.append(f"{name} {height_m:.1f} m ({seen.confidence:.2f}, seed {k - 1})")
                shown += squares(seen, second_level) < squares(seen, first_level)
            right += off < min(0.1 * height_m, off_second)
    print(
        f"{looks} looks, the second pad's centre in view in {in_view}: the first pad is followed in {right}; nearer to the other "
        f"{len(over)}, {shown} of them show it; the other is reported elsewhere in {reported}; past the check of a place go "
        f"{admitted}" + (": " + ", ".join(over[:12]) if over else "")
    )


if __name__ == "__main__":
    main()
