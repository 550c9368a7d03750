"""Measure how a pad that is one letter on the bare deck is followed: python -m benches.followed_letters [--pad h].

Frames of the simulated ship's deck, from random places above the pad. The tracker has a belief that is off by a share of the
height along each axis at one sigma, 2 cm at least, and the attitude to a degree. The output is, by height, the frames with a
confidence of 0.5 or more that are right within 5 % of the height, and those that are not.
"""

import argparse
import math

import cv2
import numpy as np
from msgspec.structs import replace

from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.options import TrackerOptions
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track
from sitl.scenario.scenario import PadView, Scenario, camera_model, load, pad_model
from sitl.world.world import World

HEIGHTS_M = (2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 14.0)
STAMP = Stamp(MonoNs(0), MonoNs(0), 0.0, "sim")
RIGHT = 0.05
"""Share of the height within which a sighting is right."""


def seen_from(scenario: Scenario, height_m: float, seed: list[int], sigma: float) -> tuple[float, float]:
    """Return the confidence of what the tracker sees, 0 for nothing, and its error over the height."""
    rng = np.random.default_rng(seed)
    ahead, right = height_m * rng.uniform(-0.2, 0.2), height_m * rng.uniform(-0.3, 0.3)
    heading_deg = math.degrees(rng.uniform(-math.pi, math.pi))
    start = replace(scenario.start, height_m=height_m, pad_forward_m=ahead, pad_right_m=right, heading_deg=heading_deg)
    scenario = replace(scenario, start=start)
    world = World(scenario, int(rng.integers(1_000_000)))
    frame, truth = world.render(), world.truth()
    yaw_rad = truth.R_ned_body.rpy_rad[2]
    d_level = Rotation.from_rpy(0.0, 0.0, yaw_rad).inv @ (truth.p_pad_ned - truth.p_body_ned)
    sigma_m = max(0.02, sigma * height_m)
    belief = RelativeState(
        STAMP.measured_at, "ekf", d_level + rng.normal(0.0, sigma_m, 3), np.zeros(3),
        math.remainder(truth.R_ned_pad.rpy_rad[2] - yaw_rad, math.tau) + rng.normal(0.0, 0.02),
        np.diag([sigma_m**2] * 3 + [0.01] * 3 + [4e-4]), STAMP.measured_at, True,
    )  # fmt: skip
    config = TrackerConfig(camera_model(scenario), pad_model(scenario), TrackerOptions())
    attitude = Attitude(STAMP, truth.R_ned_body.without_heading(), math.radians(1.0) ** 2 * np.eye(3))
    seen = track(config, TrackerMemory(), Frame(STAMP, 0, frame.px), attitude, belief)[0].selected
    if seen is None:
        return 0.0, math.inf
    return seen.confidence, float(np.linalg.norm(seen.d_body_pad_level - d_level)) / height_m


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pad", default="h")
    parser.add_argument("--scenario", default="sea_state_4")
    parser.add_argument("--sigma", type=float, default=0.004, help="error of the belief over the height")
    parser.add_argument("--frames", type=int, default=14, help="at each height")
    parser.add_argument("--seed", type=int, default=5)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    scenario = replace(load(args.scenario), pad=PadView(args.pad))
    for height_m in HEIGHTS_M:
        looks = [seen_from(scenario, height_m, [args.seed, round(10 * height_m), k], args.sigma) for k in range(args.frames)]
        sure = [off for confidence, off in looks if confidence >= 0.5]
        right = sum(off <= RIGHT for off in sure)
        print(f"{height_m:4g} m: {right} of {args.frames} sure and right, {len(sure) - right} sure and wrong", flush=True)


if __name__ == "__main__":
    main()
