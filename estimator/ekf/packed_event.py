"""Events as the native core reads them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from msgspec import Struct

from estimator.contracts.estimates import Sighting
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VesselReport
from estimator.core import abi
from estimator.core.library import CORE

Event = Imu | Attitude | BodyVelocity | Range | Baro | VesselReport | Sighting
"""What the filter processes."""


class PackedEvent(Struct, frozen=True):
    """An event as the core reads it."""

    record: bytes
    """The core's `dl_event`."""
    seen: bytes = b""
    """The core's `dl_sighting`; empty for any other event."""


def packed_event(event: Event) -> PackedEvent:
    """Return an event as the core reads it."""
    kind, write = _KINDS[type(event)]
    made = _new(_EVENT)
    made.kind, made.t = kind, event.stamp.measured_at
    write(made.sample, event)
    record = bytes(_buffer(made))
    return PackedEvent(record, bytes(_buffer(_sighting(event)))) if type(event) is Sighting else PackedEvent(record)


def _write_imu(sample: Any, event: Imu) -> None:
    _copy(sample.imu.w_body, event.w_body, 24)
    _copy(sample.imu.f_body, event.f_body, 24)


def _write_attitude(sample: Any, event: Attitude) -> None:
    sample.attitude = {"R_ned_body": event.R_ned_body.matrix.ravel().tolist(), "cov_body": event.cov_body.ravel().tolist()}


def _write_velocity(sample: Any, event: BodyVelocity) -> None:
    sample.velocity = {"v_level": event.v_level.tolist(), "cov_level": event.cov_level.ravel().tolist()}


def _write_range(sample: Any, event: Range) -> None:
    sample.distance = {"measured_m": event.range_m, "sigma_m": event.sigma_m}


def _write_height(sample: Any, event: Baro) -> None:
    sample.distance = {"measured_m": event.height_m, "sigma_m": event.sigma_m}


def _write_vessel(sample: Any, report: VesselReport) -> None:
    v, cov = report.v_vessel_ned, report.cov_v_ned
    if v is not None and cov is not None:
        sample.vessel = {"has_velocity": 1, "v_ned": v.tolist(), "cov_v_ned": cov.ravel().tolist()}
    if report.heading_rad is not None:
        sample.vessel.has_heading, sample.vessel.heading_rad = 1, report.heading_rad
        sample.vessel.sigma_heading_rad = report.sigma_heading_rad or 0.0


def _write_nothing(sample: Any, event: Sighting) -> None:
    """Leave the event without a sample: the sighting is beside it."""


def _sighting(s: Sighting) -> Any:
    made = CORE.ffi.new(
        "dl_sighting *",
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
        made.has_pose6 = 1
        made.pose_d_level = whole.d_body_pad_level.tolist()
        made.pose_R = whole.R_level_pad.matrix.ravel().tolist()
        made.pose_cov = whole.cov.ravel().tolist()
    return made


_EVENT = CORE.ffi.typeof("dl_event *")
_new, _copy, _buffer = CORE.ffi.new, CORE.ffi.memmove, CORE.ffi.buffer
_KINDS: dict[type[Event], tuple[int, Callable[[Any, Any], None]]] = {
    Imu: (abi.DL_IMU, _write_imu),
    Attitude: (abi.DL_ATTITUDE, _write_attitude),
    BodyVelocity: (abi.DL_VELOCITY, _write_velocity),
    Range: (abi.DL_RANGE, _write_range),
    Baro: (abi.DL_HEIGHT, _write_height),
    VesselReport: (abi.DL_VESSEL, _write_vessel),
    Sighting: (abi.DL_SIGHTING, _write_nothing),
}
"""The number of each kind of event, and what writes its values."""
