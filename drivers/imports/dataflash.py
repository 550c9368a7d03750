"""Read IMU, attitude, velocity, range and baro samples of an ArduPilot dataflash log, through pymavlink.

Source: ArduPilot's log message documentation, Copter 3.2 to 4.6. Angles are in degrees, velocities NED; the time is
`TimeUS`, in logs of 2014 `TimeMS`.
"""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink import DFReader

from drivers.imports.stamps import attitude, in_level, stamp
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Baro, BodyVelocity, Imu, Range, Sample, VehicleStatus

MAGIC = b"\xa3\x95"
_VELOCITIES = ("XKF1", "NKF1", "EKF1")
"""The velocity messages, the newest generation of the filter first; the first core of the first one in the log is used."""
_LANDED, _NOT_LANDED = (17, 18), 28
"""The values of LogEvent for "land complete maybe" and "land complete", and for "not landed"."""


def read(path: Path) -> list[Sample]:
    """Return all samples in order; values that are not finite are left out.

    Raises:
        BadInput: the file cannot be read, is no dataflash log, or holds neither IMU nor attitude.
    """
    log = open_log(path)
    try:
        samples = _Reader(log).samples()
    except Exception as why:
        log.give_up(why)
        raise BadInput(f"{path}: not a readable dataflash log: {why}") from why
    log.close()
    if not any(isinstance(s, Imu) or type(s).__name__ == "Attitude" for s in samples):
        raise BadInput(f"{path}: holds neither IMU nor ATT messages")
    return sorted(samples, key=lambda s: s.stamp.received_at)


def open_log(path: Path) -> DataflashLog:
    """Open a log; `close` it, or `give_up` after an error.

    Raises:
        BadInput: the file cannot be read or is no dataflash log.
    """
    try:
        with path.open("rb") as file:
            binary = file.read(2) == MAGIC
        log = DataflashLog(str(path)) if binary else None
    except OSError as why:
        raise BadInput(f"{path}: {why.strerror or why}") from why
    except Exception as why:  # pymavlink lets any error of its parser through
        raise BadInput(f"{path}: not a readable dataflash log: {why}") from why
    if log is None:
        raise BadInput(f"{path}: not a dataflash log (its text form is not read: keep the .bin)")
    return log


class DataflashLog(DFReader.DFReader_binary):  # type: ignore[misc]
    """A reader that ends at a message of length 0, at which pymavlink's own loops forever, and closes unreadable files."""

    def __init__(self, filename: str) -> None:
        try:
            super().__init__(filename)
        except BaseException as why:
            self.give_up(why)
            raise

    def give_up(self, why: BaseException) -> None:
        """Close the file after an error whose stack frames still refer to it."""
        traceback.clear_frames(why.__traceback__)
        for name in ("filehandle", "data_map"):
            if (opened := getattr(self, name, None)) is not None:
                opened.close()

    def _parse_next(self) -> Any:
        before = self.offset
        message = super()._parse_next()
        if message is not None and self.offset <= before:
            raise ValueError(f"a message of no length at byte {before}")
        return message


class _Reader:
    def __init__(self, log: Any) -> None:
        self._log = log
        self._first_us: int | None = None
        self._now_ns = 0
        self._yaw_rad: float | None = None
        self._velocity_of: str | None = None
        self._makers: dict[str, Callable[[Any, int], Sample | None]] = {
            "IMU": self._imu,
            "ATT": self._attitude,
            "BARO": self._baro,
            "RFND": self._range,
            "EV": self._event,
            **dict.fromkeys(_VELOCITIES, self._velocity),
        }

    def samples(self) -> list[Sample]:
        out: list[Sample] = []
        while (message := self._log.recv_match(type=list(self._makers))) is not None:
            at_us = time_us(message)
            if at_us is not None:
                self._first_us = at_us if self._first_us is None else self._first_us
                self._now_ns = max(0, at_us - self._first_us) * 1000
            try:
                sample = self._makers[message.get_type()](message, self._now_ns)
            except (AttributeError, TypeError, ValueError):  # a field is missing, is text, or has a value that no sensor gives
                continue
            if sample is not None:
                out.append(sample)
        return out

    def _imu(self, m: Any, at: int) -> Sample | None:
        if getattr(m, "I", 0) != 0:
            return None
        w, f = np.array([m.GyrX, m.GyrY, m.GyrZ], float), np.array([m.AccX, m.AccY, m.AccZ], float)
        return Imu(stamp(at), w, f) if np.all(np.isfinite(w)) and np.all(np.isfinite(f)) else None

    def _attitude(self, m: Any, at: int) -> Sample | None:
        angles = [math.radians(a) for a in (m.Roll, m.Pitch, m.Yaw)]
        if not all(map(math.isfinite, angles)):
            return None
        self._yaw_rad = angles[2]
        return attitude(at, Rotation.from_rpy(*angles))

    def _velocity(self, m: Any, at: int) -> Sample | None:
        kind = m.get_type()
        if self._velocity_of is None or _VELOCITIES.index(kind) < _VELOCITIES.index(self._velocity_of):
            self._velocity_of = kind
        v = np.array([m.VN, m.VE, m.VD], float)
        known = self._yaw_rad is not None and np.all(np.isfinite(v))
        if kind != self._velocity_of or getattr(m, "C", 0) != 0 or not known or self._yaw_rad is None:
            return None
        return BodyVelocity(stamp(at), in_level(v, self._yaw_rad), np.diag([0.09, 0.09, 0.09]))

    def _baro(self, m: Any, at: int) -> Sample | None:
        usable = getattr(m, "I", 0) == 0 and math.isfinite(m.Alt)
        return Baro(stamp(at), float(m.Alt), 0.5) if usable else None

    def _range(self, m: Any, at: int) -> Sample | None:
        distance = float(getattr(m, "Dist", getattr(m, "Dist1", math.nan)))
        good = getattr(m, "Stat", 4) == 4 and getattr(m, "Instance", 0) == 0
        return Range(stamp(at), distance, 0.05) if good and math.isfinite(distance) and distance > 0 else None

    def _event(self, m: Any, at: int) -> Sample | None:
        if m.Id not in (*_LANDED, _NOT_LANDED):
            return None
        flying = m.Id == _NOT_LANDED
        return VehicleStatus(stamp(at), flying, "flying" if flying else "landed", None, False, True)


def time_us(m: Any) -> int | None:
    """Return a message's time since the start of the autopilot, microseconds; None if it has none."""
    if hasattr(m, "TimeUS"):
        return int(m.TimeUS)
    return int(m.TimeMS) * 1000 if hasattr(m, "TimeMS") else None
