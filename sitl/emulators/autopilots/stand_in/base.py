"""An autopilot in miniature on a real socket, and the stand-ins that fly a body of the physics by it.

A miniature sends and obeys what ArduCopter and PX4 were measured to send and obey. By itself it flies as a point whose velocity
follows the setpoint at once. Its clock is its own: `epoch_ns` before ours.
"""

from __future__ import annotations

import asyncio
import itertools
import math
import struct
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from drivers.clock import SystemClock
from drivers.endpoint import parse_endpoint
from drivers.mavlink.access import NamedSenders
from drivers.mavlink.dialect import Event, Message, TimeSyncV2, mav
from drivers.mavlink.failsafe import event_id
from drivers.mavlink.links import LinkOptions, Links, ReceivedMessage, open_links
from drivers.mavlink.options import LinkLimits
from drivers.mavlink.vehicle import ARMED, HOLD_MODE, LAND_MODE, VELOCITY_MODE, Stack, custom_mode, mode_name
from estimator.contracts.geometry import F64, GeoPoint, Rotation, moved, ned_between
from estimator.contracts.time import Clock
from sitl.camera.gimbal import SimulatedGimbal
from sitl.emulators.autopilots.body import BodyState
from sitl.sensors.sensors import ORIGIN
from sitl.world.drives import Motors

_REPORT_S, _STATUS_S = 0.2, 0.2
"""Interval of reports that nobody has requested otherwise, and of the manager's status."""
_BOOT_MS = 77_000
"""Age of the clock of a gimbal that is a component of its own, at the start."""
_ACCEPTED, _DENIED, _UNSUPPORTED = (
    int(result) for result in (mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_DENIED, mav.MAV_RESULT_UNSUPPORTED)
)
_FAILSAFES: dict[Stack, dict[str, str]] = {
    Stack.ARDUPILOT: {"land": "Battery Failsafe", "hold": "EKF Failsafe"},
    Stack.PX4: {"land": "Failsafe activated: Low battery, landing", "hold": "Failsafe activated: Low battery, entering Hold"},
}
"""Texts of each stack when a failsafe takes a mode."""
_LOCKS = int(mav.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | mav.GIMBAL_DEVICE_FLAGS_PITCH_LOCK)


class GimbalLink:
    """The messages of a simulated gimbal and of its manager, which is the autopilot."""

    def __init__(self, gimbal: SimulatedGimbal, system: int) -> None:
        self._gimbal, self._system = gimbal, system
        self._own = gimbal.settings.device_id > 6
        self._interval_s = _REPORT_S
        self._report_s = self._status_s = 0.0
        self._began_s: float | None = None
        self._on_the_way: deque[tuple[float, Message]] = deque()
        self.control: tuple[int, int] = (0, 0)
        """The (system, component) that has primary control; zeros for nobody."""
        self.commands: Counter[int] = Counter()

    @property
    def component(self) -> int:
        """The component that reports."""
        return self._gimbal.settings.device_id if self._own else 1

    def on_command(self, m: Message, sender: tuple[int, int]) -> int | None:
        """Take a COMMAND_LONG; return its result, or None of one that is not for gimbal or manager."""
        if m.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
            asked = m.param1 == mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS
            if m.target_component != self.component or not (asked or self._own):
                return None
            if not asked:
                return _UNSUPPORTED
            self._interval_s = max(1e-6 * m.param2, 0.005)
            return _ACCEPTED
        if m.target_component != 1 or m.param7 not in (0, self._gimbal.settings.device_id):
            return None
        if m.command == mav.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE:
            self.commands[m.command] += 1
            self.control = int(m.param1), int(m.param2)
            return _ACCEPTED
        if m.command == mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW:
            self.commands[m.command] += 1
            if self.control != sender or not math.isfinite(m.param1):
                return _DENIED
            self._gimbal.point(math.radians(m.param1))
            return _ACCEPTED
        return None

    def due(self, now_s: float, boot_ms: int, yaw_rad: float) -> list[tuple[int, Message]]:
        """Return what is sent now, each with its component.

        Args:
            boot_ms: the autopilot's time since boot.
            yaw_rad: the vehicle's heading.
        """
        s = self._gimbal.settings
        self._began_s = now_s if self._began_s is None else self._began_s
        since_s = now_s - self._began_s
        silent = 0.0 < s.silent_at_s <= since_s
        if now_s >= self._report_s and not silent:
            self._report_s = max(now_s, self._report_s + self._interval_s)
            stamp_ms = _BOOT_MS + int(1e3 * since_s) if self._own else boot_ms
            self._on_the_way.append((now_s + s.report_delay_s, self._report(stamp_ms, yaw_rad)))
        out: list[tuple[int, Message]] = []
        while self._on_the_way and self._on_the_way[0][0] <= now_s:
            out.append((self.component, self._on_the_way.popleft()[1]))
        if now_s >= self._status_s:
            self._status_s = now_s + _STATUS_S
            out.append((1, mav.MAVLink_gimbal_manager_status_message(boot_ms, 0, s.device_id, *self.control, 0, 0)))
        return out

    def _report(self, stamp_ms: int, yaw_rad: float) -> Message:
        s, rotation = self._gimbal.settings, self._gimbal.R_ned_gimbal
        flags, delta = _LOCKS | int(mav.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME), math.nan
        if s.yaw == "vehicle":
            rotation = Rotation.from_rpy(0.0, 0.0, -yaw_rad) @ rotation
            flags = _LOCKS | int(mav.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME)
        q, number = rotation.quat_wxyz.tolist(), 0 if self._own else s.device_id
        return mav.MAVLink_gimbal_device_attitude_status_message(
            self._system, 0, stamp_ms, flags, q, *self._gimbal.w_gimbal.tolist(), 0, delta, math.nan, number
        )


EPOCH_NS = 5_000_000_000
"""The autopilot booted this long before this process' clock began."""


def global_position(boot_ms: int, p_ned: F64, v_ned: F64, heading_deg: float | None = None) -> Message:
    """Return the GLOBAL_POSITION_INT of a system at `p_ned`, (3,) m from the simulated world's origin.

    Args:
        v_ned: (3,) m/s.
        heading_deg: heading, clockwise from north; None for unknown.
    """
    place = moved(ORIGIN, p_ned)
    latitude, longitude = (round(1e7 * math.degrees(a)) for a in (place.latitude_rad, place.longitude_rad))
    height_mm = 0 if place.height_m is None else round(1e3 * place.height_m)
    heading = 65535 if heading_deg is None else round(100.0 * (heading_deg % 360.0))
    v = [round(100.0 * float(c)) for c in v_ned]
    return mav.MAVLink_global_position_int_message(
        boot_ms, latitude, longitude, height_mm, round(-1e3 * float(p_ned[2])), *v, heading
    )


@dataclass
class MiniatureAutopilot:
    """See the module."""

    stack: Stack = Stack.ARDUPILOT
    system: int = 7
    mode: str = "loiter"
    armed: bool = True
    landed_state: int = 2
    parameters: dict[str, float] = field(default_factory=dict)
    fixed_parameters: frozenset[str] = frozenset()
    """Parameters that are read-only."""
    unsupported: set[int] = field(default_factory=set)
    """Messages whose stream is refused."""
    distance_cm: int | None = None
    """Distance of its rangefinder, or echoed from us."""
    pressure_pa: float | None = None
    """Reading of its barometer; None for one that reports none."""
    deaf: bool = False
    """Hears commands and answers none."""
    silent: bool = False
    critical: bool = False
    """Reports that a failsafe is in force."""
    charge: float = 0.83
    """Charge of the battery, 0 to 1."""
    beat_s: float = 0.25
    """Interval of its HEARTBEATs until another is accepted, s; the programs begin with a second."""
    p_ned: F64 = field(default_factory=lambda: np.array([0.0, 0.0, -5.0]))
    v_ned: F64 = field(default_factory=lambda: np.zeros(3))
    rpy: Callable[[float], tuple[float, float, float]] = lambda t: (0.0, 0.0, 0.0)
    gyro_mrad_s: tuple[int, int, int] = (100, -200, 300)
    """Reading of its gyro, forward, right, down."""
    f_body: tuple[float, float, float] = (0.1, -0.2, -9.8)
    """Reading of its accelerometer, the same axes, m/s^2."""
    epoch_ns: int = EPOCH_NS
    clock: Clock = field(default_factory=SystemClock)
    messages: list[Message] = field(default_factory=list)
    commands: Counter[int] = field(default_factory=Counter)
    intervals: dict[int, float] = field(default_factory=dict)
    setpoints: list[tuple[float, Message]] = field(default_factory=list)
    sync_answers: list[tuple[int, int, int]] = field(default_factory=list)
    """(remote clock, our request, received) of TIMESYNC answers to us."""

    def __post_init__(self) -> None:
        self.links: Links | None = None
        self._next: dict[int, float] = {}
        self._samples = 0
        self._at, self._beat_at = self.now_s, 0.0
        self._makers: dict[int, Callable[[float, int], Message | None]] = {
            mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self._attitude,
            mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: self._landed,
            mav.MAVLINK_MSG_ID_SYS_STATUS: self._status,
            mav.MAVLINK_MSG_ID_RAW_IMU: self._raw_imu,
            mav.MAVLINK_MSG_ID_SCALED_PRESSURE: self._pressure,
            mav.MAVLINK_MSG_ID_HIGHRES_IMU: self._highres_imu,
            mav.MAVLINK_MSG_ID_DISTANCE_SENSOR: self._distance,
        }

    def of(self, kind: str) -> list[Any]:
        """Messages of one kind that were received."""
        return [m for m in self.messages if m.get_type() == kind]

    @property
    def now_s(self) -> float:
        return self.clock.now() * 1e-9

    @property
    def p_world_ned(self) -> F64:
        """Position (3,) from the world's origin, m: that of its GNSS."""
        return self.p_ned

    @property
    def boot_ns(self) -> int:
        return self.clock.now() + self.epoch_ns

    @property
    def boot_ms(self) -> int:
        return self.boot_ns // 1_000_000 & 0xFFFFFFFF

    def send(self, message: Message) -> None:
        if self.links is not None and not self.silent:
            self.links.send(message)

    def heartbeat(self) -> Message:
        base = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (ARMED if self.armed else 0)
        kind = 3 if self.stack is Stack.ARDUPILOT else 12
        # ArduCopter says so on the ground too, PX4 while it is armed.
        critical = self.critical and (self.armed or self.stack is not Stack.PX4)
        status = mav.MAV_STATE_CRITICAL if critical else mav.MAV_STATE_ACTIVE if self.armed else mav.MAV_STATE_STANDBY
        return mav.MAVLink_heartbeat_message(2, kind, base, custom_mode(self.stack, self.mode), status, 3)

    def set_mode(self, name: str) -> None:
        """Set the mode as a person would by the remote control."""
        self.mode = name
        self._shows_mode()

    def fail(self, mode: str, words: str, cause: int = 0) -> None:
        """Let a failsafe act by a mode: ArduPilot reports the mode first and then why, PX4 the other way round.

        Args:
            cause: failsafe_cause_t of PX4, which an EVENT names; 0 for none.
        """
        self.critical = True
        if self.stack is Stack.PX4:
            self.text(2, words)
            arguments = list(struct.pack("<IBB", 0, 0, cause).ljust(40, b"\0"))
            self.send(Event(0, 0, event_id("commander_failsafe_enter"), self.boot_ms, 0, 0x44, arguments))
        self.mode = mode
        self._shows_mode()
        if self.stack is not Stack.PX4:
            self.text(4, words)

    def _shows_mode(self) -> None:
        """Report a new mode at once, as ArduPilot does; PX4 reports it in its next HEARTBEAT."""
        if self.stack is not Stack.PX4:
            self.send(self.heartbeat())

    def text(self, severity: int, text: str) -> None:
        self.send(mav.MAVLink_statustext_message(severity, text.encode()))

    def _on_message(self, received: ReceivedMessage) -> None:
        m = received.message
        self.messages.append(m)
        handler = getattr(self, f"_on_{m.get_type().lower()}", None)
        if handler is not None and not self.deaf:
            handler(m, received)

    def _on_timesync(self, m: Message, received: ReceivedMessage) -> None:
        if m.tc1 == 0:
            self.send(TimeSyncV2(self.boot_ns, m.ts1, received.system, received.component))
        else:
            self.sync_answers.append((m.tc1, m.ts1, self.boot_ns))

    def _on_param_request_read(self, m: Message, received: ReceivedMessage) -> None:
        if m.param_id in self.parameters:
            self._tell_parameter(m.param_id)

    def _on_param_set(self, m: Message, received: ReceivedMessage) -> None:
        """Take a parameter's value and report the one in force, as both programs do; an unknown name is not answered."""
        if m.target_system != self.system or m.param_id not in self.parameters:
            return
        if m.param_id not in self.fixed_parameters:
            integer = self.stack is Stack.PX4 and isinstance(self.parameters[m.param_id], int)
            bits = struct.unpack("<i", struct.pack("<f", m.param_value))[0]
            self.parameters[m.param_id] = bits if integer else float(m.param_value)
        self._tell_parameter(m.param_id)

    def _tell_parameter(self, name: str) -> None:
        value, kind = self.parameters[name], 9
        if self.stack is Stack.PX4 and isinstance(value, int):
            value, kind = struct.unpack("<f", struct.pack("<i", value))[0], 6
        self.send(mav.MAVLink_param_value_message(name.encode(), value, kind, len(self.parameters), 0))

    def _on_command_long(self, m: Message, received: ReceivedMessage) -> None:
        if m.target_system != self.system or m.target_component != 1:
            return
        self.commands[m.command] += 1
        result = 0
        if m.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
            number = int(m.param1)
            if number in self.unsupported:
                result = 2
            elif self.stack is Stack.PX4 and number == mav.MAVLINK_MSG_ID_HEARTBEAT:
                result = 4
            else:
                self.intervals[number] = m.param2 * 1e-6
        elif m.command == mav.MAV_CMD_REQUEST_MESSAGE and m.param1 == mav.MAVLINK_MSG_ID_HEARTBEAT:
            self.send(self.heartbeat())
        elif m.command == mav.MAV_CMD_DO_SET_MODE:
            custom = int(m.param2) if self.stack is Stack.ARDUPILOT else int(m.param2) << 16 | int(m.param3) << 24
            result = self._enter(mode_name(self.stack, custom))
        elif m.command == mav.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = bool(m.param1)
        elif m.command == mav.MAV_CMD_NAV_TAKEOFF and self.armed and self.mode == "guided":
            self.landed_state, self.p_ned = 2, np.array([*self.p_ned[:2], -m.param7])
        self.send(mav.MAVLink_command_ack_message(m.command, result, 0, 0, received.system, received.component))
        if m.command == mav.MAV_CMD_DO_SET_MODE:
            self._shows_mode()

    def _enter(self, name: str) -> int:
        streamed = [at for at, _ in self.setpoints if self.now_s - at < 2.5]
        if name == "offboard" and (not streamed or self.now_s - streamed[0] < 1.5):
            return 2
        self.mode = name
        if name == "auto.takeoff" and self.armed:
            self.landed_state = 2
        return 0

    def _on_set_position_target_local_ned(self, m: Message, received: ReceivedMessage) -> None:
        self.setpoints.append((self.now_s, m))
        if self.mode in ("guided", "offboard") and m.coordinate_frame == 1 and m.type_mask == 0x05C7:
            self.v_ned = np.array([m.vx, m.vy, m.vz])

    def _streams(self, t: float) -> list[Message]:
        """Return the messages of the requested streams that are due."""
        self._samples += 1
        # No reading of a true sensor repeats for long: the least digits of IMU, attitude and velocity never stand still.
        least = self._samples % 7 - 3
        out = []
        for number, interval in self.intervals.items():
            maker = self._makers.get(number)
            if maker is None or not interval or t < self._next.get(number, -math.inf):
                continue
            self._next[number] = max(t, self._next.get(number, t) + interval)
            if (message := maker(t, least)) is not None:
                out.append(message)
        return out

    def _attitude(self, t: float, least: int) -> Message:
        roll, pitch, yaw = self.rpy(t)
        q = Rotation.from_rpy(roll + 1e-6 * least, pitch, yaw).quat_wxyz.tolist()
        return mav.MAVLink_attitude_quaternion_message(self.boot_ms, *q, 0.0, 0.0, 0.0)

    def _local_position(self, t: float, least: int) -> Message:
        v = [v + 1e-7 * least for v in self.v_ned.tolist()]
        return mav.MAVLink_local_position_ned_message(self.boot_ms, *self.p_ned.tolist(), *v)

    def _global_position(self, t: float, least: int) -> Message:
        return global_position(self.boot_ms, self.p_world_ned, self.v_ned)

    def _landed(self, t: float, least: int) -> Message:
        return mav.MAVLink_extended_sys_state_message(0, self.landed_state)

    def _status(self, t: float, least: int) -> Message:
        return mav.MAVLink_sys_status_message(0, 0, 0, 0, 12000, -1, round(100 * self.charge), 0, 0, 0, 0, 0, 0)

    def _raw_imu(self, t: float, least: int) -> Message | None:
        gyro = (w + least for w in self.gyro_mrad_s)
        return mav.MAVLink_raw_imu_message(self.boot_ns // 1000, *self._f_mg(least), *gyro, 0, 0, 0)

    def _highres_imu(self, t: float, least: int) -> Message | None:
        f = (*self.f_body[:2], self.f_body[2] + 1e-3 * least)
        gyro = (1e-3 * (w + least) for w in self.gyro_mrad_s)
        return mav.MAVLink_highres_imu_message(self.boot_ns // 1000, *f, *gyro, 0, 0, 0, 1000.0, 0, 0, 20.0, 0xFFFF)

    def _distance(self, t: float, least: int) -> Message | None:
        if self.distance_cm is None:
            return None
        return mav.MAVLink_distance_sensor_message(self.boot_ms, 5, 5000, self.distance_cm, 0, 0, 25, 0)

    def _pressure(self, t: float, least: int) -> Message | None:
        if self.pressure_pa is None:
            return None
        return mav.MAVLink_scaled_pressure_message(self.boot_ms, 0.01 * self.pressure_pa, 0.0, 2000)

    def _f_mg(self, least: int) -> tuple[int, int, int]:
        forward, right, down = (round(1e3 * f / 9.8) for f in self.f_body)
        return forward, right, down + least

    def report(self) -> None:
        """Send what is due."""
        now = self.now_s
        dt, self._at = now - self._at, now
        self.p_ned = self.p_ned + self.v_ned * dt
        if now >= self._beat_at:
            self._beat_at = now + self.intervals.get(mav.MAVLINK_MSG_ID_HEARTBEAT, self.beat_s)
            self.send(self.heartbeat())
        for message in self._streams(now):
            self.send(message)

    def read(self) -> None:
        """Take the messages that wait at its links."""
        if self.links is not None:
            for received in self.links.received.waiting():
                self._on_message(received)

    async def _live(self) -> None:
        while True:
            await self.clock.sleep(0.004)
            self.report()

    async def _read(self, links: Links) -> None:
        async for received in links.received:
            self._on_message(received)

    @asynccontextmanager
    async def talking_to(self, url: str) -> AsyncIterator[MiniatureAutopilot]:
        """Alive on a link to `url`."""
        option = LinkOptions(parse_endpoint(url), limits=LinkLimits(restart_first_s=0.02, restart_most_s=0.1))
        async with (
            open_links([option], self.clock, (self.system, 1), access=NamedSenders(everybody=True)) as links,
            asyncio.TaskGroup() as group,
        ):
            self.links = links
            tasks = [group.create_task(self._live()), group.create_task(self._read(links))]
            try:
                yield self
            finally:
                self.links = None
                for task in tasks:
                    task.cancel()


FORCED = 21196.0
"""Parameter 2 of COMPONENT_ARM_DISARM that arms or disarms whatever the checks say (mavlink.io)."""
ON_GROUND, IN_AIR = 1, 2
"""MAV_LANDED_STATE."""
STILL: Motors = (0.0, 0.0, 0.0, 0.0)
_OURS = (mav.MAVLINK_MSG_ID_RAW_IMU, mav.MAVLINK_MSG_ID_HIGHRES_IMU)
"""Streams of a miniature that a stand-in sends by its own, as it is stepped."""
_NO_ECHO_CM = 5000
"""The limit of its rangefinder, which it reports where it sees nothing."""
_CHUNK = 50
"""Characters in one STATUSTEXT."""


class StandIn(MiniatureAutopilot, ABC):
    """An autopilot that flies a body of the physics; each stack's own behaviour is in its subclass.

    Its filter is taken to be right: position, velocity and attitude are the true ones, from an origin where it stood at first.
    """

    def __init__(self, stack: Stack, clock: Clock, parameters: Mapping[str, float], mode: str) -> None:
        super().__init__(stack, system=1, mode=mode, armed=False, landed_state=ON_GROUND, beat_s=1.0, clock=clock)
        self.parameters = dict(parameters)
        self.state: BodyState | None = None
        self.failsafes: list[str] = []
        """Failsafes that acted, oldest first."""
        self.refused: list[str] = []
        """Reasons for which arming was refused, oldest first."""
        for number in _OURS:
            del self._makers[number]
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
        self.critical = False
        self.entered(name)
        super().set_mode(name)

    def take(self, message: Message, sender: tuple[int, int]) -> None:
        """Take a message of a (system, component) that has no link to it here."""
        super()._on_message(ReceivedMessage(message, 0, self.clock.now(), *sender))

    def _on_set_position_target_local_ned(self, m: Message, received: ReceivedMessage) -> None:
        """Note the setpoint alone: the body's own velocity is what the streams report."""
        self.setpoints.append((self.now_s, m))

    def begin_in_air(self, s: BodyState) -> None:
        """Begin armed and in flight by setpoints, where a pilot has brought it; call it before the first step."""
        self.state, self.armed, self.landed_state = s, True, IN_AIR
        self.mode = VELOCITY_MODE[self.stack]
        self.entered(self.mode)

    def acts_by_failsafe(self, takes: Literal["land", "hold"]) -> None:
        """Take a mode by a failsafe."""
        words, mode = _FAILSAFES[self.stack][takes], (LAND_MODE if takes == "land" else HOLD_MODE)[self.stack]
        self.failsafes.append(words)
        self.entered(mode)
        self.fail(mode, words)

    def entered(self, name: str) -> None:
        """Note that a mode begins."""

    def _enter(self, name: str) -> int:
        result = super()._enter(name)
        if result == 0:
            self.critical = False
            self.entered(name)
        return result

    def _on_message(self, received: ReceivedMessage) -> None:
        """Take a message; one for another component, or for all, goes on to the other link, as both programs route it."""
        assert self.links is not None
        m = received.message
        if getattr(m, "target_component", 0) != 1 and m.get_type() != "TIMESYNC" and len(self.links.all) > 1:
            self.links.all[1 - received.link].forward(m)
        super()._on_message(received)

    def _on_command_long(self, m: Message, received: ReceivedMessage) -> None:
        result = None
        if self.gimbal is not None and m.target_system == self.system:
            result = self.gimbal.on_command(m, (received.system, received.component))
        if result is not None:
            ack = mav.MAVLink_command_ack_message(m.command, result, 0, 0, received.system, received.component)
            self._send_as(m.target_component, ack)
            return
        own = {mav.MAV_CMD_COMPONENT_ARM_DISARM: self._on_arm_disarm, mav.MAV_CMD_NAV_TAKEOFF: self._on_take_off}.get(m.command)
        if own is None or m.target_system != self.system or m.target_component != 1:
            super()._on_command_long(m, received)
            return
        self.commands[m.command] += 1
        self.send(mav.MAVLink_command_ack_message(m.command, own(m), 0, 0, received.system, received.component))

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

    def _on_command_int(self, m: Message, received: ReceivedMessage) -> None:
        """MAV_CMD_DO_REPOSITION: fly to a place, in the mode that holds it."""
        if m.command != mav.MAV_CMD_DO_REPOSITION or m.target_system != self.system:
            return
        self.commands[m.command] += 1
        self.goes_to(ned_between(ORIGIN, GeoPoint.of_degrees(1e-7 * m.x, 1e-7 * m.y, m.z)))
        ack = mav.MAVLink_command_ack_message(m.command, mav.MAV_RESULT_ACCEPTED, 0, 0, received.system, received.component)
        self.send(ack)
        self._shows_mode()

    @abstractmethod
    def goes_to(self, p_ned: F64) -> None:
        """Begin the way to a place, (3,) m from the world's origin."""

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
        out = super()._streams(t)
        if t >= self._next.get(-1, 0.0):
            self._next[-1] = t + 0.01
            out.append(self.imu(s))
        return out

    def step(self, s: BodyState) -> Motors:
        """Return the motors for the body's state; call it once for each step of the physics."""
        self.state = s
        self._origin = s.p_ned if self._origin is None else self._origin
        self.p_ned, self.v_ned, self.charge = s.p_ned - self._origin, s.v_ned, s.battery
        self.pressure_pa, self.distance_cm = s.pressure_pa, _NO_ECHO_CM if s.range_m is None else round(100.0 * s.range_m)
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


STEP_S = 0.004
"""Step of the physics and of the loops, s."""
