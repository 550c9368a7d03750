"""The service's one HTTP port: its token, its limit of connections, its counters, and the log of what went wrong on it.

Parts add what they serve; the server knows none of them. aiohttp logs a request that is no HTTP, and a client that goes away in
the middle of its handshake, as an error with a traceback. Anybody who reaches a port could fill the journal with them, so our own
errors are logged, and a client's faults on its own connection are not. Bytes that are no text fail in several places of a
handshake, with errors that could be ours, so that a request with them in a header that is read here is refused before. Headers
that are not read judge nothing: a browser sends the cookies of every other service of this computer, of any text and length.

aiohttp waits indefinitely for the first byte of a request. Here each connection has one deadline from its opening to its end,
whatever it does meanwhile, and the newest connection is served: when there are too many, the oldest is closed.
"""

from __future__ import annotations

import asyncio
import logging
import re
import ssl
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError
from aiohttp.typedefs import Handler
from msgspec import Struct, field

from companion.base.health import Health
from companion.settings import files
from companion.settings.certificates import server_context
from companion.settings.links import HttpSettings
from estimator.contracts.errors import Recoverable, refused

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
_READ = re.compile(
    r"host|origin|authorization|connection|upgrade|sec-websocket-.*|x-forwarded-(host|port)|range|if-.*", re.IGNORECASE
)
"""Names of the headers that are read here, or by aiohttp for us."""
_BY_CLIENTS = (HttpProcessingError, ConnectionError)


class ConnectionLimits(Struct):
    """The bounds, and the number of times that each was reached."""

    connections: int = 16
    """The most connections that are open at once."""
    connection_s: float = 5.0
    """The longest duration of a connection."""
    request_bytes: int = 65_536
    """The most bytes that a connection may send in all, and the longest header: browsers keep 180 cookies of 4 kB for a name."""
    evicted: int = 0
    overdue: int = 0
    oversized: int = 0
    open: dict[_Bounded, asyncio.Transport] = field(default_factory=dict)
    """The open connections from the oldest to the newest."""

    def lift(self, transport: asyncio.BaseTransport | None) -> None:
        """Bound this connection no longer: its peer has proven who it is, and its handler bounds it from here on."""
        for protocol in [protocol for protocol, open_one in self.open.items() if open_one is transport]:
            protocol.lift()

    def counts(self) -> dict[str, float]:
        """Return the counters for health."""
        return {"connections_evicted": self.evicted, "connections_overdue": self.overdue, "connections_oversized": self.oversized}


async def listen(
    runner: web.AppRunner, limits: ConnectionLimits, host: str, port: int, tls: ssl.SSLContext | None = None
) -> asyncio.Server:
    """Serve an application on a port by bounded connections.

    Raises:
        Recoverable: the port is taken, or the address is none of this machine's.
    """
    server = runner.server
    assert server is not None, "the runner is set up"
    with refused(f"HTTP cannot be served on {host}:{port}", OSError, by=Recoverable):
        return await asyncio.get_running_loop().create_server(
            lambda: _Bounded(server(), limits), host, port, backlog=limits.connections, ssl=tls
        )


class _Bounded(asyncio.Protocol):
    """One connection: it passes everything to aiohttp's own protocol while the bounds hold."""

    def __init__(self, inner: asyncio.Protocol, limits: ConnectionLimits) -> None:
        self._inner = inner
        self._limits = limits
        self._deadline: asyncio.TimerHandle | None = None
        self._received = 0
        self._lifted = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        limits = self._limits
        while len(limits.open) >= limits.connections:
            limits.evicted += 1
            limits.open.pop(next(iter(limits.open))).abort()
        limits.open[self] = transport
        self._deadline = asyncio.get_running_loop().call_later(limits.connection_s, self._overdue, transport)
        self._inner.connection_made(transport)

    def lift(self) -> None:
        """End the bounds of this connection."""
        self._lifted = True
        if self._deadline is not None:
            self._deadline.cancel()
        self._limits.open.pop(self, None)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
        self._limits.open.pop(self, None)
        self._inner.connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        self._received += len(data)
        if self._received > self._limits.request_bytes and not self._lifted:
            self._limits.oversized += 1
            if (transport := self._limits.open.get(self)) is not None:
                transport.abort()
            return
        self._inner.data_received(data)

    def eof_received(self) -> bool | None:
        return self._inner.eof_received()

    def pause_writing(self) -> None:
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        self._inner.resume_writing()

    def _overdue(self, transport: asyncio.Transport) -> None:
        self._limits.overdue += 1
        transport.abort()


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
        s = settings
        self._token = files.Renewed(lambda: files.token(s.token_file, "http.token_file"), "http", s.token_file)
        of_tls = (s.certificate_file, s.key_file) if s.endpoint == "https" else ()
        self._certified = files.Renewed(lambda: server_context(s), "http", *of_tls)
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
        wanted = self._token()
        known = wanted is None or files.is_token(token, wanted)
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
        return bool(self.settings.token_file)

    @property
    def full(self) -> bool:
        """True if there are as many viewers as may be."""
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
            tls = self._certified()
            if tls is not None:
                tls.sni_callback = self._certify
            server = await listen(runner, self.limits, self.settings.host, self.settings.port, tls)
            try:
                self.port = server.sockets[0].getsockname()[1]
                log.info("listening on %s://%s:%d/", self.settings.endpoint, self.settings.host, self.port)
                await asyncio.Event().wait()
            finally:
                server.close()
        finally:
            self.port = None
            await runner.cleanup()

    def _certify(self, connection: ssl.SSLObject, name: str | None, context: ssl.SSLContext) -> None:
        """Answer a browser's first message with the certificate of now; OpenSSL calls this whether it names a server or not."""
        connection.context = self._certified() or context


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
    longest = ConnectionLimits().request_bytes
    return web.AppRunner(app, access_log=None, shutdown_timeout=0.5, logger=ServerLog(log), max_field_size=longest)


@web.middleware
async def _of_ascii(request: web.Request, handler: Handler) -> web.StreamResponse:
    if torn := [name for name, text in request.headers.items() if _READ.fullmatch(name) and not text.isascii()]:
        raise web.HTTPBadRequest(text=f"the headers {', '.join(torn)} must be of ASCII characters")
    return await handler(request)


async def _finish(request: web.Request, answer: web.StreamResponse) -> None:
    """Set the headers of every answer, and close its connection; an answer that has its own policy keeps it."""
    for name, value in HEADERS.items():
        if name == "Server" or name not in answer.headers:
            answer.headers[name] = value
    if not isinstance(answer, web.WebSocketResponse):
        answer.force_close()  # a connection's time is bounded, and an idle one holds no descriptor
        answer.headers["Connection"] = "close"
