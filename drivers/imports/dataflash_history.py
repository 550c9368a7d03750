"""Read parameters, texts and events of an ArduPilot dataflash log, through pymavlink.

Source: ArduPilot's log message documentation, Copter 3.2 to 4.6 (EV, ERR, MSG, PARM, VIBE, XKF4, PL), and the values of
LogEvent and LogErrorSubsystem in AP_Logger.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drivers.imports.dataflash import open_log, time_us
from drivers.imports.log_history import (
    RATIO_LIMIT,
    VIBRATION_LIMIT_M_S2,
    AutopilotLog,
    ExcessMeter,
    LandingMeter,
    LoggedMoment,
    LogHistory,
)
from estimator.contracts.errors import BadInput

_ARMED, _DISARMED, _LANDED, _NOT_LANDED = 10, 11, 18, 28
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


def read_history(path: Path) -> AutopilotLog:
    """Return what the log says besides its samples.

    Raises:
        BadInput: the file cannot be read, is no dataflash log, or is damaged before its first parameter.
    """
    log = open_log(path)
    reader = _HistoryReader()
    try:
        while (message := log.recv_match(type=list(reader.makers))) is not None:
            reader.take(message)
    except Exception as why:  # pymavlink lets any error of its parser through
        log.give_up(why)
        if not reader.parameters:
            raise BadInput(f"{path}: not a readable dataflash log: {why}") from why
    else:
        log.close()
    if not reader.parameters:
        raise BadInput(f"{path}: holds no parameters (no PARM message)")
    return reader.log()


class _HistoryReader:
    def __init__(self) -> None:
        self.parameters: dict[str, float] = {}
        self._texts: list[str] = []
        self._vehicle: str | None = None
        self._firmware: tuple[int, int, int] | None = None
        self._first_us: int | None = None
        self._now_s = 0.0
        self._armed: bool | None = None
        self._failsafes: list[LoggedMoment] = []
        self._ratios = {name: ExcessMeter(RATIO_LIMIT) for name in _RATIOS}
        self._vibration = ExcessMeter(VIBRATION_LIMIT_M_S2["ArduPilot"])
        self._clips: dict[str, float] = {}
        self._clipped = 0
        self._landings = LandingMeter()
        self._acquired = False
        self._targets_lost = 0
        self.makers: dict[str, Callable[[Any], None]] = {
            "PARM": self._parameter, "MSG": self._text, "EV": self._event, "ERR": self._error, "VIBE": self._vibe,
            "PL": self._target, **dict.fromkeys(_ESTIMATORS, self._estimator),
        }  # fmt: skip

    def take(self, message: Any) -> None:
        """Take one message; one whose fields are missing or are text is left out."""
        at_us = time_us(message)
        if at_us is not None:
            self._first_us = at_us if self._first_us is None else self._first_us
            self._now_s = max(self._now_s, 1e-6 * (at_us - self._first_us))
        try:
            self.makers[message.get_type()](message)
        except (AttributeError, TypeError, ValueError, OverflowError):
            return

    def log(self) -> AutopilotLog:
        """Return all that was taken."""
        found = {name: meter.excess for name, meter in self._ratios.items()}
        history = LogHistory(
            round(self._now_s, 2),
            tuple(self._failsafes),
            {name: excess for name, excess in found.items() if excess is not None},
            self._vibration.excess,
            self._clipped,
            self._landings.landings(self._now_s),
            self._targets_lost,
        )
        return AutopilotLog(
            "ArduPilot", self._vehicle, self._firmware, dict(sorted(self.parameters.items())), tuple(self._texts), (), history
        )

    def _parameter(self, m: Any) -> None:
        value = float(m.Value)
        if math.isfinite(value):
            self.parameters[str(m.Name)] = value

    def _text(self, m: Any) -> None:
        text = str(m.Message)
        if self._vehicle is None and (found := _VEHICLE.search(text)) is not None:
            self._vehicle = f"Ardu{found[1]}"
            self._firmware = (int(found[2]), int(found[3]), int(found[4] or 0))
        if len(self._texts) < _TEXTS_MAX:
            self._texts.append(text)

    def _event(self, m: Any) -> None:
        if m.Id == _ARMED:
            self._armed = True
        elif m.Id == _DISARMED:
            self._armed = False
            self._landings.disarmed(self._now_s)
        elif m.Id == _LANDED:
            self._landings.landed(self._now_s)
        elif m.Id == _NOT_LANDED:
            self._landings.flying(self._now_s)

    def _error(self, m: Any) -> None:
        named = _ERRORS.get(int(m.Subsys))
        what = named.get(int(m.ECode)) if isinstance(named, dict) else named if int(m.ECode) else None
        if what is not None:
            self._failsafes.append(LoggedMoment(round(self._now_s, 2), what))

    def _estimator(self, m: Any) -> None:
        core = getattr(m, "C", 0)
        if self._armed is False or core != getattr(m, "PI", core if core == 0 else -1):
            return
        for name, fields in _RATIOS.items():
            self._ratios[name].add(max(float(getattr(m, field, 0.0)) for field in fields), self._now_s)

    def _vibe(self, m: Any) -> None:
        first = getattr(m, "IMU", 0) == 0
        if self._armed is not False and first:
            self._vibration.add(max(float(m.VibeX), float(m.VibeY), float(m.VibeZ)), self._now_s)
        if hasattr(m, "Clip"):
            counters = {str(getattr(m, "IMU", 0)): float(m.Clip)}
        else:
            counters = {str(n): float(getattr(m, f"Clip{n}")) for n in range(3)}
        for name, count in counters.items():
            if self._armed is not False:
                self._clipped += max(0, round(count - self._clips.get(name, count)))
            self._clips[name] = count

    def _target(self, m: Any) -> None:
        acquired = bool(m.TAcq)
        self._targets_lost += self._acquired and not acquired and self._armed is not False
        self._acquired = acquired
