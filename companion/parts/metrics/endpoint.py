"""Serve the metrics over HTTP, as a supervised part."""

from __future__ import annotations

import asyncio
import json
import logging
import math

from aiohttp import web

from companion.base.connection_limits import ConnectionLimits, listen
from companion.base.health import Health
from companion.base.liveness import stuck
from companion.base.server_log import make_runner
from companion.parts.metrics.exposition import CONTENT_TYPE, text
from companion.settings import secret_files
from companion.settings.metrics import MetricsSettings

log = logging.getLogger(__name__)

_PAGE_S = 0.2
"""The shortest time between two renderings of a page, s: a flood of requests must not cost the flight more than that."""


class MetricsEndpoint:
    """Serves /metrics (Prometheus) and /health.

    /health answers 200 while what the flight needs is up and not stuck, else 503, and as JSON every part that is down. Whoever
    restarts the service on a 503 must not do so in flight because the broker is away.

    If a token is set, /metrics answers 401 to requests without it, and /health answers only yes or no.

    Raises:
        BadInput: the token cannot be read or is too short.
    """

    def __init__(self, settings: MetricsSettings, health: Health, limits: ConnectionLimits | None = None) -> None:
        self._settings = settings
        self._health = health
        self._limits = limits or ConnectionLimits()
        self._token = secret_files.token(settings.token_file, "metrics", "token_file")
        self._page = b""
        self._made_s = -math.inf
        self.port: int | None = None
        """The port that the endpoint listens on; None while it does not listen."""
        self.refused = 0
        """The number of requests for the metrics without the right token."""
        health.counters("metrics", self.counts)

    def counts(self) -> dict[str, float]:
        """Return the counters for health."""
        return {"refused": self.refused, **self._limits.counts()}

    async def run(self) -> None:
        """Serve until cancelled.

        Raises:
            Recoverable: the port is taken, or the address is none of this machine's.
        """
        app = web.Application(client_max_size=1024)
        app.router.add_get("/metrics", self._metrics)
        app.router.add_get("/health", self._state)
        runner = make_runner(app)
        await runner.setup()
        try:
            server = await listen(runner, self._limits, self._settings.host, self._settings.port, "metrics")
            try:
                self.port = server.sockets[0].getsockname()[1]
                log.info("metrics on http://%s:%d/metrics", self._settings.host, self.port)
                await asyncio.Event().wait()
            finally:
                server.close()
        finally:
            self.port = None
            await runner.cleanup()

    async def _metrics(self, request: web.Request) -> web.Response:
        if not self._allows(request):
            self.refused += 1
            return _closing(web.Response(status=401, headers={"WWW-Authenticate": "Bearer"}))
        now_s = asyncio.get_running_loop().time()
        if now_s >= self._made_s + _PAGE_S:
            self._page, self._made_s = text(self._health.snapshot()), now_s
        return _closing(web.Response(body=self._page, headers={"Content-Type": CONTENT_TYPE}))

    async def _state(self, request: web.Request) -> web.Response:
        down = {name: part.last_error for name, part in self._health.parts.items() if not part.up}
        ok = self._health.flight_fault() is None
        if "Decision" in self._health.flows and (why := stuck(self._health.snapshot(), flying=False)) is not None:
            down["pipeline"], ok = why, False
        said: dict[str, object] = {"ok": ok}
        if self._allows(request):
            said["down"] = down
        return _closing(web.Response(text=json.dumps(said) + "\n", status=200 if ok else 503, content_type="application/json"))

    def _allows(self, request: web.Request) -> bool:
        """Return whether the request carries the token."""
        if self._token is None:
            return True
        scheme, _, given = request.headers.get("Authorization", "").partition(" ")
        return secret_files.is_token(given, self._token) and scheme.lower() == "bearer"


def _closing(answer: web.Response) -> web.Response:
    """Return the answer, set to close its connection: a connection's time is bounded, and an idle one holds no descriptor."""
    answer.force_close()
    return answer
