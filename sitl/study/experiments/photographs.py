"""The photographs of the real pad, in place of the thesis' outdoor flight (section 5.2), whose images were not published."""

import csv
import math
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from estimator.contracts.errors import BadInput, file_errors
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.pad import Pad
from estimator.vision.track.tracker import PadTracker

_STAMP = Stamp(MonoNs(0), MonoNs(0), 0.001, "arrival")
_TILT_SIGMA_RAD = math.radians(0.3)


class Photographs(NamedTuple):
    """Conditions under which the photographs were read."""

    number: int
    found: dict[str, int]
    """Number of photographs with an estimate, by method."""
    median_percent: dict[str, float]
    """Median error of the position, in percent of the range."""
    p95_percent: dict[str, float]


def read_photographs(folder: Path, camera: Camera, pad: Pad) -> Photographs:
    """Search every photograph by itself and compare it with the pose that was solved from hand labels.

    Args:
        folder: holds `pose.csv` (`frame`, `rvec_x..z`, `t_cam_x..z_m`) and `images`.

    Raises:
        BadInput: the folder does not hold them, or a photograph cannot be read.
    """
    with file_errors(f"--photos {folder}"), (folder / "pose.csv").open(encoding="utf-8") as text:
        rows = list(csv.DictReader(text))
    errors: dict[str, list[float]] = {}
    for row in rows:
        path = folder / "images" / row["frame"]
        px = cv2.imread(str(path))
        if px is None:
            raise BadInput(f"{path}: not an image that can be read")
        R_cam_pad = Rotation.from_rotvec([float(row[f"rvec_{k}"]) for k in "xyz"])
        t = np.array([float(row[f"t_cam_{k}_m"]) for k in "xyz"])
        roll, pitch, _ = (R_cam_pad.inv @ camera.T_body_cam.R.inv).rpy_rad
        R_level_body = Rotation.from_rpy(roll, pitch, 0.0)
        true = (R_level_body @ camera.T_body_cam.R) @ t
        attitude = Attitude(_STAMP, R_level_body, np.eye(3) * _TILT_SIGMA_RAD**2)
        tracker = PadTracker(camera, pad, method="fused")
        best = tracker.track(np.asarray(px, np.uint8), stamp=_STAMP, attitude=attitude)
        methods = {} if tracker.detection is None else tracker.detection.methods
        for name, seen in (*methods.items(), ("best", best)):
            if seen is not None:
                off = float(np.linalg.norm(seen.d_body_pad_level - true) / np.linalg.norm(true))
                errors.setdefault(name, []).append(100.0 * off)
    return Photographs(
        len(rows),
        {name: len(off) for name, off in errors.items()},
        {name: float(np.median(off)) for name, off in errors.items()},
        {name: float(np.percentile(off, 95)) for name, off in errors.items()},
    )
