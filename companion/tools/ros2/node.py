"""A flight in ROS 2 while it is flown: the service's live data as the messages of a recording's bag, and orders the other way.

Protocol of the live port: github.com/foxglove/ws-protocol, docs/spec.md, version 1.
"""

import asyncio
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Annotated, Any

import aiohttp
import msgspec
from msgspec import Meta, Struct

from companion.base.orders import OperatorOrder
from companion.facts import records as rec
from companion.facts.wire import RequestRate
from companion.guidance.operator.order_time import BEGINS
from companion.recording import channels
from companion.recording.foxglove_protocol import MESSAGE, MESSAGE_DATA, SUBPROTOCOLS
from companion.recording.reading import NOT_UNDERSTOOD, EventAssembly, instant
from companion.tools.ros2.messages import KEPT, Message, RosMessages
from drivers.ros2 import Request, RosNode, typestore
from estimator.contracts.errors import BadInput
from estimator.contracts.time import Clock

_AGAIN_S = 1.0  # time to the next attempt to connect
_ALIVE_S = 4.0  # interval of pings to the service; half of it without an answer ends the connection
_BYTES_MAX = 1 << 24  # longest message of the service
_CHANNELS_MAX = 1000  # channels that it may offer
_LATE_S = 5.0
"""Age from which a begin or a stay is refused: it may have waited in a network that was away."""
_EACH_SECOND_MOST = 10  # requests that are passed on in a second


class _Channel(Struct, frozen=True):
    id: int
    topic: Annotated[str, Meta(max_length=200)]
    encoding: str


class _Advertise(Struct, frozen=True, tag_field="op", tag="advertise"):
    channels: Annotated[list[_Channel], Meta(max_length=_CHANNELS_MAX)]


class _ServerInfo(Struct, frozen=True, tag_field="op", tag="serverInfo"):
    name: str


_texts: msgspec.json.Decoder[_Advertise | _ServerInfo] = msgspec.json.Decoder(_Advertise | _ServerInfo)
_subscribe = msgspec.json.Encoder()
_NO_MESSAGES = (rec.FusionRecord, rec.LinkRecord, rec.OrderRecord)
"""Records for which ROS has no standard message."""
_WANTED = {t for t, of in channels.TOPICS.items() if t not in channels.FOR_VIEWERS and not issubclass(of, _NO_MESSAGES)}


class LiveClient:
    """See the module's docstring.

    Args:
        url: the address, ws://HOST:PORT/live.
        token: returns its token of now; None for none.
        note: receives what a person should know: a connection, its loss and why.
    """

    def __init__(self, url: str, token: Callable[[], bytes | None], note: Callable[[str], None]) -> None:
        self._url, self._token = url, token
        self._note = note
        self._told = ""
        self.connections = 0
        """Number of connections to the service."""

    async def messages(self) -> AsyncIterator[tuple[str, int, bytes]]:
        """Yield topic, time on the viewers' axis in ns and JSON of one connection after the other, without end.

        `connections` counts up before each one's first message.

        Raises:
            BadInput: the address is none, or the token is refused.
        """
        while True:
            headers = {} if (token := self._token()) is None else {"Authorization": f"Bearer {token.decode()}"}
            try:
                async with (
                    aiohttp.ClientSession() as session,
                    session.ws_connect(
                        self._url, protocols=SUBPROTOCOLS, headers=headers, heartbeat=_ALIVE_S, max_msg_size=_BYTES_MAX
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

    async def _from(self, socket: aiohttp.ClientWebSocketResponse[bool]) -> AsyncIterator[tuple[str, int, bytes]]:
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
            if channel.encoding == "json" and channel.topic in _WANTED:
                topics[channel.id] = channel.topic
                yield {"id": channel.id, "channelId": channel.id}

    def _say(self, what: str) -> None:
        if what != self._told:
            self._told = what
            self._note(what)


_COMMON = ("/tf", "/tf_static", "/diagnostics", "/rosout")
"""Topics that all nodes share, outside the namespace."""


class RosBridge:
    """Publishes what a client receives.

    Args:
        namespace: the begin of the topics' names.
        messages: what makes the messages, but for the store and the offset of the time axis.
        note: receives what a person should know.
    """

    def __init__(
        self, client: LiveClient, node: RosNode, namespace: str, messages: Callable[..., RosMessages], note: Callable[[str], None]
    ) -> None:
        self._client = client
        self._node, self._namespace = node, namespace
        self._messages, self._note = messages, note
        self._writers: dict[str, Callable[[bytes], None] | None] = {}
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
                    messages = self._messages(self._store, at_ns - instant(event))
                for message in messages.of(event):
                    self._publish(message)
            except NOT_UNDERSTOOD:
                self.skipped[topic] += 1
                if self.skipped[topic] == 1:
                    self._note(f"{topic}: a message is not understood: is the service of another version? More are counted")

    def _publish(self, message: Message) -> None:
        topic, kind, _, value = message
        if topic not in self._writers:
            name = topic if topic in _COMMON else f"/{self._namespace}{topic}"
            self._writers[topic] = self._node.writer(name, kind, topic in KEPT)
            if self._writers[topic] is None:
                self._note(f"{name}: this ROS has no {kind}; the topic is left out")
        if (write := self._writers[topic]) is not None:
            write(bytes(self._store.serialize_cdr(value, kind)))
            self.published[topic] += 1


ORDERS = {order.value: order for order in (OperatorOrder.BEGIN, OperatorOrder.HOLD, OperatorOrder.STAY, OperatorOrder.ABORT)}
"""Orders by the name of their topic (std_msgs/Empty) and service (std_srvs/Trigger)."""


class RosOrders:
    """Takes the orders that come by ROS: each has a topic, and a service that answers.

    Args:
        namespace: the begin of their names.
    """

    def __init__(self, node: RosNode, namespace: str, clock: Clock) -> None:
        self._clock = clock
        self.refused: Counter[str] = Counter()
        """Orders that were not passed on: `late` and `flood`."""
        self._ends = [
            (name, RequestRate(_EACH_SECOND_MOST), node.reader(path, "std_msgs/msg/Empty", reliable=True), node.server(path))
            for name, path in ((name, f"/{namespace}/{name}") for name in ORDERS)
        ]

    def come(self) -> Iterator[tuple[str, Request, float]]:
        """Yield the orders that came by their names, each with its age by its sender, s, without those that are refused here."""
        for name, rate, messages, requests in self._ends:
            for request in (*(Request(at, lambda accepted, text: None) for _, at in messages()), *requests()):
                late_s = 1e-9 * (time.time_ns() - request.sent_at_ns)
                if rate.exceeded(self._clock.now()):
                    self.refused["flood"] += 1
                    request.answer(False, f"refused: more than {_EACH_SECOND_MOST} of them in a second")
                elif ORDERS[name] in BEGINS and not abs(late_s) <= _LATE_S:
                    self.refused["late"] += 1
                    request.answer(False, f"refused: sent {late_s:.1f} s ago by its sender's clock, at most {_LATE_S:g} s")
                else:
                    yield name, request, late_s
