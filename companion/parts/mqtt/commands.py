"""Decode commands and the ship's reports from the broker, check their signatures, and carry each command out once. No I/O.

A command names the run of the service that it is meant for and its expiry, both in the terms of the drone's own messages:
no wall clock has to be right for a late command to be refused, and one from before a restart is never carried out. If a key is
set, the command must be signed as well; an unsigned one leaves no trace but a count and an answer. A ship's report carries the
run of the service and its own instant on the drone's clock, and is checked likewise.

What is signed is the signature, a space, and the JSON. The signature is HMAC-SHA-256 over the topic, a line feed and the very
bytes of the JSON, written as 64 hexadecimal digits. The topic names the drone; the JSON names the run of the service, the
command's own id and its expiry, so that a copy is worth nothing for another drone, after a restart, a second time, or later.
"""

import hashlib
import hmac
import logging
import math
import re
from collections import Counter, OrderedDict
from dataclasses import dataclass, field
from typing import Protocol

import msgspec
import numpy as np

from companion.parts.mqtt.messages import (
    AbortCommand,
    ClearCommand,
    Command,
    CommandReply,
    PauseCommand,
    Refusal,
    SetPathCommand,
    SetRecordingCommand,
    ShipReport,
    StartCommand,
)
from companion.parts.mqtt.topics import Topics
from drivers.nmea.sentences import COV_SPEED, HEADING_SIGMA_RAD
from estimator.contracts.estimates import PathName
from estimator.contracts.geodesy import GeoPoint
from estimator.contracts.samples import GeoFix, VesselReport
from estimator.contracts.time import MonoNs, Stamp, after, seconds_between

_SIGNED = re.compile(rb"([0-9a-f]{64}) (.+)", re.DOTALL)


class Unsigned(ValueError):
    """The payload carries no signature at all."""


class Forged(ValueError):
    """The signature does not match this topic, command and key."""


def signed(key: bytes, topic: str, command: bytes) -> bytes:
    """Return the payload to publish on `topic` for a command in JSON."""
    return _digits(key, topic, command) + b" " + command


def verified(key: bytes, topic: str, payload: bytes) -> bytes:
    """Return the command in JSON.

    Raises:
        Unsigned: the payload does not begin with a signature.
        Forged: the signature is wrong.
    """
    match = _SIGNED.fullmatch(payload)
    if match is None:
        raise Unsigned
    if not hmac.compare_digest(match[1], _digits(key, topic, match[2])):
        raise Forged
    return match[2]


def _digits(key: bytes, topic: str, command: bytes) -> bytes:
    return hmac.new(key, topic.encode() + b"\n" + command, hashlib.sha256).hexdigest().encode()


LONGEST_BYTES = 4096
FARTHEST_S = 60.0
"""The longest time that a command may stay valid, s."""
REMEMBERED = 4096
"""The number of answers kept for repeated commands: more than can arrive while one of them is still valid."""

_decoder = msgspec.json.Decoder(Command)


class Operated(Protocol):
    """The pilot's operations for an operator; each returns None if it was carried out, else the reason why it cannot be."""

    def start(self) -> str | None: ...

    def pause(self) -> str | None: ...

    def abort(self) -> str | None: ...

    def clear(self) -> str | None: ...

    def steer_by(self, path: PathName) -> str | None: ...

    def record(self, on: bool) -> str | None: ...


@dataclass(frozen=True, slots=True)
class HandledCommand:
    """The outcome of one message on the command topic."""

    reply: CommandReply
    topic: str
    """The topic that the answer is published on."""
    command: str | None
    """The name of the command; None if it could not be read."""
    repeated: bool = False


@dataclass(slots=True)
class CommandHandler:
    """Checks, carries out and answers commands.

    Args:
        session: the id of this run of the service that everyone may read.
        run: the id of this run that only those who may command can read.
        key: the key that commands are signed with; None if the broker decides who may send them.
    """

    topics: Topics
    session: str
    operated: Operated
    run: str
    key: bytes | None = field(default=None, repr=False)
    _answered: OrderedDict[str, HandledCommand] = field(default_factory=OrderedDict)
    counts: Counter[str] = field(default_factory=Counter)

    def take(self, payload: bytes, now: MonoNs, *, retained: bool = False, reply_to: str | None = None) -> HandledCommand:
        """Check one message, and carry it out if every check passes.

        Args:
            retained: whether the broker had retained the message; its sender may be long gone.
            reply_to: the response topic of MQTT 5, used if the command itself names none.
        """
        handled = self._handle(payload, now, retained, reply_to)
        self.counts["repeated" if handled.repeated else handled.reply.reason or "accepted"] += 1
        return handled

    def _handle(self, payload: bytes, now: MonoNs, retained: bool, reply_to: str | None) -> HandledCommand:
        def refuse(
            reason: Refusal, words: str, of: str | None = None, name: str | None = None, to: str | None = None
        ) -> HandledCommand:
            answer = CommandReply(session=self.session, at_ns=now, id=of, accepted=False, reason=reason, text=words)
            return HandledCommand(answer, to or self.topics.reply, name)

        if len(payload) > LONGEST_BYTES:
            return refuse("too_long", f"{len(payload)} bytes, at most {LONGEST_BYTES} are read")
        if self.key is not None:
            try:
                payload = verified(self.key, self.topics.command, payload)
            except Unsigned:
                return refuse("unsigned", "commands are signed here: the signature, a space, the command")
            except Forged:
                return refuse("bad_signature", "the signature is not that of this topic, command and key")
        try:
            command = _decoder.decode(payload)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as why:
            return refuse("malformed", str(why)[:200], _id_in(payload))
        name = command.__struct_config__.tag
        assert isinstance(name, str)
        wished = command.reply_to or reply_to
        if wished is not None and not self.topics.allows_reply(wished):
            return refuse("reply_elsewhere", f"answers go to {self.topics.reply} or one name below it", command.id, name)
        to = wished or self.topics.reply
        if (known := self._answered.get(command.id)) is not None:
            return HandledCommand(known.reply, to, name, repeated=True)
        if retained:
            handled = refuse("retained", "a retained command is never carried out", command.id, name, to)
        elif not hmac.compare_digest(command.run.encode(errors="replace"), self.run.encode()):
            handled = refuse("other_run", "meant for another run of the service", command.id, name, to)
        elif command.expires_ns < now:
            late_s = seconds_between(MonoNs(command.expires_ns), now)
            handled = refuse("expired", f"came {late_s:.3g} s after it had expired", command.id, name, to)
        elif command.expires_ns > after(now, FARTHEST_S):
            handled = refuse("expiry_too_far", f"it may expire {FARTHEST_S:.0f} s from now at most", command.id, name, to)
        elif (cannot := self._carry_out(command)) is not None:
            handled = refuse("not_possible", cannot, command.id, name, to)
        else:
            done = CommandReply(session=self.session, at_ns=now, id=command.id, accepted=True, reason=None, text=f"{name} done")
            handled = HandledCommand(done, to, name)
        self._answered[command.id] = handled
        if len(self._answered) > REMEMBERED:
            self._answered.popitem(last=False)
        return handled

    def _carry_out(self, command: Command) -> str | None:
        match command:
            case StartCommand():
                return self.operated.start()
            case PauseCommand():
                return self.operated.pause()
            case AbortCommand():
                return self.operated.abort()
            case ClearCommand():
                return self.operated.clear()
            case SetPathCommand():
                return self.operated.steer_by(command.path)
            case SetRecordingCommand():
                return self.operated.record(command.on)


def _id_in(payload: bytes) -> str | None:
    """Return the id of a command that is otherwise malformed, so that its sender can recognize the command."""
    try:
        data = msgspec.json.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    found = data.get("id") if isinstance(data, dict) else None
    return found if isinstance(found, str) and len(found) <= 64 else None


log = logging.getLogger(__name__)

REPORT_MAX_BYTES = 1024
_STAMP_SIGMA_S = 0.2
"""Standard deviation of the report's instant: its sender knows the drone's clock by messages that took their time to it."""

_report_decoder = msgspec.json.Decoder(ShipReport)

Samples = list[GeoFix | VesselReport]


@dataclass(slots=True)
class ShipReportReader:
    """Reads the reports of one ship.

    Args:
        run: the id of this run of the service that only those who may command can read.
        key: the key that reports are signed with; None if the broker decides who may send them.
    """

    topics: Topics
    run: str
    key: bytes | None = field(default=None, repr=False)
    counts: Counter[str] = field(default_factory=Counter)
    """The number of reports by `taken`, or by the reason why they were refused."""
    _newest_ns: int = -1

    def samples(self, payload: bytes, received_at: MonoNs, *, retained: bool = False) -> Samples:
        """Return the samples in one message; none if it is refused, which is counted and logged once for each reason."""
        try:
            out = self._samples(payload, received_at, retained)
        except _Refused as why:
            reason = str(why)
            if reason not in self.counts:
                log.warning("a report of the ship was refused (%s); the next ones are counted only", reason.replace("_", " "))
            self.counts[reason] += 1
            return []
        self.counts["taken"] += 1
        return out

    def _samples(self, payload: bytes, received_at: MonoNs, retained: bool) -> Samples:
        if len(payload) > REPORT_MAX_BYTES:
            raise _Refused("too_long")
        if self.key is not None:
            try:
                payload = verified(self.key, self.topics.vessel, payload)
            except Unsigned:
                raise _Refused("unsigned") from None
            except Forged:
                raise _Refused("bad_signature") from None
        try:
            report = _report_decoder.decode(payload)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            raise _Refused("malformed") from None
        if retained:
            raise _Refused("retained")
        if not hmac.compare_digest(report.run.encode(errors="replace"), self.run.encode()):
            raise _Refused("other_run")
        if report.at_ns > received_at:
            raise _Refused("ahead")
        if report.at_ns <= self._newest_ns:
            raise _Refused("not_newer")
        self._newest_ns = report.at_ns
        return _samples(report, Stamp(MonoNs(report.at_ns), received_at, _STAMP_SIGMA_S, "synced"))


class _Refused(Exception):
    """A report is not taken; the text is the name of the counter."""


def _samples(report: ShipReport, stamp: Stamp) -> Samples:
    v = None
    if report.speed_m_s is not None and report.course_deg is not None:
        course = math.radians(report.course_deg)
        v = np.array([report.speed_m_s * math.cos(course), report.speed_m_s * math.sin(course), 0.0])
    place = GeoPoint.of_degrees(report.latitude_deg, report.longitude_deg, report.height_m)
    out: Samples = [GeoFix(stamp, "vessel", place, report.sigma_m, v)]
    if v is None and report.heading_deg is None:
        return out
    cov = None if v is None else COV_SPEED
    heading = None if report.heading_deg is None else math.radians(report.heading_deg)
    return [*out, VesselReport(stamp, v, cov, heading, None if heading is None else HEADING_SIGMA_RAD)]
