"""Shared parts of the targets that open a port: a client that sends pieces of bytes, and a watch on failures beside it."""

import asyncio
import base64
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any
from unittest.mock import patch

from companion.base.server_log import ServerLog

ANSWER_S = 10.0
"""Time limit for the end of a connection on a machine under load, s."""
_TURNS = 4
"""Turns of the loop between two pieces: this many the other end needs to answer one, such as a handshake, before the next."""
HOST = b"Host: 127.0.0.1\r\n"


async def watched(work: Coroutine[Any, Any, None]) -> None:
    """Do the work; show that nothing failed beside it."""
    complaints: list[object] = []
    asyncio.get_running_loop().set_exception_handler(lambda loop, context: complaints.append(context))
    with patch.object(ServerLog, "error", lambda _, message, *args, **how: complaints.append((message, args, how))):
        await work
    assert not complaints, complaints


async def ended(serving: asyncio.Future[None]) -> None:
    """Cancel a task and wait for its end."""
    serving.cancel()
    with suppress(asyncio.CancelledError):
        await serving


async def converse(ends: tuple[asyncio.StreamReader, asyncio.StreamWriter], pieces: list[bytes]) -> None:
    """Send the pieces one after the other and read until the other end closes, which it must.

    Raises:
        OSError: the connection was reset.
        TimeoutError: the other end does not close.
    """
    reader, writer = ends
    try:
        for piece in pieces:
            writer.write(piece)
            for _ in range(_TURNS):
                await asyncio.sleep(0)
        writer.write_eof()
        async with asyncio.timeout(ANSWER_S):
            while await reader.read(65536):
                pass
    finally:
        writer.close()
        with suppress(OSError):
            await writer.wait_closed()


def upgrade(address: bytes, *headers: bytes) -> bytes:
    """Return a browser's request for a websocket at an address (RFC 6455, section 4.1)."""
    key = b"Sec-WebSocket-Key: " + base64.b64encode(b"sixteen bytes of")
    asked = (b"Connection: Upgrade", b"Upgrade: websocket", b"Sec-WebSocket-Version: 13", key, *headers)
    return b"GET " + address + b" HTTP/1.1\r\n" + HOST + b"\r\n".join(asked) + b"\r\n\r\n"


def websocket_frame(content: bytes, opcode: int = 1) -> bytes:
    """Return a whole frame of a browser, masked by zeros (RFC 6455, section 5.2)."""
    length = bytes([0x80 | len(content)]) if len(content) < 126 else bytes([0x80 | 126]) + len(content).to_bytes(2, "big")
    return bytes([0x80 | opcode]) + length + bytes(4) + content
