"""The metrics over HTTP, as a supervised part."""

from __future__ import annotations

import asyncio
import json
import logging

from aiohttp import web

from companion.health import Health
from companion.metrics.exposition import CONTENT_TYPE, text
from companion.metrics.settings import MetricsSettings
from companion.vital import stuck
from estimator.contracts.errors import Recoverable

log = logging.getLogger(__name__)


class MetricsEndpoint:
    """Serves /metrics (Prometheus) and /health (200 when every part is up and none is stuck, else 503, the reasons as JSON)."""

    def __init__(self, settings: MetricsSettings, health: Health) -> None:
        self._settings = settings
        self._health = health
        self.port: int | None = None
        """Where it listens, while it does."""

    async def run(self) -> None:
        """Until cancelled.

        Raises:
            Recoverable: the port is taken, or the address is none of this machine's.
        """
        app = web.Application(client_max_size=1024)
        app.router.add_get("/metrics", self._metrics)
        app.router.add_get("/health", self._state)
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=0.5)
        await runner.setup()
        try:
            site = web.TCPSite(runner, self._settings.host, self._settings.port)
            try:
                await site.start()
            except OSError as why:
                where = f"{self._settings.host}:{self._settings.port}"
                raise Recoverable(f"metrics cannot be served on {where}: {why.strerror or why}") from why
            self.port = runner.addresses[0][1]
            log.info("metrics on http://%s:%d/metrics", self._settings.host, self.port)
            await asyncio.Event().wait()
        finally:
            self.port = None
            await runner.cleanup()

    async def _metrics(self, _: web.Request) -> web.Response:
        return web.Response(body=text(self._health.snapshot()), headers={"Content-Type": CONTENT_TYPE})

    async def _state(self, _: web.Request) -> web.Response:
        down = {name: part.last_error for name, part in self._health.parts.items() if not part.up}
        if "Decision" in self._health.flows and (why := stuck(self._health.snapshot(), flying=False)) is not None:
            down["pipeline"] = why
        return web.Response(
            text=json.dumps({"ok": not down, "down": down}) + "\n",
            status=503 if down else 200,
            content_type="application/json",
        )
