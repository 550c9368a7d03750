"""Serve COMMAND_LONG and COMMAND_INT: answer each, carry out a repeat only once, report progress of a long one. No I/O.

A command does not say when it was given: its time of arrival counts. A stop is carried out each time it comes.

`Refusals` refuses commands and parameter writes of unauthorized senders: it answers peers, counts all, and reports once.

| command | meaning |
|---|---|
| NAV_LAND (21) | start the landing; IN_PROGRESS with percent until it ends |
| NAV_LOITER_UNLIM (17) | fly over the pad and stay there; its place and radius are the pad's and the settings' |
| DO_PAUSE_CONTINUE (193) | param1 0: hover where it is; 1: go on |
| DO_GO_AROUND (191) | call the landing off and hover |
| LOGGING_START (2510), LOGGING_STOP (2511) | start or stop a recording |
| REQUEST_MESSAGE (512), SET_MESSAGE_INTERVAL (511), GET_MESSAGE_INTERVAL (510) | of our own messages |

Source: mavlink.io, "Command Protocol".
"""

import logging
import math
from collections import Counter
from collections.abc import Callable
from typing import Protocol

from msgspec import Struct

from companion.base.mission import FlightOutcome
from companion.base.orders import OperatorOrder, OrderSender, OrderSource
from companion.guidance.pilot import Pilot
from companion.guidance.pilot_operator import Operated, PilotOperator
from drivers.mavlink.access import AccessLevel
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import Links, ReceivedMessage
from estimator.contracts.estimates import RelativeState
from estimator.contracts.time import Clock, MonoNs, seconds_between

CAPABILITIES = int(
    mav.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT | mav.MAV_PROTOCOL_CAPABILITY_FTP | mav.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
"""The capabilities that components with parameters report."""


CANCELLED = 6
"""MAV_RESULT_CANCELLED, which the shipped dialect lacks."""
_PROGRESS_UNKNOWN = 255  # progress that is not known
_REPEAT_S = 5.0  # age up to which a command with a confirmation repeats the one before
_AT_ONCE_S = 1.0  # age up to which an equal command does
_REPORT_S = 1.0  # time between two reports of a command's progress
_INTERVAL_MIN_S = 0.01  # shortest interval of a message that is sent periodically
_INTERVAL_MAX_S = 2000.0  # longest interval of it; MESSAGE_INTERVAL cannot carry a longer one
_REPORTED_MAX = 32  # senders whose refusals are reported


COMMANDS = ("COMMAND_LONG", "COMMAND_INT")
ACCEPTED, DENIED, UNSUPPORTED = int(mav.MAV_RESULT_ACCEPTED), int(mav.MAV_RESULT_DENIED), int(mav.MAV_RESULT_UNSUPPORTED)
FAILED, IN_PROGRESS = int(mav.MAV_RESULT_FAILED), int(mav.MAV_RESULT_IN_PROGRESS)
_REFUSED = int(mav.MAV_RESULT_TEMPORARILY_REJECTED)
_ABOUT_MESSAGES = frozenset(
    {int(mav.MAV_CMD_REQUEST_MESSAGE), int(mav.MAV_CMD_SET_MESSAGE_INTERVAL), int(mav.MAV_CMD_GET_MESSAGE_INTERVAL)}
)

_HEARTBEAT_BOUNDS_S = 0.2, 2.0
"""A component whose HEARTBEAT comes more rarely counts as lost; a sender behind the autopilot's router may not request that."""

Params = tuple[float, float, float, float, float, float, float]


class LandingProgress(Struct, frozen=True):
    """The progress of the landing that was requested."""

    percent: int | None
    """The progress in percent, 0..100; None if it is not known."""
    landed: bool | None = None
    """The result: None while the landing goes on, True if the vehicle landed on the pad, False if it ended otherwise."""
    called_off: bool = False
    """True if the operator ended the landing."""


class Operator(Operated, Protocol):
    """The operations that a ground station may request, and how far the landing is."""

    def progress(self) -> LandingProgress: ...


class PilotTower(PilotOperator):
    """Commands the pilot for ground stations.

    Args:
        believe: returns the steering path's newest belief.
        recording: switches the recorder; None if there is no recorder.
    """

    def __init__(
        self,
        pilot: Pilot,
        believe: Callable[[], RelativeState | None],
        clock: Clock,
        recording: Callable[[bool], str | None] | None = None,
    ) -> None:
        super().__init__(pilot, OrderSender(OrderSource.MAVLINK), clock, recording)
        self._believe = believe
        self._from_m: float | None = None

    def order(self, order: OperatorOrder, given_at: MonoNs | None = None) -> str | None:
        refusal = super().order(order, given_at)
        if refusal is None and order is OperatorOrder.BEGIN:
            self._from_m = None
        return refusal

    def progress(self) -> LandingProgress:
        """Return the progress of the landing, by the height that is left."""
        outcome = self._pilot.outcome
        if outcome is not None:
            called_off = outcome is FlightOutcome.ABORTED
            return LandingProgress(None, None if called_off else outcome is FlightOutcome.LANDED, called_off)
        belief = self._believe()
        if belief is None or belief.height_m <= 0:
            return LandingProgress(None)
        self._from_m = max(belief.height_m, self._from_m or 0.0)
        return LandingProgress(round(100.0 * (1.0 - belief.height_m / self._from_m)))


class Offered:
    """The messages that a peer can request, and the interval at which each is sent.

    Args:
        messages: by message number: what makes it, which returns None while it has nothing to say, and the interval at which
            it is sent by itself, s; 0 for not at all.
    """

    def __init__(self, messages: dict[int, tuple[Callable[[MonoNs], Message | None], float]]) -> None:
        self._messages = messages
        self._intervals_s = {number: interval_s for number, (_, interval_s) in messages.items()}
        self._next: dict[int, MonoNs] = {}

    def make(self, number: int, now: MonoNs) -> Message | None:
        """Return the message, or None if the number is unknown or there is nothing to send."""
        return self._messages[number][0](now) if number in self._messages else None

    def offers(self, number: int) -> bool:
        return number in self._messages

    def interval_us(self, number: int) -> int:
        """Return the interval as MESSAGE_INTERVAL encodes it, microseconds: 0 is not available, -1 is not sent periodically."""
        if number not in self._messages:
            return 0
        interval_s = self._intervals_s[number]
        return round(interval_s * 1e6) if interval_s > 0 else -1

    def set_interval(self, number: int, interval_us: float) -> bool:
        """Set a message's interval: -1 stops it, 0 sets the default.

        Return False if that is impossible or exceeds 2000 s. HEARTBEAT is never stopped, nor sent more often or rarely than a
        component may.
        """
        if number not in self._messages or not (interval_us == -1 or 0 <= interval_us <= _INTERVAL_MAX_S * 1e6):
            return False
        if number == mav.MAVLINK_MSG_ID_HEARTBEAT and interval_us:
            shortest_s, longest_s = _HEARTBEAT_BOUNDS_S
            if not shortest_s <= interval_us * 1e-6 <= longest_s:
                return False
        wanted_s = max(_INTERVAL_MIN_S, interval_us * 1e-6) if interval_us else self._messages[number][1]
        self._intervals_s[number] = 0.0 if interval_us == -1 else wanted_s
        self._next.pop(number, None)
        return True

    def due(self, now: MonoNs) -> list[Message]:
        """Return the messages that are due."""
        out = []
        for number, interval_s in self._intervals_s.items():
            if interval_s > 0 and now >= self._next.get(number, now):
                self._next[number] = MonoNs(now + round(interval_s * 1e9))
                message = self.make(number, now)
                if message is not None:
                    out.append(message)
        return out


class _Done(Struct):
    params: Params
    result: int
    at: MonoNs


class _Running(Struct):
    command: int
    sender: tuple[int, int]
    reported: MonoNs


class CommandServer:
    """Carries out commands through an `Operator` and answers them."""

    def __init__(self, operator: Operator, offered: Offered) -> None:
        self._operator = operator
        self._offered = offered
        self._done: dict[tuple[tuple[int, int], int], _Done] = {}
        self._last: dict[tuple[int, int], int] = {}
        """The newest command of each sender."""
        self._running: _Running | None = None
        self.refusal: str | None = None
        """The reason why the newest command was refused; None if it was carried out."""

    def on_message(self, message: Message, sender: tuple[int, int], us: tuple[int, int], now: MonoNs) -> list[Message]:
        """Return the answer, followed by the messages that the command requested."""
        kind = message.get_type()
        if kind not in COMMANDS or (message.target_system, message.target_component) != us:
            return []
        last = (message.param5, message.param6, message.param7) if kind == "COMMAND_LONG" else (message.x, message.y, message.z)
        params: Params = (message.param1, message.param2, message.param3, message.param4, *last)
        known = self._done.get((sender, message.command))
        if known is not None and known.params == params and self._repeats(message, known, sender, now):
            return [self._ack(message.command, known.result, sender)]
        self._last[sender] = message.command
        result, extra = self._do(message.command, params, sender, now)
        self._done[(sender, message.command)] = _Done(params, result, now)
        if len(self._done) > 64:
            oldest = min(self._done, key=lambda k: self._done[k].at)
            del self._done[oldest]
            self._last.pop(oldest[0], None)
        return [self._ack(message.command, result, sender), *extra]

    def _repeats(self, message: Message, known: _Done, sender: tuple[int, int], now: MonoNs) -> bool:
        """Return whether the command is a repeat: it counts a confirmation, or it is its sender's last command, sent again."""
        stops = message.command == mav.MAV_CMD_DO_GO_AROUND or (
            message.command == mav.MAV_CMD_DO_PAUSE_CONTINUE and message.param1 == 0.0
        )
        if message.command in _ABOUT_MESSAGES or stops:
            return False
        age_s = seconds_between(known.at, now)
        counted = message.get_type() == "COMMAND_LONG" and message.confirmation > 0 and age_s < _REPEAT_S
        at_once = self._last.get(sender) == message.command and age_s < _AT_ONCE_S and known.result in (ACCEPTED, IN_PROGRESS)
        return counted or at_once

    def due(self, now: MonoNs) -> list[Message]:
        """Return the progress of the long command, or its final result once it ended."""
        running = self._running
        if running is None:
            return []
        progress = self._operator.progress()
        if progress.landed is None and not progress.called_off:
            if seconds_between(running.reported, now) < _REPORT_S:
                return []
            running.reported = now
            return [self._ack(running.command, IN_PROGRESS, running.sender)]
        self._running = None
        result = ACCEPTED if progress.landed else CANCELLED if progress.called_off else FAILED
        if (done := self._done.get((running.sender, running.command))) is not None:
            done.result = result
        return [self._ack(running.command, result, running.sender)]

    def _ack(self, command: int, result: int, sender: tuple[int, int]) -> Message:
        percent = self._operator.progress().percent if result == IN_PROGRESS else None
        progress = 0 if result != IN_PROGRESS else _PROGRESS_UNKNOWN if percent is None else min(max(percent, 0), 100)
        return mav.MAVLink_command_ack_message(command, result, progress, 0, *sender)

    def _do(self, command: int, params: Params, sender: tuple[int, int], now: MonoNs) -> tuple[int, list[Message]]:
        self.refusal = None
        first = params[0]
        if command == mav.MAV_CMD_NAV_LAND:
            result = self._handler(self._operator.order(OperatorOrder.BEGIN))
            if result == ACCEPTED:
                self._running = _Running(command, sender, now)
                result = IN_PROGRESS
            return result, []
        if command == mav.MAV_CMD_DO_PAUSE_CONTINUE:
            if first not in (0.0, 1.0):
                self.refusal = f"pause or continue, not {first:g}"
                return DENIED, []
            return self._handler(self._operator.order(OperatorOrder.BEGIN if first else OperatorOrder.HOLD)), []
        if command == mav.MAV_CMD_NAV_LOITER_UNLIM:
            return self._handler(self._operator.order(OperatorOrder.STAY)), []
        if command == mav.MAV_CMD_DO_GO_AROUND:
            return self._handler(self._operator.order(OperatorOrder.ABORT)), []
        if command in (mav.MAV_CMD_LOGGING_START, mav.MAV_CMD_LOGGING_STOP):
            return self._handler(self._operator.record(command == mav.MAV_CMD_LOGGING_START)), []
        return self._about_messages(command, params, now)

    def _about_messages(self, command: int, params: Params, now: MonoNs) -> tuple[int, list[Message]]:
        number = int(params[0]) if math.isfinite(params[0]) else -1
        if command == mav.MAV_CMD_REQUEST_MESSAGE:
            if not self._offered.offers(number):
                return UNSUPPORTED, []
            message = self._offered.make(number, now)
            return (FAILED, []) if message is None else (ACCEPTED, [message])
        if command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
            if not self._offered.offers(number):
                return UNSUPPORTED, []
            return (ACCEPTED if self._offered.set_interval(number, params[1]) else DENIED), []
        if command == mav.MAV_CMD_GET_MESSAGE_INTERVAL:
            if not 0 <= number <= 65535:
                return DENIED, []
            return ACCEPTED, [mav.MAVLink_message_interval_message(number, self._offered.interval_us(number))]
        return UNSUPPORTED, []

    def _handler(self, refusal: str | None) -> int:
        self.refusal = refusal
        return ACCEPTED if refusal is None else _REFUSED


_log = logging.getLogger(__name__)


class Refusals:
    """Decides for one component of ours whether a message is obeyed.

    Args:
        setting: the key of the setting that names the operators, for the log.
    """

    def __init__(self, setting: str) -> None:
        self._setting = setting
        self._reported: set[tuple[int, int]] = set()
        self.counts: Counter[str] = Counter()
        """The numbers of refused messages, by message name."""

    def refuses(self, received: ReceivedMessage, us: tuple[int, int]) -> bool:
        """Return whether this message requests something of us (system, component) that its sender is not allowed."""
        message, name = received.message, received.message.get_type()
        if received.access_level >= AccessLevel.OPERATOR or name not in (*COMMANDS, "PARAM_SET"):
            return False
        if (message.target_system, message.target_component) != us:
            return False
        self.counts[name] += 1
        return True

    def answer(self, received: ReceivedMessage) -> list[Message]:
        """Return the answer to a refused command; a refused parameter is answered elsewhere, with its value in force."""
        if received.access_level < AccessLevel.PEER or received.message.get_type() not in COMMANDS:
            return []
        return [mav.MAVLink_command_ack_message(received.message.command, DENIED, 0, 0, received.system, received.component)]

    def text_for(self, received: ReceivedMessage) -> str | None:
        """Return the text for the pilot, or None if that sender was reported before; log the refusal together with its fix."""
        sender = (received.system, received.component)
        if sender in self._reported or len(self._reported) >= _REPORTED_MAX:
            return None
        self._reported.add(sender)
        _log.warning(
            "MAVLink: %s of %s refused: it is no operator; name its system in %s, or sign the link (decklander keys)",
            received.message.get_type(),
            received.source_text,
            self._setting,
        )
        return f"system {received.system} may not command"


def link_counters(links: Links, refusals: Refusals) -> dict[str, float]:
    """Return the counters of all links together for health, and the numbers of refusals, contained faults, unsent messages."""
    out: dict[str, float] = {}
    for link in links.all:
        for name, n in link.counters.as_dict().items():
            out[name] = out.get(name, 0) + n
    out |= {"peers": sum(link.peers for link in links.all), "impostors": links.access.refused["impostor"]}
    return out | {"refused": refusals.counts.total(), "faults": links.contained.total, "unfit": links.unfit.total()}
