"""One viewer that is connected: what it asked for, and what is sent to it without ever waiting for it."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Protocol

from aiohttp import WSCloseCode, WSMsgType, web

from companion.recording import foxglove_protocol as protocol
from companion.recording.foxglove_protocol import CHANNELS, Subscribe, Unsubscribe
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, seconds_between

_WAITING_BYTES = 4 << 20
"""What may wait for a slow viewer, bytes; the oldest is dropped."""
_REQUESTS_EACH_S = 100
_REFUSALS_MAX = 20
"""Requests that are refused before the connection is closed."""


class LiveServer(Protocol):
    """What a viewer needs of the endpoint."""

    clock: Clock
    topics: tuple[str, ...]

    def count(self, what: str) -> None: ...

    def changed(self, *, new: bool) -> None:
        """Take note that a viewer's subscriptions changed."""
        ...


class LiveViewer:
    """See the module's docstring."""

    def __init__(self, served: LiveServer, socket: web.WebSocketResponse) -> None:
        self._served = served
        self._socket = socket
        self._subscriptions: dict[int, str] = {}
        """The topics asked for, by the viewer's own numbers."""
        self._waiting: deque[str | bytes] = deque()
        self._waiting_bytes = 0
        self._ready = asyncio.Event()
        self._recent: deque[MonoNs] = deque(maxlen=_REQUESTS_EACH_S)
        self._refusals = 0

    @property
    def wanted(self) -> frozenset[str]:
        """The topics that it asked for."""
        return frozenset(self._subscriptions.values())

    def tell(self, text: str) -> None:
        """Send a text."""
        self._offer(text)

    def show(self, topic: str, at_ns: int, payload: bytes) -> None:
        """Send a message of a topic, if it was asked for."""
        for number, wanted in self._subscriptions.items():
            if wanted == topic:
                self._offer(protocol.message_data(number, at_ns, payload))

    async def serve(self) -> None:
        """Serve this viewer until it goes away."""
        try:
            async with asyncio.TaskGroup() as group:
                sending = group.create_task(self._send())
                await self._read()
                sending.cancel()
        except* ConnectionError:
            pass

    async def close(self) -> None:
        """Close the connection, as the service ends."""
        if not self._socket.closed:
            await self._socket.close(code=WSCloseCode.GOING_AWAY)

    def _offer(self, data: str | bytes) -> None:
        self._waiting.append(data)
        self._waiting_bytes += len(data)
        while self._waiting_bytes > _WAITING_BYTES:
            self._waiting_bytes -= len(self._waiting.popleft())
            self._served.count("slow_dropped")
        self._ready.set()

    async def _send(self) -> None:
        while True:
            await self._ready.wait()
            while self._waiting:
                data = self._waiting.popleft()
                self._waiting_bytes -= len(data)
                await (self._socket.send_str(data) if isinstance(data, str) else self._socket.send_bytes(data))
            self._ready.clear()

    async def _read(self) -> None:
        async for message in self._socket:
            now = self._served.clock.now()
            flood = len(self._recent) == self._recent.maxlen and seconds_between(self._recent[0], now) < 1.0
            self._recent.append(now)
            refused = self._take(message.data) if message.type is WSMsgType.TEXT else "publishing is not offered"
            if flood:
                refused = f"more than {_REQUESTS_EACH_S} requests in a second"
            if refused is None:
                continue
            self._served.count("refused")
            self._refusals += 1
            self.tell(protocol.status(protocol.ERROR, refused))
            if flood or self._refusals >= _REFUSALS_MAX:
                await self._socket.close(code=WSCloseCode.POLICY_VIOLATION, message=refused.encode()[:120])
                return

    def _take(self, text: str) -> str | None:
        """Carry a request out; return why it, or a part of it, is refused."""
        before = self.wanted
        match request := protocol.request_in(text):
            case Subscribe():
                refusals = [why for s in request.subscriptions if (why := self._subscribe(s.id, s.channelId)) is not None]
            case Unsubscribe():
                unknown = [number for number in request.subscriptionIds if self._subscriptions.pop(number, None) is None]
                refusals = [f"there is no subscription {unknown[0]}"] if unknown else []
            case _:
                return request
        if self.wanted != before:
            self._served.changed(new=bool(self.wanted - before))
        return refusals[0] if refusals else None

    def _subscribe(self, number: int, channel: int) -> str | None:
        topic = CHANNELS.get(channel)
        if topic not in self._served.topics:
            return f"there is no channel {channel}"
        if number in self._subscriptions:
            return f"there is a subscription {number} already"
        if topic in self._subscriptions.values():
            return f"{topic} is subscribed already"
        self._subscriptions[number] = topic
        return None
