"""The log of aiohttp's servers: our own errors are logged, and a client's faults on its own connection are not.

aiohttp logs a request that is no HTTP, and a client that goes away in the middle of its handshake, as an error with a traceback.
Anybody who reaches a port could fill the journal with them. Bytes that are no text fail in several places of a handshake, with
errors that could be ours, so that a request with them is refused before.
"""

import logging
from typing import Any

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError
from aiohttp.typedefs import Handler

log = logging.getLogger(__name__)

_BY_CLIENTS = (HttpProcessingError, ConnectionError)


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
    return web.AppRunner(app, access_log=None, shutdown_timeout=0.5, logger=ServerLog(log))


@web.middleware
async def _of_ascii(request: web.Request, handler: Handler) -> web.StreamResponse:
    if not all(text.isascii() for text in request.headers.values()):
        raise web.HTTPBadRequest(text="headers must be of ASCII characters")
    return await handler(request)
