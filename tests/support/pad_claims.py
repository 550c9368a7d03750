"""Claims of a confident pose of the pad, checked against the true pose."""

import math

import numpy as np

from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose

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
