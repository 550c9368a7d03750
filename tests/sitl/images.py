"""Cameras, pads and shots that the tests of the renderer share."""

import math
import tomllib
from pathlib import Path

import cv2
import numpy as np
from msgspec.structs import replace

from estimator.contracts.geometry import F64, Rotation, Transform
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.pad.pad import Pad
from estimator.vision.pad.shapes import part_of
from sitl.camera.camera import Exposure

CONFIGS = Path(__file__).parents[2] / "configs"
MOUNT = Transform(Rotation.from_rpy(0.0, 0.0, math.pi / 2), np.array([0.15, 0.0, 0.0]))
PLAIN = Camera(640, 360, 374.67, 374.67, 319.5, 179.5, np.zeros(5), MOUNT)
BENT = Camera(640, 360, 400.0, 398.0, 315.2, 188.7, np.array([-0.16, 0.05, 0.003, -0.002, -0.004]), MOUNT)
BLACK, WHITE = (0, 0, 0), (255, 255, 255)


def pad(name: str, **colours: tuple[int, int, int]) -> Pad:
    with (CONFIGS / "pads" / f"{name}.toml").open("rb") as file:
        whole = Pad.from_mapping(tomllib.load(file))
    if not colours:
        return whole
    part = {"arrow": "ring", "letter": "h"}
    regions = tuple(replace(r, paint=part.get(part_of(r), part_of(r))) for r in whole.regions)
    return Pad(whole.name, tuple({"disc": BLACK, "ring": BLACK, "h": BLACK, "rim": BLACK, **colours}.items()), regions)


def shot(
    height_m: float, aside: tuple[float, float] = (0.0, 0.0), rpy: tuple[float, float, float] = (0.0, 0.0, 0.0), **more: F64
) -> Exposure:
    """Return the camera `height_m` over a pad that lies a little askew, its centre `aside` (in frame heights) off the axis."""
    R_ned_pad = Rotation.from_rpy(0.03, -0.02, 0.7)
    p_pad = np.array([3.0, -2.0, -0.5])
    R_ned_body = Rotation.from_rpy(*rpy)
    R_ned_cam = R_ned_body @ MOUNT.R
    d_cam_pad = np.array([aside[0] * height_m, aside[1] * height_m, height_m])
    p_body = p_pad - R_ned_cam @ d_cam_pad - R_ned_body @ MOUNT.t
    return Exposure(4.0, R_ned_body, p_body, R_ned_pad, p_pad, **more)


def pad_pose(s: Exposure, camera: Camera) -> PadPose:
    """Return the pad as the camera sees it in the middle of the exposure."""
    R_cam_ned = (s.R_ned_body @ camera.T_body_cam.R).inv
    return PadPose(R_cam_ned @ s.R_ned_pad, R_cam_ned @ (s.p_pad_ned - s.p_body_ned - s.R_ned_body @ camera.T_body_cam.t))


def project(camera: Camera, s: Exposure, p_pad: F64) -> F64:
    """(N, 2) px by OpenCV: the renderer's own geometry is not used."""
    R = (s.R_ned_body.matrix @ camera.T_body_cam.R.matrix).T
    p_cam_ned = s.p_body_ned + s.R_ned_body.matrix @ camera.T_body_cam.t
    rvec = cv2.Rodrigues(R @ s.R_ned_pad.matrix)[0]
    uv_px = cv2.projectPoints(p_pad, rvec, R @ (s.p_pad_ned - p_cam_ned), camera.K, camera.distortion)[0][:, 0]
    return uv_px.astype(np.float64)
