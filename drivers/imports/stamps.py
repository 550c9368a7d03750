"""Stamps and covariances of what was logged elsewhere."""

from __future__ import annotations

import math

import numpy as np

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp

SIGMA_S = 0.002
"""How well a log's time stamps are trusted."""
SIGMA_TILT_RAD = math.radians(0.5)
SIGMA_YAW_RAD = math.radians(3.0)
FRAME_DELAY_S = 0.05
"""A frame is taken to be heard this much after it was taken, so that the attitude around its exposure is known by then."""


def stamp(at_ns: int, delay_s: float = 0.0) -> Stamp:
    """Of a datum that was true at `at_ns` on the source's clock."""
    return Stamp(MonoNs(at_ns), MonoNs(at_ns + round(delay_s * 1e9)), SIGMA_S, "synced")


def attitude(at_ns: int, R_ned_body: Rotation) -> Attitude:
    """With the doubt that an autopilot's estimate customarily deserves."""
    return Attitude(stamp(at_ns), R_ned_body, np.diag([SIGMA_TILT_RAD**2, SIGMA_TILT_RAD**2, SIGMA_YAW_RAD**2]))


def in_level(v_ned: F64, yaw_rad: float) -> F64:
    """(3,) of `ned` written in `level`."""
    return Rotation.from_rpy(0.0, 0.0, yaw_rad).inv @ v_ned
