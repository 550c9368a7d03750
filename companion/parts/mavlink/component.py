"""The service as a MAVLink component: identity, heartbeat, parameters, commands, status texts and messages about the pad.

    component = Component(outputs, operator, store, believe=..., clock=clock, health=health)
    async with open_autopilot(...) as autopilot, speaking(component, autopilot, clock): ...

The component is an observer of the service. The heartbeat stops when a vital part is down or guidance has stalled, so that
a dead pipeline is not taken for a live one. Any other part that is down (recorder, broker, metrics) is reported in a status
text and changes nothing else.

The component lives inside the vehicle's context and is not vital itself: a fault in one message costs that message alone.
"""

import logging
import math
import os
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import TypeVar

from msgspec import Struct

from companion.base.health import Health
from companion.base.mission import State
from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.base.orders import HandledOrder, OperatorOrder, OrderSource
from companion.base.service_log import ReportedOnce
from companion.base.version import version
from companion.guidance.targets import LED
from companion.parts.mavlink.commands import CAPABILITIES, COMMANDS, CommandServer, Offered, Operator, Refusals
from companion.parts.mavlink.file_server import FILE_REQUEST, FileServer
from companion.parts.mavlink.metadata import metadata_files, metadata_message
from companion.parts.mavlink.outputs import AutopilotView, Outputs
from companion.parts.mavlink.parameters import PARAMETER_REQUESTS, ParameterServer, Tunables
from drivers.mavlink.access import AccessLevel
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.dialect import ComponentInformationBasic, ComponentMetadata, Message, mav, ms_since_boot
from drivers.mavlink.links import Links, ReceivedMessage
from drivers.reconnect import Repeated, running_beside
from estimator.contracts.estimates import RelativeState, Verdict
from estimator.contracts.samples import Attitude, Sample
from estimator.contracts.time import Clock, MonoNs, after, seconds_between

_UNKNOWN_8 = 255  # value of a byte of ONBOARD_COMPUTER_STATUS that is not known
_UNKNOWN_16 = 32767  # value of two bytes of it that is not known
_UNKNOWN_32 = 0xFFFFFFFF  # value of four bytes of it that is not known
_NO_TEMPERATURE = 127  # temperature that is not known
_LONGEST = 1 << 20
"""The most characters that are read from one file."""
T = TypeVar("T")
_REPEAT_S = 60.0
"""The shortest time between two texts about the same part, which may fail and recover many times a minute, s."""
_CHUNK = 50  # bytes of a text in one STATUSTEXT
_SENT_MAX = 64  # texts whose time is kept
BURST = 5
"""The texts that may be sent at once."""
WAITING = 10
"""The texts that may wait."""
_SAME_S = 10.0
"""The time within which the same text is not sent again."""
_CHARGE_S = 30.0
"""Time between two texts of how a charge ends, s."""
_TICK_S = 0.02  # period of ticks
_FINE_TICK_S = 0.01  # period of ticks where something is due between them
_HEARTBEAT_S = 1.0  # period of HEARTBEAT
_STATE_S = 0.2  # period in which each NAMED_VALUE_FLOAT is sent once
_COMPUTER_S = 1.0  # period of ONBOARD_COMPUTER_STATUS
_BELIEF_S = 0.035
"""Age up to which the track of the target needs no newer belief, s: at 2 m/s^2 it is interpolated to a third of a millimetre."""
_GUIDANCE_SILENCE_S = 1.0
"""The time without a decision after which guidance counts as stalled."""


class Computer(Struct, frozen=True):
    """One reading; a field is None if the host does not report it."""

    cores_percent: tuple[int, ...]
    memory_used_mib: int | None
    memory_total_mib: int | None
    temperature_c: int | None
    uptime_s: float | None


class ComputerReader:
    """Reads `/proc` and `/sys`; the load is the mean since the previous reading."""

    def __init__(self, root: Path = Path("/")) -> None:
        self._root = root
        self._before: list[tuple[int, int]] = []

    def read(self) -> Computer:
        """Return the current state. It never raises: a value that cannot be read or parsed is None."""
        memory = _tried(self._memory) or {}
        used = memory["MemTotal"] - memory["MemAvailable"] if {"MemTotal", "MemAvailable"} <= memory.keys() else None
        total = memory.get("MemTotal")
        return Computer(
            cores_percent=_tried(self._load) or (),
            memory_used_mib=None if used is None else used // 1024,
            memory_total_mib=None if total is None else total // 1024,
            temperature_c=_tried(self._temperature),
            uptime_s=_tried(self._uptime_s),
        )

    def _text(self, path: str) -> str:
        with (self._root / path).open() as file:
            return file.read(_LONGEST)

    def _load(self) -> tuple[int, ...]:
        now: list[tuple[int, int]] = []
        for line in self._text("proc/stat").splitlines():
            name, *numbers = line.split() or [""]
            if name.startswith("cpu") and name != "cpu" and len(numbers) >= 5:
                ticks = [int(n) for n in numbers]
                now.append((sum(ticks) - ticks[3] - ticks[4], sum(ticks)))
        before, self._before = self._before, now
        if len(before) != len(now):
            return ()
        spans = [(busy - b, total - t) for (busy, total), (b, t) in zip(now, before, strict=True)]
        return tuple(min(max(round(100 * busy / total), 0), 100) if total > 0 else 0 for busy, total in spans)

    def _memory(self) -> dict[str, int]:
        pairs = (line.split() for line in self._text("proc/meminfo").splitlines())
        return {p[0].rstrip(":"): int(p[1]) for p in pairs if len(p) >= 2 and p[1].isdigit()}

    def _uptime_s(self) -> float | None:
        uptime_s = float(self._text("proc/uptime").split()[0])
        return uptime_s if math.isfinite(uptime_s) else None

    def _temperature(self) -> int | None:
        readings = []
        for entry in os.listdir(self._root / "sys/class/thermal"):
            if entry.startswith("thermal_zone"):
                # Reading a zone whose sensor does not answer raises an error; the other zones are still worth reading.
                path = f"sys/class/thermal/{entry}/temp"
                readings.append(_tried(partial(self._celsius, path)))
        known = [reading for reading in readings if reading is not None]
        return max(known) if known else None

    def _celsius(self, path: str) -> int:
        return round(int(self._text(path)) / 1000)


def _tried(read: Callable[[], T]) -> T | None:
    """Return what `read` returns, or None if the host does not report it or reports something other than a number.

    Every reading goes through here, so that one that fails (no descriptors left, a sensor gone) costs only itself.
    """
    try:
        return read()
    except (OSError, ValueError, IndexError):
        return None


def computer_status(computer: Computer, now: MonoNs) -> Message:
    """Return the message for one reading."""
    cores = list(computer.cores_percent[:8])
    combined = round(sum(cores) / len(cores)) if cores else _UNKNOWN_8
    temperature = _NO_TEMPERATURE if computer.temperature_c is None else min(max(computer.temperature_c, -126), 126)
    uptime_ms = 0 if computer.uptime_s is None else round(1000 * computer.uptime_s) & 0xFFFFFFFF
    return mav.MAVLink_onboard_computer_status_message(
        now // 1000,
        uptime_ms,
        0,
        cores + [_UNKNOWN_8] * (8 - len(cores)),
        [combined] + [_UNKNOWN_8] * 9,
        [_UNKNOWN_8] * 4,
        [_UNKNOWN_8] * 10,
        temperature,
        [temperature] + [_NO_TEMPERATURE] * 7,
        [_UNKNOWN_16] * 4,
        _memory_field(computer.memory_used_mib),
        _memory_field(computer.memory_total_mib),
        *([_UNKNOWN_32] * n for n in (4, 4, 4, 6, 6, 6, 6, 6)),
    )


def _memory_field(mib: int | None) -> int:
    return _UNKNOWN_32 if mib is None else min(max(mib, 0), _UNKNOWN_32 - 1)


log = logging.getLogger(__name__)

TYPE_ONBOARD, NO_AUTOPILOT = int(mav.MAV_TYPE_ONBOARD_CONTROLLER), int(mav.MAV_AUTOPILOT_INVALID)
_OURS = int(mav.MAV_COMP_ID_ONBOARD_COMPUTER)
_REQUESTS = frozenset((*COMMANDS, *PARAMETER_REQUESTS, FILE_REQUEST))


class MavSeverity(IntEnum):
    """The values of MAV_SEVERITY that are used."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class StatusTexts:
    """A token bucket of `BURST` texts that refills at 1 Hz; excess texts wait, and the least severe is dropped first."""

    def __init__(self) -> None:
        self._tokens = float(BURST)
        self._filled: MonoNs | None = None
        self._waiting: deque[tuple[MavSeverity, str]] = deque()
        self._said: dict[str, MonoNs] = {}
        self._id = 0
        self.dropped = 0
        """The number of texts that were never sent."""

    def say(self, severity: MavSeverity, text: str, now: MonoNs) -> None:
        """Queue a text unless it was queued within `_SAME_S`."""
        last = self._said.get(text)
        if last is not None and seconds_between(last, now) < _SAME_S:
            return
        if len(self._said) >= _SENT_MAX:
            self._said.clear()
        self._said = {t: at for t, at in self._said.items() if seconds_between(at, now) < _SAME_S} | {text: now}
        self._waiting.append((severity, text))
        if len(self._waiting) > WAITING:
            least = max(range(len(self._waiting)), key=lambda i: (self._waiting[i][0], i))
            del self._waiting[least]
            self.dropped += 1

    def due(self, now: MonoNs) -> list[Message]:
        """Return the messages that may be sent now, the most severe first."""
        if self._filled is not None:
            self._tokens = min(float(BURST), self._tokens + seconds_between(self._filled, now))
        self._filled = now
        out: list[Message] = []
        while self._waiting and self._tokens >= 1.0:
            first = min(range(len(self._waiting)), key=lambda i: (self._waiting[i][0], i))
            text = self._waiting[first]
            del self._waiting[first]
            self._tokens -= 1.0
            out += self._chunks(*text)
        return out

    def _chunks(self, severity: MavSeverity, text: str) -> list[Message]:
        data = text.encode("ascii", errors="replace")
        if len(data) <= _CHUNK:
            return [mav.MAVLink_statustext_message(int(severity), data)]
        self._id = self._id % 65535 + 1
        pieces = [data[i : i + _CHUNK] for i in range(0, len(data), _CHUNK)]
        if len(pieces[-1]) == _CHUNK:
            pieces.append(b"")  # A full last chunk would leave the receiver waiting for more.
        return [mav.MAVLink_statustext_message(int(severity), piece, self._id, n) for n, piece in enumerate(pieces)]


_SEVERITIES = {
    state.value: severity
    for state, severity in {
        State.LANDED: MavSeverity.NOTICE,
        State.LANDED_BY_OTHERS: MavSeverity.NOTICE,
        State.PAUSED: MavSeverity.NOTICE,
        State.HOLD_BLIND: MavSeverity.WARNING,
        State.GO_AROUND: MavSeverity.WARNING,
        State.ABORTED: MavSeverity.WARNING,
        State.ANOTHER_PAD: MavSeverity.ERROR,
        State.REFUSED: MavSeverity.CRITICAL,
        State.GAVE_UP: MavSeverity.CRITICAL,
        State.TAKEN: MavSeverity.CRITICAL,
        State.EMERGENCY: MavSeverity.CRITICAL,
    }.items()
}
"""The severities of those phases that are more than information."""


PARAMETERS = ("PLND_LAG", "PLND_ENABLED", "PLND_TYPE", "MPC_ACC_HOR", "MPC_JERK_AUTO", *(f"RNGFND{n}_TYPE" for n in range(1, 5)))
"""The parameters that are requested from the autopilot (see `open_autopilot`)."""
_LED = frozenset(state.value for state in LED)


class Component(NullObserver):
    """The component; see the module's docstring.

    Args:
        believe: the steering path's belief at an instant.
        health: the service's health, whose parts it reports.
    """

    def __init__(
        self,
        outputs: Outputs,
        operator: Operator,
        store: Tunables | None,
        *,
        believe: Callable[[MonoNs], RelativeState | None],
        clock: Clock,
        health: Health,
    ) -> None:
        self.outputs = outputs
        self._health = health
        self._reported: dict[str, MonoNs] = {}
        self._believe = believe
        self._clock, self._tick_due = clock, clock.now()
        self._autopilot: Autopilot | None = None
        self._links: Links | None = None
        self._computer = ComputerReader()
        self._phase = ""
        self._charge_said_at: MonoNs | None = None
        self._lost = ReportedOnce()
        self._decided: MonoNs | None = None
        self.belief: RelativeState | None = None
        """The newest belief that the component reports."""
        self._believed_at: MonoNs | None = None
        self._sick = False
        self._values = 0
        self._parameters = None if store is None else ParameterServer(store)
        values_s = _STATE_S / len(_VALUES)  # the values take turns
        self._offered = Offered(
            {
                mav.MAVLINK_MSG_ID_HEARTBEAT: (partial(self._guarded, "heartbeat", self._heartbeat), _HEARTBEAT_S),
                mav.MAVLINK_MSG_ID_ONBOARD_COMPUTER_STATUS: (partial(self._guarded, "computer", self._load), _COMPUTER_S),
                mav.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: (partial(self._guarded, "values", self._value), values_s),
                ComponentInformationBasic.id: (self._information, 0.0),
                ComponentMetadata.id: (partial(metadata_message, _OURS), 0.0),
            }
        )
        self._commands = CommandServer(operator, self._offered)
        self.refusals = Refusals("vehicle.operators")
        self.texts = StatusTexts()
        self.files = FileServer(metadata_files(_OURS))
        self._ticks: dict[str, Callable[[MonoNs], None]] = {
            "health": lambda now: self._check_health(now),
            "the messages sent by themselves": lambda now: self._send(self._offered.due(now)),
            "the progress of commands": lambda now: self._send(self._commands.due(now)),
            "the texts": lambda now: self._send(self.texts.due(now)),
            "the parameters": lambda now: self._send([] if self._parameters is None else self._parameters.due()),
            "the target": lambda now: self._tell_target(now),
            "the files": lambda now: self._send_files(now),
        }

    def attach(self, autopilot: Autopilot) -> None:
        """Send over this autopilot's links from now on."""
        self._autopilot, self._links, self._tick_due = autopilot, autopilot.links, self._clock.now()
        autopilot.add_listener(self.on_message)

    def detach(self) -> None:
        """Stop sending, because the links are about to close."""
        self._autopilot = self._links = None

    # Events from the service

    def on_sample(self, sample: Sample) -> None:
        if isinstance(sample, Attitude):
            self.outputs.track.on_attitude(sample)

    def on_frame(self, processed: ProcessedFrame) -> None:
        """Send a fused sighting at once instead of at the next tick."""
        if processed.verdict is Verdict.FUSED and self._autopilot is not None and self._autopilot.unclear is None:
            now = self._clock.now()
            self._update_belief(now)
            self._send(self.outputs.target(now, AutopilotView.of(self._autopilot), self._sighted))

    def on_decision(self, decision: Decision) -> None:
        self._decided = decision.at
        if self.outputs.lead is not None:
            self.outputs.lead.wanted = decision.phase in _LED
            if decision.phase == State.GATE.value and decision.reason:
                self.texts.say(MavSeverity.NOTICE, f"Decklander: {decision.reason}", decision.at)
        if decision.response is not None and decision.response.contradicts:
            self.texts.say(MavSeverity.WARNING, f"Decklander: {decision.response.text}", decision.at)
        for text in self._lost.new(() if decision.belief is None else decision.belief.lost, decision.at):
            self.texts.say(MavSeverity.WARNING, f"Decklander: {text}", decision.at)
        said_at = self._charge_said_at
        if decision.charge and (said_at is None or seconds_between(said_at, decision.at) >= _CHARGE_S):
            self._charge_said_at = decision.at
            self.texts.say(MavSeverity.WARNING, f"Decklander: {decision.charge}", decision.at)
        if decision.phase != self._phase:
            self._phase = decision.phase
            severity = _SEVERITIES.get(decision.phase, MavSeverity.INFO)
            why = decision.transitions[-1].reason.text if decision.transitions and decision.phase in _SEVERITIES else ""
            self.texts.say(severity, ": ".join(filter(None, ("Decklander", decision.phase, why))), decision.at)

    def on_order(self, handled: HandledOrder) -> None:
        """Say by what a landing or a stay is begun, and why it is not where the sender has no screen."""
        if handled.accepted and handled.order in (OperatorOrder.BEGIN, OperatorOrder.STAY):
            self.texts.say(MavSeverity.INFO, f"Decklander: {handled.order.value} by {handled.sender}", handled.at)
        elif not handled.accepted and handled.sender.source in (OrderSource.SWITCH, OrderSource.HANDOVER):
            self.texts.say(MavSeverity.WARNING, f"Decklander: {handled}", handled.at)

    # Messages from other components

    def on_message(self, received: ReceivedMessage) -> None:
        """Answer a command, parameter or file request of any link to its sender, and broadcast changes to all."""
        if self._links is None or received.message.get_type() not in _REQUESTS:
            return
        now, us = self._clock.now(), self._links.identity
        if received.message.get_type() == FILE_REQUEST:
            self.files.on_message(received, us)
            return
        if self.refusals.refuses(received, us):
            self._answer(received, self.refusals.answer(received))
            if self._parameters is not None:
                self._answer(received, self._parameters.in_force(received.message))
            if (text := self.refusals.text_for(received)) is not None:
                self.texts.say(MavSeverity.WARNING, f"Decklander: {text}", now)
            return
        self._answer(received, self._commands.on_message(received.message, (received.system, received.component), us, now))
        if received.message.get_type() in COMMANDS and self._commands.refusal is not None:
            self.texts.say(MavSeverity.WARNING, f"Decklander: {self._commands.refusal}", now)
            self._commands.refusal = None
        if self._parameters is not None and received.access_level >= AccessLevel.PEER:
            self._send(self._parameters.on_message(received.message, us))
            if self._parameters.refused is not None:
                self.texts.say(MavSeverity.WARNING, f"Decklander: {self._parameters.refused}", now)
                self._parameters.refused = None

    def _answer(self, received: ReceivedMessage, messages: list[Message]) -> None:
        if self._links is not None:
            for message in messages:
                self._links.send(message, received.source)

    # Messages that the component sends

    @property
    def work(self) -> Repeated:
        """Its work while it is attached."""
        return Repeated("mavlink-component", self._tick)

    def _tick(self) -> float:
        """Send what is due; return the time until the next tick, s."""
        self.tick(self._clock.now())
        now = self._clock.now()
        self._tick_due = max(after(self._tick_due, _FINE_TICK_S if self.sends_often else _TICK_S), now)
        return seconds_between(now, self._tick_due)

    def tick(self, now: MonoNs) -> None:
        """Send everything that is due. A bug in one message is contained, and the others are still sent."""
        for name, part in self._ticks.items():
            if self._links is None:
                return
            try:
                part(now)
            except Exception as why:
                self._links.contained.hold(f"telling {name}", "us", why)

    def _guarded(self, name: str, maker: Callable[[MonoNs], Message | None], now: MonoNs) -> Message | None:
        """Return what `maker` makes, or None if it raised, so that it does not cost the messages beside it."""
        return None if self._links is None else self._links.contained.run(f"making the {name}", "us", partial(maker, now))

    def _tell_target(self, now: MonoNs) -> None:
        if self._autopilot is None or not self._autopilot.connected or self._autopilot.unclear is not None:
            return
        ranges = self.sends_ranges
        self._autopilot.take_ranges(not ranges)
        due = self.outputs.is_due(now, ranges)
        if due or self._believed_at is None or seconds_between(self._believed_at, now) >= _BELIEF_S:
            self._update_belief(now)
        if due:
            self._send(self.outputs.due(now, AutopilotView.of(self._autopilot), self._sighted))

    @property
    def sends_often(self) -> bool:
        """True if ticks of `_TICK_S` are too few for the target's rate, or for a rangefinder's 20 Hz."""
        return self.sends_ranges or not (1.0 / (_TICK_S * self.outputs.rate_hz)).is_integer()

    @property
    def sends_ranges(self) -> bool:
        """True if the component serves as the autopilot's rangefinder."""
        return self._autopilot is not None and self.outputs.sends_ranges(AutopilotView.of(self._autopilot))

    @property
    def _sighted(self) -> MonoNs | None:
        """Return the time of the last sighting of the pad, without doubtful ones, which are not sent to an autopilot."""
        return None if self.belief is None or self.belief.alerts else self.belief.sighted

    def _update_belief(self, now: MonoNs) -> None:
        self._believed_at, self.belief = now, self._believe(now)
        self.outputs.track.believe(self.belief)

    def _send(self, messages: list[Message]) -> None:
        if self._links is not None:
            for message in messages:
                self._links.send(message)

    def _send_files(self, now: MonoNs) -> None:
        if self._links is not None:
            for message, source in self.files.due(now):
                self._links.send(message, source)

    def _fault(self, now: MonoNs) -> str | None:
        if self._decided is None or seconds_between(self._decided, now) > _GUIDANCE_SILENCE_S:
            return "guidance stands still"
        return self._health.fault(of_flight=True)

    def _check_health(self, now: MonoNs) -> None:
        why = self._fault(now) if self._decided is not None else None
        if why is not None and not self._sick:
            self.texts.say(MavSeverity.ERROR, f"Decklander: {why}", now)
        self._sick = why is not None
        troubles = {n: f"{n} is down: {p.last_error}" for n, p in self._health.parts.items() if not (p.up or p.vital)}
        if self._health.too_slow is not None:
            troubles["speed"] = self._health.too_slow
        for name, text in troubles.items():
            last = self._reported.get(name)
            if last is None or seconds_between(last, now) >= _REPEAT_S:
                self._reported[name] = now
                self.texts.say(MavSeverity.WARNING, f"Decklander: {text}", now)

    def _heartbeat(self, now: MonoNs) -> Message | None:
        if self._fault(now) is not None:
            return None
        state = mav.MAV_STATE_ACTIVE if self.belief is not None else mav.MAV_STATE_STANDBY
        return mav.MAVLink_heartbeat_message(TYPE_ONBOARD, NO_AUTOPILOT, 0, 0, int(state), 3)

    def _load(self, now: MonoNs) -> Message:
        return computer_status(self._computer.read(), now)

    def _information(self, now: MonoNs) -> Message:
        return ComponentInformationBasic(ms_since_boot(now), CAPABILITIES, 0, "Decklander", "companion", version(), "", "")

    def _value(self, now: MonoNs) -> Message | None:
        for _ in _VALUES:
            name = _VALUES[self._values % len(_VALUES)]
            self._values += 1
            value = self._figure(name, now)
            if value is not None:
                return mav.MAVLink_named_value_float_message(ms_since_boot(now), name.encode(), value)
        return None

    def _figure(self, name: str, now: MonoNs) -> float | None:
        belief = self.belief
        if belief is None:
            return 0.0 if name == "dl_seen" else None
        figures = {
            "dl_seen": float(belief.age_s(now) <= self.outputs.stale_s),
            "dl_age": belief.age_s(now),
            "dl_sigma": math.sqrt(max(float(belief.cov[0, 0] + belief.cov[1, 1]) / 2.0, 0.0)),
            "dl_height": belief.height_m,
            "dl_lateral": belief.lateral_m,
        }
        return figures[name]


_VALUES = ("dl_seen", "dl_age", "dl_sigma", "dl_height", "dl_lateral")
"""NAMED_VALUE_FLOAT, at most ten characters: seen lately (1 or 0), s since then, m of one horizontal sigma, m, m."""


@asynccontextmanager
async def speaking(component: Component, autopilot: Autopilot, clock: Clock) -> AsyncIterator[None]:
    """Run the component on the links of an autopilot."""
    component.attach(autopilot)
    async with running_beside([("mavlink-component", component.work.run(clock))]):
        try:
            yield
        finally:
            component.detach()
