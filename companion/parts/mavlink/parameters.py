"""The settings that may be tuned in flight, and a server of the parameter protocol for them. No I/O.

The server lists, reads and sets values and broadcasts every change.
All values are REAL32, so both encodings of the protocol (C cast and bytewise) mean the same bytes. Source: mavlink.io,
"Parameter Protocol".
"""

import math
import struct
from collections import deque
from collections.abc import Callable
from typing import Any

import msgspec

from companion.settings.load import from_mapping
from companion.settings.model import Settings
from drivers.mavlink.dialect import Message, mav
from estimator.contracts.errors import BadInput

_REAL32 = int(mav.MAV_PARAM_TYPE_REAL32)
PARAMETER_REQUESTS = ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET")
_AT_ONCE = 4
"""The number of values of a list that one call of `ParameterServer.due` returns."""


NAMES: dict[str, str] = {
    "PID_H_KP": "guidance.pid.horizontal.kp",
    "PID_H_KI": "guidance.pid.horizontal.ki",
    "PID_H_KD": "guidance.pid.horizontal.kd",
    "PID_V_KP": "guidance.pid.vertical.kp",
    "PID_V_KI": "guidance.pid.vertical.ki",
    "PID_V_KD": "guidance.pid.vertical.kd",
    "PID_Y_KP": "guidance.pid.heading.kp",
    "PID_Y_KI": "guidance.pid.heading.ki",
    "PID_SPEED_MAX": "guidance.pid.speed_max_m_s",
    "PID_CLIMB_MAX": "guidance.pid.climb_max_m_s",
    "PID_SINK_MAX": "guidance.pid.descent_rate_max_m_s",
    "PID_TURN_MAX": "guidance.pid.turn_max_deg_s",
    "PID_INTEGRAL_MAX": "guidance.pid.integral_max_m_s",
    "CONE_RATE": "guidance.cone.descent_rate_m_s",
    "CONE_SLOPE": "guidance.cone.slope",
    "CONE_SPEED": "guidance.cone.intercept_speed_m_s",
    "GATE_ALT": "guidance.cone.gate_height_m",
    "COMMIT_RATE": "guidance.cone.commit_rate_m_s",
    "LIM_ERROR": "guidance.limits.error_m",
    "LIM_SIGMA": "guidance.limits.sigma_m",
    "LIM_TILT_GATE": "guidance.limits.deck_tilt_gate_deg",
    "LIM_TILT_COMMIT": "guidance.limits.deck_tilt_commit_deg",
    "TRY_CLIMB_AFTER": "guidance.tries.climb_after_s",
    "TRY_SAFE_ALT": "guidance.tries.safe_height_m",
    "TRY_GIVE_UP": "guidance.tries.give_up_after_s",
    "GUID_STALE": "guidance.stale_after_s",
    "GUID_LAND_TOUT": "guidance.land_timeout_s",
    "EST_MIN_CONF": "estimator.min_confidence",
    "EST_MAX_DELAY": "estimator.max_delay_s",
}
"""The settings key of each parameter, in the order of the list; the order and the count never change while running."""
_ORDER = tuple(NAMES)


class Tunables:
    """The settings in force, presented as parameters.

    Args:
        apply: puts changed settings into force; it may refuse by raising BadInput.
    """

    def __init__(self, settings: Settings, apply: Callable[[Settings], None]) -> None:
        self._settings = settings
        self._apply = apply

    @property
    def settings(self) -> Settings:
        """The settings in force."""
        return self._settings

    def get(self, name: str) -> float:
        """Return the current value.

        Raises:
            KeyError: no such parameter.
        """
        value: Any = self._settings
        for part in NAMES[name].split("."):
            value = getattr(value, part)
        return float(value)

    def set(self, name: str, value: float) -> None:
        """Put a value into force.

        Raises:
            KeyError: no such parameter.
            BadInput: out of range, or not possible together with the others; nothing has changed.
        """
        whole = msgspec.to_builtins(self._settings)
        *path, last = NAMES[name].split(".")
        table = whole
        for part in path:
            table = table[part]
        table[last] = value
        changed = from_mapping(whole, f"parameter {name}")
        self._apply(changed)
        self._settings = changed


class ParameterServer:
    """Answers PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET."""

    def __init__(self, store: Tunables) -> None:
        self._store = store
        self._listing: deque[str] = deque()
        self.refused: str | None = None
        """The reason why the newest PARAM_SET was refused; None if it was accepted."""

    def on_message(self, message: Message, us: tuple[int, int]) -> list[Message]:
        """Return the values to broadcast in answer."""
        kind = message.get_type()
        if kind not in PARAMETER_REQUESTS:
            return []
        if message.target_system not in (0, us[0]) or message.target_component not in (0, us[1]):
            return []
        if kind == "PARAM_REQUEST_LIST":
            self._listing = deque(NAMES)
        elif kind == "PARAM_REQUEST_READ":
            name = self._named(message)
            return [] if name is None else [self._value(name)]
        elif kind == "PARAM_SET" and message.target_component == us[1]:
            return self._set(message)
        return []

    def in_force(self, message: Message) -> list[Message]:
        """Return the value that stays in force after a PARAM_SET was refused."""
        return [self._value(message.param_id)] if message.get_type() == "PARAM_SET" and message.param_id in NAMES else []

    def due(self) -> list[Message]:
        """Return the next values of a list that was requested."""
        return [self._value(self._listing.popleft()) for _ in range(min(_AT_ONCE, len(self._listing)))]

    def _named(self, message: Message) -> str | None:
        if message.param_index >= 0:
            return _ORDER[message.param_index] if message.param_index < len(NAMES) else None
        return message.param_id if message.param_id in NAMES else None

    def _set(self, message: Message) -> list[Message]:
        name = message.param_id
        if name not in NAMES:
            self.refused = f"no parameter {name}"
            return []
        value = float(message.param_value)
        if message.param_type != _REAL32 or not math.isfinite(value):
            self.refused = f"{name} takes a number of type REAL32"
        else:
            try:
                self._store.set(name, float(f"{value:.7g}"))  # 0.3 in 32 bits means 0.3.
                self.refused = None
            except BadInput as why:
                self.refused = str(why)
        return [self._value(name)]

    def _value(self, name: str) -> Message:
        value = struct.unpack("<f", struct.pack("<f", self._store.get(name)))[0]
        return mav.MAVLink_param_value_message(name.encode(), value, _REAL32, len(NAMES), _ORDER.index(name))
