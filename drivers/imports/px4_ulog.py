"""Read IMU, attitude, velocity, range and baro samples of a PX4 log (ULog), through pyulog.

Source: the topics' definitions in PX4 v1.7 to v1.16: SI, FRD body, NED world, Hamilton quaternion from body to world.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from pyulog import ULog

from drivers.imports.stamps import attitude, in_level, stamp
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Baro, BodyVelocity, Imu, Range, Sample, VehicleStatus

MAGIC = b"ULog\x01\x12\x35"
_TOPICS = (
    "sensor_combined", "vehicle_attitude", "vehicle_local_position", "distance_sensor", "vehicle_air_data",
    "vehicle_land_detected",
)  # fmt: skip
_SIGMA_V_M_S = 0.3
"""The standard deviation of the velocity that is assumed if the log gives none."""


def read(path: Path) -> list[Sample]:
    """Return all samples in order; values that are not finite are left out.

    Raises:
        BadInput: the file cannot be read, is no ULog, or holds neither IMU nor attitude.
    """
    log = open_ulog(path, _TOPICS)
    topics = {data.name: data.data for data in reversed(log.data_list)}
    if not topics.keys() & {"sensor_combined", "vehicle_attitude"}:
        raise BadInput(f"{path}: holds neither sensor_combined nor vehicle_attitude")
    try:
        return _samples(topics)
    except (KeyError, IndexError, TypeError, ValueError, OverflowError) as why:
        raise BadInput(f"{path}: not the topics of a PX4 log: {type(why).__name__}: {why}") from why


def open_ulog(path: Path, topics: tuple[str, ...]) -> Any:
    """Return the parsed log, a `pyulog.ULog`, with these topics.

    Raises:
        BadInput: the file cannot be read or is no ULog.
    """
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            return ULog(_Bounded(file, size), message_name_filter_list=list(topics))
    except OSError as why:
        raise BadInput(f"{path}: {why.strerror or why}") from why
    except Exception as why:  # pyulog lets any error of its parser through
        raise BadInput(f"{path}: not a readable PX4 log: {why}") from why


class _Bounded:
    """A file whose reading is bounded: pyulog seeks back after damage, and repeats that forever after some damage."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file = file
        self._left = 4 * size + 4096

    def read(self, size: int = -1) -> bytes:
        self._left -= 1
        if self._left < 0:
            raise RuntimeError("damaged so that reading it does not come to an end")
        return self._file.read(size)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def _samples(topics: dict[str, dict[str, Any]]) -> list[Sample]:
    first_us = min(int(data["timestamp"][0]) for data in topics.values() if len(data["timestamp"]))
    yaw = _yaw(topics.get("vehicle_attitude"))
    makers: dict[str, Callable[[dict[str, Any], int, int], Sample | None]] = {
        "sensor_combined": _imu,
        "vehicle_attitude": _attitude,
        "vehicle_local_position": lambda data, i, at: _velocity(data, i, at, yaw),
        "distance_sensor": _range,
        "vehicle_air_data": _baro,
        "vehicle_land_detected": _status,
    }
    samples = [s for name, data in topics.items() for s in _all(data, first_us, makers[name])]
    return sorted(samples, key=lambda s: s.stamp.received_at)


def _all(data: dict[str, Any], first_us: int, make: Callable[[dict[str, Any], int, int], Sample | None]) -> Iterator[Sample]:
    for i, at_us in enumerate(data["timestamp"]):
        sample = make(data, i, (int(at_us) - first_us) * 1000)
        if sample is not None:
            yield sample


def _row(data: dict[str, Any], name: str, i: int, n: int) -> F64:
    return np.array([data[f"{name}[{k}]"][i] for k in range(n)], dtype=float)


def _imu(data: dict[str, Any], i: int, at: int) -> Sample | None:
    w, f = _row(data, "gyro_rad", i, 3), _row(data, "accelerometer_m_s2", i, 3)
    return Imu(stamp(at), w, f) if np.all(np.isfinite(w)) and np.all(np.isfinite(f)) else None


def _attitude(data: dict[str, Any], i: int, at: int) -> Sample | None:
    q = _row(data, "q", i, 4)
    return attitude(at, Rotation.from_quat(q)) if np.all(np.isfinite(q)) and np.linalg.norm(q) > 0.5 else None


def _yaw(data: dict[str, Any] | None) -> Callable[[int], float | None]:
    """Return a function that gives the heading of the newest attitude at a timestamp in microseconds."""
    if data is None or not len(data["timestamp"]):
        return lambda at_us: None
    at = np.asarray(data["timestamp"], dtype=np.int64)

    def heading(at_us: int) -> float | None:
        i = max(0, int(np.searchsorted(at, at_us, side="right")) - 1)
        q = _row(data, "q", i, 4)
        return Rotation.from_quat(q).rpy_rad[2] if np.all(np.isfinite(q)) and np.linalg.norm(q) > 0.5 else None

    return heading


def _velocity(data: dict[str, Any], i: int, at: int, yaw: Callable[[int], float | None]) -> Sample | None:
    v = np.array([data[name][i] for name in ("vx", "vy", "vz")], dtype=float)
    yaw_rad = yaw(int(data["timestamp"][i]))
    valid = all(bool(data[name][i]) for name in ("v_xy_valid", "v_z_valid") if name in data)
    if yaw_rad is None or not valid or not np.all(np.isfinite(v)):
        return None
    sigmas = [float(data[name][i]) if name in data else _SIGMA_V_M_S for name in ("evh", "evv")]
    horizontal, vertical = (s if math.isfinite(s) and s > 0 else _SIGMA_V_M_S for s in sigmas)
    return BodyVelocity(stamp(at), in_level(v, yaw_rad), np.diag([horizontal**2, horizontal**2, vertical**2]))


def _range(data: dict[str, Any], i: int, at: int) -> Sample | None:
    distance, variance = float(data["current_distance"][i]), float(data["variance"][i]) if "variance" in data else 0.0
    within = float(data["min_distance"][i]) <= distance <= float(data["max_distance"][i])
    usable = math.isfinite(distance) and distance >= 0.0 and within
    return Range(stamp(at), distance, math.sqrt(max(variance, 1e-4))) if usable else None


def _baro(data: dict[str, Any], i: int, at: int) -> Sample | None:
    height = float(data["baro_alt_meter"][i])
    return Baro(stamp(at), height, 0.5) if math.isfinite(height) else None


def _status(data: dict[str, Any], i: int, at: int) -> Sample | None:
    landed = bool(data["landed"][i])
    return VehicleStatus(stamp(at), not landed, "landed" if landed else "flying", None, False, True)
