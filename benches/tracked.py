"""Measure how often the pad is found where the filter expects it: `python -m benches.tracked [--frames N] [--pad P]`.

The pad tracker processes rendered frames with a prediction that is off by 0.4 % of the range along each axis at one sigma, 2 cm
at least, the heading by 0.02 rad; the attitude is known to a degree. The output is the frames with a confidence of 0.5 or more,
in %, and how many of all frames are off by more than a tenth of the height. With `--times` it is the processor time of the whole
look by height, in floors (one BGR to HSV conversion and one inRange), the smallest of 25 of both, the median of six frames. With
`--lost` it is that of frames without a pad where one is expected, at the median and at most.
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

from benches.acquisition import floor_ms  # noqa: E402
from estimator.contracts.estimates import RelativeState  # noqa: E402
from estimator.contracts.geometry import F64, Rotation  # noqa: E402
from estimator.contracts.samples import Attitude, Frame  # noqa: E402
from estimator.contracts.time import MonoNs, Stamp  # noqa: E402
from estimator.vision.options import TrackerOptions  # noqa: E402
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track  # noqa: E402
from estimator.vision.tracker_config import FRAME_WORK  # noqa: E402
from tests.support.pad_scenes import CONDITIONS, PadScene, empty_scene, load_camera, load_pad, pad_scene  # noqa: E402

HEIGHTS_M = (0.2, 0.3, 0.5, 10.0, 15.0, 20.0, 30.0)
TIMED_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
FRAMES_HZ = 30.0
READ_HZ, LOW_HZ, LOW_M = (3.75, 3.75, 5.0), 10.0, 1.0
"""Readings a second of the pad's surface, its surroundings and what passes, in a stream of `FRAMES_HZ`; of the last one, low."""
STAMP = Stamp(MonoNs(0), MonoNs(0), 0.0, "sim")
SIGMA_ATTITUDE_RAD, SIGMA_DECK_RAD, SIGMA_YAW_RAD = math.radians(1.0), math.radians(2.0), 0.02


def expected(
    scene: PadScene, R_level_body: Rotation, tracker: TrackerConfig, rng: np.random.Generator, sigma_m: float
) -> tuple[RelativeState, Attitude, F64]:
    """Return a belief, the attitude, and the true vector from body to pad in `level`, (3,) m."""
    assert scene.truth is not None
    mount = tracker.camera.T_body_cam
    d_level = R_level_body @ (mount.R @ scene.truth.t_cam_pad + mount.t)
    arrow = (R_level_body @ mount.R @ scene.truth.R_cam_pad).matrix[:, 0]
    belief = RelativeState(
        STAMP.measured_at, "ekf", d_level + rng.normal(0.0, sigma_m, 3), np.zeros(3),
        -math.atan2(arrow[1], arrow[0]) + rng.normal(0.0, SIGMA_YAW_RAD),
        np.diag([sigma_m**2] * 3 + [0.01] * 3 + [SIGMA_YAW_RAD**2]), STAMP.measured_at, True,
    )  # fmt: skip
    return belief, Attitude(STAMP, R_level_body, np.eye(3) * SIGMA_ATTITUDE_RAD**2), d_level


def looked(scene: PadScene, R_level_body: Rotation, tracker: TrackerConfig, rng: np.random.Generator) -> tuple[float, float]:
    """Return the confidence of the selected sighting, 0 for none, and its error over the height."""
    belief, attitude, d_level = expected(scene, R_level_body, tracker, rng, max(0.02, 0.004 * scene.height_m))
    seen = track(tracker, TrackerMemory(), Frame(STAMP, 0, scene.px), attitude, belief)[0].selected
    if seen is None:
        return 0.0, math.inf
    return seen.confidence, float(np.linalg.norm(seen.d_body_pad_level - d_level)) / scene.height_m


def times(tracker: TrackerConfig) -> None:
    """Print what a whole look costs, with a belief off by 0.08 % of the range at one sigma, 2 mm at least.

    The pad's surface, its surroundings and what passes are read in different frames: looks without any and with each are timed
    apart, and averaged over `FRAMES_HZ`. The surroundings are timed with new corners, which cost most.
    """
    for height_m in TIMED_M:
        ratios: list[list[float]] = []
        k = 0
        while len(ratios) < 6:
            rng = np.random.default_rng([77, k, round(10 * height_m)])
            k += 1
            scene = pad_scene(rng, tracker.camera, tracker.pad, height_m, "light", 0.1)
            if scene.R_level_body is None:
                continue
            belief, attitude, _ = expected(scene, scene.R_level_body, tracker, rng, max(0.002, 0.0008 * height_m))
            frame, rests = Frame(STAMP, 0, scene.px), TrackerMemory()
            for _ in range(4):
                _, rests = track(tracker, rests, frame, attitude, belief)
            before = MonoNs(STAMP.measured_at - round(1e9 / READ_HZ[0]))
            about, passing = rests.around, rests.passing
            key = None if about is None else replace(about, at=before, key_at=MonoNs(before - 10**10))
            was = None if passing is None else tuple(replace(each, at=before) for each in passing.readings)
            all_of = [
                rests, replace(rests, deck=None), replace(rests, around=key),
                replace(rests, passing=None if passing is None or was is None else replace(passing, readings=was)),
            ]  # fmt: skip
            least, floor = [math.inf] * len(all_of), math.inf
            for _ in range(25):
                for which, memory in enumerate(all_of):
                    began = time.process_time_ns()
                    track(tracker, memory, frame, attitude, belief)
                    least[which] = min(least[which], (time.process_time_ns() - began) * 1e-6)
                floor = min(floor, floor_ms(scene.px))
            ratios.append([ms / floor for ms in least])
        look, *reads = np.median(np.array(ratios), axis=0).tolist()
        more = [each - look for each in reads]
        mean = (
            sum(each * hz for each, hz in zip(more, (*READ_HZ[:2], LOW_HZ if height_m < LOW_M else READ_HZ[2]), strict=True))
            / FRAMES_HZ
        )
        print(
            f"{height_m:g} m: {look:.1f} floors; more for the pad's surface {more[0]:.1f}, its surroundings {more[1]:.1f}, "
            f"what passes {more[2]:.1f}, on average {mean:.2f}",
            flush=True,
        )


def lost(tracker: TrackerConfig, frames: int) -> None:
    """Print what whole looks cost, within a flight's budget of a search, where a pad is expected and none is there."""
    attitude = Attitude(STAMP, Rotation.from_rpy(0.02, -0.03, 0.4), np.eye(3) * SIGMA_ATTITUDE_RAD**2)
    for height_m in TIMED_M:
        sigma_m = max(0.02, 0.004 * height_m)
        belief = RelativeState(
            STAMP.measured_at, "ekf", np.array([0.0, 0.0, height_m]), np.zeros(3), 0.2,
            np.diag([sigma_m**2] * 3 + [0.01] * 3 + [SIGMA_YAW_RAD**2]), STAMP.measured_at, True,
        )  # fmt: skip
        ratios: list[float] = []
        for k in range(-1, frames):
            scene = empty_scene(np.random.default_rng([78, k + 1, round(10 * height_m)]), tracker.camera, height_m)
            memory = TrackerMemory()
            for _ in range(3):
                began = time.process_time_ns()
                _, memory = track(tracker, memory, Frame(STAMP, 0, scene.px), attitude, belief)
                took = (time.process_time_ns() - began) * 1e-6
                if k >= 0:  # the first frame builds what later ones have
                    ratios.append(took / floor_ms(scene.px))
        print(f"{height_m:g} m: {np.median(ratios):.0f} floors, at most {max(ratios):.0f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=12, help="at each height in each condition")
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument("--times", action="store_true", help="measure what a whole look costs instead")
    instead.add_argument("--lost", action="store_true", help="the same where the pad is believed and not there")
    parser.add_argument("--pad", default="thesis", help="name of a shipped pad (default: %(default)s)")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    tracker = TrackerConfig(load_camera("sim"), load_pad(args.pad), TrackerOptions(colours="simulator"))
    if args.times:
        times(tracker)
        return
    if args.lost:
        lost(replace(tracker, search_work=FRAME_WORK), args.frames)
        return
    wrong: list[str] = []
    print("called 0.5 or more, % " + "".join(f"{h:>7g} m" for h in HEIGHTS_M))
    for condition in CONDITIONS:
        cells = ""
        for height_m in HEIGHTS_M:
            rng = np.random.default_rng([9, int(height_m * 10), CONDITIONS.index(condition)])
            sure = n = 0
            while n < args.frames:
                scene = pad_scene(rng, tracker.camera, tracker.pad, height_m, condition)
                if scene.R_level_body is None:
                    continue
                n += 1
                confidence, off = looked(scene, scene.R_level_body, tracker, rng)
                sure += confidence >= 0.5
                if confidence >= 0.5 and off > 0.1:
                    wrong.append(f"{condition} {height_m:g} m")
            cells += f"{100 * sure / n:9.0f}"
        print(f"{condition:22}{cells}", flush=True)
    print(f"of these a tenth of the height off or more: {len(wrong)} ({', '.join(wrong)})")


if __name__ == "__main__":
    main()
