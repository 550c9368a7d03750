"""Events as the native core reads them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from msgspec import Struct

from estimator.contracts.estimates import Sighting
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VesselReport
from estimator.core import abi
from estimator.core.interface import size_of

Event = Imu | Attitude | BodyVelocity | Range | Baro | VesselReport | Sighting
"""What the filter processes."""

_VALUES = size_of("event") - 2
_HEAD, _TWO, _VESSEL = struct.Struct("2q"), struct.Struct("2d"), struct.Struct("16d")
_FLAGS = 3
_SIGHTING = struct.Struct(f"{_FLAGS}q{size_of('sighting') - _FLAGS}d")
_NO_POSE = (0.0,) * (3 + 9 + 36)
_NO_VELOCITY = (0.0,) * (3 + 9)


class PackedEvent(Struct, frozen=True):
    """An event as the core reads it."""

    record: bytes
    """The core's `event`."""
    seen: bytes = b""
    """The core's `sighting`; empty for any other event."""


def packed_event(event: Event) -> PackedEvent:
    """Return an event as the core reads it."""
    kind, values_of, rest = _KINDS[type(event)]
    record = _HEAD.pack(kind, event.stamp.measured_at) + values_of(event) + rest
    return PackedEvent(record, _seen(event)) if type(event) is Sighting else PackedEvent(record)


def _of_imu(event: Imu) -> bytes:
    return event.w_body.tobytes() + event.f_body.tobytes()


def _of_attitude(event: Attitude) -> bytes:
    return event.R_ned_body.matrix.tobytes() + event.cov_body.tobytes()


def _of_velocity(event: BodyVelocity) -> bytes:
    return event.v_level.tobytes() + event.cov_level.tobytes()


def _of_range(event: Range) -> bytes:
    return _TWO.pack(event.range_m, event.sigma_m)


def _of_height(event: Baro) -> bytes:
    return _TWO.pack(event.height_m, event.sigma_m)


def _of_vessel(report: VesselReport) -> bytes:
    v, cov, heading, sigma = report.v_vessel_ned, report.cov_v_ned, report.heading_rad, report.sigma_heading_rad
    velocity = _NO_VELOCITY if v is None or cov is None else (*v.tolist(), *cov.ravel().tolist())
    return _VESSEL.pack(*velocity, heading or 0.0, sigma or 0.0, v is not None, heading is not None)


def _seen(s: Sighting) -> bytes:
    whole = s.pose6
    pose = _NO_POSE
    if whole is not None:
        pose = (*whole.d_body_pad_level.tolist(), *whole.R_level_pad.matrix.ravel().tolist(), *whole.cov.ravel().tolist())
    return _SIGHTING.pack(
        s.yaw_rad is not None, s.yaw_ambiguous, whole is not None,
        s.confidence, s.stamp.sigma_s, *s.d_body_pad_level.tolist(), s.yaw_rad or 0.0, *s.cov.ravel().tolist(), *pose,
    )  # fmt: skip


def _kind(name: str, values_of: Callable[[Any], bytes], n: int) -> tuple[int, Callable[[Any], bytes], bytes]:
    return getattr(abi, name), values_of, bytes(8 * (_VALUES - n))


_KINDS: dict[type[Event], tuple[int, Callable[[Any], bytes], bytes]] = {
    Imu: _kind("IMU", _of_imu, 6),
    Attitude: _kind("ATTITUDE", _of_attitude, 18),
    BodyVelocity: _kind("VELOCITY", _of_velocity, 12),
    Range: _kind("RANGE", _of_range, 2),
    Baro: _kind("HEIGHT", _of_height, 2),
    VesselReport: _kind("VESSEL", _of_vessel, 16),
    Sighting: _kind("SIGHTING", lambda event: b"", 0),
}
"""Of each kind of event its number, what packs its values, and the zeros after them."""
