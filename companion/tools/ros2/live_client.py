"""A client of the service's live data (`[http] foxglove`): the messages of a flight while it is flown, and again after a loss.

Protocol: github.com/foxglove/ws-protocol, docs/spec.md, version 1.
"""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Annotated

import aiohttp
import msgspec
from msgspec import Meta, Struct

from companion.recording.foxglove_protocol import MESSAGE, MESSAGE_DATA, SUBPROTOCOLS
from estimator.contracts.errors import BadInput

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
