"""Send a file to a browser: read on a thread of its own, piece by piece, so that a slow disk never holds up guidance."""

from __future__ import annotations

import asyncio
import stat
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from aiohttp import web

from companion.base.worker import Worker
from estimator.contracts.errors import unusable

_PIECE_BYTES = 64 * 1024
_PIECE_S = 10.0
"""A browser that takes no piece for so long is hung up on."""


async def send_file(request: web.Request, path: Path, headers: Mapping[str, str]) -> web.StreamResponse:
    """Send a file as far as it is written at this moment; answer 404 where there is none. No symbolic link is followed.

    Raises:
        ConnectionResetError: the browser hung up or was too slow, or the disk failed, on the way.
    """
    worker = Worker("page file")
    file: BinaryIO | None = None
    try:
        file, size = opened = await worker.run(_opened, path)
        answer = web.StreamResponse(headers=headers)
        answer.content_length = size
        answer.force_close()
        await answer.prepare(request)
        while size > 0:
            piece = await worker.run(opened[0].read, min(size, _PIECE_BYTES))
            if not piece:
                break
            size -= len(piece)
            async with asyncio.timeout(_PIECE_S):
                await answer.write(piece)
        return answer
    except OSError as why:  # a hung-up browser, a slow one (TimeoutError), or the disk
        if file is None:
            return web.Response(status=404, text=f"{unusable(path.name, why)}\n")
        raise ConnectionResetError(f"{path.name} was not sent to its end") from why
    finally:
        if file is not None:
            with suppress(Exception):
                await worker.run(file.close)
        worker.close()


def _opened(path: Path) -> tuple[BinaryIO, int]:
    status = path.lstat()
    if not stat.S_ISREG(status.st_mode):
        raise FileNotFoundError(2, "not a file", str(path))
    return path.open("rb"), status.st_size
