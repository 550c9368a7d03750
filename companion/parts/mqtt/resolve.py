"""Resolve a host's addresses on a separate thread: a resolver may hang for half a minute, and nobody can end it."""

from __future__ import annotations

import asyncio
import socket
import threading
from contextlib import suppress
from typing import Any

from estimator.contracts.errors import Recoverable

Address = tuple[Any, Any, int, str, Any]
"""The family, kind, protocol, canonical name and address that `socket.getaddrinfo` returns."""

_asking: set[str] = set()
"""The hosts that a thread is still resolving: one thread each, however often a caller retries."""


async def resolve(host: str, port: int, timeout_s: float) -> list[Address]:
    """Return the addresses to connect to, the best first.

    Raises:
        Recoverable: there is no such host, or no answer came within `timeout_s`.
    """
    if host in _asking:
        raise Recoverable(f"broker {host}: its address is still being asked for")
    loop = asyncio.get_running_loop()
    found: asyncio.Future[list[Address]] = loop.create_future()

    def ask() -> None:
        addresses: list[Address] = []
        why = ""
        try:
            addresses = list(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM))
        except (OSError, UnicodeError) as error:
            why = str(getattr(error, "strerror", None) or error)
        finally:
            _asking.discard(host)
        # The loop may have ended in the meantime.
        with suppress(RuntimeError):
            loop.call_soon_threadsafe(settle, addresses, why)

    def settle(addresses: list[Address], why: str) -> None:
        if found.done():
            return
        if addresses:
            found.set_result(addresses)
        else:
            found.set_exception(Recoverable(f"broker {host}:{port}: {why or 'no address'}"))

    _asking.add(host)
    try:
        threading.Thread(target=ask, name="resolve", daemon=True).start()
    except RuntimeError as why:
        _asking.discard(host)
        raise Recoverable(f"broker {host}: {why}") from why
    try:
        async with asyncio.timeout(timeout_s):
            return await found
    except TimeoutError as why:
        raise Recoverable(f"broker {host}:{port}: no answer from the resolver within {timeout_s:g} s") from why
