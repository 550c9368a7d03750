"""Stamps and covariances for data that another program logged, and the time of a log whose clock steps."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp

SIGMA_S = 0.002
"""The standard deviation assumed for a log's time stamps, seconds."""
SIGMA_TILT_RAD = math.radians(0.5)
"""Usual standard deviation of roll and pitch in an autopilot's estimate."""
SIGMA_YAW_RAD = math.radians(3.0)
"""Usual standard deviation of its heading."""
FRAME_DELAY_S = 0.05
"""The assumed delay from a frame's exposure to its arrival, so that the attitude around its exposure is known by then."""


Tell = Callable[[str], None]
"""Receives a reader's notes on a file: omitted data, and steps of its clock."""
_DISORDER_US = 250_000
"""The time by which a log's samples may be out of order: sensors and estimators stamp before they log."""
_PAUSE_US = 600_000_000
"""A log that goes on after a longer pause was not paused: its clock was set."""
_AFTER = 5
"""Number of stamps after an odd one that decide whether it is alone."""


def quiet(text: str) -> None:
    """Drop a remark."""


def timeline(stamps_us: Sequence[int], tell: Tell = quiet) -> list[int | None]:
    """Return when each datum of a log was logged, ns since the first, by its stamps in the order of the file.

    One absurd stamp is None, and its datum lost. Where the clock steps and stays there, time goes on, and the step is reported.
    """
    steps = np.diff(np.asarray([min(max(t, 0), 2**62) for t in stamps_us], dtype=np.int64))
    usual = steps[(steps > 0) & (steps < _PAUSE_US)]
    step_us = int(np.median(usual)) if usual.size else 0
    out: list[int | None] = []
    last: int | None = None
    zero = newest = lost = 0
    for i, at in enumerate(stamps_us):
        if last is None or not -_DISORDER_US <= at - last <= _PAUSE_US:
            after = stamps_us[i + 1 : i + 1 + _AFTER]
            if last is None:
                alone = sum(abs(t - at) > _PAUSE_US for t in after) * 2 > len(after)
            else:
                alone = sum(abs(t - at) < abs(t - last) for t in after) * 2 <= len(after)
            if alone:
                lost += 1
                out.append(None)
                continue
            if last is None:
                zero = at
            else:
                way = f"back by about {(last - at) / 1e6:.2f} s" if at < last else f"ahead by {(at - last) / 1e6:.0f} s"
                tell(f"its clock went {way} after {newest / 1e6:.1f} s: what follows goes on from there")
                zero = at - newest - step_us
        last = at if last is None or at > last or last - at > _DISORDER_US else last
        newest = max(newest, at - zero)
        out.append(max(0, at - zero) * 1000)
    if lost:
        tell(f"{lost} of {len(stamps_us)} stamps are absurd: what they belong to was left out")
    return out


def stamp(at_ns: int, delay_s: float = 0.0) -> Stamp:
    """Return the stamp of a datum that was measured at `at_ns` on the source's clock."""
    return Stamp(MonoNs(at_ns), MonoNs(at_ns + round(delay_s * 1e9)), SIGMA_S, "synced")


def attitude(at_ns: int, R_ned_body: Rotation) -> Attitude:
    """Return an attitude sample with the usual covariance of an autopilot's estimate."""
    return Attitude(stamp(at_ns), R_ned_body, np.diag([SIGMA_TILT_RAD**2, SIGMA_TILT_RAD**2, SIGMA_YAW_RAD**2]))


def in_level(v_ned: F64, yaw_rad: float) -> F64:
    """Return the (3,) vector `v_ned` in the level frame."""
    return Rotation.from_rpy(0.0, 0.0, yaw_rad).inv @ v_ned
