"""The service's one HTTP port: its token, its limit of connections, its counters, and the log of what went wrong on it.

Parts add what they serve; the server knows none of them. aiohttp logs a request that is no HTTP, and a client that goes away in
the middle of its handshake, as an error with a traceback. Anybody who reaches a port could fill the journal with them, so our own
errors are logged, and a client's faults on its own connection are not. Bytes that are no text fail in several places of a
handshake, with errors that could be ours, so that a request with them is refused before.
"""

import asyncio
import logging
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError
from aiohttp.typedefs import Handler

from companion.base.connection_limits import ConnectionLimits, listen
from companion.base.health import Health
from companion.settings import files
from companion.settings.links import HttpSettings
from companion.settings.referenced_files import server_context

log = logging.getLogger(__name__)

HEADERS: Mapping[str, str] = MappingProxyType(
    {
        "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
        "connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        "Server": "decklander",
        "X-Content-Type-Options": "nosniff",
        "X-Frame-Options": "DENY",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Embedder-Policy": "require-corp",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Permissions-Policy": "camera=(), microphone=(), geolocation=(), usb=(), serial=(), gamepad=(self)",
        "Cache-Control": "no-store",
    }
)
"""The headers of every answer: nothing of another host is loaded, and no other page may frame, read or script ours."""
_BY_CLIENTS = (HttpProcessingError, ConnectionError)


class HttpServer:
    """See the module's docstring.

    Raises:
        BadInput: the token or the certificate cannot be read or used.
    """

    def __init__(self, settings: HttpSettings, health: Health, limits: ConnectionLimits | None = None) -> None:
        self.settings = settings
        self.counts: Counter[str] = Counter()
        self.limits = limits or ConnectionLimits()
        self.viewers = 0
        """Browsers and programs that watch, whose connections are bounded by those who serve them."""
        self.port: int | None = None
        """The port that the server listens on; None while it does not listen."""
        self._token = files.token(settings.token_file, "http", "token_file")
        self._tls = server_context(settings)
        self._routes: list[web.RouteDef] = []
        health.counters("http", self.counted)

    def counted(self) -> dict[str, float]:
        """Return the counters for health."""
        return {**self.counts, "viewers": self.viewers, **self.limits.counts()}

    def serve(self, path: str, handler: Handler) -> None:
        """Answer GET requests for a path; before `run`."""
        self._routes.append(web.get(path, handler))

    def knows(self, token: str) -> bool:
        """Return whether a text is the token; True if none is set. Wrong ones are counted."""
        known = self._token is None or files.is_token(token, self._token)
        if not known:
            self.counts["wrong_tokens"] += 1
            if self.counts["wrong_tokens"] == 1:
                log.warning("a wrong token was given to the HTTP port; further ones are only counted")
        return known

    def allows(self, request: web.Request) -> bool:
        """Return whether a request carries the token, as a bearer or in its query; True if none is set."""
        scheme, _, bearer = request.headers.get("Authorization", "").partition(" ")
        return self.knows(bearer if scheme.lower() == "bearer" else request.query.get("token", ""))

    @property
    def has_token(self) -> bool:
        """True if a token is set."""
        return self._token is not None

    @property
    def full(self) -> bool:
        """True if nobody else may watch now."""
        return self.viewers >= self.settings.viewers_max

    @contextmanager
    def watched_by(self, request: web.Request) -> Iterator[None]:
        """Lift the bounds of a connection whose peer was let in; the caller bounds it from here on."""
        self.limits.lift(request.transport)
        self.counts["opened"] += 1
        self.viewers += 1
        try:
            yield
        finally:
            self.viewers -= 1

    async def run(self) -> None:
        """Serve until cancelled.

        Raises:
            Recoverable: the port is taken, or the address is none of this machine's.
        """
        app = web.Application(client_max_size=1024)
        app.add_routes(self._routes)
        runner = make_runner(app)
        await runner.setup()
        try:
            server = await listen(runner, self.limits, self.settings.host, self.settings.port, self._tls)
            try:
                self.port = server.sockets[0].getsockname()[1]
                log.info("listening on %s://%s:%d/", self.settings.endpoint, self.settings.host, self.port)
                await asyncio.Event().wait()
            finally:
                server.close()
        finally:
            self.port = None
            await runner.cleanup()


class ServerLog(logging.LoggerAdapter[logging.Logger]):
    """Tells what a client did at the level of debugging, in one line."""

    def exception(self, msg: object, *args: object, exc_info: Any = True, **_: Any) -> None:
        if isinstance(exc_info, _BY_CLIENTS):
            self.debug(f"{msg}: {type(exc_info).__name__}", *args)
        else:
            self.error(msg, *args, exc_info=exc_info)


def make_runner(app: web.Application) -> web.AppRunner:
    """Return a runner of an application without a log of requests, whose errors go to this module's log."""
    app.middlewares.append(_of_ascii)
    app.on_response_prepare.append(_finish)
    return web.AppRunner(app, access_log=None, shutdown_timeout=0.5, logger=ServerLog(log))


@web.middleware
async def _of_ascii(request: web.Request, handler: Handler) -> web.StreamResponse:
    if not all(text.isascii() for text in request.headers.values()):
        raise web.HTTPBadRequest(text="headers must be of ASCII characters")
    return await handler(request)


async def _finish(request: web.Request, answer: web.StreamResponse) -> None:
    """Set the headers of every answer, and close its connection; an answer that has its own policy keeps it."""
    for name, value in HEADERS.items():
        if name == "Server" or name not in answer.headers:
            answer.headers[name] = value
    if not isinstance(answer, web.WebSocketResponse):
        answer.force_close()  # a connection's time is bounded, and an idle one holds no descriptor
        answer.headers["Connection"] = "close"
