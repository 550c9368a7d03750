"""Serve the options that may change in flight as MAVLink parameters."""

import math
import struct
import tomllib
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from companion.guidance.pilot import Pilot
from companion.settings.load import from_mapping
from companion.settings.model import Settings
from drivers.mavlink.dialect import Message, mav
from estimator.contracts.address import raw
from estimator.contracts.errors import BadInput

_REAL32 = int(mav.MAV_PARAM_TYPE_REAL32)
PARAMETER_REQUESTS = ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET")
_AT_ONCE = 4
"""The number of values of a list that one call of `ParameterServer.due` returns."""
NAMES: dict[str, str] = tomllib.loads(Path(__file__).with_name("parameters.toml").read_text(encoding="ascii"))
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
        whole = msgspec.to_builtins(self._settings, enc_hook=raw)
        *path, last = NAMES[name].split(".")
        table = whole
        for part in path:
            table = table[part]
        table[last] = value
        changed = from_mapping(whole, f"parameter {name}")
        self._apply(changed)
        self._settings = changed


def tunables(settings: Settings, pilot: Pilot) -> Tunables:
    """Return the parameters of a service that flies by this pilot."""

    def apply(changed: Settings) -> None:
        e = changed.estimator
        pilot.retune(changed.guidance, min_confidence=e.min_confidence, max_delay_s=e.max_delay_s)

    return Tunables(settings, apply)


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
