"""Look up the addresses of a host name on a thread, so that the event loop never waits for a resolver."""

import asyncio
import ipaddress
import socket
import threading
from contextlib import suppress
from typing import Any

from estimator.contracts.errors import Recoverable

Address = tuple[Any, Any, int, str, Any]
"""The family, kind, protocol, canonical name and address that `socket.getaddrinfo` returns."""

_asking: dict[tuple[str, int, int], asyncio.Future[list[Address]]] = {}
"""The look-ups that a thread still makes: one thread each, however many callers wait and however often they retry."""


async def resolve(host: str, port: int, timeout_s: float, kind: int = socket.SOCK_STREAM) -> list[Address]:
    """Return the addresses to connect to, the best first; an address written in numbers needs no look-up.

    Raises:
        Recoverable: there is no such host, or no answer came within `timeout_s`.
    """
    with suppress(ValueError):
        written = ipaddress.ip_address(host)
        if isinstance(written, ipaddress.IPv4Address):
            return [(socket.AF_INET, kind, 0, "", (host, port))]
        if written.scope_id is None:
            return [(socket.AF_INET6, kind, 0, "", (host, port, 0, 0))]
    loop, key = asyncio.get_running_loop(), (host, port, kind)
    found = _asking.get(key)
    if found is None or found.get_loop() is not loop:
        found = _asking[key] = loop.create_future()
        found.add_done_callback(lambda done: done.cancelled() or done.exception())  # nobody may be left to read it
        _ask(key, loop, found)
    try:
        async with asyncio.timeout(timeout_s):
            return await asyncio.shield(found)
    except TimeoutError as why:
        raise Recoverable(f"{host}:{port}: no answer from the resolver within {timeout_s:g} s") from why


def _ask(key: tuple[str, int, int], loop: asyncio.AbstractEventLoop, found: asyncio.Future[list[Address]]) -> None:
    host, port, kind = key

    def settle(addresses: list[Address], why: str) -> None:
        if _asking.get(key) is found:
            del _asking[key]
        if found.done():
            return
        if addresses:
            found.set_result(addresses)
        else:
            found.set_exception(Recoverable(f"{host}:{port}: {why or 'no address'}"))

    def ask() -> None:
        addresses: list[Address] = []
        why = ""
        try:
            addresses = list(socket.getaddrinfo(host, port, type=kind))
        except (OSError, UnicodeError) as error:
            why = str(getattr(error, "strerror", None) or error)
        # The loop may have ended in the meantime.
        with suppress(RuntimeError):
            loop.call_soon_threadsafe(settle, addresses, why)

    try:
        threading.Thread(target=ask, name="resolve", daemon=True).start()
    except RuntimeError as why:
        settle([], str(why))
