"""The gimbal that carries the camera, on an autopilot's links: take its reports, request them, and point it down.

async with tending(Gimbal(options, clock), autopilot): ...    # its attitudes are among `autopilot.samples`

To point it down, control is taken (MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE), then the angle is given
(MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW); each is repeated until it is answered. The gimbal is then left alone while its own reports
say that it points down.

Frames: the quaternion of GIMBAL_DEVICE_ATTITUDE_STATUS has roll and pitch against the horizon, and a yaw from the vehicle's
heading or from north, as its flags say. MOUNT_ORIENTATION is the same in degrees. MOUNT_STATUS has hundredths of a degree against
the vehicle itself, as ArduPilot sends it of servo gimbals.

Source: mavlink.io, "Gimbal Protocol v2" and the definitions of messages 158, 265 and 285.
"""

import logging
import math
from collections import Counter, deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from enum import Enum

import numpy as np
from msgspec.structs import replace

from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.mavlink.access import AccessLevel, Source
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.options import GimbalOptions
from drivers.mavlink.requests import Streams, is_for
from drivers.mavlink.timesync import MS_WRAP_NS, BootClock, boot_ms
from drivers.reconnect import running_beside
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import GimbalAttitude, GimbalFrame
from estimator.contracts.time import NS_PER_S, Clock, MonoNs, Stamp, after, seconds_between

DEVICE_STATUS, MOUNT_ORIENTATION, MOUNT_STATUS = "GIMBAL_DEVICE_ATTITUDE_STATUS", "MOUNT_ORIENTATION", "MOUNT_STATUS"
_VEHICLE_YAW, _EARTH_YAW = int(mav.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME), int(mav.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME)
_YAW_LOCK = int(mav.GIMBAL_DEVICE_FLAGS_YAW_LOCK)
_FAILURES = int(
    mav.GIMBAL_DEVICE_ERROR_FLAGS_ENCODER_ERROR
    | mav.GIMBAL_DEVICE_ERROR_FLAGS_POWER_ERROR
    | mav.GIMBAL_DEVICE_ERROR_FLAGS_MOTOR_ERROR
    | mav.GIMBAL_DEVICE_ERROR_FLAGS_SOFTWARE_ERROR
    | mav.GIMBAL_DEVICE_ERROR_FLAGS_COMMS_ERROR
    | mav.GIMBAL_DEVICE_ERROR_FLAGS_CALIBRATION_RUNNING
)
"""Failures with which the reported attitude need not be the camera's. At a limit of its travel a gimbal still knows its own."""
_LENGTH_OFF = 0.05
"""Largest difference of a quaternion's length from one."""
_ANGLE_MAX_DEG = 720.0
_ARRIVAL_SIGMA_S = 0.02
"""Standard deviation of the instant of a report without a stamp, which has the time of its arrival."""
_OLDER_AFTER_S = 1.0
"""Time without a report of the gimbal protocol after which MOUNT_ORIENTATION is taken."""
_OWN_CLOCK = ClockMapOptions(wrap_ns=MS_WRAP_NS, resolution_s=0.001, floor_s=0.001, floor_sigma_s=0.005, name="the gimbal")


class Refused(Exception):
    """A report that cannot be used; its text is the reason, one word for counting."""


class GimbalSampler:
    """Reports of one gimbal, in the order in which they were received, to samples."""

    def __init__(self, options: GimbalOptions) -> None:
        self._o = options
        self._cov = np.eye(3) * options.sigma_rad**2
        self._cov.setflags(write=False)
        self._clock = ClockMap(_OWN_CLOCK)
        self._device_at: MonoNs | None = None
        self.newest: GimbalAttitude | None = None
        self.refused: Counter[str] = Counter()
        """Reports that were refused, by reason: rotation, frame, failure, angle, old."""

    def restart(self) -> None:
        """Forget the sender's clock, because it has booted or another one reports."""
        self._clock, self._device_at, self.newest = ClockMap(_OWN_CLOCK), None, None

    def sample(self, message: Message, received_at: MonoNs, boot: BootClock | None) -> GimbalAttitude | None:
        """Return the sample of a message; None of one that is no report of the chosen kind, or is refused.

        Args:
            boot: the clock of the autopilot, if that stamped the message; None if the gimbal itself did.
        """
        kind = message.get_type()
        if not self._chosen(kind, received_at):
            return None
        try:
            frame, rotation = self._rotation(kind, message)
        except Refused as why:
            self.refused[str(why)] += 1
            return None
        stamp = self._stamp(getattr(message, "time_boot_ms", 0), received_at, boot)
        if self.newest is not None and stamp.measured_at <= self.newest.stamp.measured_at:
            self.refused["old"] += 1
            return None
        if kind == DEVICE_STATUS:
            self._device_at = received_at
        self.newest = GimbalAttitude(stamp, frame, rotation, self._cov)
        return self.newest

    def _chosen(self, kind: str, received_at: MonoNs) -> bool:
        if self._o.report == "mount_status":
            return kind == MOUNT_STATUS
        if kind == MOUNT_ORIENTATION:
            return self._device_at is None or seconds_between(self._device_at, received_at) > _OLDER_AFTER_S
        return kind == DEVICE_STATUS

    def _rotation(self, kind: str, m: Message) -> tuple[GimbalFrame, Rotation]:
        if kind == DEVICE_STATUS:
            return _of_device(m)
        if kind == MOUNT_ORIENTATION:
            if math.isfinite(m.yaw):
                return "level", _of_degrees(m.roll, m.pitch, m.yaw)
            return "ned", _of_degrees(m.roll, m.pitch, m.yaw_absolute)
        return "body", _of_degrees(0.01 * m.pointing_b, 0.01 * m.pointing_a, 0.01 * m.pointing_c)

    def _stamp(self, time_boot_ms: int, received_at: MonoNs, boot: BootClock | None) -> Stamp:
        if time_boot_ms == 0:
            stamp = Stamp(received_at, received_at, _ARRIVAL_SIGMA_S, "arrival")
        elif boot is not None:
            stamp = boot.stamp(boot_ms(time_boot_ms), received_at)
        else:
            stamp = self._clock.stamp(boot_ms(time_boot_ms), received_at)
        measured_at = MonoNs(stamp.measured_at - round(self._o.latency_s * NS_PER_S))
        sigma_s = min(math.hypot(stamp.sigma_s, self._o.latency_sigma_s), 0.9)
        return replace(stamp, measured_at=measured_at, sigma_s=sigma_s)


def _of_device(m: Message) -> tuple[GimbalFrame, Rotation]:
    """Return the frame and the rotation of a GIMBAL_DEVICE_ATTITUDE_STATUS.

    Where an attitude from north comes with the vehicle's heading by the same clockwork, `delta_yaw`, that is taken out: two
    compasses differ. A field that a sender leaves out reads zero.

    Raises:
        Refused: a failure, flags that contradict one another, or no rotation.
    """
    if m.failure_flags & _FAILURES:
        raise Refused("failure")
    stated = m.flags & (_VEHICLE_YAW | _EARTH_YAW)
    if stated == _VEHICLE_YAW | _EARTH_YAW:
        raise Refused("frame")
    size = math.sqrt(sum(q * q for q in m.q))
    if not abs(size - 1.0) <= _LENGTH_OFF:
        raise Refused("rotation")
    rotation = Rotation.from_quat(list(m.q))
    if stated == _VEHICLE_YAW or not (stated or m.flags & _YAW_LOCK):
        return "level", rotation
    if stated and math.isfinite(m.delta_yaw) and 0.0 < abs(m.delta_yaw) <= math.tau:
        return "level", Rotation.from_rpy(0.0, 0.0, -m.delta_yaw) @ rotation
    return "ned", rotation


def _of_degrees(roll: float, pitch: float, yaw: float) -> Rotation:
    """Return a rotation of angles in degrees.

    Raises:
        Refused: one is no angle.
    """
    if not all(abs(angle) <= _ANGLE_MAX_DEG for angle in (roll, pitch, yaw)):
        raise Refused("angle")
    return Rotation.from_rpy(math.radians(roll), math.radians(pitch), math.radians(yaw))


_log = logging.getLogger(__name__)

OFF_RAD = math.radians(10.0)
"""Angle from the vertical beyond which the gimbal has left: less than what a stabilizing gimbal lags behind in a gust."""
_REPEAT_S, _REFUSED_S, _SETTLE_S = 1.0, 5.0, 4.0
"""Times to the next command: after one that was not answered, after one that was refused, and after one that was accepted."""
_CONTROL, _POINT = int(mav.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE), int(mav.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW)
_DONE = frozenset({int(mav.MAV_RESULT_ACCEPTED), int(mav.MAV_RESULT_IN_PROGRESS)})
_UNSUPPORTED = int(mav.MAV_RESULT_UNSUPPORTED)
_KEEP = -1.0
"""Leaves who has secondary control unchanged."""
_FLAGS = int(
    mav.GIMBAL_MANAGER_FLAGS_ROLL_LOCK | mav.GIMBAL_MANAGER_FLAGS_PITCH_LOCK | mav.GIMBAL_MANAGER_FLAGS_YAW_IN_VEHICLE_FRAME
)
"""Roll and pitch against the horizon, yaw with the vehicle."""


class Step(Enum):
    """Next request to the gimbal manager."""

    CONTROL = "taking control"
    POINT = "pointing"
    POINTED = "pointed"


class GimbalPointer:
    """Commands to one gimbal's manager.

    Args:
        device_id: the gimbal.
    """

    def __init__(self, device_id: int) -> None:
        self._device_id = device_id
        self._asked: int | None = None
        self._not_before: MonoNs | None = None
        self._logged: set[tuple[int, int]] = set()
        self.step = Step.CONTROL
        self.counts: Counter[str] = Counter()
        """The number of times that it was pointed down (`pointed`), had left (`left`), and that a command was refused."""

    def restart(self) -> None:
        """Begin again, because the autopilot or the gimbal has."""
        self.step, self._asked, self._not_before = Step.CONTROL, None, None

    def due(self, now: MonoNs, us: tuple[int, int], manager: tuple[int, int], off_rad: float | None) -> list[Message]:
        """Return the command to send now as a list of at most one message.

        Args:
            us: our (system, component).
            manager: the (system, component) of the gimbal's manager.
            off_rad: the angle between the gimbal and the vertical as it reports it; None while it reports none.
        """
        if self._not_before is not None and now < self._not_before:
            return []
        if self.step is Step.POINTED:
            if off_rad is None or off_rad <= OFF_RAD:
                return []
            self.counts["left"] += 1
            _log.info("gimbal %d: %.0f degrees off the vertical; pointing it down again", self._device_id, math.degrees(off_rad))
            self.step = Step.CONTROL
        self._not_before = after(now, _REPEAT_S)
        if self.step is Step.CONTROL:
            self._asked = _CONTROL
            return [self._command(manager, _CONTROL, float(us[0]), float(us[1]), _KEEP, _KEEP, 0.0)]
        self._asked = _POINT
        return [self._command(manager, _POINT, -90.0, 0.0, math.nan, math.nan, float(_FLAGS))]

    def on_ack(self, command: int, result: int, now: MonoNs) -> None:
        """Take a COMMAND_ACK of the manager."""
        if command != self._asked:
            return
        self._asked = None
        if command == _CONTROL and (result in _DONE or result == _UNSUPPORTED):
            self.step, self._not_before = Step.POINT, None
        elif command == _POINT and result in _DONE:
            self.step, self._not_before = Step.POINTED, after(now, _SETTLE_S)
            self.counts["pointed"] += 1
        else:
            self.step, self._not_before = Step.CONTROL, after(now, _REFUSED_S)
            self.counts["refused"] += 1
            if (command, result) not in self._logged and len(self._logged) < 16:
                self._logged.add((command, result))
                what = "control" if command == _CONTROL else "to be pointed down"
                _log.warning("gimbal %d: its manager refuses %s (result %d); asking again", self._device_id, what, result)

    def _command(self, manager: tuple[int, int], command: int, *values: float) -> Message:
        return mav.MAVLink_command_long_message(*manager, command, 0, *values, 0.0, float(self._device_id))


_REPORTS = frozenset({DEVICE_STATUS, MOUNT_ORIENTATION, MOUNT_STATUS})
_MANAGER = frozenset({"GIMBAL_MANAGER_STATUS", "GIMBAL_MANAGER_INFORMATION"})
_TICK_S = 0.1
_SILENT_S = 3.0
"""Time of silence after which the gimbal may report over another link or from another peer."""


class Gimbal:
    """One gimbal; see the module's docstring.

    Its reports count only from the vehicle's own system and from the first place that they come from: like an autopilot's ids, a
    gimbal's prove nothing.
    """

    def __init__(self, options: GimbalOptions, clock: Clock) -> None:
        self._o = options
        self._clock = clock
        self.sampler = GimbalSampler(options)
        self.pointer = GimbalPointer(options.device_id) if options.point_down else None
        self._streams = Streams({MOUNT_STATUS if options.report == "mount_status" else DEVICE_STATUS: options.rate_hz})
        self._heard: tuple[Source, int] | None = None
        self._heard_at: MonoNs | None = None
        self._manager: tuple[int, int] | None = None
        self._connects = 0
        self._samples = 0
        self._times: deque[MonoNs] = deque(maxlen=50)
        """Time when the newest of them were received."""

    @property
    def device_id(self) -> int:
        return self._o.device_id

    @property
    def rate_hz(self) -> float:
        """The rate of its newest reports that were taken, Hz; 0 while none come."""
        times = self._times
        if len(times) < 2 or seconds_between(times[-1], self._clock.now()) > 1.0:
            return 0.0
        return (len(times) - 1) / max(seconds_between(times[0], times[-1]), 1e-3)

    def counted(self) -> dict[str, float]:
        """Return the counters for health."""
        out: dict[str, float] = {"reports": self._samples}
        out |= {f"refused_{why}": n for why, n in self.sampler.refused.items()}
        if self.pointer is not None:
            out |= {name: self.pointer.counts[name] for name in ("pointed", "left")}
            out["pointing_refused"] = self.pointer.counts["refused"]
        return out

    def on_message(self, autopilot: Autopilot, received: ReceivedMessage) -> GimbalAttitude | None:
        """Take any message of the autopilot's links; return the sample of a report."""
        identity, kind, m = autopilot.identity, received.message.get_type(), received.message
        if identity is None or received.system != identity.system or received.access_level < AccessLevel.PEER:
            return None
        if kind in _MANAGER:
            if m.gimbal_device_id == self._o.device_id:
                self._manager = (received.system, received.component)
            return None
        if kind == "COMMAND_ACK":
            if not is_for(m, autopilot.links.identity):
                return None
            sender = (received.system, received.component)
            if sender == self._device(identity.address):
                self._streams.on_message(received.message, received.received_at)
            if self.pointer is not None and sender == (self._manager or identity.address):
                self.pointer.on_ack(int(received.message.command), int(received.message.result), received.received_at)
            return None
        own = received.component == identity.component
        if kind not in _REPORTS or not self._reports(m, received.component, own=own) or not self._hold(received):
            return None
        self._streams.on_message(m, received.received_at)
        sample = self.sampler.sample(m, received.received_at, autopilot.boot_clock if own else None)
        if sample is not None:
            self._samples += 1
            self._times.append(received.received_at)
        return sample

    def due(self, autopilot: Autopilot, now: MonoNs) -> list[Message]:
        """Return the messages to send now."""
        identity, streams = autopilot.identity, autopilot.streams
        if identity is None or streams is None or not autopilot.connected:
            return []
        if autopilot.connects != self._connects:
            self._connects = autopilot.connects
            self._streams.restart()
            self.sampler.restart()
            if self.pointer is not None:
                self.pointer.restart()
        out: list[Message] = []
        # An answer does not name the stream that it is for, so the request goes out when the autopilot has answered all others.
        if streams.settled or not self._o.of_autopilot:
            out += self._streams.due(now, self._device(identity.address))
        if self.pointer is not None:
            out += self.pointer.due(now, autopilot.links.identity, self._manager or identity.address, self._off_rad())
        return out

    def _device(self, autopilot: tuple[int, int]) -> tuple[int, int]:
        return autopilot if self._o.of_autopilot else (autopilot[0], self._o.device_id)

    def _reports(self, m: Message, component: int, *, own: bool) -> bool:
        """Return whether a report is one of this gimbal; older autopilots do not number theirs."""
        if m.get_type() != DEVICE_STATUS:
            return own or component == self._o.device_id
        if self._o.of_autopilot:
            return own and m.gimbal_device_id in ((0, 1) if self._o.device_id == 1 else (self._o.device_id,))
        return bool(component == self._o.device_id)

    def _hold(self, received: ReceivedMessage) -> bool:
        """Return whether a report comes from where the gimbal's reports come from."""
        came_from, at = (received.source, received.component), received.received_at
        silent = self._heard_at is None or seconds_between(self._heard_at, at) > _SILENT_S
        if self._heard != came_from:
            if not silent:
                return False
            self._heard = came_from
            self.sampler.restart()
        self._heard_at = at
        return True

    def _off_rad(self) -> float | None:
        newest = self.sampler.newest
        if newest is None:
            return None
        return math.acos(max(-1.0, min(1.0, float(newest.R_frame_gimbal.matrix[2, 0]))))


@asynccontextmanager
async def tending(gimbal: Gimbal | None, autopilot: Autopilot, clock: Clock) -> AsyncIterator[None]:
    """Run the gimbal on the links of an autopilot: its samples are offered among the autopilot's. Without one do nothing."""
    if gimbal is None:
        yield
        return

    def on_message(received: ReceivedMessage) -> None:
        sample = gimbal.on_message(autopilot, received)
        if sample is not None:
            autopilot.samples.offer(sample)

    def step() -> None:
        if autopilot.unclear is not None:
            return  # a command would reach whoever has the gimbal's ids
        for message in gimbal.due(autopilot, clock.now()):
            autopilot.send(message)

    async def tick() -> None:
        while True:
            autopilot.links.contained.run("the gimbal's tick", "us", step)
            await clock.sleep(_TICK_S)

    autopilot.add_listener(on_message)
    async with running_beside([("mavlink-gimbal", tick())]):
        yield
