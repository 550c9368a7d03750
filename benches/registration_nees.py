"""Measure how well registration's covariance holds by what surrounds the pad: `python -m benches.registration_nees`.

Registration starts half a pixel off, as from a track; the vehicle's attitude has an error of half a degree and the deck one of a
degree, both drawn at random and reported. The normalised squared errors are of registration's six (place and rotation in `cam`)
and of the four that a sighting has (place and heading in `level`). One outlier makes a mean, so the median and the 95th
percentile stand beside it, all divided by what chi-square gives: 1 is right, above 1 the sigma is too small, below 1 too large.
The band holds 95 % of such means.
"""

import argparse
import math
import sys
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import chi2

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from estimator.contracts.geometry import F64, wrap_pi  # noqa: E402
from estimator.contracts.samples import Frame  # noqa: E402
from estimator.contracts.time import MonoNs, Stamp  # noqa: E402
from estimator.vision.camera import Camera  # noqa: E402
from estimator.vision.pad import Pad  # noqa: E402
from estimator.vision.register.registration import RegistrationOptions, register  # noqa: E402
from estimator.vision.register.sighting import sighting_of  # noqa: E402
from tests.support.pad_scenes import load_camera, load_pad  # noqa: E402
from tests.support.pad_surroundings import SURROUNDINGS, SurroundedView, surrounded_view  # noqa: E402
from tests.support.pad_views import error, pad_error  # noqa: E402

HEIGHTS_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0)
TILTS_DEG = (2.0, 12.0, 25.0)
STAMP = Stamp(MonoNs(0), MonoNs(0), 0.0, "sim")
LOST = 100.0
"""NEES of six beyond which a frame is counted as an outlier, not averaged: its sigma is off by four."""


def measured(view: SurroundedView, camera: Camera, pad: Pad) -> F64 | None:
    """Return NEES of 6, of 4, and the squared normalised errors of x, y, range, heading, tilt (2), (8,); None if not found."""
    found = register(view.px, camera, pad, view.start, view.prior, RegistrationOptions(coarse=False))
    if found is None:
        return None
    e = error(found.pose, view.truth)
    seen = sighting_of(Frame(STAMP, 0, view.px), found.pose, found.cov, camera, view.prior, found.yaw_ambiguous, 1.0)
    turned = 0.0 if seen.yaw_rad is None else wrap_pi(seen.yaw_rad - view.yaw_rad)
    e4 = np.append(seen.d_body_pad_level - view.d_body_pad_level, turned)
    R = view.truth.R_cam_pad.matrix
    T = np.kron(np.eye(2), R.T)
    own = T @ found.cov @ T.T
    d, _ = pad_error(found.pose, view.truth)
    z2 = np.append(d, R.T @ e[3:]) ** 2 / np.diag(own)
    six = float(e @ np.linalg.solve(found.cov, e))
    return np.array([six, float(e4 @ np.linalg.solve(seen.cov, e4)), z2[0], z2[1], z2[2], z2[5], z2[3], z2[4]])


def row(name: str, values: list[F64], frames: int) -> str:
    v = np.array(values)
    kept = v[v[:, 0] < LOST]
    text = f"{name:34}{len(v):4d}/{frames:<4d}{len(v) - len(kept):4d} "
    for k, of in ((0, 6), (1, 4)):
        low, high = chi2.ppf((0.025, 0.975), of * len(kept)) / (of * len(kept))
        mean = kept[:, k].mean() / of
        mark = "-" if mean < low else "+" if mean > high else " "
        median, most = np.median(v[:, k]) / chi2.ppf(0.5, of), np.percentile(v[:, k], 95) / chi2.ppf(0.95, of)
        text += f"| {mean:5.2f}{mark}({low:.2f}..{high:.2f}) {median:5.2f} {most:5.2f} "
    return text + "| " + " ".join(f"{x:5.2f}" for x in kept[:, 2:].mean(axis=0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=24, help="at each height, surroundings and tilt")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pad", default="thesis", help="name of a shipped pad (default: %(default)s)")
    parser.add_argument("--heights", default=",".join(map(str, HEIGHTS_M)), help="metres, with commas")
    parser.add_argument("--surroundings", default=",".join(SURROUNDINGS), help="with commas")
    parser.add_argument("--tilts", action="store_true", help="a line for each tilt as well")
    parser.add_argument("--worst", type=int, default=0, help="name so many of the worst frames")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    camera, pad = load_camera("sim"), load_pad(args.pad)
    heights, worst = [float(h) for h in args.heights.split(",")], list[tuple[float, str]]()
    each = "mean (band)    median  95 % "
    print(f"{'':34}found    out | of 6: {each}| of 4: {each}| x y range heading tilt tilt")
    for name in args.surroundings.split(","):
        for height_m in heights:
            every = list[F64]()
            for tilt in TILTS_DEG:
                values = list[F64]()
                for k in range(args.frames):
                    rng = np.random.default_rng([args.seed, SURROUNDINGS.index(name), round(10 * height_m), round(tilt), k])
                    one = measured(surrounded_view(rng, camera, pad, name, height_m, math.radians(tilt)), camera, pad)
                    if one is not None:
                        values.append(one)
                        worst.append((float(one[0]), f"{name} {height_m:g} m {tilt:g} deg frame {k}"))
                if args.tilts:
                    print(row(f"{name} {height_m:g} m {tilt:g} deg", values, args.frames))
                every += values
            print(row(f"{name} {height_m:g} m", every, args.frames * len(TILTS_DEG)), flush=True)
    for nees, which in sorted(worst, reverse=True)[: args.worst]:
        print(f"{nees:8.1f} {which}")


if __name__ == "__main__":
    main()
