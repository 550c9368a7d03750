"""Events as the native core reads them."""

from __future__ import annotations

import struct
from typing import NamedTuple

from estimator.contracts.estimates import Sighting
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VesselReport
from estimator.core.interface import CONSTANTS, size_of

Event = Imu | Attitude | BodyVelocity | Range | Baro | VesselReport | Sighting
"""What the filter processes."""

_VALUES = size_of("event") - 2
_EVENT = struct.Struct(f"2q{_VALUES}d")
_NO_VALUES = (0.0,) * _VALUES
_FLAGS = 3
_SIGHTING = struct.Struct(f"{_FLAGS}q{size_of('sighting') - _FLAGS}d")
_NO_POSE = (0.0,) * (3 + 9 + 36)
_NO_VELOCITY = (0.0,) * (3 + 9)


class PackedEvent(NamedTuple):
    """An event as the core reads it."""

    record: bytes
    """The core's `event`."""
    seen: bytes = b""
    """The core's `sighting`; empty for any other event."""


def packed_event(event: Event) -> PackedEvent:
    """Return an event as the core reads it."""
    values: tuple[float, ...] = ()
    match event:
        case Imu():
            kind, values = "IMU", (*event.w_body.tolist(), *event.f_body.tolist())
        case Attitude():
            kind, values = "ATTITUDE", (*event.R_ned_body.matrix.ravel().tolist(), *event.cov_body.ravel().tolist())
        case BodyVelocity():
            kind, values = "VELOCITY", (*event.v_level.tolist(), *event.cov_level.ravel().tolist())
        case Range():
            kind, values = "RANGE", (event.range_m, event.sigma_m)
        case Baro():
            kind, values = "HEIGHT", (event.height_m, event.sigma_m)
        case VesselReport():
            kind, values = "VESSEL", _of_vessel(event)
        case Sighting():
            kind = "SIGHTING"
    record = _EVENT.pack(CONSTANTS[kind], event.stamp.measured_at, *values, *_NO_VALUES[len(values) :])
    return PackedEvent(record, _seen(event) if isinstance(event, Sighting) else b"")


def _of_vessel(report: VesselReport) -> tuple[float, ...]:
    v, cov, heading, sigma = report.v_vessel_ned, report.cov_v_ned, report.heading_rad, report.sigma_heading_rad
    velocity = _NO_VELOCITY if v is None or cov is None else (*v.tolist(), *cov.ravel().tolist())
    return (*velocity, heading or 0.0, sigma or 0.0, v is not None, heading is not None)


def _seen(s: Sighting) -> bytes:
    whole = s.pose6
    pose = _NO_POSE
    if whole is not None:
        pose = (*whole.d_body_pad_level.tolist(), *whole.R_level_pad.matrix.ravel().tolist(), *whole.cov.ravel().tolist())
    return _SIGHTING.pack(
        s.yaw_rad is not None, s.yaw_ambiguous, whole is not None,
        s.confidence, s.stamp.sigma_s, *s.d_body_pad_level.tolist(), s.yaw_rad or 0.0, *s.cov.ravel().tolist(), *pose,
    )  # fmt: skip
