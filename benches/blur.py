"""Measure the effect of blur on the range: `python -m benches.blur [--frames N] [--write FOLDER]`.

Registration and the thesis' ellipse are compared on the same frames, from a sharp one to one blurred by 3 px (one sigma) by the
lens (Gaussian) or by the drone's motion during the exposure (a line with the same spread). The floor is even grey, with the
renderer's sensor noise, a known tilt of 1.5 degrees, and a start that is off by 0.3 px. The output is the bias in % of the range
with its standard error. `--write` draws it as blur.png.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import cv2  # noqa: E402
import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from estimator.vision.pose import OrientedCamera, solve  # noqa: E402
from estimator.vision.register.registration import RegistrationOptions, register  # noqa: E402
from estimator.vision.thesis.ellipse import find_disc  # noqa: E402
from estimator.vision.thesis.segmentation import COLOUR_SETS, segment  # noqa: E402
from sitl.camera.light import Sensor  # noqa: E402
from tests.support.pad_views import Stage  # noqa: E402
from tests.support.shipped import shipped_camera, shipped_pad  # noqa: E402

HEIGHTS_M = (1.0, 3.0, 6.0, 12.0)
BLURS_PX = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
EXPOSURE_S = 0.02
LENS_PX = 0.5
"""Sigma of the lens' own blur while motion is varied, px."""
By = Literal["lens", "motion"]


@dataclass(frozen=True, slots=True)
class Bias:
    """The bias of one method over some frames, in % of the range."""

    found: int
    mean: float
    error: float
    """Standard error of the mean."""

    @staticmethod
    def of(shares: list[float]) -> Bias:
        n = len(shares)
        if n < 2:
            return Bias(n, math.nan, math.nan)
        return Bias(n, 100 * float(np.mean(shares)), 100 * float(np.std(shares)) / math.sqrt(n))


def biases(by: By, height_m: float, blur_px: float, frames: int) -> tuple[Bias, Bias]:
    """Return the biases of registration and of the ellipse method."""
    camera, pad = shipped_camera("sim"), shipped_pad("thesis")
    if by == "lens":
        sensor, speed = Sensor(exposure_s=0.0, psf_sigma_px=blur_px), 0.0
    else:
        # The standard deviation of an evenly weighted line is its length over the root of 12.
        sensor, speed = (
            Sensor(exposure_s=EXPOSURE_S, psf_sigma_px=LENS_PX),
            blur_px * math.sqrt(12.0) * height_m / camera.fx / EXPOSURE_S,
        )
    stage = Stage(camera, pad, sensor=sensor)
    ours: list[float] = []
    thesis: list[float] = []
    for i in range(frames):
        way = math.tau * i / frames
        view = stage.view(height_m, v_body_ned=(speed * math.cos(way), speed * math.sin(way), 0.0))
        found = register(view.px, camera, pad, stage.start(view, 0.3), view.orientation(), RegistrationOptions(coarse=False))
        if found is not None:
            ours.append(float(np.linalg.norm(found.pose.t_cam_pad) / np.linalg.norm(view.pose.t_cam_pad)) - 1.0)
        seg, level = segment(view.px, COLOUR_SETS["simulator"]), OrientedCamera(camera, view.orientation())
        disc = None if seg is None else find_disc(seg, level, pad)
        fix = None if disc is None else solve(disc.marks, level)
        if fix is not None:
            thesis.append(float(np.linalg.norm(fix.d_body_pad_level) / np.linalg.norm(view.d_body_pad_level)) - 1.0)
    return Bias.of(ours), Bias.of(thesis)


def draw(rows: dict[tuple[By, float], list[tuple[Bias, Bias]]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 3.6), sharey=True, layout="constrained")
    kinds: tuple[By, ...] = ("lens", "motion")
    for axis, by in zip(axes, kinds, strict=True):
        for colour, height_m in zip(("C0", "C1", "C2", "C3"), HEIGHTS_M, strict=True):
            ours, thesis = zip(*rows[by, height_m], strict=True)
            axis.errorbar(BLURS_PX, [b.mean for b in ours], [b.error for b in ours], color=colour, label=f"{height_m:g} m")
            axis.plot(BLURS_PX, [b.mean for b in thesis], ":", color=colour)
        axis.axhline(0.0, color="grey", linewidth=0.6)
        axis.set_xlabel(f"blur by {'the lens' if by == 'lens' else 'motion'}, sigma in px")
    axes[0].set_ylabel("range bias, %")
    axes[0].set_ylim(-1.2, 1.6)
    axes[0].legend(title="registration; dotted: ellipse", fontsize=8, title_fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=12, help="frames for each height and blur")
    parser.add_argument("--write", type=Path, help="draw blur.png into this folder")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    rows: dict[tuple[By, float], list[tuple[Bias, Bias]]] = {}
    by: By
    for by in ("lens", "motion"):
        print(f"range bias in % by {by} blur, registration / ellipse; columns: sigma in px")
        print("height m " + "".join(f"{b:>22.1f}" for b in BLURS_PX))
        for height_m in HEIGHTS_M:
            rows[by, height_m] = [biases(by, height_m, b, args.frames) for b in BLURS_PX]
            cells = [
                f"{a.mean:+.3f}({a.error:.3f})/" + (f"{b.mean:+.2f}" if b.found > 1 else "none") for a, b in rows[by, height_m]
            ]
            print(f"{height_m:8g} " + "".join(f"{c:>22}" for c in cells), flush=True)
    if args.write is not None:
        draw(rows, args.write / "blur.png")


if __name__ == "__main__":
    main()
