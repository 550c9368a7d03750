"""Measure the time of a rendered frame by height, on one thread: `python benches/render.py [--frames N]`.

It runs from the repository's root. Times are processor time, the smallest of several rounds, beside a floor measured in between:
one BGR to HSV conversion and one inRange of a frame of the same size.
"""

import argparse
import sys
import time
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from estimator.contracts.geometry import Rotation  # noqa: E402
from estimator.vision.camera import Camera  # noqa: E402
from estimator.vision.pad import Pad  # noqa: E402
from sitl.camera.camera import Exposure, Renderer  # noqa: E402
from sitl.camera.surroundings import Deck, Surroundings  # noqa: E402
from sitl.sea.sea import SHELTERED_SLIGHT, Waves  # noqa: E402
from sitl.vessel.seakeeping import FERRY  # noqa: E402
from sitl.vessel.vessel import Mooring, Vessel  # noqa: E402

HEIGHTS_M = (0.3, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 30.0)


def table(path: str) -> dict[str, Any]:
    with (ROOT / "configs" / path).open("rb") as file:
        return tomllib.load(file)


def shot_over_pad(vessel: Vessel, t_s: float, height_m: float) -> Exposure:
    """Return an exposure as in a landing: two degrees of tilt, half a metre a second, a slow turn."""
    pad = vessel.pad_at(t_s)
    R = Rotation.from_rpy(0.02, -0.03, 0.6)
    away = np.array([0.1 * height_m if height_m > 0.5 else 0.0, -0.05 * height_m, -height_m])
    p = pad.p_ned + away - R @ np.array([0.15, 0.0, 0.0])
    v = np.array([0.3, -0.2, 0.3]) * min(1.0, height_m / 2)
    return Exposure(t_s, R, p, pad.rotation(), pad.p_ned, v, np.array([0.05, -0.05, 0.1]), pad.v_ned, pad.w)


def milliseconds(call: Callable[[], object], rounds: int) -> tuple[float, float]:
    """Return the smallest and the median processor time of one call, ms."""
    took = []
    for _ in range(rounds):
        began = time.process_time_ns()
        call()
        took.append((time.process_time_ns() - began) * 1e-6)
    return min(took), float(np.median(took))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=60, help="rounds at each height")
    rounds = parser.parse_args().frames
    cv2.setNumThreads(1)
    camera = Camera.from_mapping(table("cameras/sim.toml"))
    pad = Pad.from_mapping(table("pads/thesis.toml"))
    waves = Waves.draw(SHELTERED_SLIGHT, 3, towards_rad=0.8)
    vessel = Vessel(FERRY, waves, heading_rad=0.3, mooring=Mooring(), seeds=3)
    began = time.perf_counter()
    renderer = Renderer(camera, pad, Surroundings(Deck.of(FERRY), waves))
    print(f"building a renderer: {(time.perf_counter() - began) * 1e3:.0f} ms")
    rng = np.random.default_rng(0)
    image = renderer.render(shot_over_pad(vessel, 0.0, 3.0), rng)
    print("height_m  min_ms  median_ms  ratio_to_floor")
    for height_m in HEIGHTS_M:
        shot = shot_over_pad(vessel, 12.3, height_m)
        renderer.render(shot, rng)
        floor = milliseconds(lambda: cv2.inRange(cv2.cvtColor(image, cv2.COLOR_BGR2HSV), (52, 217, 38), (68, 255, 153)), rounds)[
            0
        ]
        best, median = milliseconds(partial(renderer.render, shot, rng), rounds)
        print(f"{height_m:8.1f}  {best:6.2f}  {median:9.2f}  {median / floor:14.1f}")


if __name__ == "__main__":
    main()
