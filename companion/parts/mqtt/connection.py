"""One connection to the broker through aiomqtt, from its opening to a guaranteed end.

This module closes what aiomqtt leaves open. Connecting happens on a thread that cannot be cancelled, so it is bounded and
awaited. A connection that fails half-way leaves a socket and a task, which are ended. Publications that a broker refused (MQTT 5)
are counted, because aiomqtt takes any answer for success.
"""

from __future__ import annotations

import asyncio
import errno
import hashlib
import logging
import math
import socket
import ssl
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import Any

import aiomqtt
from msgspec import Struct
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from companion.parts.mqtt.options import MqttSettings
from companion.settings import files
from companion.settings.capabilities import Reference
from companion.settings.certificates import add_certificate, reason_of
from companion.settings.model import Settings
from drivers.device_errors import device_fault
from drivers.files import Largest, refuse_special
from drivers.wires import AddressInfo, resolve
from estimator.contracts.errors import BadInput, Recoverable

INCOMING = 64
"""The number of incoming messages that may wait before further ones are discarded."""
_LARGEST_BYTES = 65_536  # the largest packet that is taken
_KEEPALIVE_S = 4  # keep-alive interval; a dead connection is noticed within twice that time
_FAREWELL_S = 1.0  # time to end the connection in order
_NO_TLS = ("WRONG_VERSION_NUMBER", "PACKET_LENGTH_TOO_LONG")
"""OpenSSL's reasons where the other end answers in plain TCP."""
_THREAD_S = 0.02  # interval at which the end of a cancelled dialling is looked for
_quiet = logging.getLogger("companion.parts.mqtt.paho")
_quiet.setLevel(logging.CRITICAL)
"""This logger is silenced because aiomqtt warns once for every message that it discards, which in a flood is a second flood."""


_ENDED = {
    0x81: "it cannot read what was sent",
    0x82: "it takes what was sent for an error of protocol",
    0x83: "for a reason of its own",
    0x87: "it does not allow this user (its access list)",
    0x89: "it is busy",
    0x8B: "it shuts down",
    0x8D: "it received nothing for the keep-alive interval",
    0x8E: "session taken over: another program connected with the same client id; give each drone a name of its own (mqtt.drone)",
    0x93: "it had too many unanswered messages",
    0x95: "a packet was too large",
    0x96: "too many messages in a short time",
    0x97: "a quota is used up",
    0x98: "its administrator ended it",
    0x9C: "another server is to be used (mqtt.host)",
    0x9D: "the server has moved (mqtt.host)",
    0x9F: "too many connections in a short time",
    0xA0: "the longest time of a connection is over",
}
"""Meanings of the reason codes with which a broker ends a connection. Source: MQTT 5.0, 3.14.2.1."""


def client_id(drone: str, system: Path = Path("/")) -> str:
    """Return the name of our client: a broker ends the older of two connections that have one name.

    It is unique for each computer and drone. Cards that were copied have one machine id, so serial number and network addresses
    of the hardware count as well.

    Args:
        system: the root of the file system.
    """
    digest = hashlib.sha256(b"decklander-mqtt")
    hardware = [device.parent / "address" for device in sorted(system.glob("sys/class/net/*/device"))]
    for path in (system / "etc/machine-id", system / "proc/device-tree/serial-number", *hardware):
        with suppress(OSError):
            digest.update(path.read_bytes())
    return f"decklander-{drone}-{digest.hexdigest()[:8]}"


class BrokerEndpoint(Struct, frozen=True):
    """The broker's address, and the identity and secrets that we connect with."""

    host: str
    port: int
    user: str | None
    password: str | None
    tls: ssl.SSLContext | None
    mqtt5: bool
    timeout_s: float

    @staticmethod
    def of(settings: MqttSettings) -> BrokerEndpoint:
        """Return the endpoint that the settings describe, and read its secrets.

        Raises:
            BadInput: a secret or certificate cannot be read or used.
        """
        return BrokerEndpoint(
            settings.host,
            settings.port,
            settings.user or None,
            files.text(settings.password_file, "mqtt.password_file"),
            tls_context(settings),
            settings.protocol == "5",
            settings.timeout_s,
        )


def renewed_endpoint(s: MqttSettings) -> files.Renewed[BrokerEndpoint]:
    """Return the endpoint, whose secrets are read again when they changed. Raises BadInput."""
    of_tls = (s.ca_file, s.certificate_file, s.key_file) if s.transport == "tls" else ()
    return files.Renewed(lambda: BrokerEndpoint.of(s), "mqtt", s.password_file, *of_tls)


class Publication(Struct, frozen=True):
    """A message from the broker."""

    topic: str
    payload: bytes
    retained: bool
    reply_to: str | None
    correlation: bytes | None


class Connection(aiomqtt.Client):
    """An open connection. `MqttError` is what its methods raise when the broker fails."""

    def __init__(self, endpoint: BrokerEndpoint, identifier: str, will: aiomqtt.Will | None, incoming: int) -> None:
        properties = None
        if endpoint.mqtt5:
            properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
            properties.MaximumPacketSize = _LARGEST_BYTES
            properties.ReceiveMaximum = INCOMING
        super().__init__(
            endpoint.host,
            endpoint.port,
            username=endpoint.user,
            password=endpoint.password,
            logger=_quiet,
            identifier=identifier,
            protocol=aiomqtt.ProtocolVersion.V5 if endpoint.mqtt5 else aiomqtt.ProtocolVersion.V311,
            will=will,
            clean_session=None if endpoint.mqtt5 else True,
            timeout=endpoint.timeout_s,
            keepalive=_KEEPALIVE_S,
            max_queued_incoming_messages=incoming,
            properties=properties,
            tls_context=endpoint.tls,
            socket_options=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
        )
        self.pending_calls_threshold = 1000
        self._endpoint = endpoint
        self._addresses: list[AddressInfo] = []
        self._dialling: socket.socket | None = None
        self._interrupted = False
        self.dialling = False
        """True while the connecting thread is running."""
        # These bound what paho leaves to the system or to the broker: the duration of connecting, the addresses (paho's own
        # look-up cannot be ended), and the size of a packet that an MQTT 3.1.1 broker sends.
        self._client._create_socket_connection = self._dial  # type: ignore[method-assign]
        if endpoint.tls is not None:  # closes the socket where the handshake fails; paho leaves that to the garbage collector
            secure = partial(endpoint.tls.wrap_socket, server_hostname=endpoint.host)
            self._client._ssl_wrap_socket = secure  # type: ignore[method-assign]
        self._receive = self._client._sock_recv
        self._client._sock_recv = self._receive_bounded  # type: ignore[method-assign]
        self._client.connect_timeout = endpoint.timeout_s
        self._mqtt5 = endpoint.mqtt5
        self.refusals = 0
        """The number of publications that the broker refused."""
        self.last_refusal = ""
        self.farewell = ""
        """Reason for which the broker ended the connection, if it gave one (MQTT 5)."""
        self.accepted: set[str] = set()
        """Topics at which the broker acknowledged a publication."""
        self._first, self._asked = asyncio.Lock(), ""
        self.ended_at = ""
        """The topic at which the broker ended the connection without a reason."""

    async def subscribe_to(self, topic: str, qos: int, *, retained: bool = False) -> None:
        """Subscribe to a topic; unless `retained`, ask an MQTT 5 broker to leave out retained messages.

        Raises:
            Recoverable: the broker refuses.
        """
        options = SubscribeOptions(qos=qos, retainHandling=SubscribeOptions.RETAIN_DO_NOT_SEND)
        qos_fields = {"options": options} if self._mqtt5 and not retained else {"qos": qos}
        async with self._answered():
            granted = await self.subscribe(topic, timeout=math.inf, **qos_fields)
        for code in granted:
            if code.value >= 0x80 if isinstance(code, ReasonCode) else code >= 0x80:
                raise Recoverable(f"the broker refuses the subscription to {topic}")

    async def publications(self) -> AsyncIterator[Publication]:
        """Yield messages as they arrive. Cancel this only when the connection is to end: the next message would be lost."""
        async for message in self.messages:
            reply_to = getattr(message.properties, "ResponseTopic", None)
            correlation = getattr(message.properties, "CorrelationData", None)
            payload = message.payload if isinstance(message.payload, bytes) else b""
            yield Publication(str(message.topic), payload, message.retain, reply_to, correlation)

    async def publish_message(
        self, topic: str, payload: bytes, *, qos: int = 0, retain: bool = False, correlation: bytes | None = None
    ) -> None:
        """Publish a message; return when it is written out (QoS 0) or answered (QoS 1).

        The first message of each topic is sent alone and is answered, so that a broker that hangs up at it shows at which.
        """
        properties = None
        if self._mqtt5 and correlation is not None:
            properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
            properties.CorrelationData = correlation
        async with self._first if topic not in self.accepted else nullcontext():
            if topic not in self.accepted:
                self._asked, qos = topic, 1
            async with self._answered():
                await self.publish(topic, payload, qos=qos, retain=retain, properties=properties, timeout=math.inf)
            if qos > 0:
                self.accepted.add(topic)

    @asynccontextmanager
    async def _answered(self) -> AsyncIterator[None]:
        """Limit the time of an answer in place of aiomqtt.

        Until Python 3.12 its `asyncio.wait_for` swallows a cancellation that arrives together with the answer, and the cancelled
        task would run for ever.
        """
        try:
            async with asyncio.timeout(self.timeout):
                yield
        except TimeoutError as why:
            raise aiomqtt.MqttError(f"no answer within {self.timeout:g} s") from why

    def dial_to(self, addresses: list[AddressInfo]) -> None:
        """Connect to the first of these that answers."""
        self._addresses = addresses

    def interrupt(self) -> None:
        """End an attempt to connect: the thread that waits for the broker gets an error at once."""
        self._interrupted = True
        if (dialling := self._dialling) is not None:
            with suppress(OSError):
                dialling.shutdown(socket.SHUT_RDWR)

    def _dial(self) -> socket.socket:
        """Return a connected socket. This runs on the connecting thread.

        Raises:
            OSError: no address answers in time, or `interrupt` was called.
        """
        give_up_s = time.monotonic() + self._endpoint.timeout_s
        failure = OSError("no address")
        for family, kind, protocol, _, address in self._addresses:
            made = socket.socket(family, kind, protocol)
            # TLS takes the socket over; this duplicate refers to the same connection, so that it can be interrupted.
            self._forget_dialling()
            self._dialling = made.dup()
            made.settimeout(max(0.05, give_up_s - time.monotonic()))
            try:
                if self._interrupted:
                    raise OSError("interrupted")
                made.connect(address)
            except OSError as why:
                made.close()
                failure = why
            else:
                return made
        raise failure

    def _client_connect(self) -> None:
        self.dialling = True
        try:
            super()._client_connect()
        finally:
            self.dialling = False

    def _forget_dialling(self) -> None:
        if self._dialling is not None:
            self._dialling.close()
            self._dialling = None

    def _receive_bounded(self, bufsize: int) -> bytes:
        if bufsize > _LARGEST_BYTES:
            raise OSError(f"a packet of {bufsize} bytes, at most {_LARGEST_BYTES} are taken")
        return self._receive(bufsize)

    def abandon(self) -> None:
        """Close whatever is still open, without a disconnect message."""
        self._forget_dialling()
        self._client._sock_close()
        if self._disconnected.done() and not self._disconnected.cancelled():
            self._disconnected.exception()

    def _on_socket_register_write(self, client: Any, userdata: Any, sock: Any) -> None:
        """Watch the socket for room to write, unless it is closed by the time the loop gets to it.

        The library hands the loop its number, which is then free, or that of another socket.
        """

        def write() -> None:
            try:
                client.loop_write()
            except Exception as why:
                if not self._disconnected.done():
                    self._disconnected.set_exception(why)

        def watch() -> None:
            if sock.fileno() >= 0:
                self._loop.add_writer(sock.fileno(), write)

        self._loop.call_soon_threadsafe(watch)

    def _on_publish(self, client: Any, userdata: Any, mid: int, reason_code: ReasonCode, properties: Properties) -> None:
        if reason_code.is_failure:
            self.refusals += 1
            self.last_refusal = str(reason_code)
        super()._on_publish(client, userdata, mid, reason_code, properties)

    def _on_disconnect(
        self, client: Any, userdata: Any, flags: Any, reason_code: ReasonCode, properties: Properties | None = None
    ) -> None:
        if flags.is_disconnect_packet_from_server and not self.farewell:
            self.farewell = f"the broker ended the connection: {_ENDED.get(reason_code.value, str(reason_code))}"
        super()._on_disconnect(client, userdata, flags, reason_code, properties)

    @contextmanager
    def explained(self) -> Iterator[None]:
        """Raise the broker's own reason in place of the errors that follow from the end of the connection.

        Brokers of MQTT 3.1.1 have none to give: some hang up at a topic that this user may not write.

        Raises:
            Recoverable: the broker ended the connection, with its reason or just after a publication.
        """
        try:
            yield
        except* aiomqtt.MqttError as group:
            if self.farewell:
                raise Recoverable(self.farewell) from group
            if self._asked not in self.accepted and self._disconnected.done():
                self.ended_at = topic = self._asked
                raise Recoverable(f"the connection ended just after publishing {topic}: may this user write there?") from group
            raise


@asynccontextmanager
async def connect(
    endpoint: BrokerEndpoint, identifier: str, will: aiomqtt.Will | None = None, incoming: int = INCOMING
) -> AsyncIterator[Connection]:
    """Open a connection, and keep it while the context is open.

    Raises:
        Recoverable: the broker cannot be reached, or refuses us.
    """
    try:
        addresses = await resolve(endpoint.host, endpoint.port, endpoint.timeout_s)
    except Recoverable as why:
        raise Recoverable(f"broker {why}") from why
    connection = Connection(endpoint, identifier, will, incoming)
    connection.dial_to(addresses)
    try:
        failure = await _entered(connection)
        if failure is not None:
            raise Recoverable(f"broker {endpoint.host}:{endpoint.port}: {_fault(failure)}") from failure
        try:
            yield connection
        finally:
            with suppress(aiomqtt.MqttError, OSError, TimeoutError):
                async with asyncio.timeout(_FAREWELL_S):
                    await connection.__aexit__(None, None, None)
    finally:
        connection.abandon()


def _fault(failure: Exception) -> str:
    """Return in one line why a broker was not reached; an end that speaks TLS to one that does not is as one that hangs up."""
    crossed = isinstance(failure, ssl.SSLEOFError) or (isinstance(failure, ssl.SSLError) and failure.reason in _NO_TLS)
    if crossed:
        return device_fault(ConnectionResetError(errno.ECONNRESET, ""), "broker")
    if isinstance(failure, OSError) and not isinstance(failure, ssl.SSLError):
        return device_fault(failure, "broker")
    return str(failure) or type(failure).__name__


async def _entered(connection: Connection) -> Exception | None:
    """Connect, and return why that failed. When cancelled, end the connecting thread first: nothing else closes its socket."""
    async with asyncio.TaskGroup() as group:
        entering = group.create_task(_enter(connection))
        try:
            return await asyncio.shield(entering)
        except asyncio.CancelledError:
            connection.interrupt()
            # End the thread first, so that it opens no further socket, then the task that waits for the broker's answer.
            while connection.dialling and not entering.done():
                await asyncio.wait({entering}, timeout=_THREAD_S)
            entering.cancel()
            await asyncio.wait({entering})
            raise


async def _enter(connection: Connection) -> Exception | None:
    connection.dialling = True  # This is set before the thread can set it itself.
    try:
        await connection.__aenter__()
    except (aiomqtt.MqttError, OSError, ValueError) as why:
        cause = why.__context__  # the library keeps the words of a system's error alone
        return cause if isinstance(cause, OSError) else why
    return None


def references(settings: Settings) -> Iterator[Reference]:
    """Yield the secrets and certificates that the settings name."""
    m = settings.of(MqttSettings)
    yield "mqtt.password_file", (m.password_file,), lambda: files.text(m.password_file, "mqtt.password_file")
    yield "mqtt.command_key_file", (m.command_key_file,), lambda: files.key(m.command_key_file, "mqtt.command_key_file")
    yield "mqtt.ca_file", (m.ca_file, m.certificate_file, m.key_file), lambda: tls_context(m)


def tls_context(settings: MqttSettings) -> ssl.SSLContext | None:
    """Return a context for TLS 1.2 or newer that checks the broker's name against its certificate, or None for plain TCP.

    Raises:
        BadInput: a file of certificates or keys that cannot be read or used.
    """
    if settings.transport != "tls":
        return None
    ca = files.find(settings.ca_file, "mqtt")
    if ca is not None:
        refuse_special(ca, Largest.CERTIFICATE, f"mqtt.ca_file: {ca}")
    try:
        context = ssl.create_default_context(cafile=None if ca is None else str(ca))
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        if ca is not None:  # one's own may lack extensions that Python demands from 3.13 on
            context.verify_flags &= ~ssl.VERIFY_X509_STRICT
    except (OSError, ValueError) as why:
        raise BadInput(f"mqtt.ca_file: {ca}: {reason_of(why)}") from why
    add_certificate(context, settings, "mqtt")
    return context
