"""The live data of a flight for Foxglove and Lichtblick, by a websocket at /live.

A viewer only watches: nothing of the flight can be changed here. A connection is bounded in bytes and time until it is
let in; then its subscriptions, its requests and what waits for it are bounded.
"""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import closing

import msgspec
from aiohttp import WSCloseCode, WSMsgType, web

from companion.base.health import Health
from companion.base.http_server import HttpServer
from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.base.orders import HandledOrder
from companion.base.worker import Worker
from companion.cycle.ports import Assembly
from companion.facts import encode
from companion.facts.wire import RequestRate
from companion.guidance.pilot import Pilot
from companion.parts.live.options import LiveHttp
from companion.recording import channels
from companion.recording import foxglove_protocol as protocol
from companion.recording.foxglove_protocol import CHANNELS, Subscribe, Unsubscribe
from companion.recording.message_encoder import MessageEncoder
from drivers.clock import wall_offset_ns
from drivers.mailbox import Line
from estimator.contracts.estimates import FusionResult, Verdict
from estimator.contracts.samples import Attitude, Sample
from estimator.contracts.time import Clock, MonoNs, seconds_between
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.pad import Pad

# What viewers are shown: events are taken on the flight's loop, encoded on a thread of its own, and dropped when that is
# behind.
#
# Nothing is taken that no viewer requested. The messages are those of a recording, by the same encoder.

Encoded = tuple[str, int, bytes]
"""Topic, time on the viewer's axis in ns, and the message as JSON."""
_EVENTS = 1024  # events that may wait for the thread: some two seconds of them
_FRAMES = 2  # frames that may wait for it: 1.4 MB
_NEVER_LIVE = frozenset({channels.TRUTH, channels.TRUE_POSE, channels.LINK})
"""Topics of the simulator and of links, which are recorded otherwise."""
_WAITING_BYTES = 4 << 20
"""Most bytes that wait for a slow viewer; the oldest are dropped."""
_REQUESTS_EACH_S = 100  # requests of a viewer that are answered in a second
_REFUSALS_MAX = 20
"""Requests that are refused before the connection is closed."""
_ALIVE_S = 4.0
"""Interval of pings to a viewer, s; half of it without an answer ends the connection."""


def topics(settings: LiveHttp) -> tuple[str, ...]:
    """Return the topics that are offered."""
    image = {"jpeg": {channels.IMAGE}, "h264": {channels.VIDEO}, "none": set[str]()}[settings.foxglove_frames]
    return tuple(t for t in channels.TOPICS if t not in _NEVER_LIVE and (t not in (channels.IMAGE, channels.VIDEO) or t in image))


class LiveFeed(NullObserver):
    """An observer of the flight.

    Args:
        offset_ns: the offset from the monotonic clock to the viewers' time axis, ns.
        send: is given each message that somebody requested.
    """

    def __init__(
        self,
        settings: LiveHttp,
        camera: Camera,
        pad: Pad,
        offset_ns: int,
        health: Health,
        send: Callable[[Sequence[Encoded]], None],
    ) -> None:
        self._settings = settings
        self._health = health
        self._send = send
        self._encoder = MessageEncoder(camera, offset_ns, settings.foxglove_frames, settings.jpeg_quality, pad)
        self._json = msgspec.json.Encoder()
        self._events: Line[tuple[MonoNs, object]] = Line(_EVENTS)
        self._wanted: frozenset[str] = frozenset()
        self._again = False
        self._frames_waiting = 0
        self._shown: MonoNs | None = None
        self._reported: MonoNs | None = None
        self._counts: Counter[str] = Counter()

    def counted(self) -> dict[str, float]:
        """Return the counters for health."""
        return {"messages": 0, "frames_dropped": 0, **self._counts, "events_dropped": self._events.dropped}

    def want(self, wanted: frozenset[str], *, new: bool) -> None:
        """Take what these topics need from now on.

        Args:
            new: somebody requested another topic, and gets the latched topics again.
        """
        self._wanted = wanted
        self._again = self._again or new

    def on_sample(self, sample: Sample) -> None:
        if channels.SAMPLES[type(sample)] in self._wanted or (type(sample) is Attitude and channels.TRANSFORMS in self._wanted):
            self._events.offer((sample.stamp.received_at, sample))

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        if channels.fusion(result.source) in self._wanted and (result.source != "imu" or result.verdict is not Verdict.FUSED):
            self._events.offer((at, result))

    def on_frame(self, processed: ProcessedFrame) -> None:
        images = not self._wanted.isdisjoint((channels.IMAGE, channels.VIDEO))
        if not images and self._wanted.isdisjoint((channels.DETECTION, channels.ANNOTATIONS)):
            return
        keep = images and self._due(processed.done)
        if keep and self._frames_waiting >= _FRAMES:
            self._counts["frames_dropped"] += 1
            keep = False
        self._frames_waiting += keep
        self._events.offer((processed.done, (encode.detection(processed), processed if keep else None, processed.detection)))

    def on_decision(self, decision: Decision) -> None:
        if not self._wanted:
            return
        self._events.offer((decision.at, decision))
        if channels.HEALTH in self._wanted and (self._reported is None or seconds_between(self._reported, decision.at) >= 1.0):
            self._reported = decision.at
            self._events.offer((decision.at, encode.health(decision.at, self._health.snapshot())))

    def on_order(self, handled: HandledOrder) -> None:
        if self._wanted:
            self._events.offer((handled.at, handled))

    async def run(self) -> None:
        """Encode and send until cancelled."""
        with closing(Worker("foxglove")) as worker:
            async for events in self._events.together():
                again, self._again = self._again, False
                # A frame that the queue dropped waits no more either: all that wait are in this batch.
                self._frames_waiting = 0
                encoded = await worker.run(self._encoded, events, self._wanted, again)
                self._counts["messages"] += len(encoded)
                self._send(encoded)

    def _due(self, at: MonoNs) -> bool:
        due = self._shown is None or seconds_between(self._shown, at) >= 0.9 / self._settings.picture_rate_hz
        if due:
            self._shown = at
        return due

    def _encoded(self, events: Sequence[tuple[MonoNs, object]], wanted: frozenset[str], again: bool) -> list[Encoded]:
        """Return the wanted messages of these events; runs on the thread."""
        if again:
            self._encoder.begin()
        out = []
        for at, what in events:
            for topic, t, message in self._encoder.messages(at, what):
                if topic in wanted:
                    out.append((topic, t, self._json.encode(message)))
        return out


class LiveViewer:
    """One viewer that is connected: what it requested, and what is sent to it without ever waiting for it."""

    def __init__(self, served: FoxgloveEndpoint, socket: web.WebSocketResponse) -> None:
        self._served = served
        self._socket = socket
        self._subscriptions: dict[int, str] = {}
        """The topics requested, by the viewer's own numbers."""
        self._waiting: deque[str | bytes] = deque()
        self._waiting_bytes = 0
        self._ready = asyncio.Event()
        self._rate = RequestRate(_REQUESTS_EACH_S)
        self._refusals = 0

    @property
    def wanted(self) -> frozenset[str]:
        """The topics that it requested."""
        return frozenset(self._subscriptions.values())

    def tell(self, text: str) -> None:
        """Send a text."""
        self._offer(text)

    def show(self, topic: str, at_ns: int, payload: bytes) -> None:
        """Send a message of a topic, if it was requested."""
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
            flood = self._rate.exceeded(self._served.clock.now())
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


class FoxgloveEndpoint:
    """See the module's docstring.

    Args:
        name: the vehicle's name for the viewer.
        offset_ns: the offset from the clock's instants to Unix time, ns.
    """

    def __init__(
        self, server: HttpServer, settings: LiveHttp, pilot: Pilot, health: Health, clock: Clock, name: str, offset_ns: int
    ) -> None:
        self._server = server
        self.clock = clock
        self.topics = topics(settings)
        self._origins = {origin.strip().lower() for origin in settings.origins.split(",")}
        self._viewers: list[LiveViewer] = []
        self._counts: Counter[str] = Counter()
        self._greetings = protocol.server_info(name, str(clock.now() + offset_ns)), protocol.advertise(self.topics)
        self.feed = LiveFeed(settings, pilot.camera, pilot.pad, offset_ns, health, self._show)
        """The observer of the flight."""
        health.counters("foxglove", self.counted)
        server.serve("/live", self._live)

    def counted(self) -> dict[str, float]:
        """Return the counters for health."""
        return {**self.feed.counted(), **self._counts}

    def count(self, what: str) -> None:
        """Count something for health."""
        self._counts[what] += 1

    def changed(self, *, new: bool) -> None:
        """Take note that a viewer's subscriptions changed."""
        self.feed.want(frozenset().union(*(viewer.wanted for viewer in self._viewers)), new=new)

    async def run(self) -> None:
        """Encode and send until cancelled."""
        try:
            await self.feed.run()
        finally:
            for viewer in tuple(self._viewers):
                await viewer.close()

    async def _live(self, request: web.Request) -> web.StreamResponse:
        if (refusal := self._refusal(request)) is not None:
            return refusal
        socket = web.WebSocketResponse(
            protocols=protocol.SUBPROTOCOLS, max_msg_size=protocol.TEXT_MAX, compress=False, heartbeat=_ALIVE_S, timeout=1.0
        )
        if not socket.can_prepare(request).ok or socket.can_prepare(request).protocol is None:
            why = f"this address is for a websocket of {' or '.join(protocol.SUBPROTOCOLS)}\n"
            return web.Response(status=426, text=why, headers={"Upgrade": "websocket"})
        await socket.prepare(request)
        if self._server.full:
            await socket.close(code=WSCloseCode.TRY_AGAIN_LATER)
            return socket
        with self._server.watched_by(request):
            viewer = LiveViewer(self, socket)
            for text in self._greetings:
                viewer.tell(text)
            self._viewers.append(viewer)
            try:
                await viewer.serve()
            finally:
                self._viewers.remove(viewer)
                self.changed(new=False)
        return socket

    def _refusal(self, request: web.Request) -> web.Response | None:
        """Return the answer to a viewer that may not watch: without the token, from a page that is not named, or one too many."""
        if not self._server.allows(request):
            return web.Response(status=401, text="the token is missing or wrong\n", headers={"WWW-Authenticate": "Bearer"})
        origin = request.headers.get("Origin")
        if not self._server.has_token and origin is not None and origin.lower() not in self._origins:
            self._server.counts["foreign_origins"] += 1
            return web.Response(status=403, text="this page is not among expert.http.origins\n")
        if self._server.full:
            self._server.counts["too_many"] += 1
            return web.Response(status=503, text=f"{self._server.viewers} watch already\n")
        return None

    def _show(self, messages: Sequence[Encoded]) -> None:
        for viewer in self._viewers:
            for topic, at_ns, payload in messages:
                viewer.show(topic, at_ns, payload)


def join(service: Assembly) -> None:
    """Serve the flight to viewers on the HTTP port, if there is one."""
    if (server := service.server) is None:
        return
    settings, offset_ns = service.settings.of(LiveHttp), wall_offset_ns(service.clock)
    name = service.settings.vehicle.name
    data = FoxgloveEndpoint(server, settings, service.pilot, service.health, service.clock, name, offset_ns)
    service.observers.append(data.feed)
    service.extras["foxglove"] = data.run
