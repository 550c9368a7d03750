"""The server of live data, as an observer of the flight and a supervised part beside it.

Whoever connects only watches: nothing of the flight can be changed here. A connection is bounded in bytes and time until it is
let in; then its subscriptions, its requests and what waits for it are bounded.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence

from aiohttp import WSCloseCode, web

from companion.base.connection_limits import ConnectionLimits, listen
from companion.base.health import Health
from companion.base.observer import Decision, ProcessedFrame
from companion.base.orders import HandledOrder
from companion.base.server_log import make_runner
from companion.guidance.pilot import Pilot
from companion.parts.live.feed import Encoded, LiveFeed, topics
from companion.parts.live.viewer import LiveViewer
from companion.recording import foxglove_protocol as protocol
from companion.settings import secret_files
from companion.settings.live import FoxgloveSettings
from estimator.contracts.fusion import FusionResult
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs

log = logging.getLogger(__name__)

_ALIVE_S = 4.0
"""How often a viewer is asked whether it is still there; half of it without an answer ends the connection."""


class FoxgloveEndpoint:
    """See the module's docstring.

    Args:
        name: the vehicle's name for the viewer.
        offset_ns: the offset from the clock's instants to Unix time, ns.

    Raises:
        BadInput: the token cannot be read or is too short.
    """

    def __init__(
        self,
        settings: FoxgloveSettings,
        pilot: Pilot,
        health: Health,
        clock: Clock,
        name: str,
        offset_ns: int,
        limits: ConnectionLimits | None = None,
    ) -> None:
        self._settings = settings
        self.clock = clock
        self.topics = topics(settings)
        self._limits = limits or ConnectionLimits()
        self._token = secret_files.token(settings.token_file, "foxglove", "token_file")
        self._origins = {origin.strip().lower() for origin in settings.origins.split(",")}
        self._viewers: list[LiveViewer] = []
        self._counts: Counter[str] = Counter()
        self._greetings = protocol.server_info(name, str(clock.now() + offset_ns)), protocol.advertise(self.topics)
        self._feed = LiveFeed(settings, pilot.camera, pilot.pad, offset_ns, health, self._show)
        self.port: int | None = None
        """The port that the endpoint listens on; None while it does not listen."""

    def counted(self) -> dict[str, float]:
        """Return the counters for health."""
        return {**self._feed.counted(), **self._counts, "viewers": len(self._viewers), **self._limits.counts()}

    def count(self, what: str) -> None:
        """Count something for health."""
        self._counts[what] += 1

    def changed(self, *, new: bool) -> None:
        """Take note that a viewer's subscriptions changed."""
        self._feed.want(frozenset().union(*(viewer.wanted for viewer in self._viewers)), new=new)

    def on_sample(self, sample: Sample) -> None:
        self._feed.on_sample(sample)

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        self._feed.on_fusion(at, result)

    def on_frame(self, processed: ProcessedFrame) -> None:
        self._feed.on_frame(processed)

    def on_decision(self, decision: Decision) -> None:
        self._feed.on_decision(decision)

    def on_order(self, handled: HandledOrder) -> None:
        self._feed.on_order(handled)

    async def run(self) -> None:
        """Serve until cancelled.

        Raises:
            Recoverable: the port is taken, or the address is none of this machine's.
        """
        app = web.Application(client_max_size=1024)
        app.router.add_get("/", self._live)
        runner = make_runner(app)
        await runner.setup()
        try:
            server = await listen(runner, self._limits, self._settings.host, self._settings.port, "Foxglove's data")
            try:
                self.port = server.sockets[0].getsockname()[1]
                log.info("live data for Foxglove on ws://%s:%d", self._settings.host, self.port)
                await self._feed.run()
            finally:
                server.close()
                for viewer in tuple(self._viewers):
                    await viewer.close()
        finally:
            self.port = None
            await runner.cleanup()

    async def _live(self, request: web.Request) -> web.StreamResponse:
        if (refusal := self._refusal(request)) is not None:
            refusal.force_close()
            return refusal
        socket = web.WebSocketResponse(
            protocols=protocol.SUBPROTOCOLS, max_msg_size=protocol.TEXT_MAX, compress=False, heartbeat=_ALIVE_S, timeout=1.0
        )
        if not socket.can_prepare(request).ok or socket.can_prepare(request).protocol is None:
            why = f"this address is for a websocket of {' or '.join(protocol.SUBPROTOCOLS)}\n"
            answer = web.Response(status=426, text=why, headers={"Upgrade": "websocket"})
            answer.force_close()
            return answer
        await socket.prepare(request)
        if len(self._viewers) >= self._settings.viewers_max:
            await socket.close(code=WSCloseCode.TRY_AGAIN_LATER)
            return socket
        self._limits.lift(request.transport)
        viewer = LiveViewer(self, socket)
        for text in self._greetings:
            viewer.tell(text)
        self.count("opened")
        self._viewers.append(viewer)
        try:
            await viewer.serve()
        finally:
            self._viewers.remove(viewer)
            self.changed(new=False)
        return socket

    def _refusal(self, request: web.Request) -> web.Response | None:
        """Return the answer to whoever may not watch: without the token, from a page that is not named, or one too many."""
        if self._token is not None:
            scheme, _, bearer = request.headers.get("Authorization", "").partition(" ")
            given = bearer if scheme.lower() == "bearer" else request.query.get("token", "")
            if not secret_files.is_token(given, self._token):
                self.count("wrong_tokens")
                return web.Response(status=401, text="the token is missing or wrong\n", headers={"WWW-Authenticate": "Bearer"})
        elif (origin := request.headers.get("Origin")) is not None and origin.lower() not in self._origins:
            self.count("foreign_origins")
            return web.Response(status=403, text="this page is not among expert.foxglove.origins\n")
        if len(self._viewers) >= self._settings.viewers_max:
            self.count("too_many")
            return web.Response(status=503, text=f"{self._settings.viewers_max} viewers watch already\n")
        return None

    def _show(self, messages: Sequence[Encoded]) -> None:
        for viewer in self._viewers:
            for topic, at_ns, payload in messages:
                viewer.show(topic, at_ns, payload)
