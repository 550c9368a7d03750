"""Compare our search and track of pads with fiducials with OpenCV's own pose on the same frames, by height.

    python -m benches.fiducials --frames 40

One thread, 640x360, f = 374.67 px, a worn deck, the renderer's sensor noise and blur, tilts of `--tilt` degrees at one sigma
that are known. OpenCV's pose is solvePnP (IPPE) from the sub-pixel corners of all of the pad's markers that its detector
reads with the whole dictionary. Figures are of the vector from camera to pad, written with the true attitude: its range,
lateral standard deviation (root mean square of both axes) and heading. The track begins at a belief that is off by 0.4 % of
the range, 2 cm at least, at one sigma. Ours counts as found with confidence 0.5 or more, OpenCV's when the error is below a
tenth of the height. Times are processor time, medians; ratios are to a floor measured in the same run: one BGR to HSV
conversion and one inRange of the whole frame.
"""

import argparse
import math
import os
import sys

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import cv2  # noqa: E402
import numpy as np  # noqa: E402
from numpy.typing import NDArray  # noqa: E402

from benches.registration import milliseconds_of_floor  # noqa: E402
from benches.vision import Tally, of_pose, timed  # noqa: E402
from estimator.contracts.estimates import RelativeState  # noqa: E402
from estimator.contracts.geometry import F64, Rotation  # noqa: E402
from estimator.contracts.samples import Attitude  # noqa: E402
from estimator.vision.camera import Camera  # noqa: E402
from estimator.vision.fiducial import dictionary_of  # noqa: E402
from estimator.vision.options import TrackerOptions  # noqa: E402
from estimator.vision.pad import Pad  # noqa: E402
from estimator.vision.pad_pose import PadPose  # noqa: E402
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track  # noqa: E402
from sitl.camera.light import Sensor  # noqa: E402
from sitl.camera.surroundings import Surroundings  # noqa: E402
from tests.support.pad_images import STAMP  # noqa: E402
from tests.support.pad_views import RenderedView, Stage  # noqa: E402
from tests.support.plain_light import FLAT  # noqa: E402
from tests.support.shipped import shipped_camera, shipped_pad  # noqa: E402

HEIGHTS_M = (0.3, 0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0)


class OpenCvPose:
    """The pose of a pad by OpenCV alone."""

    def __init__(self, pad: Pad, camera: Camera) -> None:
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        self._fiducials = {f.id: f for f in pad.markings.fiducials}
        self._detector = cv2.aruco.ArucoDetector(dictionary_of(pad.markings.fiducials[0].dictionary), parameters)
        self._camera = camera

    def __call__(self, px: NDArray[np.uint8]) -> PadPose | None:
        corners, ids, _ = self._detector.detectMarkers(cv2.cvtColor(px, cv2.COLOR_BGR2GRAY))
        read = [
            (c, int(i)) for c, i in zip(corners, [] if ids is None else np.ravel(ids), strict=True) if int(i) in self._fiducials
        ]
        if not read:
            return None
        p_pad = np.pad(np.concatenate([self._fiducials[i].corners_read() for _, i in read]), ((0, 0), (0, 1)))
        uv = np.concatenate([np.asarray(c, float).reshape(4, 2) for c, _ in read])
        _, rvec, tvec = cv2.solvePnP(p_pad, uv, self._camera.K, None, flags=cv2.SOLVEPNP_IPPE)
        return PadPose(Rotation(np.asarray(cv2.Rodrigues(rvec)[0], float)), np.asarray(tvec, float)[:, 0])


def belief(view: RenderedView, height_m: float, rng: np.random.Generator) -> RelativeState:
    """Return a belief that is off by what its covariance says."""
    sigma_m = max(0.02, 0.004 * height_m)
    cov = np.diag([*[sigma_m**2] * 3, *[0.01] * 3, math.radians(2.0) ** 2])
    d = view.d_body_pad_level + rng.normal(0.0, sigma_m, 3)
    yaw = view.yaw_rad + rng.normal(0.0, math.radians(2.0))
    return RelativeState(STAMP.measured_at, "ekf", d, np.zeros(3), yaw, cov, STAMP.measured_at, True)


def at_height(pad: Pad, height_m: float, frames: int, tilt_rad: float) -> tuple[dict[str, Tally], float]:
    """Return the tallies by method, and the floor in ms."""
    camera = shipped_camera("sim")
    config = TrackerConfig(camera, pad, TrackerOptions(method="registration"))
    stage, opencv = Stage(camera, pad, Surroundings(), FLAT, Sensor(exposure_s=0.0), seed=1), OpenCvPose(pad, camera)
    tallies = {name: Tally() for name in ("OpenCV", "searched", "tracked")}
    floor: list[float] = []
    rng = np.random.default_rng(2)
    for _ in range(frames):
        view = stage.view(height_m, tilt_rad)
        level = Rotation.from_rpy(view.roll_rad, view.pitch_rad, 0.0)
        attitude, mount = Attitude(STAMP, level, 1e-8 * np.eye(3)), level @ camera.T_body_cam.t
        pose, ms = timed(lambda px=view.px: opencv(px))  # type: ignore[misc]
        tallies["OpenCV"].add(None if pose is None else of_pose(view, camera, pose), view, ms)
        for name, start in (("searched", None), ("tracked", belief(view, height_m, rng))):
            track(config, TrackerMemory(), view.frame(), attitude, start)
            (seen, _), ms = timed(lambda v=view, a=attitude, b=start: track(config, TrackerMemory(), v.frame(), a, b))  # type: ignore[misc]
            sure = seen.selected if seen.selected is not None and seen.selected.confidence >= 0.5 else None
            found: tuple[F64, float | None] | None = None if sure is None else (sure.d_body_pad_level - mount, sure.yaw_rad)
            tallies[name].add(found, view, ms)
        floor.append(milliseconds_of_floor(view.px))
    return tallies, float(np.median(floor))


HEADER = ["pad", "height m", "method", "found", "lateral mm", "range mm", "range bias mm", "heading deg", "ms", "x floor"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=20, help="frames at each height")
    parser.add_argument("--heights", default=",".join(map(str, HEIGHTS_M)), help="metres, with commas")
    parser.add_argument("--tilt", type=float, default=3.0, help="standard deviation of roll and of pitch, degrees")
    parser.add_argument("--pads", default="apriltag_nest,aruco_board", help="shipped pads, with commas")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    print("| " + " | ".join(HEADER) + " |\n|" + "---|" * len(HEADER))
    for name in args.pads.split(","):
        for height_m in map(float, args.heights.split(",")):
            tallies, floor_ms = at_height(shipped_pad(name), height_m, args.frames, math.radians(args.tilt))
            for method, tally in tallies.items():
                print("| " + " | ".join([name, f"{height_m:g}", method, *tally.row(floor_ms)]) + " |", flush=True)


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    os._exit(0)
