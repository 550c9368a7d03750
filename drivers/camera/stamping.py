"""The stamp of mid-exposure from the stamp that a kernel or a camera stack gives a frame."""

import math

from drivers.camera.options import CameraOptions
from estimator.contracts.time import MonoNs, Stamp, after, seconds_between

_OLDEST_S = 2.0
"""A frame whose stamp is older than this was not stamped by this host's monotonic clock."""
_AHEAD_S = 0.005
"""A driver that stamps by the kernel's tick may be ahead by one tick; a stamp further ahead is refused."""


def stamp_of(
    stamped: MonoNs | None,
    to_middle_s: float,
    received_at: MonoNs,
    options: CameraOptions,
    exposure_s: float,
    error_s: float = 0.0,
) -> tuple[Stamp, bool]:
    """Return the stamp of mid-exposure, and whether the given stamp had to be refused (future, or older than 2 s).

    If the exposure is not known, half a frame's time is added to the variance.

    Args:
        stamped: by CLOCK_MONOTONIC; None if nothing or another clock stamped the frame, whose arrival is used then.
        to_middle_s: from the stamped instant to mid-exposure, s; `latency_s` is subtracted besides.
        exposure_s: exposure time, 0 if unknown.
        error_s: largest error of `to_middle_s`.
    """
    unknown_s = 0.5 / options.rate_hz / math.sqrt(3.0) if exposure_s == 0.0 else 0.0
    sigma_s = math.hypot(options.latency_sigma_s, unknown_s, error_s / math.sqrt(3.0))
    if stamped is not None:
        measured_at = after(stamped, to_middle_s - options.latency_s)
        possible = (
            -_AHEAD_S <= seconds_between(stamped, received_at) <= _OLDEST_S
            and seconds_between(received_at, measured_at) <= 5.0 * sigma_s
        )
        if possible:
            return Stamp(measured_at, received_at, sigma_s, "kernel"), False
    measured_at = after(received_at, -0.5 * exposure_s - max(0.0, options.latency_s))
    return Stamp(measured_at, received_at, math.hypot(sigma_s, options.arrival_sigma_s), "arrival"), stamped is not None
