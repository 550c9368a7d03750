"""Waiting for what happens: a condition, or a server that listens. Nothing here waits for a fixed time."""

import asyncio
import socket
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import ExitStack, asynccontextmanager
from typing import Protocol

from sitl.emulators.autopilots.programs.program import reserved_port

PATIENCE_S = 60.0
"""Time limit for anything that a healthy program does at some time: a machine under load is slow, and no test asks how slow."""
_POLL_S = 0.005
_RESERVED = ExitStack()
"""Ports that stay reserved until this process ends."""


def free_port() -> int:
    """Return a port of the loopback that nobody else is given as long as this process lives."""
    return _RESERVED.enter_context(reserved_port())


async def until(condition: Callable[[], object], limit_s: float = PATIENCE_S) -> None:
    """Wait for a condition.

    Raises:
        TimeoutError: it does not come true within `limit_s`.
    """
    async with asyncio.timeout(limit_s):
        while not condition():  # noqa: ASYNC110 - a condition of any kind, also of other processes
            await asyncio.sleep(_POLL_S)


def wait_until(condition: Callable[[], object], limit_s: float = PATIENCE_S) -> None:
    """Wait for a condition on a thread of one's own.

    Raises:
        TimeoutError: it does not come true within `limit_s`.
    """
    end_s = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end_s:
            raise TimeoutError
        time.sleep(_POLL_S)


def accepts(port: int) -> bool:
    """Return whether a program listens at a TCP port of the loopback."""
    try:
        socket.create_connection(("127.0.0.1", port), PATIENCE_S).close()
    except OSError:
        return False
    return True


@asynccontextmanager
async def answering(
    serve: Callable[[asyncio.StreamReader, asyncio.StreamWriter], Coroutine[None, None, None] | None],
) -> AsyncIterator[int]:
    """Serve each connection to a port of the loopback, and yield the port. None is open afterwards, however soon it ends."""
    writers: list[asyncio.StreamWriter] = []

    def met(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> Coroutine[None, None, None] | None:
        writers.append(writer)
        if server.is_serving():
            return serve(reader, writer)
        writer.transport.abort()
        return None

    server = await asyncio.start_server(met, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for writer in writers:
            writer.transport.abort()


class Serving(Protocol):
    """A part that listens on a port."""

    port: int | None

    async def run(self) -> None:
        """Serve until cancelled."""
        ...


@asynccontextmanager
async def listening(part: Serving, *beside: Callable[[], Coroutine[None, None, None]]) -> AsyncIterator[int]:
    """Run a part with others, and yield its port once it listens. Errors are raised here, before it listens and afterwards."""
    async with asyncio.TaskGroup() as group:
        running = [group.create_task(run()) for run in (part.run, *beside)]
        await until(lambda: part.port is not None)
        assert part.port is not None
        try:
            yield part.port
        finally:
            for task in running:
                task.cancel()
