"""The settings that may be tuned in flight, under names that fit a MAVLink parameter (16 characters)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from companion.settings.load import from_mapping
from companion.settings.model import Settings

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


class Tunables:
    """The settings in force, presented as parameters.

    Args:
        apply: puts changed settings into force; it may refuse by raising BadInput.
    """

    def __init__(self, settings: Settings, apply: Callable[[Settings], None]) -> None:
        self._settings = settings
        self._apply = apply
        self.names = tuple(NAMES)

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
