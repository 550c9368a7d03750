"""The attitude's roll and pitch as a rotation, and the axes about which their errors turn the body."""

from __future__ import annotations

import math

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.pose import Orientation


def roll_pitch(prior: Orientation) -> F64:
    """Return `R_level_body`, (3, 3)."""
    cr, sr, cp, sp = math.cos(prior.roll_rad), math.sin(prior.roll_rad), math.cos(prior.pitch_rad), math.sin(prior.pitch_rad)
    return np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])


def tilt_axes(prior: Orientation) -> F64:
    """Return the (3, 2) axes in `level` about which an error of roll and of pitch turns the body."""
    return np.array([[math.cos(prior.pitch_rad), 0.0], [0.0, 1.0], [-math.sin(prior.pitch_rad), 0.0]])
