"""Events as the native core reads them."""

import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64
from estimator.contracts.samples import (
    Attitude,
    Baro,
    Baseline,
    BaselineFix,
    BodyVelocity,
    Imu,
    Range,
    VesselMotion,
    VesselReport,
)
from estimator.core import abi
from estimator.core.library import CORE

Event = Imu | Attitude | BodyVelocity | Range | Baro | VesselReport | VesselMotion | Baseline | Sighting
"""Events that the filter processes. A motion is that of the pad and about its arrow, as `estimator.ship_motion` makes it."""

_HEAD = struct.Struct("@I4x3qQ")
"""The numbers of an event before its sample: kind, instants of measuring and of reception, frame, method."""
_TWO = struct.Struct("2d")  # The times for which gyro and accelerometer were lost, s; a distance and its standard deviation, m
_new, _bytes_of, _EVENT = CORE.ffi.new, CORE.ffi.buffer, CORE.ffi.typeof("dl_event *")


def packed(event: Event) -> bytes:
    """Return the core's `dl_event` of an event.

    Raises:
        TypeError: the object is not a measurement.
    """
    try:
        record = _RECORDS[type(event)]
    except KeyError:
        raise TypeError(f"the filter takes samples and sightings, not {type(event).__name__}") from None
    return record(event)


def _head(kind: int, event: Event) -> bytes:
    return _HEAD.pack(kind, event.stamp.measured_at, event.stamp.received_at, 0, 0)


def _record(kind: int, event: Event, sample: dict[str, Any], seq: int = 0, method: int = 0) -> bytes:
    """Return the core's `dl_event` with a sample given by its name in the header."""
    values = kind, event.stamp.measured_at, event.stamp.received_at, seq, method, sample
    return _bytes_of(_new(_EVENT, values))[:]  # type: ignore[no-any-return]


# Hundreds of samples a second: their bytes are joined in the order of the header's members.
def _of_imu(event: Imu) -> bytes:
    lost = _TWO.pack(event.gyro_lost_s, event.accel_lost_s)
    return b"".join([_head(abi.DL_IMU, event), event.w_body.tobytes(), event.f_body.tobytes(), lost, _AFTER_IMU])


def _with_cov(kind: int, event: Attitude | BodyVelocity, measured: F64, cov: F64, rest: bytes) -> bytes:
    return b"".join([_head(kind, event), measured.tobytes(), cov.tobytes(), rest])


def _of_distance(kind: int, event: Range | Baro, measured_m: float) -> bytes:
    return b"".join([_head(kind, event), _TWO.pack(measured_m, event.sigma_m), _AFTER_DISTANCE])


def _of_vessel(report: VesselReport) -> bytes:
    v, cov, values = report.v_vessel_ned, report.cov_v_ned, dict[str, Any]()
    if v is not None and cov is not None:
        values |= {"has_velocity": True, "v_ned": v.tolist(), "cov_v_ned": cov.ravel().tolist()}
    if report.heading_rad is not None:
        values |= {"has_heading": True, "heading_rad": report.heading_rad, "sigma_heading_rad": report.sigma_heading_rad}
    if report.turn_rad_s is not None:
        values |= {"has_turn": True, "turn_rad_s": report.turn_rad_s, "sigma_turn_rad_s": report.sigma_turn_rad_s}
    return _record(abi.DL_VESSEL, report, {"vessel": values})


def _of_motion(motion: VesselMotion) -> bytes:
    values = dict[str, Any]()
    if motion.roll_rad is not None and motion.pitch_rad is not None:
        values |= {"has_tilt": True, "tilt_rad": [motion.roll_rad, motion.pitch_rad], "sigma_tilt_rad": motion.sigma_tilt_rad}
    if motion.heave_down_m is not None:
        values |= {"has_heave": True, "down_m": motion.heave_down_m, "sigma_down_m": motion.sigma_heave_m}
    # Motions of one instant are ordered by what they hold.
    return _record(abi.DL_MOTION, motion, {"motion": values}, seq=len(values))


def _of_sighting(s: Sighting) -> bytes:
    values: dict[str, Any] = {
        "has_yaw": s.yaw_rad is not None,
        "yaw_ambiguous": s.yaw_ambiguous,
        "confidence": s.confidence,
        "sigma_s": s.stamp.sigma_s,
        "d_level": s.d_body_pad_level.tolist(),
        "yaw_rad": s.yaw_rad or 0.0,
        "cov": s.cov.ravel().tolist(),
    }
    whole = s.pose6
    if whole is not None:
        values |= {
            "has_pose6": True,
            "pose_d_level": whole.d_body_pad_level.tolist(),
            "pose_R": whole.R_level_pad.matrix.ravel().tolist(),
            "pose_cov": whole.cov.ravel().tolist(),
        }
    # Methods are ordered as their names are.
    method = int.from_bytes(s.method.encode()[:8].ljust(8, b"\0"), "big")
    return _record(abi.DL_SIGHTING, s, {"sighting": values}, s.seq, method)


_ALIKE_S: dict[BaselineFix, float] = {"fixed": 0.0, "float": 20.0}
"""Time over which the errors of solutions are alike: those of estimated ambiguities wander slowly (assumed)."""


def _of_baseline(b: Baseline) -> bytes:
    cov = np.zeros((4, 4))
    cov[:3, :3] = b.cov_ned
    values = {
        "by_baseline": True,
        "alone": b.alone,
        "confidence": 1.0,
        "sigma_s": b.stamp.sigma_s,
        "d_level": (-b.d_ned).tolist(),
        "cov": cov.ravel().tolist(),
        "alike_s": _ALIKE_S[b.fix],
        "antenna_body": b.antenna_body.tolist(),
        "antenna_vessel": b.antenna_vessel.tolist(),
    }
    return _record(abi.DL_SIGHTING, b, {"sighting": values})


_AFTER_IMU, _AFTER_ATTITUDE, _AFTER_VELOCITY, _AFTER_DISTANCE = (
    bytes(CORE.ffi.sizeof("dl_event") - _HEAD.size - CORE.ffi.sizeof(sample))
    for sample in ("dl_imu", "dl_attitude", "dl_velocity", "dl_distance")
)
_RECORDS: dict[type[Event], Callable[[Any], bytes]] = {
    Imu: _of_imu,
    Attitude: lambda event: _with_cov(abi.DL_ATTITUDE, event, event.R_ned_body.matrix, event.cov_body, _AFTER_ATTITUDE),
    BodyVelocity: lambda event: _with_cov(abi.DL_VELOCITY, event, event.v_level, event.cov_level, _AFTER_VELOCITY),
    Range: lambda event: _of_distance(abi.DL_RANGE, event, event.range_m),
    Baro: lambda event: _of_distance(abi.DL_HEIGHT, event, event.height_m),
    VesselReport: _of_vessel,
    Baseline: _of_baseline,
    VesselMotion: _of_motion,
    Sighting: _of_sighting,
}
