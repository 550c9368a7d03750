"""Stamps and covariances for data that another program logged."""

import math

import numpy as np

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp

SIGMA_S = 0.002
"""The standard deviation assumed for a log's time stamps, seconds."""
SIGMA_TILT_RAD = math.radians(0.5)
SIGMA_YAW_RAD = math.radians(3.0)
FRAME_DELAY_S = 0.05
"""The assumed delay from a frame's exposure to its arrival, so that the attitude around its exposure is known by then."""


def stamp(at_ns: int, delay_s: float = 0.0) -> Stamp:
    """Return the stamp of a datum that was measured at `at_ns` on the source's clock."""
    return Stamp(MonoNs(at_ns), MonoNs(at_ns + round(delay_s * 1e9)), SIGMA_S, "synced")


def attitude(at_ns: int, R_ned_body: Rotation) -> Attitude:
    """Return an attitude sample with the usual covariance of an autopilot's estimate."""
    return Attitude(stamp(at_ns), R_ned_body, np.diag([SIGMA_TILT_RAD**2, SIGMA_TILT_RAD**2, SIGMA_YAW_RAD**2]))


def in_level(v_ned: F64, yaw_rad: float) -> F64:
    """Return the (3,) vector `v_ned` in the level frame."""
    return Rotation.from_rpy(0.0, 0.0, yaw_rad).inv @ v_ned
