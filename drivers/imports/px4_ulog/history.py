"""Read the parameters, texts and events of a PX4 log (ULog)."""

import math
from collections.abc import Callable, Mapping, Set
from pathlib import Path
from typing import Any

import numpy as np

from drivers.imports.history_meter import HistoryMeter
from drivers.imports.px4_ulog.samples import ERRORS_OF_OTHERS, open_ulog
from drivers.log_history import AutopilotLog, LoggedMoment, LogHistory
from drivers.log_stamps import Tell, quiet, timeline
from estimator.contracts.errors import BadInput, refused

_ARMED = 2
"""arming_state of vehicle_status."""
_PRECLAND = 20
"""nav_state of AUTO.PRECLAND."""
_WITH_S = 3.0
"""Longest time before a failsafe at which its reason may have begun, s; PX4 waits with most for a moment."""
_HISTORY_TOPICS = (
    "vehicle_status", "vehicle_land_detected", "failsafe_flags", "estimator_status", "vehicle_imu_status", "sensor_combined",
    "event",
)  # fmt: skip
_RATIOS = {"vel_test_ratio": "velocity", "pos_test_ratio": "position", "hgt_test_ratio": "height", "mag_test_ratio": "compass"}
_REASONS = {
    "offboard_control_signal_lost": "setpoints lost", "manual_control_signal_lost": "remote control lost",
    "gcs_connection_lost": "station lost", "battery_warning": "battery", "battery_low_remaining_time": "battery",
    "battery_unhealthy": "battery unhealthy", "geofence_breached": "fence", "local_position_invalid": "no position",
    "local_velocity_invalid": "no velocity", "attitude_invalid": "no attitude", "wind_limit_exceeded": "wind",
    "fd_critical_failure": "failure detector", "fd_motor_failure": "motor", "fd_imbalanced_prop": "propeller",
}  # fmt: skip
"""Flags of failsafe_flags; those that rose with the failsafe are its reason."""
Topic = dict[str, Any]


def read_history(path: Path, tell: Tell = quiet) -> AutopilotLog:
    """Return what the log says besides its samples.

    Raises:
        BadInput: the file cannot be read, is no ULog, or holds no parameters.
    """
    log = open_ulog(path, _HISTORY_TOPICS, tell)
    with refused(f"{path}: not the topics of a PX4 log", *ERRORS_OF_OTHERS):
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
