"""Requests to the autopilot that need an answer: message streams and parameters. This module does no I/O.

No request is settled for good. The way up may come later than the way down, and another station may slow or stop a stream
that was granted, so what arrives is compared with what was requested, and requested again with a growing pause.
"""

import logging
import math
import struct
from collections import deque
from collections.abc import Iterable, Mapping

from msgspec import Struct

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.vehicle import Stack
from estimator.contracts.time import MonoNs, seconds_between

_log = logging.getLogger(__name__)
_ACCEPTED = int(mav.MAV_RESULT_ACCEPTED)
_NO_ANSWER = (int(mav.MAV_RESULT_TEMPORARILY_REJECTED), int(mav.MAV_RESULT_IN_PROGRESS))
_PAUSE_MAX_S = 30.0
"""The longest pause between two requests for the same."""
_SILENT_S = 5.0
"""The first pause for a parameter that counts as absent."""
_RETRY_S = 0.5  # time after which an unanswered request is repeated
_WINDOW_S = 3.0  # time over which arrivals are counted; ten intervals if that is longer
_REFUSED_TRIES = 3
"""The requests without an answer that a refusal counts as."""
_ENOUGH = 0.5
"""The share of its rate with which a stream counts as granted: the stacks choose divisors of their own rates."""
_REAL = (int(mav.MAV_PARAM_TYPE_REAL32), int(mav.MAV_PARAM_TYPE_REAL64))
_VALUES_MAX = 4096
"""Largest number of parameters kept of an autopilot; ArduPilot has about 1,500."""
_INTEGERS = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}
"""MAV_PARAM_TYPE to struct layout, for integers that travel as bytes in a float."""
_POLL_INTERVALS = 0.75  # age at which a polled message is requested where its stream is refused, in its intervals
_LATE_INTERVALS = 1.5  # age at which it is requested where its stream is too slow, in its intervals
_POLL_AGES = 0.2  # least pause between requests, in parts of its age: none arrives where requests cannot


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
"""The message that is requested one by one where its stream is refused or slower than requested."""
INSTEAD = {"ATTITUDE_QUATERNION": "ATTITUDE", "GIMBAL_DEVICE_ATTITUDE_STATUS": "MOUNT_ORIENTATION"}
"""The message to request if the first is refused: ArduCopter 4.0 does not stream the quaternion, nor older mounts theirs."""


def message_id(name: str) -> int:
    """Return the number of a message of the dialect.

    Raises:
        KeyError: the dialect has no message of that name.
    """
    found = {cls.msgname: number for number, cls in mav.mavlink_map.items()}
    return int(found[name])


def is_for(message: Message, us: tuple[int, int]) -> bool:
    """Return whether a COMMAND_ACK is for this program: it names this program, or none, as one of MAVLink 1 does."""
    return message.target_system in (0, us[0]) and message.target_component in (0, us[1])


def _pause_over(asked: MonoNs | None, now: MonoNs, first_s: float, over: int) -> bool:
    """Return whether a request may be repeated; each one over the usual number of tries doubles the pause."""
    pause_s = min(first_s * 2.0 ** min(max(over, 0), 10), max(_PAUSE_MAX_S, first_s))
    return asked is None or seconds_between(asked, now) >= pause_s


def request_message(target: tuple[int, int], number: int) -> Message:
    """Return the request for one message, by its number."""
    return mav.MAVLink_command_long_message(*target, mav.MAV_CMD_REQUEST_MESSAGE, 0, number, 0, 0, 0, 0, 0, 0)


class _Stream(Struct):
    interval_s: float
    tries: int = 0
    asked: MonoNs | None = None
    result: int | None = None
    received_at: MonoNs | None = None
    count: int = 0
    """Messages since `since`."""
    since: MonoNs | None = None
    share: float | None = None
    """Share of the requested rate in the last whole window; None if there was none since the last request."""
    flowed: bool = False
    """True if it has arrived often enough and no word was written since about its end."""


class Streams:
    """Request each message stream with MAV_CMD_SET_MESSAGE_INTERVAL, and again wherever it does not arrive.

    Requests go out one at a time because the acknowledgement does not name the message that it is for. A `POLLED` message that
    does not arrive often enough is requested with MAV_CMD_REQUEST_MESSAGE each time, whose acknowledgement is not awaited.

    Args:
        rates_hz: rate by message name, Hz.
        tries: number of requests after which a message counts as unanswered, and the pauses grow.
    """

    def __init__(self, rates_hz: Mapping[str, float], *, tries: int = 4) -> None:
        self._streams = {name: _Stream(1.0 / rate) for name, rate in rates_hz.items()}
        self._ids = {name: message_id(name) for name in rates_hz}
        self._tries = tries
        self._waiting: str | None = None
        self._polled: MonoNs | None = None

    @property
    def refused(self) -> dict[str, int]:
        """MAV_RESULT of each message that the autopilot refused to send; -1 if it never answered."""
        given_up = {n: -1 for n, s in self._streams.items() if s.result is None and s.tries >= self._tries}
        return given_up | {n: s.result for n, s in self._streams.items() if s.result not in (None, _ACCEPTED)}

    @property
    def settled(self) -> bool:
        """True if every request was answered or sent several times in vain, and no answer is awaited."""
        tried = all(s.result is not None or s.tries >= self._tries for s in self._streams.values())
        return tried and self._waiting is None

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
        received_at = stream.received_at or self._polled
        wait_s = max(wait_s, min(_POLL_AGES * seconds_between(received_at, now), _PAUSE_MAX_S))
        if seconds_between(max(received_at, self._polled), now) < wait_s:
            return []
        self._polled = now
        return [request_message(target, self._ids[POLLED])]

    def _requests(self, now: MonoNs, target: tuple[int, int]) -> list[Message]:
        if self._waiting is not None:
            waiting = self._streams[self._waiting]
            if waiting.asked is not None and seconds_between(waiting.asked, now) < _RETRY_S:
                return []
            self._waiting = None
        for name, stream in self._streams.items():
            self._measure(name, stream, now)
        name, stream = min(self._streams.items(), key=lambda one: (not self._lacks(one[1], now), one[1].tries >= self._tries))
        if not self._lacks(stream, now):
            return []
        stream.tries += 1
        stream.asked, stream.since, stream.count, stream.share = now, now, 0, None
        self._waiting = name
        return [
            mav.MAVLink_command_long_message(
                *target, mav.MAV_CMD_SET_MESSAGE_INTERVAL, min(stream.tries - 1, 255), self._ids[name],
                round(stream.interval_s * 1e6), 0, 0, 0, 0, 0,
            )
        ]  # fmt: skip

    def _lacks(self, stream: _Stream, now: MonoNs) -> bool:
        """Return whether a stream is to be requested now."""
        if stream.share is None and stream.result == _ACCEPTED:
            return False
        enough = stream.share is not None and stream.share >= _ENOUGH
        return not enough and _pause_over(stream.asked, now, _RETRY_S, stream.tries - self._tries)

    def on_message(self, message: Message, received_at: MonoNs) -> None:
        """Process any message of the autopilot that is not for another program: note acknowledgements and arrivals."""
        kind = message.get_type()
        if kind == "COMMAND_ACK":
            if message.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL and self._waiting is not None:
                name, self._waiting = self._waiting, None
                waiting = self._streams[name]
                waiting.result = None if message.result in _NO_ANSWER else int(message.result)
                other = INSTEAD.get(name)
                if waiting.result in (None, _ACCEPTED):
                    return
                waiting.tries = max(waiting.tries, self._tries + _REFUSED_TRIES)
                if other is not None and other not in self._streams:
                    self._streams[other], self._ids[other] = _Stream(waiting.interval_s), message_id(other)
        elif kind in self._streams:
            self._streams[kind].received_at = received_at
            self._streams[kind].count += 1

    def _measure(self, name: str, stream: _Stream, now: MonoNs) -> None:
        """Compare what has arrived with what was requested, once a window."""
        if stream.since is None:
            stream.since, stream.count = now, 0
        lasted_s = seconds_between(stream.since, now)
        if lasted_s < max(_WINDOW_S, 10.0 * stream.interval_s):
            return
        stream.share = stream.count * stream.interval_s / lasted_s
        if stream.share >= _ENOUGH:
            stream.tries, stream.flowed = min(stream.tries, 1), True
        elif stream.flowed:
            stream.flowed = False
            text = "autopilot: %s arrives at %.1f Hz instead of %.0f Hz: requesting it again; does another station set its rate?"
            _log.warning(text, name, stream.count / lasted_s, 1.0 / stream.interval_s)
        stream.since, stream.count = now, 0


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
    """Request AUTOPILOT_VERSION until it is answered: it has the unique id of the hardware."""

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
        if self.answered or not _pause_over(self._asked, now, self._RETRY_S, self._tries - self._TRIES):
            return []
        self._asked, self._tries = now, self._tries + 1
        return [request_message(target, int(mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION))]


class Parameters:
    """Read parameters with PARAM_REQUEST_READ, a few at a time.

    Args:
        stack: the autopilot's stack. ArduPilot sends an integer as its value in a float, PX4 as its bytes in a float.
    """

    def __init__(self, stack: Stack, names: Iterable[str] = (), *, tries: int = 4, at_once: int = 4) -> None:
        self._stack = stack
        self._wanted: deque[str] = deque(dict.fromkeys(names))
        self._asked: dict[str, tuple[MonoNs, int]] = {}
        self._tries, self._at_once = tries, at_once
        self.values: dict[str, float] = {}
        """Every parameter that the autopilot sent, requested or not."""
        self.kinds: dict[str, int] = {}
        """MAV_PARAM_TYPE of each parameter that the autopilot sent."""
        self.absent: set[str] = set()
        """Parameters that were requested several times and not answered, or refused: this firmware does not have them, or no
        request arrives. Those without an answer are requested again."""
        self._silent: dict[str, tuple[MonoNs, int]] = {}
        """Absent ones without an answer, with the time and the number of the last request."""

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
        """Request nothing more. An unanswered parameter is neither read nor absent."""
        self._wanted.clear()
        self._asked.clear()
        self._silent.clear()

    def due(self, now: MonoNs, target: tuple[int, int]) -> list[Message]:
        """Return the requests to send now."""
        out = []
        for name, (at, tries) in list(self._asked.items()):
            if seconds_between(at, now) < _RETRY_S:
                continue
            if tries >= self._tries:
                self._silent[name] = self._asked.pop(name)
                self.absent.add(name)
            else:
                self._asked[name] = (now, tries + 1)
                out.append(name)
        while self._wanted and len(self._asked) < self._at_once:
            name = self._wanted.popleft()
            self._asked[name] = (now, 1)
            self._silent.pop(name, None)
            out.append(name)
        for name, (at, tries) in self._silent.items():
            if len(out) < self._at_once and _pause_over(at, now, _SILENT_S, tries - self._tries):
                self._silent[name] = (now, tries + 1)
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
            if self._silent.pop(name, None) is not None:
                self.absent.discard(name)
        elif kind == "PARAM_ERROR" and (message.param_id in self._asked or message.param_id in self._silent):
            self._asked.pop(message.param_id, None)
            self._silent.pop(message.param_id, None)
            self.absent.add(message.param_id)
