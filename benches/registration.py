"""Registration on rendered frames against the Cramer-Rao bound, by height: `python benches/registration.py [--frames N]`.

One thread, 640x360, f = 374.67 px, the renderer's sensor noise and blur, 1.5 degrees of tilt with the attitude given, an even
grey floor round the pad (`--scene` for a deck at sea with worn paint, shade and uneven light). Starts are off by half a pixel.
The bound takes blur, paints and tilt as known. "x y z: 1" is the mean of each axis' squared error over its variance, 1 where the
covariance is right. Times are processor time beside a floor measured in the same run: one BGR to HSV
conversion and one inRange. `--tones` flies the same approach, 8 m to 1 m, through cameras of other tone curves, tracked.
"""

import argparse
import math
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import cv2  # noqa: E402
import numpy as np  # noqa: E402
from scipy.stats import chi2  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from estimator.contracts.estimates import RelativeState  # noqa: E402
from estimator.contracts.geometry import F64, Rotation  # noqa: E402
from estimator.contracts.samples import Attitude, Frame  # noqa: E402
from estimator.contracts.time import MonoNs, Stamp  # noqa: E402
from estimator.vision.pad_pose import PadPose  # noqa: E402
from estimator.vision.register.registration import RegistrationOptions, register  # noqa: E402
from estimator.vision.srgb import LINEAR_LIGHT  # noqa: E402
from estimator.vision.tone import STEP  # noqa: E402
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track  # noqa: E402
from sitl.camera.camera import Exposure  # noqa: E402
from sitl.camera.light import Light, Sensor  # noqa: E402
from sitl.camera.surroundings import Surroundings  # noqa: E402
from tests.support.bound import information, sigmas  # noqa: E402
from tests.support.pad_views import PLAIN, Stage, error, pad_error  # noqa: E402
from tests.support.plain_light import FLAT  # noqa: E402
from tests.support.shipped import shipped_camera, shipped_pad  # noqa: E402

TONES: dict[str, Callable[[F64], F64]] = {
    "sRGB": lambda x: np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055),
    "linear": lambda x: x,
    "clipped": lambda x: np.minimum(TONES["sRGB"](1.8 * x), 1.0),
    "gamma 2.2": lambda x: np.asarray(x ** (1 / 2.2)),
    "gamma 1.8": lambda x: np.asarray(x ** (1 / 1.8)),
    "gamma 2.6": lambda x: np.asarray(x ** (1 / 2.6)),
    "BT.709": lambda x: np.where(x < 0.018, 4.5 * x, 1.099 * x**0.45 - 0.099),
    "s-curve": lambda x: TONES["sRGB"](x) + 0.06 * np.sin(math.tau * (TONES["sRGB"](x) - 0.5)),
}
"""Values, 0..1, by light, 0..1, of cameras. Source: IEC 61966-2-1, ITU-R BT.709."""
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
    table = LINEAR_LIGHT
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


def tones(frames: int) -> None:
    """Print for each tone curve the range's error at 1 m after an approach, what was learnt, and the least confidence."""
    camera, pad = shipped_camera("sim"), shipped_pad("thesis")
    stage, last = Stage(camera, pad, Surroundings(), Light(), Sensor(exposure_s=0.0, psf_sigma_px=0.6)), 15
    renderer, well, noise = stage.renderer, stage.sensor.full_well_e, stage.sensor.read_noise_e
    memories, off_mm = dict.fromkeys(TONES, TrackerMemory()), {name: list[float]() for name in TONES}
    least = dict.fromkeys(TONES, 1.0)
    for k, height_m in enumerate([*np.exp(np.linspace(math.log(8.0), 0.0, frames)), *np.ones(last)]):
        view = stage.view(float(height_m))
        light = renderer.radiance(view.shot).astype(float)
        light += stage.rng.normal(size=light.shape) * np.sqrt(np.maximum(light, 0.0) / well + (noise / well) ** 2)
        at = MonoNs(10**9 + 205_000_000 * k)
        stamp, sigma_m = Stamp(at, at, 0.0, "sim"), max(0.002, 0.0008 * float(height_m))
        cov, d = np.diag([sigma_m**2] * 3 + [0.01] * 3 + [4e-4]), view.d_body_pad_level
        belief = RelativeState(at, "ekf", d + stage.rng.normal(0.0, sigma_m, 3), np.zeros(3), view.yaw_rad, cov, at, True)
        attitude = Attitude(stamp, Rotation.from_rpy(view.roll_rad, view.pitch_rad, 0.0), np.eye(3) * 1e-8)
        for name, values in TONES.items():
            px = np.asarray(np.rint(255.0 * np.clip(values(np.clip(light, 0.0, 1.0)), 0.0, 1.0)), np.uint8)
            frame, tracker = Frame(stamp, k, px), TrackerConfig(camera, pad)
            seen, memories[name] = track(tracker, memories[name], frame, attitude, belief)
            least[name] = min(least[name], 0.0 if seen.selected is None else seen.selected.confidence)
            if seen.selected is not None and k >= frames:
                off_mm[name].append(1e3 * float(np.linalg.norm(seen.selected.d_body_pad_level) - np.linalg.norm(d)))
    for name, off in off_mm.items():
        print(
            f"{name:10s} {np.median(off):+.3f} mm, sd {np.std(off):.3f}; tone {1.0 + STEP * memories[name].tone.steps:.1f}, "
            f"least confidence {least[name]:.2f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=60, help="frames at each height")
    parser.add_argument("--heights", default=",".join(map(str, HEIGHTS_M)), help="metres, with commas")
    parser.add_argument("--blur", type=float, default=0.6, help="sigma of the lens' blur, px")
    parser.add_argument("--scene", action="store_true", help="deck, sea, worn paint, shade and uneven light")
    parser.add_argument("--coarse", action="store_true", help="search round starts that are off by 5 %% of the disc's radius")
    parser.add_argument("--tones", action="store_true", help="an approach through cameras of other tone curves instead")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    if args.tones:
        tones(args.frames)
        return
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
