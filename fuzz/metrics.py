"""Fuzz the requests at the metrics port."""

import asyncio
from collections.abc import Iterator
from contextlib import suppress

from companion.base.health import Health
from companion.parts.metrics.endpoint import MetricsEndpoint
from companion.settings.metrics import MetricsSettings
from drivers.clock import SystemClock
from fuzz.connections import ANSWER_S, ended, watched
from fuzz.target import Choices, Target, block


def run_metrics(data: bytes) -> None:
    """Send bytes in pieces on one connection: answered or closed, and the endpoint continues without an error."""
    choices = Choices(data)
    hang_up = bool(choices.number(1) & 1)
    asyncio.run(watched(_ask(choices.blocks(), hang_up)))


async def _ask(pieces: list[bytes], hang_up: bool) -> None:
    endpoint = MetricsEndpoint(MetricsSettings(endpoint="http", port=0), Health(SystemClock()))
    task = asyncio.ensure_future(endpoint.run())
    while endpoint.port is None and not task.done():  # noqa: ASYNC110
        await asyncio.sleep(0)
    with suppress(OSError):
        await _converse(endpoint.port, pieces, hang_up)
    assert not task.done(), "the endpoint has ended"
    await ended(task)


async def _converse(port: int | None, pieces: list[bytes], hang_up: bool) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        for piece in pieces:
            writer.write(piece)
            await asyncio.sleep(0)
        if hang_up:
            return
        writer.write_eof()
        async with asyncio.timeout(ANSWER_S):
            await reader.read()
    finally:
        writer.close()
        with suppress(OSError):
            await writer.wait_closed()


def metrics_seeds() -> Iterator[bytes]:
    """Yield a scrape, a health request, a request with a body, two requests on one connection, and bytes that are not HTTP."""
    head = b"Host: localhost\r\nUser-Agent: x\r\n\r\n"
    yield b"\0" + block(b"GET /metrics HTTP/1.1\r\n" + head)
    yield b"\0" + block(b"GET /health HTTP/1.0\r\n") + block(head)
    yield b"\0" + block(b"POST /metrics HTTP/1.1\r\nContent-Length: 3\r\n" + head + b"abc" + b"GET /health HTTP/1.1\r\n" + head)
    yield b"\1" + block(b"GET /metrics HTTP/1.1\r\nTransfer-Encoding: chunked\r\nHost: a\r\n\r\n5\r\nabcde\r\n0\r\n\r\n")
    yield b"\0" + block(b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03")


TARGETS = {"metrics": Target(run_metrics, metrics_seeds, 2048)}
