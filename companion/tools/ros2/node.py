"""A flight in ROS 2 while it is flown: the data of the service's live port, as the messages of a recording's bag.

The node sends messages as the bytes that they are (CDR), so only their types come from the installed ROS.

Protocol of the live port: github.com/foxglove/ws-protocol, docs/spec.md, version 1.
"""

import asyncio
import importlib
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from typing import Annotated, Any

import aiohttp
import msgspec
from msgspec import Meta, Struct

from companion.facts import records as rec
from companion.recording import channels
from companion.recording.foxglove_protocol import MESSAGE, MESSAGE_DATA, SUBPROTOCOLS
from companion.recording.reading import FOR_VIEWERS, NOT_UNDERSTOOD, EventAssembly, instant
from companion.tools.ros2.messages import RosMessages, typestore
from estimator.contracts.errors import BadInput
from estimator.vision.camera import Camera

_AGAIN_S = 1.0
_ALIVE_S = 4.0
_BYTES_MAX = 1 << 24
_CHANNELS_MAX = 1000


class _Channel(Struct, frozen=True):
    id: int
    topic: Annotated[str, Meta(max_length=200)]
    encoding: str


class _Advertise(Struct, frozen=True, tag_field="op", tag="advertise"):
    channels: Annotated[list[_Channel], Meta(max_length=_CHANNELS_MAX)]


class _ServerInfo(Struct, frozen=True, tag_field="op", tag="serverInfo"):
    name: str


LiveMessage = tuple[str, int, bytes]
"""Topic, time on the viewers' axis in ns, and the message as JSON."""
_texts: msgspec.json.Decoder[_Advertise | _ServerInfo] = msgspec.json.Decoder(_Advertise | _ServerInfo)
_subscribe = msgspec.json.Encoder()


class LiveClient:
    """See the module's docstring.

    Args:
        url: the address, ws://HOST:PORT/live.
        token: its token; None for none.
        wanted: says of a topic whether its messages are wanted.
        note: receives what a person should know: a connection, its loss and why.
    """

    def __init__(self, url: str, token: str | None, wanted: Callable[[str], bool], note: Callable[[str], None]) -> None:
        self._url = url
        self._headers = {} if token is None else {"Authorization": f"Bearer {token}"}
        self._wanted = wanted
        self._note = note
        self._told = ""
        self.connections = 0
        """Number of connections to the service."""

    async def messages(self) -> AsyncIterator[LiveMessage]:
        """Yield the messages of one connection after the other, without end; `connections` counts up before each one's first.

        Raises:
            BadInput: the address is none, or the token is refused.
        """
        while True:
            try:
                async with (
                    aiohttp.ClientSession() as session,
                    session.ws_connect(
                        self._url, protocols=SUBPROTOCOLS, headers=self._headers, heartbeat=_ALIVE_S, max_msg_size=_BYTES_MAX
                    ) as socket,
                ):
                    async for message in self._from(socket):
                        yield message
                self._say(f"{self._url}: the service has closed the connection; trying again")
            except aiohttp.InvalidURL as why:
                raise BadInput(f"{self._url}: is no address such as ws://127.0.0.1:8480/live") from why
            except aiohttp.WSServerHandshakeError as why:
                if why.status == 401:
                    raise BadInput(f"{self._url}: the token is missing or wrong (--token-file)") from why
                self._say(f"{self._url}: refused with status {why.status}: is foxglove = true in [http]? Trying again")
            except (aiohttp.ClientError, OSError, TimeoutError) as why:
                self._say(f"{self._url}: {why or type(why).__name__}; trying again")
            await asyncio.sleep(_AGAIN_S)

    async def _from(self, socket: aiohttp.ClientWebSocketResponse[bool]) -> AsyncIterator[LiveMessage]:
        self.connections += 1
        topics: dict[int, str] = {}
        async for message in socket:
            if message.type is aiohttp.WSMsgType.TEXT:
                asked = list(self._asked(message.data, topics))
                if asked:
                    await socket.send_str(_subscribe.encode({"op": "subscribe", "subscriptions": asked}).decode())
            elif message.type is aiohttp.WSMsgType.BINARY and len(message.data) > MESSAGE.size:
                kind, number, at_ns = MESSAGE.unpack_from(message.data)
                if kind == MESSAGE_DATA and number in topics:
                    yield topics[number], at_ns, message.data[MESSAGE.size :]

    def _asked(self, text: str, topics: dict[int, str]) -> Iterator[dict[str, int]]:
        """Yield the subscriptions that a text of the server leads to; a subscription has the number of its channel."""
        try:
            known = _texts.decode(text)
        except (msgspec.MsgspecError, UnicodeEncodeError, RecursionError):
            return
        if isinstance(known, _ServerInfo):
            self._say(f"{self._url}: connected to {known.name[:80]!r}")
            return
        for channel in known.channels:
            if channel.encoding == "json" and self._wanted(channel.topic):
                topics[channel.id] = channel.topic
                yield {"id": channel.id, "channelId": channel.id}

    def _say(self, what: str) -> None:
        if what != self._told:
            self._told = what
            self._note(what)


KEPT = ("/tf_static",)
"""Topics whose newest message a late subscriber gets, too (transient local)."""
_DEPTH = 10


class RosNode:
    """A node with a publisher for each topic, made with its first message.

    Raises:
        BadInput: there is no ROS 2 for this Python.
    """

    def __init__(self, name: str) -> None:
        try:
            self._rclpy: Any = importlib.import_module("rclpy")
            self._qos: Any = importlib.import_module("rclpy.qos")
            self._utilities: Any = importlib.import_module("rosidl_runtime_py.utilities")
            signals: Any = importlib.import_module("rclpy.signals")
        except ImportError as why:
            raise BadInput(
                f"there is no ROS 2 for this Python: {why}; source /opt/ros/DISTRO/setup.bash, install decklander for its Python"
            ) from why
        # Our own handlers end the bridge; rclpy's would take their place.
        self._rclpy.init(args=[], signal_handler_options=signals.SignalHandlerOptions.NO)
        self._node: Any = self._rclpy.create_node(name)
        self._publishers: dict[str, Any] = {}
        self._unknown: dict[str, str] = {}

    @property
    def unknown(self) -> Mapping[str, str]:
        """Topics that are not published, because this ROS has no such message; and its name."""
        return self._unknown

    def publish(self, topic: str, kind: str, message: bytes) -> None:
        """Publish a message, given as CDR with its header; it is left out if this ROS does not know its type."""
        if topic in self._unknown:
            return
        if topic not in self._publishers:
            try:
                known = self._utilities.get_message(kind)
            except (ImportError, AttributeError, LookupError, ValueError):
                self._unknown[topic] = kind
                return
            self._publishers[topic] = self._node.create_publisher(known, topic, self._quality(topic))
        self._publishers[topic].publish(message)

    def close(self) -> None:
        """End the node."""
        self._node.destroy_node()
        self._rclpy.try_shutdown()

    def _quality(self, topic: str) -> Any:
        if topic not in KEPT:
            return self._qos.QoSProfile(depth=_DEPTH)
        return self._qos.QoSProfile(depth=1, durability=self._qos.DurabilityPolicy.TRANSIENT_LOCAL)


_NO_MESSAGES = (rec.FusionRecord, rec.LinkRecord, rec.OrderRecord)
"""Records for which ROS has no standard message."""


def wanted(topic: str) -> bool:
    """Return whether a topic of the live port leads to messages of ROS."""
    return topic in channels.TOPICS and topic not in FOR_VIEWERS and not issubclass(channels.TOPICS[topic], _NO_MESSAGES)


class RosBridge:
    """Publishes what a client receives.

    Args:
        camera: the vehicle's camera; None leaves out its place on the vehicle and `/camera/camera_info`.
        note: receives what a person should know.
        gimballed: whether a gimbal turns the camera.
    """

    def __init__(
        self, client: LiveClient, node: RosNode, camera: Camera | None, note: Callable[[str], None], *, gimballed: bool = False
    ) -> None:
        self._client = client
        self._node = node
        self._camera, self._gimballed = camera, gimballed
        self._note = note
        self._store: Any = typestore()
        self.published: Counter[str] = Counter()
        """Messages by topic."""
        self.skipped: Counter[str] = Counter()
        """Messages of the live port that this version does not understand, by topic."""

    async def run(self) -> None:
        """Publish until cancelled.

        Raises:
            BadInput: the address or the token is wrong.
        """
        connection, messages, assembled = 0, None, EventAssembly()
        async for topic, at_ns, data in self._client.messages():
            if self._client.connections != connection:
                connection, messages, assembled = self._client.connections, None, EventAssembly()
            try:
                event = assembled.event(topic, data)
                if event is None:
                    continue
                if messages is None:
                    # The viewers' time axis is Unix time, and the events have the service's own clock.
                    messages = RosMessages(self._store.types, at_ns - instant(event), self._camera, gimballed=self._gimballed)
                    self._publish(messages.fixed(instant(event)))
                for message in messages.of(event):
                    self._publish(message)
            except NOT_UNDERSTOOD:
                self.skipped[topic] += 1
                if self.skipped[topic] == 1:
                    self._note(f"{topic}: a message is not understood: is the service of another version? More are counted")

    def _publish(self, message: tuple[str, str, int, Any]) -> None:
        topic, kind, _, value = message
        known = len(self._node.unknown)
        self._node.publish(topic, kind, bytes(self._store.serialize_cdr(value, kind)))
        if len(self._node.unknown) > known:
            self._note(f"{topic}: this ROS has no {kind}; the topic is left out")
        if topic not in self._node.unknown:
            self.published[topic] += 1
