"""Registration on rendered frames against the Cramer-Rao bound, by height: `python benches/registration.py [--frames N]`.

One thread, 640x360, f = 374.67 px, the renderer's sensor noise and blur, 1.5 degrees of tilt with the attitude given, an even
grey floor round the pad (`--scene` for a deck at sea with worn paint, shade and uneven light). Starts are off by half a pixel.
The bound takes blur, paints and tilt as known. "x y z: 1" is the mean of each axis' squared error over its variance, 1 where the
covariance is right. Times are processor time beside a floor measured in the same run: one BGR to HSV
conversion and one inRange.
"""

import argparse
import math
import os
import sys
import time
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import cv2  # noqa: E402
import numpy as np  # noqa: E402
from scipy.stats import chi2  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from estimator.contracts.geometry import F64, Rotation  # noqa: E402
from estimator.vision.pad_pose import PadPose  # noqa: E402
from estimator.vision.register.registration import RegistrationOptions, register  # noqa: E402
from estimator.vision.srgb import light_table  # noqa: E402
from sitl.camera.camera import Exposure  # noqa: E402
from sitl.camera.light import Light, Sensor  # noqa: E402
from sitl.camera.surroundings import Surroundings  # noqa: E402
from tests.support.bound import information, sigmas  # noqa: E402
from tests.support.pad_views import PLAIN, Stage, error, pad_error  # noqa: E402
from tests.support.plain_light import FLAT  # noqa: E402
from tests.support.shipped import shipped_camera, shipped_pad  # noqa: E402

HEIGHTS_M = (0.2, 0.3, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0)


def bound(stage: Stage, height_m: float) -> F64:
    """Return the least standard deviations with the camera over the centre: (4,) x, y, range in m and heading in rad."""
    h, mount, sensor = height_m, stage.camera.T_body_cam, stage.sensor
    renderer = stage.renderer
    p_pad = np.array([0.0, 0.0, -2.0])

    def light(delta: F64) -> F64:
        R = Rotation.from_rpy(0.0, 0.0, 0.4)
        R_ned_pad = Rotation.from_rpy(0.0, 0.0, float(delta[3]))
        at = p_pad + np.array([0.0, 0.0, -1.0]) * h - R.matrix @ mount.t
        shot = Exposure(0.0, R, at, R_ned_pad, p_pad + delta[:3])
        return renderer.radiance(shot).astype(float)

    step_m = 0.05 * h / stage.camera.fx
    steps = [step_m, step_m, step_m * max(1.0, h / stage.pad.disc_radius_m), step_m / stage.pad.disc_radius_m]
    moves = np.diag(steps)
    mean = light(np.zeros(4))
    table = light_table(True)
    code = np.searchsorted(table, np.clip(mean, 0.0, 1.0)).clip(1, 255)
    rounding = (table[code] - table[code - 1]) ** 2 / 12.0
    # The floor moves with the pad but is no part of it.
    view = stage.view(h, tilt_rad=0.0, lateral=0.0, yaw_rad=0.4)
    rim = camera_mask(stage, view.pose, 1.0 + 4.0 * h / stage.camera.fx / stage.pad.disc_radius_m)
    var = np.maximum(mean, 0.0) / sensor.full_well_e + (sensor.read_noise_e / sensor.full_well_e) ** 2 + rounding
    before, after = [light(-m)[rim] for m in moves], [light(m)[rim] for m in moves]
    return sigmas(information(before, after, steps, var[rim]))


def camera_mask(stage: Stage, pose: PadPose, times: float) -> np.ndarray:
    """Return (H, W) whether a pixel sees a point within this many times the disc's radius."""
    mask = np.zeros((stage.camera.height, stage.camera.width), np.uint8)
    uv = stage.camera.project(pose.points(stage.pad.circle(times * stage.pad.disc_radius_m, 180)))
    cv2.fillPoly(mask, [np.round(uv).astype(np.int32)], 1)
    return mask.astype(bool)


def milliseconds_of_floor(px: np.ndarray) -> float:
    took = []
    for _ in range(40):
        began = time.process_time_ns()
        cv2.inRange(cv2.cvtColor(px, cv2.COLOR_BGR2HSV), (52, 217, 38), (68, 255, 153))
        took.append((time.process_time_ns() - began) * 1e-6)
    return min(took)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=60, help="frames at each height")
    parser.add_argument("--heights", default=",".join(map(str, HEIGHTS_M)), help="metres, with commas")
    parser.add_argument("--blur", type=float, default=0.6, help="sigma of the lens' blur, px")
    parser.add_argument("--scene", action="store_true", help="deck, sea, worn paint, shade and uneven light")
    parser.add_argument("--coarse", action="store_true", help="search round starts that are off by 5 %% of the disc's radius")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    camera, pad = shipped_camera("sim"), shipped_pad("thesis")
    sensor = Sensor(exposure_s=0.0, psf_sigma_px=args.blur)
    options = RegistrationOptions(coarse=args.coarse)
    print("height  found | lateral std mm: ours bound ratio | range std mm: ours bound ratio   bias | heading deg: ours bound  | "
          "NEES (95 % band)    90 % | x y z: 1 | ms  /floor")  # fmt: skip
    for height_m in map(float, args.heights.split(",")):
        stage = Stage(camera, pad, Surroundings() if args.scene else PLAIN, Light() if args.scene else FLAT, sensor)
        off, turn, nees, took = [], [], [], []
        squares: list[F64] = []
        for _ in range(args.frames):
            view = stage.view(height_m)
            off_px = 0.05 * pad.disc_radius_m * camera.fx / height_m if args.coarse else 0.5
            start, prior = stage.start(view, off_px), view.orientation()
            began = time.process_time_ns()
            found = register(view.px, camera, pad, start, prior, options)
            took.append((time.process_time_ns() - began) * 1e-6)
            if found is None:
                continue
            d, angle = pad_error(found.pose, view.pose)
            off.append(d * 1e3)
            turn.append(math.degrees(angle))
            e = error(found.pose, view.pose)
            nees.append(float(e @ np.linalg.solve(found.cov, e)))
            squares.append(e[:3] ** 2 / np.diag(found.cov)[:3])
        n = len(off)
        if n < 2:
            print(f"{height_m:6.1f}  {n:3d}/{args.frames}")
            continue
        best = bound(stage, height_m)
        std, mean = np.std(off, axis=0), np.mean(off, axis=0)
        lateral, lateral_best = (
            float(np.hypot(std[0], std[1])) / math.sqrt(2),
            1e3 * float(np.hypot(best[0], best[1])) / math.sqrt(2),
        )
        heading, heading_best = float(np.std(turn)), math.degrees(best[3])
        low, high = chi2.ppf((0.025, 0.975), 6 * n) / n
        inside = float(np.mean(np.array(nees) < chi2.ppf(0.9, 6)))
        floor = milliseconds_of_floor(view.px)
        print(
            f"{height_m:6.1f}  {n:3d}/{args.frames:<3d} | {lateral:14.4f} {lateral_best:8.4f} {lateral / lateral_best:7.1f}   |"
            f" {std[2]:12.4f} {1e3 * best[2]:8.4f} {std[2] / (1e3 * best[2]):6.1f} {mean[2]:8.3f} |"
            f" {heading:9.4f} {heading_best:8.4f} {heading / heading_best:5.1f} |"
            f" {np.mean(nees):6.2f} ({low:.1f}..{high:.1f}) {100 * inside:5.0f} % |"
            f" {' '.join(f'{v:4.1f}' for v in np.mean(squares, axis=0))} |"
            f" {np.median(took):5.2f} {np.median(took) / floor:5.1f}"
        )


if __name__ == "__main__":
    main()
