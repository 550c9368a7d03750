"""Read the samples of a PX4 log (ULog) through pyulog.

Source: the topics' definitions in PX4 v1.7 to v1.16: SI, FRD body, NED world, Hamilton quaternion from body to world.
"""

import contextlib
import io
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from drivers.extras import require
from drivers.file_kinds import ULOG_MAGIC
from drivers.files import Largest, bytes_of
from drivers.imports.columns import ULOG, cell, unknown
from drivers.imports.px4_ulog.damage import without_damage
from drivers.log_stamps import Tell, attitude, in_level, quiet, stamp, timeline
from estimator.contracts.errors import BadInput, DecklanderError, refused
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Baro, BodyVelocity, Imu, Range, Sample, VehicleStatus

_TOPICS = (
    "sensor_combined", "vehicle_attitude", "vehicle_local_position", "distance_sensor", "vehicle_air_data",
    "vehicle_land_detected",
)  # fmt: skip
ERRORS_OF_OTHERS = (KeyError, IndexError, TypeError, ValueError, OverflowError)
"""Errors of reading topics that are not as PX4 writes them."""
_DOWN = 25
"""The orientation of a distance_sensor that looks down (ROTATION_DOWNWARD_FACING)."""
_SIGMA_V_M_S = 0.3
"""The standard deviation of the velocity that is assumed if the log gives none."""


def read(path: Path, tell: Tell = quiet) -> list[Sample]:
    """Return all samples in order; values that are not finite are left out, and ranges of a sensor that does not look down.

    Raises:
        BadInput: the file cannot be read, is no ULog, or holds neither IMU nor attitude.
    """
    log = open_ulog(path, _TOPICS, tell)
    if gaps := log.dropouts:
        lost_s = sum(gap.duration for gap in gaps) / 1000
        after_s = max(0, min(gap.timestamp for gap in gaps) - log.start_timestamp) * 1e-6
        tell(f"the card did not keep up: {lost_s:.2f} s are lost, the first after {after_s:.1f} s")
    instances = sorted(log.data_list, key=lambda data: -data.multi_id)
    topics = {
        data.name: data.data for data in instances if data.name != "distance_sensor" and len(data.data.get("timestamp", ()))
    }
    if strange := sorted({f"{data.name}.{name}" for data in log.data_list for name in unknown(ULOG[data.name], data.data)}):
        tell(f"fields that are not known here are not read: {', '.join(strange)}")
    if not topics.keys() & {"sensor_combined", "vehicle_attitude"}:
        raise BadInput(f"{path}: holds neither sensor_combined nor vehicle_attitude")
    with refused(f"{path}: not the topics of a PX4 log", *ERRORS_OF_OTHERS):
        if (ranges := _looking_down([data.data for data in log.data_list if data.name == "distance_sensor"], tell)) is not None:
            topics["distance_sensor"] = ranges
        return _samples(topics, int(log.start_timestamp), tell)


def open_ulog(path: Path, topics: tuple[str, ...], tell: Tell = quiet) -> Any:
    """Return the parsed log, a `pyulog.ULog`, with these topics; foreign bytes in it are left out, and reported.

    Raises:
        BadInput: the file cannot be read or is no ULog, or pyulog is missing.
    """
    require(str(path), "logs", "pyulog")
    from pyulog import ULog

    try:
        data = bytes_of(path, Largest.LOG)
        whole = without_damage(data, tell) if data.startswith(ULOG_MAGIC) else data
        # pyulog prints its remarks to standard output, which is for results.
        with contextlib.redirect_stdout(io.StringIO()):
            return ULog(_Bounded(io.BytesIO(whole), len(whole)), message_name_filter_list=list(topics))
    except DecklanderError:
        raise
    except Exception as why:  # pyulog lets any error of its parser through
        raise BadInput(f"{path}: not a readable PX4 log: {why}") from why


def _looking_down(sensors: Sequence[dict[str, Any]], tell: Tell) -> dict[str, Any] | None:
    """Return the rangefinder that looks down; of several the one with most usable readings, None without one."""
    down = [d for d in sensors if len(d["timestamp"]) and int(_cell("distance_sensor", d, 0, "orientation", _DOWN)) == _DOWN]
    if len(down) > 1:
        tell(f"{len(down)} rangefinders look down: the height is that of the one which gave most")
    return max(down, key=lambda d: sum(_range(d, i, 0) is not None for i in range(len(d["timestamp"]))), default=None)


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


def _samples(topics: dict[str, dict[str, Any]], began_us: int, tell: Tell) -> list[Sample]:
    firsts = [int(data["timestamp"][0]) for data in topics.values() if len(data["timestamp"])]
    # What was published before logging began is written, too, at the instant of its publication.
    first_us = min((t for t in firsts if t >= began_us), default=min(firsts))
    yaw = _yaw(topics.get("vehicle_attitude"))
    makers: dict[str, Callable[[dict[str, Any], int, int], Sample | None]] = {
        "sensor_combined": _imu,
        "vehicle_attitude": _attitude,
        "vehicle_local_position": lambda data, i, at: _velocity(data, i, at, yaw),
        "distance_sensor": _range,
        "vehicle_air_data": _baro,
        "vehicle_land_detected": _status,
    }
    samples = [s for name, data in topics.items() for s in _all(data, first_us, makers[name], partial(_of, tell, name))]
    return sorted(samples, key=lambda s: s.stamp.received_at)


def _of(tell: Tell, name: str, text: str) -> None:
    tell(f"{name}: {text}")


def _all(
    data: dict[str, Any], first_us: int, make: Callable[[dict[str, Any], int, int], Sample | None], tell: Tell
) -> Iterator[Sample]:
    stamps_us = [int(at_us) for at_us in data["timestamp"]]
    of_log = [i for i, at_us in enumerate(stamps_us) if at_us >= first_us]
    if not of_log:
        return
    times = timeline([stamps_us[i] for i in of_log], tell)
    began_us = next((stamps_us[i] for i, at_ns in zip(of_log, times, strict=True) if at_ns is not None), first_us)
    begin_ns = (began_us - first_us) * 1000
    for i, at_ns in zip(of_log, times, strict=True):
        sample = None if at_ns is None else make(data, i, begin_ns + at_ns)
        if sample is not None:
            yield sample


def _row(data: dict[str, Any], name: str, i: int, n: int) -> F64:
    return np.array([data[f"{name}[{k}]"][i] for k in range(n)], dtype=float)


def _cell(topic: str, data: dict[str, Any], i: int, name: str, default: float) -> Any:
    """Return a field of a row; None where it means "not measured", the default where the log has no such field."""
    return cell(ULOG[topic], name, data[name][i] if name in data else default)


def _imu(data: dict[str, Any], i: int, at: int) -> Sample | None:
    values = np.concatenate([_row(data, "gyro_rad", i, 3), _row(data, "accelerometer_m_s2", i, 3)])
    both = _cell("sensor_combined", data, i, "accelerometer_timestamp_relative", 0) is not None
    # Six zeros are those of a sensor that is not there.
    return Imu(stamp(at), values[:3], values[3:]) if both and np.all(np.isfinite(values)) and np.any(values) else None


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
    valid = None not in [_cell("vehicle_local_position", data, i, name, 1) for name in ("v_xy_valid", "v_z_valid")]
    if yaw_rad is None or not valid or not np.all(np.isfinite(v)):
        return None
    sigmas = [float(data[name][i]) if name in data else _SIGMA_V_M_S for name in ("evh", "evv")]
    horizontal, vertical = (s if math.isfinite(s) and s > 0 else _SIGMA_V_M_S for s in sigmas)
    return BodyVelocity(stamp(at), in_level(v, yaw_rad), np.diag([horizontal**2, horizontal**2, vertical**2]))


def _range(data: dict[str, Any], i: int, at: int) -> Sample | None:
    of = partial(_cell, "distance_sensor", data, i)
    distance, variance = float(data["current_distance"][i]), float(of("variance", 0.0) or 0.0)
    within = float(data["min_distance"][i]) <= distance <= float(data["max_distance"][i])
    measures = None not in (of("signal_quality", -1), of("mode", 0))
    usable = math.isfinite(distance) and distance > 0.0 and within and measures
    return Range(stamp(at), distance, math.sqrt(max(variance, 1e-4))) if usable else None


def _baro(data: dict[str, Any], i: int, at: int) -> Sample | None:
    height = float(data["baro_alt_meter"][i])
    measured = _cell("vehicle_air_data", data, i, "baro_pressure_pa", 1.0) is not None
    return Baro(stamp(at), height, 0.5) if math.isfinite(height) and measured else None


def _status(data: dict[str, Any], i: int, at: int) -> Sample | None:
    landed = bool(data["landed"][i])
    return VehicleStatus(stamp(at), not landed, "landed" if landed else "flying", None, False, True)
