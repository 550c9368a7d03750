"""Send the page's own files, and files of the disk in pieces."""

import asyncio
import mimetypes
import stat
from collections.abc import Mapping
from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import BinaryIO

from aiohttp import web
from msgspec import Struct

from companion.base.worker import Worker
from estimator.contracts.errors import unusable

_PIECE_BYTES = 64 * 1024  # bytes that are sent at once
_PIECE_S = 10.0
"""A browser that takes no piece for so long is hung up on."""


class Asset(Struct, frozen=True):
    """One file of the page."""

    body: bytes
    content_type: str

    async def answer(self, request: web.Request) -> web.Response:
        """Answer a request with this file."""
        return web.Response(body=self.body, headers={"Content-Type": self.content_type})


def assets() -> dict[str, Asset]:
    """Return the files by their paths in an address: the page itself at `/`, the others by their names."""
    # The built-in table alone: a host's own may call a script plain text, which a browser does not run.
    found, types = {}, mimetypes.MimeTypes()
    for file in (resources.files("companion.parts.page") / "static").iterdir():
        kind, _ = types.guess_type(file.name)
        if kind is not None:
            charset = "; charset=utf-8" if kind.startswith("text/") else ""
            found["/" if file.name == "index.html" else f"/{file.name}"] = Asset(file.read_bytes(), kind + charset)
    return found


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
