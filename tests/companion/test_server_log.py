"""What a server's log tells: an error of ours, and nothing that a client did to its own connection."""

from __future__ import annotations

import asyncio
import logging

import pytest
from aiohttp import web

from companion.runtime.connection_limits import ConnectionLimits, listen
from companion.runtime.server_log import make_runner
from fuzz.connections import upgrade


async def _told(handler_fails: bool, *pieces: bytes) -> None:
    async def handle(request: web.Request) -> web.StreamResponse:
        if handler_fails:
            raise KeyError("ours")
        socket = web.WebSocketResponse()
        await asyncio.sleep(0.05)
        await socket.prepare(request)
        return socket

    app = web.Application()
    app.router.add_get("/", handle)
    runner = make_runner(app)
    await runner.setup()
    try:
        server = await listen(runner, ConnectionLimits(), "127.0.0.1", 0, "a test")
        for piece in pieces:
            reader, writer = await asyncio.open_connection("127.0.0.1", server.sockets[0].getsockname()[1])
            writer.write(piece)
            writer.write_eof()
            async with asyncio.timeout(20):
                await reader.read()
            writer.close()
        await asyncio.sleep(0.1)
        server.close()
    finally:
        await runner.cleanup()


async def test_strangers_fill_no_log(caplog: pytest.LogCaptureFixture) -> None:
    """Requests with a broken header and with bytes that are no text, bytes that are no HTTP, and a client that hangs up."""
    no_text = b"GET / HTTP/1.1\r\nHost: x\r\nConnection: Upgrade\r\nUpgrade: web\x8d\x90\r\n\r\n"
    with caplog.at_level(logging.DEBUG, "companion.runtime.server_log"):
        await _told(False, b"GET / HTTP/1.1\r\nno header\r\n\r\n", b"\x16\x03\x01\x02\x00\r\n\r\n", no_text, upgrade(b"/"))
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING], caplog.text
    assert "BadHttpMessage" in caplog.text or "InvalidHeader" in caplog.text
    assert "ConnectionResetError" in caplog.text


async def test_an_error_of_ours_is_told_with_its_traceback(caplog: pytest.LogCaptureFixture) -> None:
    await _told(True, b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
    (record,) = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert record.levelno == logging.ERROR
    assert record.exc_info is not None
    assert isinstance(record.exc_info[1], KeyError)
