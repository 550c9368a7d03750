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
from typing import Literal, TypeVar, cast

import msgspec
import numpy as np

from companion.facts.wire import read
from companion.guidance.pilot_operator import Operated
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
    Topics,
)
from drivers.nmea.sentences import COV_SPEED, HEADING_SIGMA_RAD
from estimator.contracts.geodesy import GeoPoint
from estimator.contracts.samples import GeoFix, VesselReport
from estimator.contracts.time import MonoNs, Stamp, after, seconds_between

log = logging.getLogger(__name__)

LONGEST_BYTES = 4096
REPORT_MAX_BYTES = 1024
FARTHEST_S = 60.0
"""The longest time that a command may stay valid, s."""
REMEMBERED = 4096
"""The number of answers kept for repeated commands: more than can arrive while one of them is still valid."""
_STAMP_SIGMA_S = 0.2
"""Standard deviation of the report's instant: its sender knows the drone's clock by messages that took their time to it."""
_SIGNED = re.compile(rb"([0-9a-f]{64}) (.+)", re.DOTALL)

T = TypeVar("T")
Samples = list[GeoFix | VesselReport]


class RefusedMessage(ValueError):
    """A message is not obeyed.

    Args:
        reason: the reason in one word, by which refusals are counted.
        text: the reason for the sender.
    """

    def __init__(self, reason: Refusal | Literal["ahead", "not_newer"], text: str = "") -> None:
        super().__init__(text)
        self.reason = reason
        self.text = text


def signed(key: bytes, topic: str, command: bytes) -> bytes:
    """Return the payload to publish on `topic` for a command in JSON."""
    return _digits(key, topic, command) + b" " + command


def verified(key: bytes, topic: str, payload: bytes) -> bytes:
    """Return the command in JSON.

    Raises:
        RefusedMessage: the payload does not begin with a signature, or with one that is wrong.
    """
    match = _SIGNED.fullmatch(payload)
    if match is None:
        raise RefusedMessage("unsigned", "commands are signed here: the signature, a space, the command")
    if not hmac.compare_digest(match[1], _digits(key, topic, match[2])):
        raise RefusedMessage("bad_signature", "the signature is not that of this topic, command and key")
    return match[2]


def _digits(key: bytes, topic: str, command: bytes) -> bytes:
    return hmac.new(key, topic.encode() + b"\n" + command, hashlib.sha256).hexdigest().encode()


def _opened(payload: bytes, topic: str, key: bytes | None, longest_bytes: int) -> bytes:
    if len(payload) > longest_bytes:
        raise RefusedMessage("too_long", f"{len(payload)} bytes, at most {longest_bytes} are read")
    return payload if key is None else verified(key, topic, payload)


def _decoded(payload: bytes, decoder: msgspec.json.Decoder[T]) -> T:
    found = read(decoder, payload)
    if isinstance(found, str):
        raise RefusedMessage("malformed", found)
    return found


def _check_run(named: str, run: str, retained: bool) -> None:
    if retained:
        raise RefusedMessage("retained", "a retained command is never carried out")
    if not hmac.compare_digest(named.encode(errors="replace"), run.encode()):
        raise RefusedMessage("other_run", "meant for another run of the service")


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
    _answered: OrderedDict[str, CommandReply] = field(default_factory=OrderedDict)
    counts: Counter[str] = field(default_factory=Counter)
    _decoder: msgspec.json.Decoder[Command] = field(default_factory=lambda: msgspec.json.Decoder(Command), repr=False)

    def take(self, payload: bytes, now: MonoNs, *, retained: bool = False, reply_to: str | None = None) -> HandledCommand:
        """Check one message, and carry it out if every check passes.

        Args:
            retained: whether the broker had retained the message; its sender may be long gone.
            reply_to: the response topic of MQTT 5, used if the command itself names none.
        """
        to, identifier, name, remembered = self.topics.of("reply"), None, None, False
        refused: RefusedMessage | None = None
        try:
            body = _opened(payload, self.topics.of("command"), self.key, LONGEST_BYTES)
            identifier = _id_in(body)
            command = _decoded(body, self._decoder)
            name = str(command.__struct_config__.tag)
            wished = command.reply_to or reply_to
            if wished is not None and not self.topics.allows_reply(wished):
                raise RefusedMessage("reply_elsewhere", f"answers go to {to} or one name below it")
            to = wished or to
            if (known := self._answered.get(command.id)) is not None:
                self.counts["repeated"] += 1
                return HandledCommand(known, to, name, repeated=True)
            remembered = True
            _check_run(command.run, self.run, retained)
            self._carry_out(command, now)
        except RefusedMessage as why:
            refused = why
        reason = None if refused is None else cast(Refusal, refused.reason)
        text = f"{name} done" if refused is None else refused.text
        reply = CommandReply(session=self.session, at_ns=now, id=identifier, accepted=refused is None, reason=reason, text=text)
        if remembered and identifier is not None:
            self._answered[identifier] = reply
            if len(self._answered) > REMEMBERED:
                self._answered.popitem(last=False)
        self.counts[reason or "accepted"] += 1
        return HandledCommand(reply, to, name)

    def _carry_out(self, command: Command, now: MonoNs) -> None:
        if command.expires_ns < now:
            late_s = seconds_between(MonoNs(command.expires_ns), now)
            raise RefusedMessage("expired", f"came {late_s:.3g} s after it had expired")
        if command.expires_ns > after(now, FARTHEST_S):
            raise RefusedMessage("expiry_too_far", f"it may expire {FARTHEST_S:.0f} s from now at most")
        match command:
            case StartCommand():
                cannot = self.operated.start()
            case PauseCommand():
                cannot = self.operated.pause()
            case AbortCommand():
                cannot = self.operated.abort()
            case ClearCommand():
                cannot = self.operated.clear()
            case SetPathCommand():
                cannot = self.operated.steer_by(command.path)
            case SetRecordingCommand():
                cannot = self.operated.record(command.on)
        if cannot is not None:
            raise RefusedMessage("not_possible", cannot)


def _id_in(payload: bytes) -> str | None:
    """Return the id of a command, which may be malformed otherwise, so that its sender can recognize the command."""
    try:
        data = msgspec.json.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    found = data.get("id") if isinstance(data, dict) else None
    return found if isinstance(found, str) and len(found) <= 64 else None


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
    _decoder: msgspec.json.Decoder[ShipReport] = field(default_factory=lambda: msgspec.json.Decoder(ShipReport), repr=False)

    def samples(self, payload: bytes, received_at: MonoNs, *, retained: bool = False) -> Samples:
        """Return the samples in one message; none if it is refused, which is counted and logged once for each reason."""
        try:
            report = _decoded(_opened(payload, self.topics.of("vessel"), self.key, REPORT_MAX_BYTES), self._decoder)
            _check_run(report.run, self.run, retained)
            if report.at_ns > received_at:
                raise RefusedMessage("ahead")
            if report.at_ns <= self._newest_ns:
                raise RefusedMessage("not_newer")
        except RefusedMessage as why:
            if why.reason not in self.counts:
                words = why.reason.replace("_", " ")
                log.warning("a report of the ship was refused (%s); the next ones are counted only", words)
            self.counts[why.reason] += 1
            return []
        self._newest_ns = report.at_ns
        self.counts["taken"] += 1
        return _samples(report, Stamp(MonoNs(report.at_ns), received_at, _STAMP_SIGMA_S, "synced"))


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
