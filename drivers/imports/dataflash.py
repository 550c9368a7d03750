"""Read an ArduPilot dataflash log through pymavlink: its samples, and its parameters, texts and events.

Source: ArduPilot's log message documentation, Copter 3.2 to 4.6, and the values of LogEvent and LogErrorSubsystem in AP_Logger.
Angles are in degrees, velocities NED; the time is `TimeUS`, in logs of 2014 `TimeMS`.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
import struct
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs

# DFReader loads a dialect that it does not use. An installed service has only this one (requirements/slim.sh).
os.environ.setdefault("MAVLINK_DIALECT", "common")
os.environ.setdefault("MAVLINK20", "1")
from pymavlink import DFReader

from drivers.files import Largest, opened
from drivers.imports.columns import DATAFLASH, cell, unknown
from drivers.imports.log_history import AutopilotLog, HistoryMeter, LoggedMoment
from drivers.imports.stamps import Tell, attitude, in_level, quiet, stamp, timeline
from estimator.contracts.errors import BadInput, DecklanderError
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Baro, BodyVelocity, Imu, Range, Sample, VehicleStatus

MAGIC = b"\xa3\x95"
TEXT_HEAD = 4096
_DOWN = 25
"""The orientation of a rangefinder that looks down (MAV_SENSOR_ROTATION_PITCH_270)."""
_VELOCITIES = ("XKF1", "NKF1", "EKF1")
"""The velocity messages, the newest generation of the filter first: the one that flies, else the first in the log."""
_PRIMARIES = {"XKF4": "XKF1", "NKF4": "NKF1"}
"""The messages that name the core that flies, for those of its velocity."""
_ACTIVE = {2: "NKF1", 3: "XKF1"}
"""The velocity message by the estimator that flies (AHRS_EKF_TYPE)."""
_LANDED, _NOT_LANDED = (17, 18), 28
"""The values of LogEvent for "land complete maybe" and "land complete", and for "not landed"."""


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


def open_log(path: Path, tell: Tell = quiet) -> PartedLog:
    """Open a log; `close` it, or `give_up` after an error.

    Raises:
        BadInput: the file cannot be read or is no dataflash log.
    """
    try:
        with opened(path, Largest.LOG) as file:
            head = file.read(TEXT_HEAD)
        log = None
        if head[:2] == MAGIC or is_text(head):
            log = PartedLog(path, tell, is_text=head[:2] != MAGIC)
    except DecklanderError:
        raise
    except Exception as why:  # pymavlink lets any error of its parser through
        raise BadInput(f"{path}: not a readable dataflash log: {why}") from why
    if log is None:
        raise BadInput(f"{path}: not a dataflash log")
    return log


def is_text(head: bytes) -> bool:
    """Return whether a file begins as the text form of a log, as ground stations write it."""
    return any(re.match(rb"FMT, ?\d+, ?\d+, ?\w+", line) for line in head.splitlines()[:20])


_FMT, _FMT_SIZE = MAGIC + b"\x80", 89
_FMT_FIELDS = struct.Struct("<BB4s16s64s")


def parts_of(data: bytes | mmap) -> list[bytes]:
    """Return the parts of a binary log between descriptions that replace others; an empty list without such.

    Each part but the first begins with the descriptions that hold there. pymavlink reads a whole file by its last ones.
    """
    known: dict[int, bytes] = {}
    cuts, at = list[tuple[int, bytes]](), data.find(_FMT)
    while at >= 0:
        described = data[at : at + _FMT_SIZE]
        number = _number_of(described)
        if number is None:
            at = data.find(_FMT, at + 1)
            continue
        if known.get(number, described) != described:
            cuts.append((at, b"".join(known.values())))
        known[number] = described
        at = data.find(_FMT, at + _FMT_SIZE)
    if not cuts:
        return []
    begins, ends = [(0, b""), *cuts], [*(at for at, _ in cuts), len(data)]
    return [head + data[begin:end] for (begin, head), end in zip(begins, ends, strict=True)]


def _number_of(described: bytes) -> int | None:
    """Return the number of the message that a FMT describes; None if it is none."""
    if len(described) < _FMT_SIZE:
        return None
    number, size, name, form, columns = _FMT_FIELDS.unpack_from(described, len(_FMT))
    try:
        packed = "<" + "".join(DFReader.FORMAT_TO_STRUCT[letter][0].lstrip("<") for letter in form.rstrip(b"\0").decode())
        plain = (name.rstrip(b"\0") + columns.rstrip(b"\0").replace(b",", b"")).decode("ascii").isprintable()
        return int(number) if plain and struct.calcsize(packed) + 3 == size else None
    except (KeyError, UnicodeDecodeError):
        return None


class PartedLog:
    """A log that pymavlink reads, part by part.

    What pymavlink prints about damage is given to `tell` as one note.
    """

    def __init__(self, path: Path, tell: Tell, *, is_text: bool) -> None:
        self._tell, self._printed = tell, io.StringIO()
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        paths, parts = [path], list[bytes]()
        if not is_text:
            with opened(path, Largest.LOG) as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
                parts = parts_of(data)
        if parts:
            self._folder = tempfile.TemporaryDirectory(prefix="decklander-")
            paths = [Path(self._folder.name) / f"{n}.bin" for n in range(len(parts))]
            for part, described in zip(paths, parts, strict=True):
                part.write_bytes(described)
        self._reader = DFReader.DFReader_text if is_text else DataflashLog
        self._paths = paths
        self._log: Any = None
        try:
            self._next()
        except BaseException as why:
            self.give_up(why)
            raise

    def _next(self) -> None:
        # A reader whose file cannot be read is at hand all the same, to be closed.
        self._log = self._reader.__new__(self._reader)
        with contextlib.redirect_stdout(self._printed), contextlib.redirect_stderr(self._printed):
            self._log.__init__(str(self._paths.pop(0)))

    def recv_match(self, type: list[str]) -> Any:
        """Return the next message of these types, None at the end."""
        while True:
            with contextlib.redirect_stdout(self._printed), contextlib.redirect_stderr(self._printed):
                message = self._log.recv_match(type=type)
            if message is not None or not self._paths:
                return message
            _close(self._log)
            self._next()

    def close(self) -> None:
        """Close the files, and report damage."""
        _close(self._log)
        if self._folder is not None:
            self._folder.cleanup()
        if lines := [line for line in self._printed.getvalue().splitlines() if line.strip()]:
            self._tell(f"damaged: {len(lines)} notes of its parser, the first: {lines[0]}")

    def give_up(self, why: BaseException) -> None:
        """Close the files after an error whose stack frames still refer to them."""
        traceback.clear_frames(why.__traceback__)
        _close(self._log)
        if self._folder is not None:
            self._folder.cleanup()


def _close(log: Any) -> None:
    """Close the files of a reader of pymavlink, which leaves some open."""
    for name in ("filehandle", "data_map"):
        if (opened := getattr(log, name, None)) is not None:
            opened.close()


class DataflashLog(DFReader.DFReader_binary):  # type: ignore[misc]
    """A reader that ends at a message of length 0, at which pymavlink's own loops forever."""

    def _parse_next(self) -> Any:
        before = self.offset
        message = super()._parse_next()
        if message is not None and self.offset <= before:
            raise ValueError(f"a message of no length at byte {before}")
        return message


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

    def samples(self, tell: Tell) -> list[Sample]:
        stamps_us: list[int] = []
        made: list[tuple[int, str, Sample]] = []
        met: dict[str, list[str]] = {}
        self._tell = tell
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
        times = timeline(stamps_us, tell)
        if strange := [name for names in met.values() for name in names]:
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
        if event not in (*_LANDED, _NOT_LANDED):
            return None
        flying = event == _NOT_LANDED
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


def time_us(m: Any) -> int | None:
    """Return a message's time since the start of the autopilot, microseconds; None if it has none."""
    if hasattr(m, "TimeUS"):
        return int(m.TimeUS)
    return int(m.TimeMS) * 1000 if hasattr(m, "TimeMS") else None


_ARMED, _DISARMED, _LAND_COMPLETE = 10, 11, 18
"""Values of LogEvent."""
_BAD_VARIANCE, _GLITCH = 2, 2
_ERRORS: dict[int, str | dict[int, str]] = {
    3: "compass failed", 5: "failsafe: remote control lost", 6: "failsafe: battery", 8: "failsafe: station lost",
    9: "failsafe: fence", 11: {_GLITCH: "GNSS glitch"}, 12: {1: "crash detected: motors stopped", 2: "loss of control"},
    16: {_BAD_VARIANCE: "EKF check: variances too large"}, 17: "failsafe: EKF", 18: {_GLITCH: "barometer glitch"},
    23: "failsafe: terrain", 25: "loss of thrust", 26: "failsafe: sensors", 29: "vibration failsafe",
    30: "internal error", 31: "failsafe: dead reckoning",
}  # fmt: skip
"""LogErrorSubsystem to a name; error code 0 says that it is over. Where only some codes are an error, they are named."""
_RATIOS = {"velocity": ("SV",), "position": ("SP",), "height": ("SH",), "compass": ("SM", "SMX", "SMY", "SMZ")}
_ESTIMATORS = ("XKF4", "NKF4", "EKF4")
_VEHICLE = re.compile(r"(?:APM:|Ardu)?(Copter|Plane|Rover|Sub|Tracker|Blimp)\s+V(\d+)\.(\d+)(?:\.(\d+))?")
_TEXTS_MAX = 1000


def read_history(path: Path, tell: Tell = quiet) -> AutopilotLog:
    """Return what the log says besides its samples.

    Raises:
        BadInput: the file cannot be read, is no dataflash log, or is damaged before its first parameter.
    """
    log = open_log(path, tell)
    reader, messages = _HistoryReader(), list[Any]()
    try:
        while (message := log.recv_match(type=list(reader.makers))) is not None:
            messages.append(message)
    except Exception as why:  # pymavlink lets any error of its parser through
        log.give_up(why)
        if not any(message.get_type() == "PARM" for message in messages):
            raise BadInput(f"{path}: not a readable dataflash log: {why}") from why
        tell(f"it is damaged and was read up to there: {why}")
    else:
        log.close()
    timed = [(time_us(message), message) for message in messages]
    times = iter(timeline([at for at, _ in timed if at is not None], tell))
    for at_us, message in timed:
        reader.take(message, None if at_us is None else next(times), lost=at_us is not None)
    if not reader.parameters:
        raise BadInput(f"{path}: holds no parameters (no PARM message)")
    return reader.log()


class _HistoryReader(HistoryMeter):
    def __init__(self) -> None:
        super().__init__("ArduPilot")
        self.parameters: dict[str, float] = {}
        self._defaults: dict[str, float] = {}
        self._texts: list[str] = []
        self._text_times_s: list[float] = []
        self._vehicle: str | None = None
        self._firmware: tuple[int, int, int] | None = None
        self._acquired = False
        self.makers: dict[str, Callable[[Any], None]] = {
            "PARM": self._parameter, "MSG": self._text, "EV": self._event, "ERR": self._error, "VIBE": self._vibe,
            "PL": self._target, **dict.fromkeys(_ESTIMATORS, self._estimator),
        }  # fmt: skip

    def take(self, message: Any, at_ns: int | None, *, lost: bool) -> None:
        """Take one message; one whose fields are missing or are text is left out, and one without a time that has a stamp.

        Parameters and texts are taken with any stamp.
        """
        if at_ns is not None:
            self.now_s = max(self.now_s, 1e-9 * at_ns)
        elif lost and message.get_type() not in ("PARM", "MSG"):
            return
        try:
            self.makers[message.get_type()](message)
        except (AttributeError, TypeError, ValueError, OverflowError):
            return

    def log(self) -> AutopilotLog:
        """Return all that was taken."""
        return AutopilotLog(
            "ArduPilot", self._vehicle, self._firmware, dict(sorted(self.parameters.items())), tuple(self._texts), (),
            self.history(self.now_s), tuple(self._text_times_s), self._defaults,
        )  # fmt: skip

    def _parameter(self, m: Any) -> None:
        value = float(m.Value)
        if math.isfinite(value):
            self.parameters[str(m.Name)] = value
            default = float(getattr(m, "Default", math.nan))
            if math.isfinite(default):
                self._defaults[str(m.Name)] = default

    def _text(self, m: Any) -> None:
        text = str(m.Message)
        if self._vehicle is None and (found := _VEHICLE.search(text)) is not None:
            self._vehicle = f"Ardu{found[1]}"
            self._firmware = (int(found[2]), int(found[3]), int(found[4] or 0))
        if len(self._texts) < _TEXTS_MAX:
            self._texts.append(text)
            self._text_times_s.append(round(self.now_s, 2))

    def _event(self, m: Any) -> None:
        if m.Id == _ARMED:
            self.armed = True
        elif m.Id == _DISARMED:
            self.armed = False
            self.landings.disarmed(self.now_s)
        elif m.Id == _LAND_COMPLETE:
            self.landings.landed(self.now_s)
        elif m.Id == _NOT_LANDED:
            self.landings.flying(self.now_s)

    def _error(self, m: Any) -> None:
        named = _ERRORS.get(int(m.Subsys))
        what = named.get(int(m.ECode)) if isinstance(named, dict) else named if int(m.ECode) else None
        if what is not None:
            self.failsafes.append(LoggedMoment(round(self.now_s, 2), what))

    def _estimator(self, m: Any) -> None:
        core = getattr(m, "C", 0)
        if core != getattr(m, "PI", core if core == 0 else -1):
            return
        for name, fields in _RATIOS.items():
            self.ratio(name, max(float(getattr(m, field, 0.0)) for field in fields))

    def _vibe(self, m: Any) -> None:
        imu = getattr(m, "IMU", 0)
        if imu == 0:
            self.vibration(max(float(m.VibeX), float(m.VibeY), float(m.VibeZ)))
        fields = {str(imu): "Clip"} if hasattr(m, "Clip") else {str(n): f"Clip{n}" for n in range(3)}
        for name, count in {name: float(getattr(m, field)) for name, field in fields.items()}.items():
            self.clips(name, count)

    def _target(self, m: Any) -> None:
        acquired = bool(m.TAcq)
        self.targets_lost += self._acquired and not acquired and self.armed is not False
        self._acquired = acquired
