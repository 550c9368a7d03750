"""What both stand-ins share: a miniature autopilot on a link, whose state is that of a body of the physics."""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.vehicle import Stack
from estimator.contracts.geometry import F64
from estimator.contracts.ports import Clock
from sitl.emulators.autopilots.body import BodyState
from sitl.emulators.autopilots.miniature import MiniatureAutopilot
from sitl.emulators.autopilots.motors import Motors
from sitl.emulators.autopilots.stand_in.gimbal import GimbalLink

FORCED = 21196.0
"""Parameter 2 of COMPONENT_ARM_DISARM that arms or disarms whatever the checks say (mavlink.io)."""
ON_GROUND, IN_AIR = 1, 2
"""MAV_LANDED_STATE."""
STILL: Motors = (0.0, 0.0, 0.0, 0.0)
_CHUNK = 50
"""Characters in one STATUSTEXT."""
_OURS = ("RAW_IMU", "HIGHRES_IMU", "DISTANCE_SENSOR")


class StandIn(MiniatureAutopilot, ABC):
    """An autopilot that flies a body of the physics; each stack's own behaviour is in its subclass.

    Its filter is taken to be right: position, velocity and attitude are the true ones, from an origin where it stood at first.
    """

    def __init__(self, stack: Stack, clock: Clock, parameters: Mapping[str, float], mode: str) -> None:
        super().__init__(stack, system=1, mode=mode, armed=False, landed_state=ON_GROUND, clock=clock)
        self.parameters = dict(parameters)
        self.state: BodyState | None = None
        self.failsafes: list[str] = []
        """Failsafes that acted, oldest first."""
        self.refused: list[str] = []
        """Reasons for which arming was refused, oldest first."""
        self._origin: F64 | None = None
        self._began_s = self.now_s
        self._text_id = itertools.count(1)
        self.gimbal: GimbalLink | None = None
        """The gimbal whose manager it is; None if it has none."""
        self.rpy = lambda t: (0.0, 0.0, 0.0) if self.state is None else self.state.R_ned_body.rpy_rad

    @property
    def p_world_ned(self) -> F64:
        """Position (3,) from the world's origin, m: that of its GNSS."""
        return self.p_ned if self.state is None else self.state.p_ned

    def parameter(self, name: str) -> float:
        """Return the value of a parameter."""
        return float(self.parameters[name])

    def text(self, severity: int, text: str) -> None:
        """Send a text, in chunks where one STATUSTEXT does not hold it (MAVLink 2: `id` and `chunk_seq`)."""
        if len(text) <= _CHUNK:
            self.send(mav.MAVLink_statustext_message(severity, text.encode()))
            return
        number = next(self._text_id)
        for k in range(math.ceil((len(text) + 1) / _CHUNK)):
            part = text[k * _CHUNK : (k + 1) * _CHUNK].encode()
            self.send(mav.MAVLink_statustext_message(severity, part, number, k))

    def set_mode(self, name: str) -> None:
        """Enter a mode, as a person would by the remote control."""
        self.entered(name)
        super().set_mode(name)

    def entered(self, name: str) -> None:
        """Note that a mode begins."""

    def _enter(self, name: str) -> int:
        result = super()._enter(name)
        if result == 0:
            self.entered(name)
        return result

    def _on_message(self, received: ReceivedMessage) -> None:
        """Take a message; one for another component, or for all, goes on to the other link, as both programs route it."""
        assert self.links is not None
        m = received.message
        if getattr(m, "target_component", 0) != 1 and m.get_type() != "TIMESYNC" and len(self.links.all) > 1:
            wire = self.links.all[1 - received.link]._wire
            if wire is not None:
                wire.send(bytes(m.get_msgbuf()), None)
        super()._on_message(received)

    def _on_command_long(self, m: Message, received: ReceivedMessage) -> None:
        result = None
        if self.gimbal is not None and m.target_system == self.system:
            result = self.gimbal.on_command(m, (received.system, received.component))
        if result is not None:
            ack = mav.MAVLink_command_ack_message(m.command, result, 0, 0, received.system, received.component)
            self._send_as(m.target_component, ack)
            return
        own = {
            mav.MAV_CMD_COMPONENT_ARM_DISARM: self._on_arm_disarm,
            mav.MAV_CMD_NAV_TAKEOFF: self._on_take_off,
        }.get(m.command)
        if own is None or m.target_system != self.system or m.target_component != 1:
            super()._on_command_long(m, received)
            return
        self.commands[m.command] += 1
        self.send(mav.MAVLink_command_ack_message(m.command, own(m), 0, 0, received.system, received.component))
        self.send(self.heartbeat())

    def _on_arm_disarm(self, m: Message) -> int:
        forced = m.param2 == FORCED
        if not m.param1:
            if self.armed and self.landed_state != ON_GROUND and not forced:
                self.text(2, "Disarming denied: not landed")
                return int(mav.MAV_RESULT_DENIED)
            self.armed = False
            return int(mav.MAV_RESULT_ACCEPTED)
        why = None if self.armed or forced else self.why_not_armed()
        if why is not None:
            self.refused.append(why)
            self.text(2, why)
            return int(mav.MAV_RESULT_TEMPORARILY_REJECTED)
        self.armed = True
        return int(mav.MAV_RESULT_ACCEPTED)

    @abstractmethod
    def why_not_armed(self) -> str | None:
        """Return why arming is refused; None if it is not."""

    def _on_take_off(self, m: Message) -> int:
        return int(mav.MAV_RESULT_ACCEPTED)

    @abstractmethod
    def imu(self, s: BodyState) -> Message:
        """Return the message of the inertial sensors."""

    def _streams(self, t: float) -> list[Message]:
        s = self.state
        if s is None:
            return []
        out = [m for m in super()._streams(t) if m.get_type() not in _OURS]
        if t >= self._next.get(-1, 0.0):
            self._next[-1] = t + 0.01
            out.append(self.imu(s))
        return out

    def step(self, s: BodyState) -> Motors:
        """Return the motors for the body's state; call it once for each step of the physics."""
        self.state = s
        self._origin = s.p_ned if self._origin is None else self._origin
        self.p_ned, self.v_ned = s.p_ned - self._origin, s.v_ned
        if self.gimbal is not None:
            for component, message in self.gimbal.due(self.now_s, self.boot_ms, s.R_ned_body.rpy_rad[2]):
                self._send_as(component, message)
        return self.fly(s)

    def _send_as(self, component: int, message: Message) -> None:
        if self.links is not None:
            self.links.send(message, component=component)

    @abstractmethod
    def fly(self, s: BodyState) -> Motors:
        """Return the motors for the body's state."""


def toward(error_m: F64, gain_1_s: float, most_m_s: float) -> F64:
    """Return the velocity that goes to a place, (3,) m/s."""
    v = gain_1_s * error_m
    size = float(np.linalg.norm(v))
    return np.asarray(v * (most_m_s / size) if size > most_m_s else v)
