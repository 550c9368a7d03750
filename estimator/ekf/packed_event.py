"""Events as the native core reads them."""

import struct
from collections.abc import Callable
from functools import reduce
from typing import Any

from msgspec import Struct

from estimator.contracts.estimates import Sighting
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VesselReport
from estimator.core import abi
from estimator.core.library import CORE

_new, _bytes_of = CORE.ffi.new, CORE.ffi.buffer
_EVENT, _SIGHTING = (CORE.ffi.typeof(f"dl_{name} *") for name in ("event", "sighting"))
Event = Imu | Attitude | BodyVelocity | Range | Baro | VesselReport | Sighting
"""Events that the filter processes."""


class PackedEvent(Struct, frozen=True):
    """An event as the core reads it."""

    record: bytes
    """The core's `dl_event`."""
    seen: bytes = b""
    """The core's `dl_sighting`; empty for any other event."""


def packed_event(event: Event) -> PackedEvent:
    """Return an event as the core reads it."""
    record = _RECORDS[type(event)](event)
    return PackedEvent(record, _bytes_of(_sighting(event))[:]) if type(event) is Sighting else PackedEvent(record)


def _record(kind: int, event: Event, **sample: Any) -> bytes:
    """Return the core's `dl_event` with a sample given by its name in the header."""
    return _bytes_of(_new(_EVENT, (kind, event.stamp.measured_at, sample)))[:]  # type: ignore[no-any-return]


def _of_arrays(kind: int, sample: str, **at: str) -> Callable[[Any], bytes]:
    """Return what makes a record of a sample whose members in the header are the event's own arrays: most events are such.

    Args:
        kind: the kind of event.
        sample: the structure of its sample.
        at: where the event has an array whose name is not the member's.
    """
    paths = [at.get(name, name).split(".") for name, _ in CORE.ffi.typeof(sample).fields]
    rest = bytes(CORE.ffi.sizeof("dl_event") - _HEAD.size - CORE.ffi.sizeof(sample))

    def record(event: Any) -> bytes:
        arrays = [reduce(getattr, path, event).tobytes() for path in paths]
        return b"".join([_HEAD.pack(kind, event.stamp.measured_at), *arrays, rest])

    return record


def _of_imu(event: Imu) -> bytes:
    lost = _HALVES.pack(event.gyro_lost_s, event.accel_lost_s)
    return b"".join([_HEAD.pack(abi.DL_IMU, event.stamp.measured_at), event.w_body.tobytes(), event.f_body.tobytes(), lost, _PAD])


def _of_range(event: Range) -> bytes:
    return _record(abi.DL_RANGE, event, distance=(event.range_m, event.sigma_m))


def _of_height(event: Baro) -> bytes:
    return _record(abi.DL_HEIGHT, event, distance=(event.height_m, event.sigma_m))


def _of_vessel(report: VesselReport) -> bytes:
    v, cov, values = report.v_vessel_ned, report.cov_v_ned, dict[str, Any]()
    if v is not None and cov is not None:
        values |= {"has_velocity": True, "v_ned": v.tolist(), "cov_v_ned": cov.ravel().tolist()}
    if report.heading_rad is not None:
        values |= {"has_heading": True, "heading_rad": report.heading_rad, "sigma_heading_rad": report.sigma_heading_rad}
    return _record(abi.DL_VESSEL, report, vessel=values)


def _of_sighting(event: Sighting) -> bytes:
    """Return an event without a sample: the sighting is beside it."""
    return _record(abi.DL_SIGHTING, event)


def _sighting(s: Sighting) -> Any:
    made = _new(
        _SIGHTING,
        {
            "has_yaw": s.yaw_rad is not None,
            "yaw_ambiguous": s.yaw_ambiguous,
            "confidence": s.confidence,
            "sigma_s": s.stamp.sigma_s,
            "d_level": s.d_body_pad_level.tolist(),
            "yaw_rad": s.yaw_rad or 0.0,
            "cov": s.cov.ravel().tolist(),
        },
    )
    whole = s.pose6
    if whole is not None:
        made.has_pose6 = True
        made.pose_d_level = whole.d_body_pad_level.tolist()
        made.pose_R = whole.R_level_pad.matrix.ravel().tolist()
        made.pose_cov = whole.cov.ravel().tolist()
    return made


_HEAD = struct.Struct("2q")
"""The numbers of an event before its sample."""
_HALVES = struct.Struct("2d")
_PAD = bytes(CORE.ffi.sizeof("dl_event") - _HEAD.size - CORE.ffi.sizeof("dl_imu"))
"""Padding of an event after an IMU sample."""
_RECORDS: dict[type[Event], Callable[[Any], bytes]] = {
    Imu: _of_imu,
    Attitude: _of_arrays(abi.DL_ATTITUDE, "dl_attitude", R_ned_body="R_ned_body.matrix"),
    BodyVelocity: _of_arrays(abi.DL_VELOCITY, "dl_velocity"),
    Range: _of_range,
    Baro: _of_height,
    VesselReport: _of_vessel,
    Sighting: _of_sighting,
}
