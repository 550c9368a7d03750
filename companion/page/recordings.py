"""The recordings that the page offers: which there are, and one-time addresses from which a browser may load one.

A browser's download carries no token, so the page asks for an address over its own connection first. The disk is read on a thread
of its own, piece by piece: a slow one never holds up guidance.
"""

from __future__ import annotations

import asyncio
import re
import secrets
import stat
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from aiohttp import web

from companion.page.messages import DownloadAnswer, RecordingFile, RecordingList
from companion.runtime.worker import Worker
from estimator.contracts.errors import unusable
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, seconds_between

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}\.mcap")
_LISTED = 50
_TICKETS = 16
_TICKET_S = 30.0
_DOWNLOADS = 2
_PIECE_BYTES = 64 * 1024
_PIECE_S = 10.0
"""A browser that takes no piece for so long is hung up on."""
IN_FLIGHT = "the vehicle flies, and its link is not to be shared with a download; ask again on the ground"


class Recordings:
    """See the module's docstring.

    Args:
        folder: the recorder's folder; it may be missing.
    """

    def __init__(self, folder: Path, clock: Clock) -> None:
        self._folder = folder
        self._clock = clock
        self._tickets: dict[str, tuple[str, MonoNs]] = {}
        self._under_way = 0

    def listed(self) -> RecordingList:
        """Return the newest recordings. It reads the disk, so it belongs on a thread."""
        try:
            found = [(path, path.lstat()) for path in self._folder.iterdir() if _NAME.fullmatch(path.name)]
        except FileNotFoundError:
            return RecordingList(files=(), fault="")
        except OSError as why:
            return RecordingList(files=(), fault=str(unusable(str(self._folder), why)))
        files = [
            RecordingFile(name=path.name, size_bytes=status.st_size, unix_s=status.st_mtime)
            for path, status in found
            if stat.S_ISREG(status.st_mode)
        ]
        return RecordingList(files=tuple(sorted(files, key=lambda file: -file.unix_s)[:_LISTED]), fault="")

    def ticket(self, name: str, *, flying: bool) -> DownloadAnswer:
        """Return an address that holds once and for a short time, or why there is none."""
        if flying:
            return DownloadAnswer(name=name, address=None, text=IN_FLIGHT)
        if not _NAME.fullmatch(name):
            return DownloadAnswer(name=name, address=None, text="that is no recording's name")
        if self._under_way >= _DOWNLOADS:
            return DownloadAnswer(name=name, address=None, text=f"{_DOWNLOADS} downloads are under way already")
        while len(self._tickets) >= _TICKETS:
            self._tickets.pop(next(iter(self._tickets)))
        ticket = secrets.token_urlsafe(24)
        self._tickets[ticket] = name, self._clock.now()
        return DownloadAnswer(name=name, address=f"/recordings/{ticket}", text="")

    def redeem(self, ticket: str) -> str | None:
        """Return the name of the recording that a ticket is for, and void the ticket; None if it is none or too old."""
        name, given = self._tickets.pop(ticket, ("", None))
        fresh = given is not None and seconds_between(given, self._clock.now()) <= _TICKET_S
        return name if fresh and self._under_way < _DOWNLOADS else None

    async def send(self, request: web.Request, name: str) -> web.StreamResponse:
        """Send a recording as far as it is written at this moment."""
        worker = Worker("page recordings")
        self._under_way += 1
        file: BinaryIO | None = None
        try:
            file, size = opened = await worker.run(self._opened, name)
            headers = {"Content-Disposition": f'attachment; filename="{name}"', "Content-Type": "application/octet-stream"}
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
                return web.Response(status=404, text=f"{unusable(name, why)}\n")
            raise ConnectionResetError(f"{name} was not sent to its end") from why
        finally:
            self._under_way -= 1
            if file is not None:
                with suppress(Exception):
                    await worker.run(file.close)
            worker.close()

    def _opened(self, name: str) -> tuple[BinaryIO, int]:
        path = self._folder / name
        status = path.lstat()
        if not stat.S_ISREG(status.st_mode):
            raise FileNotFoundError(2, "not a file", str(path))
        return path.open("rb"), status.st_size
