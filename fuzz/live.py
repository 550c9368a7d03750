"""Fuzz the port of Foxglove's live data, and the requests of a viewer that is let in while a recorded flight goes by."""

import asyncio
import json
import struct
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from typing import Any, cast

from aiohttp import WSMessage, WSMsgType, web

from companion.base.health import Health
from companion.base.observer import Decision, Observer, ProcessedFrame
from companion.base.orders import HandledOrder
from companion.guidance.make_pilot import make_pilot
from companion.guidance.pilot import Pilot
from companion.parts.live import part
from companion.parts.live.part import Encoded, FoxgloveEndpoint, LiveFeed, topics
from companion.recording.foxglove_protocol import CHANNELS, SUBPROTOCOLS
from companion.recording.reading import RecordedFrame, open_recording
from companion.settings.live import FoxgloveSettings
from companion.settings.load import load
from companion.settings.model import Settings
from companion.tools.replay.engine import Replay
from drivers.clock import SystemClock
from estimator.contracts.fusion import FusionResult
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs
from fuzz.connections import ANSWER_S, HOST, converse, ended, upgrade, watched, websocket_frame
from fuzz.recordings import GOLDEN
from fuzz.target import Choices, Target, block

Event = Callable[[Observer], None]
_FRAMES = 6
_TEXT, _DATA, _EVENT = range(3)
_MESSAGE = struct.Struct("<BIQ")
_OPEN = FoxgloveSettings(endpoint="websocket", port=0)


@cache
def _settings() -> Settings:
    return load("sim")


def run_port(data: bytes) -> None:
    """Send bytes in pieces to the port: answered or closed, and the endpoint goes on without an error."""
    asyncio.run(watched(_on_port(Choices(data).blocks())))


async def _on_port(pieces: list[bytes]) -> None:
    clock = SystemClock()
    endpoint = FoxgloveEndpoint(_OPEN, make_pilot(_settings()), Health(clock), clock, "a vehicle", 0)
    serving = asyncio.ensure_future(endpoint.run())
    while endpoint.port is None and not serving.done():  # noqa: ASYNC110
        await asyncio.sleep(0)
    with suppress(OSError):
        await converse(await asyncio.open_connection("127.0.0.1", endpoint.port), pieces)
    assert not serving.done(), "the endpoint has ended"
    await ended(serving)
    assert endpoint.counted()["viewers"] == 0


class _Server:
    """The endpoint as a viewer and the feed know it, with this one viewer."""

    def __init__(self, pilot: Pilot, messages: list[tuple[int, bytes]]) -> None:
        self.clock: Clock = SystemClock()
        self.topics = topics(_OPEN)
        self.feed = LiveFeed(_OPEN, pilot.camera, pilot.pad, 0, Health(self.clock), self._show)
        self.socket = _Socket(messages, self.feed)
        self.viewer = part.LiveViewer(self, cast(web.WebSocketResponse, self.socket))

    def count(self, what: str) -> None:
        assert what

    def changed(self, *, new: bool) -> None:
        assert self.viewer.wanted <= set(self.topics), "a topic that is not offered"
        self.feed.want(self.viewer.wanted, new=new)

    def _show(self, messages: Sequence[Encoded]) -> None:
        for topic, at_ns, payload in messages:
            assert topic in self.topics, f"{topic} is not offered"
            self.viewer.show(topic, at_ns, payload)


class _Socket:
    """A viewer's websocket: sends its messages, lets events of the flight happen between them, and checks what it is sent."""

    def __init__(self, messages: list[tuple[int, bytes]], feed: LiveFeed) -> None:
        self._messages = messages
        self._feed = feed
        self._asked: set[int] = set()
        self.closed = False

    async def __aiter__(self) -> AsyncIterator[WSMessage]:
        for kind, content in self._messages:
            if self.closed:
                return
            if kind == _EVENT:
                happened = _events()
                happened[Choices(content).number(1) % len(happened)](self._feed)
            elif kind == _DATA:
                yield WSMessage(WSMsgType.BINARY, content, None)
            else:
                self._asked |= _numbers(content)
                yield WSMessage(WSMsgType.TEXT, content.decode("utf-8", "replace"), None)
            await asyncio.sleep(0)

    async def send_str(self, text: str) -> None:
        reported = json.loads(text)
        assert reported["op"] == "status"
        assert len(reported["message"]) <= 300

    async def send_bytes(self, message: bytes) -> None:
        opcode, number, _ = _MESSAGE.unpack_from(message)
        assert opcode == 1
        assert number in self._asked, f"a message of subscription {number}, which nobody asked for"
        assert json.loads(message[_MESSAGE.size :])

    async def close(self, *, code: int, message: bytes) -> None:
        assert code == 1008
        assert message
        self.closed = True


def _numbers(text: bytes) -> set[int]:
    """Return the numbers of subscriptions that a request may have made, by another decoder than the server's."""
    try:
        asked = json.loads(text.decode("utf-8", "replace"))
        return {one["id"] for one in asked["subscriptions"]}
    except (ValueError, TypeError, KeyError, RecursionError):
        return set()


def run_viewer(data: bytes) -> None:
    """Send messages while a flight goes by: each is carried out or refused in words; only what was requested comes."""
    choices = Choices(data)
    messages = []
    while choices:
        messages.append((choices.number(1) % 3, choices.block()))
    asyncio.run(watched(_viewed(messages)))


async def _viewed(messages: list[tuple[int, bytes]]) -> None:
    server = _Server(make_pilot(_settings()), messages)
    feeding = asyncio.ensure_future(server.feed.run())
    async with asyncio.timeout(ANSWER_S):
        await server.viewer.serve()
    assert not feeding.done(), "the feed has ended"
    await ended(feeding)


class _Watch:
    """Keeps the events of a flight as calls of an observer."""

    def __init__(self) -> None:
        self.events: list[Event] = []

    def on_sample(self, sample: Sample) -> None:
        self.events.append(lambda observer: observer.on_sample(sample))

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        self.events.append(lambda observer: observer.on_fusion(at, result))

    def on_frame(self, processed: ProcessedFrame) -> None:
        self.events.append(lambda observer: observer.on_frame(processed))

    def on_decision(self, decision: Decision) -> None:
        self.events.append(lambda observer: observer.on_decision(decision))

    def on_order(self, handled: HandledOrder) -> None:
        self.events.append(lambda observer: observer.on_order(handled))


@cache
def _events() -> list[Event]:
    """Return the newest events of the first frames of a recording that the repository keeps, with everything decided on them."""
    watch = _Watch()
    replay = Replay(open_recording([GOLDEN]), make_pilot(_settings()), observers=(watch,))
    frames = 0
    for _, event in replay.steps():
        frames += isinstance(event, RecordedFrame)
        if frames > _FRAMES:
            break
    return watch.events[-256:]


def port_seeds() -> Iterator[bytes]:
    """Yield viewers of both protocols that subscribe, one of another protocol, and bytes that are not HTTP."""
    asked = websocket_frame(_subscribe(*CHANNELS))
    for name in SUBPROTOCOLS:
        live = upgrade(b"/", b"Sec-WebSocket-Protocol: " + name.encode())
        yield block(live) + block(asked) + block(websocket_frame(b"", 9)) + block(websocket_frame(b"", 8))
        yield block(live) + block(asked[:20]) + block(asked[20:]) + block(websocket_frame(_unsubscribe(1, 2)))
    yield block(upgrade(b"/?token=x", b"Origin: https://app.foxglove.dev", b"Sec-WebSocket-Protocol: mqtt, " + name.encode()))
    yield block(upgrade(b"/", b"Origin: http://evil.example")) + block(asked)
    yield block(b"GET / HTTP/1.1\r\n" + HOST + b"Authorization: Bearer x\r\n\r\n")
    yield block(b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03")


def viewer_seeds() -> Iterator[bytes]:
    """Yield a viewer of everything, one of some topics that changes its mind, and requests that are refused."""
    flight = b"".join(bytes([_EVENT]) + block(bytes([k])) for k in range(0, 256, 5))
    everything = bytes([_TEXT]) + block(_subscribe(*CHANNELS))
    yield everything + flight
    for channel in CHANNELS:
        yield bytes([_TEXT]) + block(_subscribe(channel)) + flight
    some = bytes([_TEXT]) + block(_subscribe(1, 2, 3))
    yield some + flight[:60] + bytes([_TEXT]) + block(_unsubscribe(1, 2)) + flight[:60] + bytes([_TEXT]) + block(_unsubscribe(2))
    yield some + some + bytes([_DATA]) + block(b"\x01\x00\x00\x00\x00data") + bytes([_TEXT]) + block(b'{"op":"getParameters"}')
    yield bytes([_TEXT]) + block(b"{") + (bytes([_TEXT]) + block(b"[]")) * 25


def _subscribe(*channels: int) -> bytes:
    return _request(op="subscribe", subscriptions=[{"id": 100 + channel, "channelId": channel} for channel in channels])


def _unsubscribe(*channels: int) -> bytes:
    return _request(op="unsubscribe", subscriptionIds=[100 + channel for channel in channels])


def _request(**fields: Any) -> bytes:
    return json.dumps(fields, separators=(",", ":")).encode()


TARGETS = {
    "foxglove_port": Target(run_port, port_seeds, 4096),
    "foxglove_viewer": Target(run_viewer, viewer_seeds, 4096),
}
