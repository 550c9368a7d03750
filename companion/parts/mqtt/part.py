"""MQTT as a part of the service: an observer that never waits, and a supervised task that talks to the broker.

If a broker is gone, slow, refusing or flooding, the part disconnects and retries with a back-off that doubles; the flight
continues. State, sighting and health are published as the newest of their kind at their own rates; events wait on disk.
"""

import asyncio
import hashlib
import hmac
import logging
import math
import os
import re
import secrets
import time
import uuid
from collections import Counter, OrderedDict
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NoReturn, TypeVar, cast, get_args

import aiomqtt
import msgspec
import numpy as np

from companion.base.containment import RestartablePart
from companion.base.health import Health
from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.base.orders import HandledOrder, OperatorOrder, OrderSender, OrderSource
from companion.base.version import version
from companion.cycle.ports import Assembly
from companion.facts.wire import RequestRate, read
from companion.guidance.operator.order_time import given_at
from companion.guidance.pilot import Pilot
from companion.guidance.pilot_operator import Operated, PilotOperator
from companion.parts.mqtt import encode as encoding
from companion.parts.mqtt.connection import BrokerEndpoint, Connection, Publication, client_id, connect, renewed_endpoint
from companion.parts.mqtt.encode import Changes, PendingEvent, order_event
from companion.parts.mqtt.messages import (
    AbortCommand,
    Command,
    CommandReply,
    EventData,
    HoldCommand,
    Message,
    OperatorNotice,
    Refusal,
    SetRecordingCommand,
    ShipReport,
    StatusMessage,
    TakingCommand,
    Topics,
    encode,
)
from companion.parts.mqtt.options import MqttSettings
from companion.parts.mqtt.outbox import Outbox
from companion.parts.mqtt.spool import Spool
from companion.settings import files
from drivers.mailbox import Line
from drivers.reconnect import BackOff, reconnect
from drivers.ship_reports import COV_SPEED, HEADING_SIGMA_RAD
from estimator.contracts.errors import Recoverable, in_words
from estimator.contracts.geometry import GeoPoint
from estimator.contracts.samples import GeoFix, Sample, VehicleStatus, VesselReport
from estimator.contracts.time import Clock, MonoNs, Stamp, after, seconds_between

LONGEST_BYTES = 4096
"""The longest command."""
REPORT_MAX_BYTES = 1024
"""The longest report of a vessel."""
FARTHEST_S = 60.0
"""The longest time that a command may stay valid, s."""
REMEMBERED = 4096
"""The number of answers kept for repeated commands: more than can arrive while one of them is still valid."""
_STAMP_SIGMA_S = 0.2
"""Standard deviation of the report's instant: its sender knows the drone's clock by messages that took their time to it."""
_SIGNED = re.compile(rb"([0-9a-f]{64}) (.+)", re.DOTALL)

T = TypeVar("T")
Samples = list[GeoFix | VesselReport]
_GOODBYE_S = 0.4
"""The time for the farewell, s: the service has 2 s to end in, and its parts have 1 s of that."""
_WATCH_PARTS_S = 0.5  # interval at which the states of parts are compared
_HEALTHY_S = 10.0  # time for which a connection lasts that ends the back-off
_CLOCK_SET_S = 1.0
"""Change of the wall clock that is published at once; NTP slews less."""
_WATCH_CLOCK_S = 2.0  # interval at which the wall clock is compared
_STATUS_AGAIN_S = 60.0  # time after which the status is published again
_LEAVE_OUT = 3
"""Connections that ended at the first message of a topic, after which it is left out; events stay in the spool."""
_NAMESAKE_AGAIN_S = 600.0  # time between two log lines about another client with the same id


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
        known = f": known are {', '.join(one.__struct_config__.tag for one in get_args(Command))}" * ("$.command" in found)
        raise RefusedMessage("malformed", found + known)
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
        key: returns the key that commands are signed with; None if the broker decides who may send them.
    """

    topics: Topics
    session: str
    operated: Operated
    run: str
    key: Callable[[], bytes | None] = lambda: None
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
            body = _opened(payload, self.topics.of("command"), self.key(), LONGEST_BYTES)
            identifier, named = _named_in(body)
            wished = named or reply_to
            if wished is not None and not self.topics.allows_reply(wished):
                raise RefusedMessage("reply_elsewhere", f"answers go to {to} or one name below it")
            to = wished or to
            command = _decoded(body, self._decoder)
            name = str(command.__struct_config__.tag)
            stops = isinstance(command, HoldCommand | AbortCommand)
            if (known := self._answered.get(command.id)) is not None and not stops:
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
            case SetRecordingCommand():
                cannot = self.operated.record(command.on)
            case TakingCommand():
                age_s = seconds_between(MonoNs(command.given_ns), now)
                cannot = self.operated.order(_order_of(command), given_at(now, age_s))
            case _:
                cannot = self.operated.order(_order_of(command))
        if cannot is not None:
            raise RefusedMessage("not_possible", cannot)


def _order_of(command: Command) -> OperatorOrder:
    return OperatorOrder(command.__struct_config__.tag)


def _named_in(payload: bytes) -> tuple[str | None, str | None]:
    """Return id and reply topic of a command, which may be malformed otherwise, so that its sender reads the answer."""
    try:
        data = msgspec.json.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None, None
    found, to = (data.get("id"), data.get("reply_to")) if isinstance(data, dict) else (None, None)
    return found if isinstance(found, str) and len(found) <= 64 else None, to if isinstance(to, str) and to else None


@dataclass(slots=True)
class ShipReportReader:
    """Reads the reports of one ship.

    Args:
        run: the id of this run of the service that only those who may command can read.
        key: returns the key that reports are signed with; None if the broker decides who may send them.
    """

    topics: Topics
    run: str
    key: Callable[[], bytes | None] = lambda: None
    counts: Counter[str] = field(default_factory=Counter)
    """The number of reports by `taken`, or by the reason why they were refused."""
    _newest_ns: int = -1
    _decoder: msgspec.json.Decoder[ShipReport] = field(default_factory=lambda: msgspec.json.Decoder(ShipReport), repr=False)

    def samples(self, payload: bytes, received_at: MonoNs, *, retained: bool = False) -> Samples:
        """Return the samples in one message; none if it is refused, which is counted and logged once for each reason."""
        try:
            report = _decoded(_opened(payload, self.topics.of("vessel"), self.key(), REPORT_MAX_BYTES), self._decoder)
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


log = logging.getLogger(__name__)

BROKER = "broker"
"""The connection's own name in health: the part is up while it tries to connect."""


class MqttPart(NullObserver):
    """The observer and the supervised task.

    Args:
        version: the software's version, for the status.
        ship: the reader of the ship's reports, and where its samples are put; None where none are taken.
    """

    def __init__(
        self,
        settings: MqttSettings,
        endpoint: Callable[[], BrokerEndpoint],
        outbox: Outbox,
        command_handler: CommandHandler,
        health: Health,
        clock: Clock,
        *,
        version: str,
        ship: tuple[ShipReportReader, Line[Sample]] | None = None,
    ) -> None:
        self._settings = settings
        self._endpoint = endpoint
        self._outbox = outbox
        self._command_handler = command_handler
        self._topics: Topics = command_handler.topics
        self._health = health
        self._clock = clock
        self._session = command_handler.session
        self._version = version
        self._ship = ship
        self._started = clock.now()
        self._client_id = client_id(self._topics.drone)
        self._namesake_at: MonoNs | None = None
        """Time of the last message of another service that publishes under our drone's name."""
        self._changes = Changes()
        self._decision: Decision | None = None
        self._seen: ProcessedFrame | None = None
        self._vehicle: VehicleStatus | None = None
        self._results_reported = 0
        self._counts: Counter[str] = Counter()
        self._broker_down = False
        self._ended_at: Counter[str] = Counter()
        self._stopping = False
        health.counters("mqtt", self.counts)
        self.tell(PendingEvent(self._started, "service", "service started", {"version": version, "unix_s": time.time()}))

    def on_sample(self, sample: Sample) -> None:
        if isinstance(sample, VehicleStatus):
            self._vehicle = sample
            self.tell(*self._changes.vehicle(sample))

    def on_frame(self, processed: ProcessedFrame) -> None:
        self._seen = processed
        self.tell(*self._changes.frame(processed))

    def on_decision(self, decision: Decision) -> None:
        self._decision = decision
        self.tell(*self._changes.decision(decision))

    def on_order(self, handled: HandledOrder) -> None:
        """Queue an event for each order that did not come over MQTT; those that did have an event with their id."""
        if handled.sender.source is not OrderSource.MQTT:
            self.tell(order_event(handled))

    def tell(self, *events: PendingEvent) -> None:
        """Queue events in order. This never waits and never fails."""
        for event in events:
            self._outbox.put(event)

    def counts(self) -> Mapping[str, float]:
        """Return the counters for health."""
        commands = {f"commands_{name}": n for name, n in self._command_handler.counts.items()}
        reports = {} if self._ship is None else {f"ship_reports_{name}": n for name, n in self._ship[0].counts.items()}
        return {**self._counts, **commands, **reports, **self._outbox.counts()}

    async def run(self) -> None:
        """Serve the broker until cancelled; then send what is left to the broker if it is there, else to disk."""
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._outbox.keep())
                group.create_task(self._watch_parts())
                group.create_task(self._stay_connected())
        finally:
            await self._outbox.close()

    async def _watch_parts(self) -> NoReturn:
        while True:
            self.tell(*self._changes.health(self._health.snapshot()))
            await self._clock.sleep(_WATCH_PARTS_S)

    async def _stay_connected(self) -> None:
        s = self._settings
        back_off = BackOff(s.reconnect_first_s, s.reconnect_cap_s, _HEALTHY_S, jitter=0.5)
        name = f"MQTT broker {s.host}:{s.port}"
        try:
            await reconnect(name, self._connection, back_off, self._clock, self._failed, (Recoverable, aiomqtt.MqttError))
        finally:
            self._log_stopped()

    def _failed(self, why: BaseException) -> None:
        """Count a failure, and report it to health once: a broker may be absent for hours."""
        self._counts["connection_failures"] += 1
        if not self._broker_down:
            self._health.down(BROKER, why)
        self._broker_down = True

    async def _connection(self) -> None:
        will = aiomqtt.Will(self._topics.of("status"), encode(self._status("lost")), qos=1, retain=True)
        async with connect(self._endpoint(), self._client_id, will) as connection:
            try:
                with connection.explained():
                    await self._converse(connection)
            except asyncio.CancelledError:
                await self._publish_stopped(connection)
                raise
            finally:
                self._note_end(connection)

    def _note_end(self, connection: Connection) -> None:
        """Count the connections that ended at each topic before it was ever taken; leave it out after some."""
        for taken in connection.accepted:
            del self._ended_at[taken]
        if topic := connection.ended_at:
            self._ended_at[topic] += 1
            if self._ended_at[topic] == _LEAVE_OUT:
                log.warning(
                    "%s is left out until the service starts again: the broker ended %d connections at it", topic, _LEAVE_OUT
                )

    async def _converse(self, connection: Connection) -> None:
        if self._settings.commands != "off":
            await connection.subscribe_to(self._topics.of("command"), qos=1)
            notice = OperatorNotice(
                session=self._session, at_ns=self._clock.now(), run=self._command_handler.run, commands=self._settings.commands
            )
            await connection.publish_message(self._topics.of("operator"), encode(notice), qos=1, retain=True)
            if self._ship is not None:
                await connection.subscribe_to(self._topics.of("vessel"), qos=1)
        with suppress(Recoverable):  # who may not read it learns of no namesake
            await connection.subscribe_to(self._topics.of("status"), qos=0)
        await self._publish_status(connection)
        self._counts["connections"] += 1
        self._broker_down = False
        self._health.up(BROKER)
        s = self._settings
        log.info("connected to broker %s:%d", s.host, s.port)
        newest: tuple[tuple[str, float, Callable[[], Message | None]], ...] = (
            ("state", s.state_hz, self._newest_state),
            ("sighting", s.sighting_hz, self._newest_sighting),
            ("fusion", s.sighting_hz, self._newest_fusion),
            ("health", s.health_hz, lambda: encoding.health(self._session, self._health.snapshot())),
        )
        async with asyncio.TaskGroup() as group:
            if self._ended_at[self._topics.of("event")] < _LEAVE_OUT:
                group.create_task(self._outbox.deliver(connection))
            group.create_task(self._take_publications(connection))
            group.create_task(self._renew_status(connection))
            for leaf, rate_hz, make in newest:
                if rate_hz > 0 and self._ended_at[self._topics.of(leaf)] < _LEAVE_OUT:
                    group.create_task(self._publish_periodically(connection, leaf, rate_hz, make))

    async def _publish_status(self, connection: Connection) -> None:
        await connection.publish_message(self._topics.of("status"), encode(self._status("up")), qos=1, retain=True)

    async def _renew_status(self, connection: Connection) -> NoReturn:
        """Publish the status again when the wall clock was set, and now and then for a broker that lost what it retained."""
        while True:
            began_unix_s, published = self._began_unix_s(), self._clock.now()
            while (
                abs(self._began_unix_s() - began_unix_s) < _CLOCK_SET_S
                and seconds_between(published, self._clock.now()) < _STATUS_AGAIN_S
            ):
                await self._clock.sleep(_WATCH_CLOCK_S)
            await self._publish_status(connection)

    def _began_unix_s(self) -> float:
        """Return the wall time of the start by the wall clock of now: a computer without a clock of its own is set late."""
        return time.time() - seconds_between(self._started, self._clock.now())

    def _hear_status(self, publication: Publication, now: MonoNs) -> None:
        """Report another service that publishes under our drone's name: its messages and ours would be mixed up."""
        try:
            status = msgspec.json.decode(publication.payload, type=StatusMessage)
        except (msgspec.DecodeError, UnicodeDecodeError):
            return
        if publication.retained or status.session == self._session or not status.online:
            return
        self._counts["namesakes"] += 1
        if self._namesake_at is None or seconds_between(self._namesake_at, now) > _NAMESAKE_AGAIN_S:
            self._namesake_at = now
            log.warning(
                "another service publishes as drone %r over the same broker: give each drone a name of its own (mqtt.drone)",
                self._topics.drone,
            )

    async def _publish_periodically(
        self, connection: Connection, leaf: str, rate_hz: float, newest: Callable[[], Message | None]
    ) -> NoReturn:
        topic, due = self._topics.of(leaf), self._clock.now()
        while True:
            message = newest()
            if message is not None:
                await connection.publish_message(topic, encode(message))
                self._counts[f"{leaf}_sent"] += 1
            now = self._clock.now()
            due = max(after(due, 1.0 / rate_hz), now)
            await self._clock.sleep(seconds_between(now, due))

    def _newest_state(self) -> Message | None:
        decision, self._decision = self._decision, None
        return None if decision is None else encoding.state(self._session, decision, self._vehicle)

    def _newest_sighting(self) -> Message | None:
        processed, self._seen = self._seen, None
        return None if processed is None else encoding.sighting(self._session, processed)

    def _newest_fusion(self) -> Message | None:
        """Return the newest result of each source, or None if none came since the last call."""
        states = self._health.fusion_states()
        counted = sum(sum(state.verdicts.values()) for state in states)
        before, self._results_reported = self._results_reported, counted
        return None if counted == before else encoding.fusion(self._session, self._health.now(), states)

    async def _take_publications(self, connection: Connection) -> None:
        most = self._settings.commands_max_hz
        rates = {False: RequestRate(most), True: RequestRate(most)}
        async for publication in connection.publications():
            now, of_ship = self._clock.now(), publication.topic == self._topics.of("vessel")
            if publication.topic == self._topics.of("status"):
                self._hear_status(publication, now)
                continue
            if rates[of_ship].exceeded(now):
                self._counts["floods"] += 1
                raise Recoverable(f"flooded: more than {most} {'reports of the ship' if of_ship else 'commands'} a second")
            if not of_ship and self._settings.commands != "off":
                await self._take(connection, publication, now)
            elif of_ship and self._ship is not None:
                reader, line = self._ship
                for sample in reader.samples(publication.payload, now, retained=publication.retained):
                    line.offer(sample)

    async def _take(self, connection: Connection, publication: Publication, now: MonoNs) -> None:
        handled = self._command_handler.take(
            publication.payload, now, retained=publication.retained, reply_to=publication.reply_to
        )
        reply = handled.reply
        if handled.command is not None and not handled.repeated:
            words = f"command {handled.command} " + ("accepted" if reply.accepted else f"refused: {reply.text}")
            data: EventData = {"command": handled.command, "id": reply.id, "accepted": reply.accepted, "reason": reply.reason}
            log.info("%s", words)
            self._outbox.put(PendingEvent(now, "command", words, data))
        await connection.publish_message(handled.topic, encode(reply), qos=1, correlation=publication.correlation)

    async def _publish_stopped(self, connection: Connection) -> None:
        """Publish the last events and the final status, if the broker takes them in time."""
        self._log_stopped()
        try:
            async with asyncio.timeout(_GOODBYE_S):
                await self._outbox.flush()
                while await self._outbox.deliver_batch(connection):
                    pass
                await connection.publish_message(self._topics.of("status"), encode(self._status("stopped")), qos=1, retain=True)
        except* (TimeoutError, aiomqtt.MqttError) as group:
            log.info("the broker did not acknowledge the disconnect: %s", in_words(group))

    def _log_stopped(self) -> None:
        if not self._stopping:
            self._stopping = True
            self._outbox.put(PendingEvent(self._clock.now(), "service", "service stopped"))

    def _status(self, reason: Literal["up", "stopped", "lost"]) -> StatusMessage:
        return StatusMessage(
            session=self._session,
            at_ns=self._clock.now(),
            online=reason == "up",
            reason=reason,
            version=self._version,
            started_unix_s=self._began_unix_s(),
            started_ns=self._started,
        )


def make_mqtt(
    settings: MqttSettings,
    pilot: Pilot,
    health: Health,
    clock: Clock,
    recording: Callable[[bool], str | None] | None = None,
    reports: Line[Sample] | None = None,
) -> MqttPart:
    """Read the secrets, open the spool and return the part.

    Args:
        recording: switches the recorder and returns why it cannot; None if there is no recorder.
        reports: where the ship's reports from the broker are put; None where none are taken.

    Raises:
        BadInput: a secret, a certificate or the spool cannot be read or used.
    """
    session, topics = uuid.uuid4().hex[:12], Topics(settings.drone)
    endpoint = renewed_endpoint(settings)
    spool = Spool(spool_folder(settings), settings.spool_max_kib * 1024)
    outbox = Outbox(spool, session, topics.of("event"), settings.spool_fsync)
    operator = PilotOperator(pilot, OrderSender(OrderSource.MQTT), clock, recording)
    named, what = settings.command_key_file, "mqtt.command_key_file"
    key = files.Renewed(lambda: files.key(named, what), what, named)
    run = secrets.token_hex(16)
    command_handler = CommandHandler(topics, session, operator, run, key)
    ship = None if reports is None else (ShipReportReader(topics, run, key), reports)
    return MqttPart(settings, endpoint, outbox, command_handler, health, clock, version=version(), ship=ship)


def spool_folder(settings: MqttSettings, environment: Mapping[str, str] = os.environ) -> Path | None:
    """Return the folder that events are spooled in, or None if they stay in memory."""
    if settings.spool:
        return Path(settings.spool)
    state = environment.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(state) / "mqtt" if state else None


def join(service: Assembly) -> None:
    """Add telemetry and commands through the broker."""
    settings, pilot, health = service.settings, service.pilot, service.health
    ship = service.ship_reports() if settings.vessel.mqtt else None
    mqtt = RestartablePart(
        "mqtt", lambda: make_mqtt(settings.of(MqttSettings), pilot, health, service.clock, service.recording, ship)
    )
    service.observers.append(mqtt)
    service.extras["mqtt"] = mqtt.run
