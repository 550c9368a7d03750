"""Rendered images of the pad on a deck, and of decks without it, and what a confident pose of the pad claims."""

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import Rotation
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.pad.pad import Pad
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import Light
from sitl.camera.surroundings import Decal, Deck, Surroundings


@dataclass(frozen=True, eq=False)
class Shown:
    px: NDArray[np.uint8]
    truth: PadPose
    """Pose of the pad, or of the place where it would be."""
    R_level_body: Rotation


@lru_cache(maxsize=64)
def _renderer(camera: Camera, pad: Pad | None, light: Light, decals: tuple[Decal, ...]) -> Renderer:
    return Renderer(camera, pad, Surroundings(Deck(), decals=decals), light)


def shown(
    camera: Camera, pad: Pad | None, height_m: float, *, aside: tuple[float, float] = (0.0, 0.0), yaw_rad: float = 0.4,
    tilt_rad: tuple[float, float] = (0.0, 0.0), light: Light | None = None, decals: tuple[Decal, ...] = (), seed: int = 0,
) -> Shown:  # fmt: skip
    """Return the camera `height_m` over the pad's plane, the pad's centre `aside` (in heights) off the lens' axis."""
    R_ned_body = Rotation.from_rpy(tilt_rad[0], tilt_rad[1], 0.7)
    R_ned_pad = Rotation.from_rpy(0.0, 0.0, 0.7 - yaw_rad)
    p_pad = np.array([2.0, -3.0, -0.6])
    R_ned_cam = R_ned_body.matrix @ camera.T_body_cam.R.matrix
    ray = np.array([aside[0], aside[1], 1.0])
    d_cam = ray * (height_m / float(R_ned_cam[2] @ ray))
    p_body = p_pad - R_ned_cam @ d_cam - R_ned_body @ camera.T_body_cam.t
    shot = Exposure(3.0, R_ned_body, p_body, R_ned_pad, p_pad, np.array([0.2, -0.1, 0.1]) * min(1.0, height_m))
    px = _renderer(camera, pad, light if light is not None else Light(), decals).render(shot, np.random.default_rng(seed))
    truth = PadPose(Rotation(R_ned_cam.T @ R_ned_pad.matrix), d_cam)
    return Shown(px, truth, R_ned_body.without_heading())


def covered(seen: Shown, camera: Camera, outline_m: NDArray[np.float64], bgr: tuple[int, int, int]) -> NDArray[np.uint8]:
    """Return the image with a part of the pad's plane (N, 2) m painted over."""
    uv = camera.project(seen.truth.points(np.c_[outline_m, np.zeros(len(outline_m))]))
    out = seen.px.copy()
    cv2.fillPoly(out, [np.rint(np.clip(uv, -5000, 5000) * 16).astype(np.int32)], bgr, cv2.LINE_AA, 4)
    return out


def disc_of(radius_m: float, at_m: tuple[float, float] = (0.0, 0.0), n: int = 40) -> NDArray[np.float64]:
    """(n, 2) m of a circle."""
    a = np.linspace(0.0, math.tau, n, endpoint=False)
    return np.stack([radius_m * np.cos(a), radius_m * np.sin(a)], axis=1) + at_m


CLAIM_ACROSS_M, CLAIM_ACROSS_PX = 0.04, 0.5
CLAIM_RANGE, CLAIM_RANGE_PX = 0.08, 0.5
CLAIM_YAW_RAD, CLAIM_YAW_PX_RAD = math.radians(8.0), math.radians(100.0)
"""The claim of a confident pose: its centre is within 4 cm and half a pixel across the line of sight, its range within 8 % and
the effect of half a pixel of the disc's radius, and its heading within 8 degrees and 100 degrees over that radius in pixels.
"""


def keeps_claim(pose: PadPose, truth: PadPose, camera: Camera, pad: Pad, yaw_ambiguous: bool) -> bool:
    """Return whether a pose is as near to the true one as the confidence claims."""
    away = float(truth.t_cam_pad[2])
    radius_px = camera.fx * pad.disc_radius_m / away
    d = pose.t_cam_pad - truth.t_cam_pad
    sight = truth.t_cam_pad / truth.range_m
    along = float(d @ sight)
    across = float(np.linalg.norm(d - along * sight))
    yaw = abs((truth.R_cam_pad.inv @ pose.R_cam_pad).rpy_rad[2])
    if yaw_ambiguous:
        yaw = min(yaw, math.pi - yaw)
    return (
        across < CLAIM_ACROSS_M + CLAIM_ACROSS_PX * away / camera.fx
        and abs(along) < truth.range_m * (CLAIM_RANGE + CLAIM_RANGE_PX / radius_px)
        and yaw < CLAIM_YAW_RAD + CLAIM_YAW_PX_RAD / radius_px
    )
