"""Contents of a server's log: errors of ours, and nothing that a client did to its own connection."""

import asyncio
import base64
import logging

import pytest
from aiohttp import web

from companion.base.http_server import ConnectionLimits, listen, make_runner
from tests.support.waiting import PATIENCE_S


def upgrade(address: bytes, *headers: bytes) -> bytes:
    """Return a browser's request for a websocket at an address (RFC 6455, section 4.1)."""
    key = b"Sec-WebSocket-Key: " + base64.b64encode(b"sixteen bytes of")
    asked = (b"Host: 127.0.0.1", b"Connection: Upgrade", b"Upgrade: websocket", b"Sec-WebSocket-Version: 13", key, *headers)
    return b"GET " + address + b" HTTP/1.1\r\n" + b"\r\n".join(asked) + b"\r\n\r\n"


async def _answers(handler_fails: bool, *pieces: bytes, hang_up: bool = True) -> list[bytes]:
    async def handle(request: web.Request) -> web.StreamResponse:
        if handler_fails:
            raise KeyError("ours")
        socket = web.WebSocketResponse()
        await asyncio.sleep(0.05)
        await socket.prepare(request)
        return socket

    app = web.Application()
    app.router.add_get("/", handle)
    runner, answers = make_runner(app), []
    await runner.setup()
    try:
        server = await listen(runner, ConnectionLimits(), "127.0.0.1", 0)
        for piece in pieces:
            reader, writer = await asyncio.open_connection("127.0.0.1", server.sockets[0].getsockname()[1])
            writer.write(piece)
            if hang_up:
                writer.write_eof()
            async with asyncio.timeout(PATIENCE_S):
                answers.append(await reader.read(4096))
            writer.close()
        await asyncio.sleep(0.1)
        server.close()
    finally:
        await runner.cleanup()
    return answers


async def test_unknown_peers_fill_no_log(caplog: pytest.LogCaptureFixture) -> None:
    """A request with a broken header, bytes that are no HTTP, and a client that hangs up."""
    with caplog.at_level(logging.DEBUG, "companion.base.http_server"):
        await _answers(False, b"GET / HTTP/1.1\r\nno header\r\n\r\n", b"\x16\x03\x01\x02\x00\r\n\r\n", upgrade(b"/"))
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING], caplog.text
    assert "BadHttpMessage" in caplog.text or "InvalidHeader" in caplog.text
    assert "ConnectionResetError" in caplog.text


@pytest.mark.parametrize(("text", "torn"), [(b"Upgrade: web", b"\x8d\x90"), (b"Sec-WebSocket-Key: c2l4", b"\x9c\xb6")])
async def test_bytes_that_are_no_text_are_refused(text: bytes, torn: bytes, caplog: pytest.LogCaptureFixture) -> None:
    (answer,) = await _answers(False, upgrade(b"/").replace(text, text + torn, 1), hang_up=False)
    assert answer.startswith(b"HTTP/1.1 400 Bad Request"), answer
    assert b"ASCII" in answer
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING], caplog.text


async def test_an_error_of_ours_is_reported_with_its_traceback(caplog: pytest.LogCaptureFixture) -> None:
    await _answers(True, b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
    (record,) = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert record.levelno == logging.ERROR
    assert record.exc_info is not None
    assert isinstance(record.exc_info[1], KeyError)
