"""Read the samples of an ArduPilot dataflash log.

Source: ArduPilot's log message documentation, Copter 3.2 to 4.6. Angles are in degrees, velocities NED.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs

from drivers.imports.columns import DATAFLASH, cell, unknown
from drivers.imports.dataflash.log import LogEvent, open_log, time_us
from drivers.log_stamps import Tell, attitude, in_level, quiet, stamp, timeline
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Baro, BodyVelocity, Imu, Range, Sample, VehicleStatus

_DOWN = 25
"""The orientation of a rangefinder that looks down (MAV_SENSOR_ROTATION_PITCH_270)."""
_VELOCITIES = ("XKF1", "NKF1", "EKF1")
"""The velocity messages, the newest generation of the filter first: the one that flies, else the first in the log."""
_PRIMARIES = {"XKF4": "XKF1", "NKF4": "NKF1"}
"""The messages that name the core that flies, for those of its velocity."""
_ACTIVE = {2: "NKF1", 3: "XKF1"}
"""The velocity message by the estimator that flies (AHRS_EKF_TYPE)."""


def read(path: Path, tell: Tell = quiet) -> list[Sample]:
    """Return all samples in order; values that are not finite are left out, and ranges of a sensor that does not look down.

    Raises:
        BadInput: the file cannot be read, is no dataflash log, or holds neither IMU nor attitude.
    """
    log = open_log(path, tell)
    try:
        samples = _Reader(log).samples(tell)
    except Exception as why:
        log.give_up(why)
        raise BadInput(f"{path}: not a readable dataflash log: {why}") from why
    log.close()
    if not any(isinstance(s, Imu) or type(s).__name__ == "Attitude" for s in samples):
        raise BadInput(f"{path}: holds neither IMU nor ATT messages")
    return sorted(samples, key=lambda s: s.stamp.received_at)


class _Reader:
    def __init__(self, log: Any) -> None:
        self._log = log
        self._yaw_rad: float | None = None
        self._velocity_of: str | None = None
        self._active: str | None = None
        self._cores: dict[str, int] = {}
        self._makers: dict[str, Callable[[Any, int], Sample | None]] = {
            "IMU": self._imu,
            "ATT": self._attitude,
            "BARO": self._baro,
            "RFND": self._range,
            "EV": self._event,
            **dict.fromkeys(_PRIMARIES, self._primary),
            **dict.fromkeys(_VELOCITIES, self._velocity),
        }

    def _made(self) -> tuple[list[int], list[tuple[int, str, Sample]], list[str]]:
        """Return all times, us, each sample with the number of its message's time and its sensor, and unknown columns."""
        stamps_us: list[int] = []
        made: list[tuple[int, str, Sample]] = []
        met: dict[str, list[str]] = {}
        while (message := self._log.recv_match(type=list(self._makers))) is not None:
            kind = message.get_type()
            if kind not in met:
                met[kind] = [f"{kind}.{name}" for name in unknown(DATAFLASH[kind], message.get_fieldnames())]
            at_us = time_us(message)
            if at_us is not None:
                stamps_us.append(at_us)
            elif not stamps_us:
                continue
            for one in _sensors(message):
                try:
                    sample = self._makers[kind](one, 0)
                except (AttributeError, TypeError, ValueError):  # a field is missing, text, or has a value that no sensor gives
                    continue
                if sample is not None:
                    made.append((len(stamps_us) - 1, str(getattr(one, "Instance", getattr(one, "I", 0))), sample))
        return stamps_us, made, [name for names in met.values() for name in names]

    def samples(self, tell: Tell) -> list[Sample]:
        self._tell = tell
        stamps_us, made, strange = self._made()
        times = timeline(stamps_us, tell)
        if strange:
            tell(f"columns that are not known here are not read: {', '.join(strange)}")
        counts = Counter(sensor for _, sensor, sample in made if type(sample) is Range)
        lower = None if not counts else max(counts, key=lambda sensor: counts[sensor])
        if len(counts) > 1:
            tell(f"{len(counts)} rangefinders look down: the height is that of number {lower}, which gave most")
        read = {Range: lower, Imu: _first(made, Imu, "IMU", tell), Baro: _first(made, Baro, "barometer", tell)}
        kept = ((times[i], s) for i, sensor, s in made if read.get(type(s), sensor) == sensor)
        return [structs.replace(s, stamp=stamp(at)) for at, s in kept if at is not None]

    def _imu(self, m: Any, at: int) -> Sample | None:
        values = np.array([_cell(m, name) for name in ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ")], float)
        healthy = None not in (_cell(m, "GH", 1), _cell(m, "AH", 1))
        # Six zeros are those of a sensor that is not there.
        return Imu(stamp(at), values[:3], values[3:]) if healthy and np.all(np.isfinite(values)) and np.any(values) else None

    def _attitude(self, m: Any, at: int) -> Sample | None:
        self._active = _ACTIVE.get(_cell(m, "AEKF", 0), self._active)
        angles = [math.radians(_cell(m, name)) for name in ("Roll", "Pitch", "Yaw")]
        if not all(map(math.isfinite, angles)):
            return None
        self._yaw_rad = angles[2]
        return attitude(at, Rotation.from_rpy(*angles))

    def _primary(self, m: Any, at: int) -> Sample | None:
        core, kind = _cell(m, "PI", -1), _PRIMARIES[m.get_type()]
        if core is not None and core != self._cores.get(kind, 0):
            self._tell(
                f"estimator core {core} flies from {1e-6 * (time_us(m) or 0):.1f} s after boot on: the velocity is that of it"
            )
            self._cores[kind] = core
        return None

    def _velocity(self, m: Any, at: int) -> Sample | None:
        kind = m.get_type()
        if self._velocity_of is None or _VELOCITIES.index(kind) < _VELOCITIES.index(self._velocity_of):
            self._velocity_of = kind
        v = np.array([_cell(m, name) for name in ("VN", "VE", "VD")], float)
        known = self._yaw_rad is not None and np.all(np.isfinite(v))
        core = _cell(m, "C", 0)
        if kind != (self._active or self._velocity_of) or core != self._cores.get(kind, 0) or not known or self._yaw_rad is None:
            return None
        return BodyVelocity(stamp(at), in_level(v, self._yaw_rad), np.diag([0.09, 0.09, 0.09]))

    def _baro(self, m: Any, at: int) -> Sample | None:
        known = None not in (_cell(m, "H", 1), _cell(m, "Health", 1), _cell(m, "Press", 1))
        height_m = float(_cell(m, "Alt"))
        return Baro(stamp(at), height_m, 0.5) if known and math.isfinite(height_m) else None

    def _range(self, m: Any, at: int) -> Sample | None:
        distance = float(_cell(m, "Dist"))
        # Logs from before there were several hold no orientation: the first sensor looked down.
        down = _cell(m, "Orient", _DOWN if _cell(m, "Instance", 0) == 0 else None) == _DOWN
        good = _cell(m, "Stat", 4) == 4 and down and _cell(m, "Quality", 100) is not None
        return Range(stamp(at), distance, 0.05) if good and math.isfinite(distance) and distance > 0 else None

    def _event(self, m: Any, at: int) -> Sample | None:
        event = _cell(m, "Id")
        if event not in (LogEvent.LAND_COMPLETE_MAYBE, LogEvent.LAND_COMPLETE, LogEvent.NOT_LANDED):
            return None
        flying = event == LogEvent.NOT_LANDED
        return VehicleStatus(stamp(at), flying, "flying" if flying else "landed", None, False, True)


_REQUIRED = object()


def _cell(m: Any, name: str, default: Any = _REQUIRED) -> Any:
    """Return a column; None where it means "not measured", the default where the log has no such column."""
    value = getattr(m, name) if default is _REQUIRED else getattr(m, name, default)
    return cell(DATAFLASH[m.get_type()], name, value)


class _Numbered:
    """One of the sensors in a message that has a column of each, as RFND had until Copter 4.0: Dist1, Orient1, Dist2, Orient2."""

    def __init__(self, of: Any, number: int) -> None:
        self._of, self._number, self.Instance = of, number, number - 1

    def get_type(self) -> str:
        return str(self._of.get_type())

    def __getattr__(self, name: str) -> Any:
        return getattr(self._of, f"{name}{self._number}")


def _sensors(m: Any) -> list[Any]:
    """Return a message by the sensors that it is of."""
    return [_Numbered(m, number) for number in (1, 2)] if hasattr(m, "Dist1") else [m]


def _first(made: Sequence[tuple[int, str, Sample]], kind: type, name: str, tell: Tell) -> str:
    """Return the number of the sensor that flies: the first one; where it gave little, it failed or is switched off."""
    readings = Counter(sensor for _, sensor, sample in made if type(sample) is kind)
    most = max(readings.values(), default=0)
    number = min(
        (sensor for sensor, n in readings.items() if 2 * n > most), default="0", key=lambda sensor: (len(sensor), sensor)
    )
    if number != "0":
        tell(f"the {name} is that of number {number}: of number 0 it holds {readings['0']} readings, of that {most}")
    return number
