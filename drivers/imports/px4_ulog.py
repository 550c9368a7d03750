"""Read a PX4 log (ULog) through pyulog: its samples, and its parameters, texts and events.

Source: the topics' definitions in PX4 v1.7 to v1.16: SI, FRD body, NED world, Hamilton quaternion from body to world.
"""

import contextlib
import io
import math
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from pyulog import ULog

from drivers.files import Largest, bytes_of
from drivers.imports.columns import ULOG, cell, unknown
from drivers.imports.log_history import AutopilotLog, HistoryMeter, LoggedMoment, LogHistory
from drivers.imports.stamps import Tell, attitude, in_level, quiet, stamp, timeline
from estimator.contracts.errors import BadInput, DecklanderError, refused
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Baro, BodyVelocity, Imu, Range, Sample, VehicleStatus

MAGIC = b"ULog\x01\x12\x35"
_TOPICS = (
    "sensor_combined", "vehicle_attitude", "vehicle_local_position", "distance_sensor", "vehicle_air_data",
    "vehicle_land_detected",
)  # fmt: skip
_OF_OTHERS = (KeyError, IndexError, TypeError, ValueError, OverflowError)
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
    with refused(f"{path}: not the topics of a PX4 log", *_OF_OTHERS):
        if (ranges := _looking_down([data.data for data in log.data_list if data.name == "distance_sensor"], tell)) is not None:
            topics["distance_sensor"] = ranges
        return _samples(topics, int(log.start_timestamp), tell)


def open_ulog(path: Path, topics: tuple[str, ...], tell: Tell = quiet) -> Any:
    """Return the parsed log, a `pyulog.ULog`, with these topics; foreign bytes in it are left out, and reported.

    Raises:
        BadInput: the file cannot be read or is no ULog.
    """
    try:
        data = bytes_of(path, Largest.LOG)
        whole = without_damage(data, tell) if data.startswith(MAGIC) else data
        # pyulog prints its remarks to standard output, which is for results.
        with contextlib.redirect_stdout(io.StringIO()):
            return ULog(_Bounded(io.BytesIO(whole), len(whole)), message_name_filter_list=list(topics))
    except DecklanderError:
        raise
    except Exception as why:  # pyulog lets any error of its parser through
        raise BadInput(f"{path}: not a readable PX4 log: {why}") from why


_KINDS = frozenset(b"BFIMPQARDLCSO")
_HEAD, _MESSAGE = 16, struct.Struct("<HB")
_IN_ORDER = 3
"""Number of correct messages in a row that ends the search for the next one behind damage."""


def without_damage(data: bytes, tell: Tell) -> bytes:
    """Return a log without the bytes in it that are no messages, as a card that fails leaves them.

    A data message has to be of a topic that was subscribed to, and as long as all of that topic.
    """
    sizes: dict[int, int | None] = {}
    out, at, good = bytearray(data[:_HEAD]), _HEAD, _HEAD
    while at < len(data):
        end = _end_of_message(data, at, sizes)
        if end is None:
            out += data[good:at]
            good = _next_message(data, at + 1, sizes)
            if good == len(data):
                tell(f"damaged: {good - at} bytes at its end (from byte {at}) are no message, or cut short, and were left out")
            else:
                tell(f"damaged: {good - at} bytes from byte {at} on are none of a log and were left out")
            at = good
            continue
        _note(data, at, sizes)
        at = end
    return bytes(out + data[good:at])


def _end_of_message(data: bytes, at: int, sizes: Mapping[int, int | None]) -> int | None:
    """Return where a message ends; None if there is none."""
    if at + _MESSAGE.size > len(data):
        return None
    size, kind = _MESSAGE.unpack_from(data, at)
    end: int = at + _MESSAGE.size + size
    if kind not in _KINDS or end > len(data) or size == 0:
        return None
    if kind == ord("D"):
        number = int.from_bytes(data[at + 3 : at + 5], "little")
        if number not in sizes or sizes[number] not in (None, size):
            return None
    return end


def _note(data: bytes, at: int, sizes: dict[int, int | None]) -> None:
    size, kind = _MESSAGE.unpack_from(data, at)
    if kind == ord("A") and size >= 3:
        sizes[int.from_bytes(data[at + 4 : at + 6], "little")] = None
    elif kind == ord("D"):
        sizes[int.from_bytes(data[at + 3 : at + 5], "little")] = size


def _next_message(data: bytes, at: int, sizes: Mapping[int, int | None]) -> int:
    """Return where messages go on behind damage, the end of the data if they do not."""
    for begin in range(at, len(data) - _MESSAGE.size):
        end: int | None = begin
        for _ in range(_IN_ORDER):
            end = None if end is None else end if end == len(data) else _end_of_message(data, end, sizes)
        if end is not None:
            return begin
    return len(data)


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
    begin_ns = (stamps_us[of_log[0]] - first_us) * 1000
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


_HISTORY_TOPICS = (
    "vehicle_status", "vehicle_land_detected", "failsafe_flags", "estimator_status", "vehicle_imu_status", "sensor_combined",
    "event",
)  # fmt: skip
_ARMED = 2
"""arming_state of vehicle_status."""
_PRECLAND = 20
"""nav_state of AUTO.PRECLAND."""
_RATIOS = {"vel_test_ratio": "velocity", "pos_test_ratio": "position", "hgt_test_ratio": "height", "mag_test_ratio": "compass"}
_REASONS = {
    "offboard_control_signal_lost": "setpoints lost", "manual_control_signal_lost": "remote control lost",
    "gcs_connection_lost": "station lost", "battery_warning": "battery", "battery_low_remaining_time": "battery",
    "battery_unhealthy": "battery unhealthy", "geofence_breached": "fence", "local_position_invalid": "no position",
    "local_velocity_invalid": "no velocity", "attitude_invalid": "no attitude", "wind_limit_exceeded": "wind",
    "fd_critical_failure": "failure detector", "fd_motor_failure": "motor", "fd_imbalanced_prop": "propeller",
}  # fmt: skip
"""Flags of failsafe_flags; those that rose with the failsafe are its reason."""
_WITH_S = 3.0
"""Longest time before a failsafe at which its reason may have begun, s; PX4 waits with most for a moment."""
Topic = dict[str, Any]


def read_history(path: Path, tell: Tell = quiet) -> AutopilotLog:
    """Return what the log says besides its samples.

    Raises:
        BadInput: the file cannot be read, is no ULog, or holds no parameters.
    """
    log = open_ulog(path, _HISTORY_TOPICS, tell)
    with refused(f"{path}: not the topics of a PX4 log", *_OF_OTHERS):
        return _autopilot_log(path, log)


def _autopilot_log(path: Path, log: Any) -> AutopilotLog:
    changed = {name: value for _, name, value in log.changed_parameters}
    parameters = {
        str(name): float(value)
        for name, value in sorted((log.initial_parameters | changed).items())
        if isinstance(value, int | float) and math.isfinite(value)
    }
    if not parameters:
        raise BadInput(f"{path}: holds no parameters")
    topics: dict[str, Topic] = {}
    for data in log.data_list:
        if len(data.data["timestamp"]) and data.multi_id == 0:
            topics.setdefault(data.name, _since(int(log.start_timestamp), data.data))
    history = _history(log, topics)
    states = topics.get("vehicle_status", {}).get("nav_state", ())
    precision = any(int(state) == _PRECLAND for state in states)
    events = tuple(int(n) for n in topics.get("event", {}).get("id", ()))
    texts = tuple(str(m.message) for m in log.logged_messages)
    times_s = tuple(round((int(m.timestamp) - int(log.start_timestamp)) * 1e-6, 2) for m in log.logged_messages)
    of_firmware, of_airframe = (log.get_default_parameters(kind) for kind in (0, 1))
    defaults = {str(name): float(value) for name, value in (of_firmware | of_airframe).items() if isinstance(value, int | float)}
    return AutopilotLog("PX4", None, _firmware(log), parameters, texts, events, history, times_s, defaults, precision)


def _since(began_us: int, topic: Topic) -> Topic:
    """Return a topic with what was published before the log began at its begin, and without absurd stamps."""
    at = np.maximum(np.asarray(topic["timestamp"], dtype=np.int64), began_us)
    kept = np.array([t is not None for t in timeline(at.tolist())], dtype=bool)
    return {name: (at if name == "timestamp" else np.asarray(values))[kept] for name, values in topic.items()}


def _firmware(log: Any) -> tuple[int, int, int] | None:
    packed = log.msg_info_dict.get("ver_sw_release")
    return (packed >> 24 & 0xFF, packed >> 16 & 0xFF, packed >> 8 & 0xFF) if isinstance(packed, int) else None


def _history(log: Any, topics: dict[str, Topic]) -> LogHistory:
    begin_us, end_us = int(log.start_timestamp), int(log.last_timestamp)
    instants = [t["timestamp"] for t in topics.values() if len(t["timestamp"])]
    if instants:
        end_us = max(int(at[-1]) for at in instants)
        begin_us = begin_us or min(int(at[0]) for at in instants)
    reader = _HistoryReader(begin_us, topics.keys())
    # Of one instant, the armed state comes first.
    order = {name: n for n, name in enumerate(reader.makers) if name in topics}
    for at_us, n, i in sorted((int(at), n, i) for name, n in order.items() for i, at in enumerate(topics[name]["timestamp"])):
        name = list(reader.makers)[n]
        reader.take(name, at_us, {field: values[i] for field, values in topics[name].items()})
    reader.failsafes += [LoggedMoment(reader.since_s(at_us), reader.reason(log, at_us)) for at_us in reader.failsafes_us]
    return reader.history(max(end_us - begin_us, 0) * 1e-6, sum(int(d.duration) for d in log.dropouts) * 1e-3)


class _HistoryReader(HistoryMeter):
    """Reads rows of topics in order of time.

    Args:
        begin_us: timestamp of the log's beginning.
        topics: names of the topics that the log holds; without `vehicle_status` the vehicle counts as armed.
    """

    def __init__(self, begin_us: int, topics: Set[str]) -> None:
        super().__init__("PX4")
        self._begin_us = begin_us
        self.armed = False if "vehicle_status" in topics else None
        self.failsafes_us: list[int] = []
        self._failsafe = False
        self._flags: dict[str, bool] = {}
        self._rose_us: dict[str, list[int]] = {name: [] for name in _REASONS}
        self._landed: bool | None = None
        self.makers: dict[str, Callable[[Any, int], None]] = {
            "vehicle_status": self._status, "failsafe_flags": self._failsafe_flags, "estimator_status": self._estimator,
            "vehicle_imu_status": self._imu_status, "vehicle_land_detected": self._land_detected,
        }  # fmt: skip
        if "vehicle_imu_status" not in topics:
            self.makers["sensor_combined"] = self._combined

    def since_s(self, at_us: int) -> float:
        """Return the time of a timestamp since the log began, s."""
        return round((at_us - self._begin_us) * 1e-6, 2)

    def take(self, name: str, at_us: int, row: Mapping[str, Any]) -> None:
        """Take one row of a topic."""
        self.now_s = (at_us - self._begin_us) * 1e-6
        self.makers[name](row, at_us)

    def reason(self, log: Any, at_us: int) -> str:
        """Return what a failsafe that began then is: by the flags that rose with it, or by a text of that second."""
        begin, end = at_us - round(_WITH_S * 1e6), at_us + 200_000
        found = [reason for name, reason in _REASONS.items() if any(begin <= rose <= end for rose in self._rose_us[name])]
        if found:
            return f"failsafe: {', '.join(dict.fromkeys(found))}"
        near = [str(m.message) for m in log.logged_messages if abs(int(m.timestamp) - at_us) < 1e6]
        return next((text.strip() for text in near if "failsafe" in text.lower()), "failsafe")

    def _status(self, row: Mapping[str, Any], at_us: int) -> None:
        armed = bool(row["arming_state"] == _ARMED)
        if self.armed and not armed:
            self.landings.disarmed(self.now_s)
        failsafe = bool(row.get("failsafe", False))
        if failsafe and not self._failsafe:
            self.failsafes_us.append(at_us)
        self.armed, self._failsafe = armed, failsafe

    def _failsafe_flags(self, row: Mapping[str, Any], at_us: int) -> None:
        flags = {name: bool(row[name]) for name in _REASONS if name in row}
        for name, flag in flags.items():
            if flag and not self._flags.get(name, True):
                self._rose_us[name].append(at_us)
        self._flags = flags

    def _estimator(self, row: Mapping[str, Any], at_us: int) -> None:
        for field, name in _RATIOS.items():
            if field in row:
                self.ratio(name, float(row[field]))

    def _imu_status(self, row: Mapping[str, Any], at_us: int) -> None:
        for axis in range(3):
            if (name := f"accel_clipping[{axis}]") in row:
                self.clips(name, int(row[name]))
        if "accel_vibration_metric" in row:
            self.vibration(float(row["accel_vibration_metric"]))

    def _combined(self, row: Mapping[str, Any], at_us: int) -> None:
        self.clipped += bool(row.get("accelerometer_clipping", False)) and self.armed is not False

    def _land_detected(self, row: Mapping[str, Any], at_us: int) -> None:
        landed = bool(row["landed"])
        if landed is not self._landed:
            (self.landings.landed if landed else self.landings.flying)(self.now_s)
        self._landed = landed
