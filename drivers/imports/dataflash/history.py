"""Read the parameters, texts and events of an ArduPilot dataflash log.

Source: the values of LogErrorSubsystem in AP_Logger.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drivers.imports.dataflash.log import LogEvent, open_log, time_us
from drivers.imports.history_meter import HistoryMeter
from drivers.log_history import AutopilotLog, LoggedMoment
from drivers.log_stamps import Tell, quiet, timeline
from estimator.contracts.errors import BadInput

_TEXTS_MAX = 1000  # texts that are kept
_ERRORS: dict[int, str | dict[int, str]] = {
    3: "compass failed", 5: "failsafe: remote control lost", 6: "failsafe: battery", 8: "failsafe: station lost",
    9: "failsafe: fence", 11: {2: "GNSS glitch"}, 12: {1: "crash detected: motors stopped", 2: "loss of control"},
    16: {2: "EKF check: variances too large"}, 17: "failsafe: EKF", 18: {2: "barometer glitch"},
    23: "failsafe: terrain", 25: "loss of thrust", 26: "failsafe: sensors", 29: "vibration failsafe",
    30: "internal error", 31: "failsafe: dead reckoning",
}  # fmt: skip
"""LogErrorSubsystem to a name; error code 0 says that it is over. Where only some codes are an error, they are named."""
_RATIOS = {"velocity": ("SV",), "position": ("SP",), "height": ("SH",), "compass": ("SM", "SMX", "SMY", "SMZ")}
_ESTIMATORS = ("XKF4", "NKF4", "EKF4")
_VEHICLE = re.compile(r"(?:APM:|Ardu)?(Copter|Plane|Rover|Sub|Tracker|Blimp)\s+V(\d+)\.(\d+)(?:\.(\d+))?")


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
        if m.Id == LogEvent.ARMED:
            self.armed = True
        elif m.Id == LogEvent.DISARMED:
            self.armed = False
            self.landings.disarmed(self.now_s)
        elif m.Id == LogEvent.LAND_COMPLETE:
            self.landings.landed(self.now_s)
        elif m.Id == LogEvent.NOT_LANDED:
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
