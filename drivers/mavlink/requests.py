"""Requests to the autopilot that need an answer: message streams and parameters. This module does no I/O.

Both classes repeat a request until it is answered and note what was refused, so a lost answer only costs a repetition.
"""

import math
import struct
from collections import deque
from collections.abc import Iterable, Mapping

from msgspec import Struct

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.vehicle import Stack
from estimator.contracts.time import NS_PER_S, MonoNs, seconds_between

_ACCEPTED = int(mav.MAV_RESULT_ACCEPTED)
_BUSY = int(mav.MAV_RESULT_TEMPORARILY_REJECTED)
_REAL = (int(mav.MAV_PARAM_TYPE_REAL32), int(mav.MAV_PARAM_TYPE_REAL64))
_VALUES_MAX = 4096
"""Largest number of parameters kept of an autopilot; ArduPilot has about 1,500."""
_INTEGERS = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}
"""MAV_PARAM_TYPE to struct layout, for integers that travel as bytes in a float."""


def parameter_value(stack: Stack, wire: float, kind: int) -> float:
    """Return the value of a PARAM_VALUE: ArduPilot sends an integer as its value in a float, PX4 as its bytes in a float.

    Args:
        wire: the message's float.
        kind: MAV_PARAM_TYPE.
    """
    if stack is not Stack.PX4 or kind in _REAL:
        return float(wire)
    return float(struct.unpack_from(_INTEGERS.get(kind, "<i"), struct.pack("<f", wire))[0])


def wire_value(stack: Stack, value: float, kind: int) -> float:
    """Return the float of a PARAM_SET, the inverse of `parameter_value`.

    Raises:
        ValueError: the parameter is an integer, and the value is none or does not fit.
    """
    if stack is not Stack.PX4 or kind in _REAL:
        return value
    layout = _INTEGERS.get(kind, "<i")
    try:
        data = struct.pack(layout, int(value))
    except struct.error as why:
        raise ValueError(f"{value:g} does not fit a parameter of type {kind}") from why
    if int(value) != value:
        raise ValueError(f"{value:g} is no integer, and the parameter is one")
    return float(struct.unpack("<f", data.ljust(4, b"\0"))[0])


COMMON_RATES_HZ = {
    # The mode and the armed state: a takeover of the vehicle is reported within one of these, and not within a second. PX4
    # refuses to send it more often than once a second, and answers each request for one.
    "HEARTBEAT": 5.0,
    "EXTENDED_SYS_STATE": 5.0,
    "SYS_STATUS": 1.0,
    "ATTITUDE_QUATERNION": 100.0,
    "LOCAL_POSITION_NED": 50.0,
    "GLOBAL_POSITION_INT": 5.0,
}
_ARDUPILOT_HZ = COMMON_RATES_HZ | {"RAW_IMU": 100.0, "DISTANCE_SENSOR": 20.0, "SCALED_PRESSURE": 10.0}
RATES_HZ: dict[Stack, dict[str, float]] = {
    Stack.ARDUPILOT: _ARDUPILOT_HZ,
    Stack.PLANE: _ARDUPILOT_HZ,
    Stack.PX4: COMMON_RATES_HZ | {"HIGHRES_IMU": 100.0, "DISTANCE_SENSOR": 20.0},
    Stack.OTHER: COMMON_RATES_HZ,
}
"""Message rates, Hz, to request on a new link. Until then ArduPilot sends only HEARTBEAT and TIMESYNC."""
POLLED = "HEARTBEAT"
"""The message that is requested one by one where its stream is refused or slower than asked for."""
_POLL_INTERVALS, _LATE_INTERVALS = 0.75, 1.5
"""Ages at which a polled message is requested, in its intervals: where its stream is refused, and where it is too slow."""
INSTEAD = {"ATTITUDE_QUATERNION": "ATTITUDE", "GIMBAL_DEVICE_ATTITUDE_STATUS": "MOUNT_ORIENTATION"}
"""The message to request if the first is refused: ArduCopter 4.0 does not stream the quaternion, nor older mounts theirs."""


def message_id(name: str) -> int:
    """Return the number of a message of the dialect.

    Raises:
        KeyError: the dialect has no message of that name.
    """
    found = {cls.msgname: number for number, cls in mav.mavlink_map.items()}
    return int(found[name])


def request_message(target: tuple[int, int], number: int) -> Message:
    """Return the request for one message, by its number."""
    return mav.MAVLink_command_long_message(*target, mav.MAV_CMD_REQUEST_MESSAGE, 0, number, 0, 0, 0, 0, 0, 0)


class _Stream(Struct):
    interval_s: float
    tries: int = 0
    asked: MonoNs | None = None
    result: int | None = None
    received_at: MonoNs | None = None


class Streams:
    """Request each message stream with MAV_CMD_SET_MESSAGE_INTERVAL.

    Requests go out one at a time because the acknowledgement does not name the message that it is for. A `POLLED` message that
    does not arrive often enough is requested with MAV_CMD_REQUEST_MESSAGE each time, whose acknowledgement is not awaited.

    Args:
        rates_hz: rate by message name, Hz.
        retry_s: time after which an unanswered request is repeated, s.
        tries: number of requests after which an unanswered message is given up.
        silence_s: an accepted message that does not arrive for this long, and for ten of its intervals, is requested again.
    """

    def __init__(self, rates_hz: Mapping[str, float], *, retry_s: float = 0.5, tries: int = 4, silence_s: float = 3.0) -> None:
        self._streams = {name: _Stream(1.0 / rate) for name, rate in rates_hz.items()}
        self._ids = {name: message_id(name) for name in rates_hz}
        self._retry_s, self._tries, self._silence_s = retry_s, tries, silence_s
        self._waiting: str | None = None
        self._polled: MonoNs | None = None

    @property
    def refused(self) -> dict[str, int]:
        """MAV_RESULT of each message that the autopilot refused to send; -1 if it never answered."""
        given_up = {n: -1 for n, s in self._streams.items() if s.result is None and s.tries >= self._tries}
        return given_up | {n: s.result for n, s in self._streams.items() if s.result not in (None, _ACCEPTED)}

    @property
    def settled(self) -> bool:
        """True if every request was answered or given up."""
        return all(s.result is not None or s.tries >= self._tries for s in self._streams.values())

    def also(self, name: str, rate_hz: float) -> None:
        """Request one more message from now on, over restarts too."""
        if name not in self._streams:
            self._streams[name], self._ids[name] = _Stream(1.0 / rate_hz), message_id(name)

    def restart(self) -> None:
        """Request every message again, because the link or the autopilot was restarted."""
        self._streams = {name: _Stream(s.interval_s) for name, s in self._streams.items()}
        self._waiting = None

    def due(self, now: MonoNs, target: tuple[int, int]) -> list[Message]:
        """Return the requests to send now: at most one for a stream, and one for a message."""
        return self._polls(now, target) + self._requests(now, target)

    def _polls(self, now: MonoNs, target: tuple[int, int]) -> list[Message]:
        stream = self._streams.get(POLLED)
        if stream is None:
            return []
        wait_s = stream.interval_s * (_LATE_INTERVALS if stream.result in (None, _ACCEPTED) else _POLL_INTERVALS)
        self._polled = self._polled or now
        if seconds_between(max(stream.received_at or self._polled, self._polled), now) < wait_s:
            return []
        self._polled = now
        return [request_message(target, self._ids[POLLED])]

    def _requests(self, now: MonoNs, target: tuple[int, int]) -> list[Message]:
        if self._waiting is not None:
            waiting = self._streams[self._waiting]
            if waiting.asked is not None and seconds_between(waiting.asked, now) < self._retry_s:
                return []
            self._waiting = None
        for name, stream in self._streams.items():
            self._check_silence(stream, now)
            if stream.result is None and stream.tries < self._tries:
                stream.tries += 1
                stream.asked = now
                self._waiting = name
                interval_us = round(stream.interval_s * 1e6)
                return [
                    mav.MAVLink_command_long_message(
                        *target, mav.MAV_CMD_SET_MESSAGE_INTERVAL, stream.tries - 1, self._ids[name], interval_us, 0, 0, 0, 0, 0
                    )
                ]
        return []

    def on_message(self, message: Message, received_at: MonoNs) -> None:
        """Process any message of the autopilot: note acknowledgements and the streams that arrive."""
        kind = message.get_type()
        if kind == "COMMAND_ACK":
            if message.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL and self._waiting is not None:
                name, self._waiting = self._waiting, None
                waiting = self._streams[name]
                waiting.result = None if message.result == _BUSY else int(message.result)
                waiting.received_at = received_at
                other = INSTEAD.get(name)
                if waiting.result not in (None, _ACCEPTED) and other is not None and other not in self._streams:
                    self._streams[other], self._ids[other] = _Stream(waiting.interval_s), message_id(other)
        elif kind in self._streams:
            self._streams[kind].received_at = received_at

    def _check_silence(self, stream: _Stream, now: MonoNs) -> None:
        if stream.result != _ACCEPTED or stream.received_at is None:
            return
        if seconds_between(stream.received_at, now) > max(self._silence_s, 10.0 * stream.interval_s):
            # A message that has nothing to send (no lidar is fitted) must not be requested all the time.
            stream.result, stream.tries = None, min(stream.tries, self._tries - 1)
            stream.received_at = MonoNs(now + round(4 * self._silence_s * NS_PER_S))


class RateLimit:
    """A bound on requests over time, whatever is requested and however often a peer seems to be new.

    Args:
        rate_hz: the requests a second.
        most: the requests at once, after a pause.
    """

    def __init__(self, rate_hz: float, most: int) -> None:
        self._rate_hz, self._most = rate_hz, most
        self._left = float(most)
        self._filled: MonoNs | None = None

    def allows(self, now: MonoNs) -> bool:
        """Return whether requests may be sent now."""
        if self._filled is not None:
            self._left = min(self._most, self._left + self._rate_hz * seconds_between(self._filled, now))
        self._filled = now
        return self._left >= 1.0

    def spend(self, requests: int) -> None:
        """Note requests that were sent."""
        self._left -= requests


class VersionRequest:
    """Request AUTOPILOT_VERSION, a few times until it is answered: it has the unique id of the hardware."""

    _TRIES, _RETRY_S, _AGAIN_S = 4, 2.0, 3.0

    def __init__(self) -> None:
        self.answered = False
        self._tries = 0
        self._asked: MonoNs | None = None

    def done(self, now: MonoNs) -> bool:
        """Return whether it was answered some time ago."""
        return self.answered and self._asked is not None and seconds_between(self._asked, now) >= self._AGAIN_S

    def due(self, now: MonoNs, target: tuple[int, int]) -> list[Message]:
        """Return the request to send now as a list of at most one message."""
        waits = self._asked is not None and seconds_between(self._asked, now) < self._RETRY_S
        if self.answered or waits or self._tries >= self._TRIES:
            return []
        self._asked, self._tries = now, self._tries + 1
        return [request_message(target, int(mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION))]


class Parameters:
    """Read parameters with PARAM_REQUEST_READ, a few at a time.

    Args:
        stack: the autopilot's stack. ArduPilot sends an integer as its value in a float, PX4 as its bytes in a float.
    """

    def __init__(
        self, stack: Stack, names: Iterable[str] = (), *, retry_s: float = 0.5, tries: int = 4, at_once: int = 4
    ) -> None:
        self._stack = stack
        self._wanted: deque[str] = deque(dict.fromkeys(names))
        self._asked: dict[str, tuple[MonoNs, int]] = {}
        self._retry_s, self._tries, self._at_once = retry_s, tries, at_once
        self.values: dict[str, float] = {}
        """Every parameter that the autopilot sent, requested or not."""
        self.kinds: dict[str, int] = {}
        """MAV_PARAM_TYPE of each parameter that the autopilot sent."""
        self.absent: set[str] = set()
        """Parameters that were requested and never answered, or refused: this firmware does not have them."""

    @property
    def settled(self) -> bool:
        return not self._wanted and not self._asked

    def request(self, names: Iterable[str]) -> None:
        """Read these parameters, again if they were read before."""
        for name in names:
            if name not in self._wanted and name not in self._asked:
                self.absent.discard(name)
                self._wanted.append(name)

    def forget(self) -> None:
        """Ask for nothing more. An unanswered parameter is neither read nor absent."""
        self._wanted.clear()
        self._asked.clear()

    def due(self, now: MonoNs, target: tuple[int, int]) -> list[Message]:
        """Return the requests to send now."""
        out = []
        for name, (at, tries) in list(self._asked.items()):
            if seconds_between(at, now) < self._retry_s:
                continue
            if tries >= self._tries:
                del self._asked[name]
                self.absent.add(name)
            else:
                self._asked[name] = (now, tries + 1)
                out.append(name)
        while self._wanted and len(self._asked) < self._at_once:
            name = self._wanted.popleft()
            self._asked[name] = (now, 1)
            out.append(name)
        return [mav.MAVLink_param_request_read_message(*target, name.encode(), -1) for name in out]

    def on_message(self, message: Message) -> None:
        """Process any message of the autopilot."""
        kind = message.get_type()
        if kind == "PARAM_VALUE":
            name, kind_of = message.param_id, int(message.param_type)
            value = parameter_value(self._stack, message.param_value, kind_of)
            if math.isfinite(value) and (name in self._asked or name in self.values or len(self.values) < _VALUES_MAX):
                self.values[name], self.kinds[name] = value, kind_of
            self._asked.pop(name, None)
        elif kind == "PARAM_ERROR" and message.param_id in self._asked:
            del self._asked[message.param_id]
            self.absent.add(message.param_id)
