"""The recordings that the page offers: which there are, and one-time addresses from which a browser may load one.

A browser's download carries no token, so the page asks for an address over its own connection first.
"""

from __future__ import annotations

import os
import re
import secrets
import stat
from pathlib import Path

from aiohttp import web

from companion.parts.page.file_answer import send_file
from companion.parts.page.messages import DownloadAnswer, RecordingFile, RecordingList
from estimator.contracts.errors import unusable
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, seconds_between

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}\.mcap")
_LISTED = 50
_TICKETS = 16
_TICKET_S = 30.0
_DOWNLOADS = 2
IN_FLIGHT = "the vehicle flies, and its link is not to be shared with a download; ask again on the ground"
NO_NAME = "that is no recording's name"


def is_recording_name(name: str) -> bool:
    """Return whether a file of the recorder's folder may have this name: one without a path."""
    return _NAME.fullmatch(name) is not None


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
            found = [(path, _status(path)) for path in self._folder.iterdir() if is_recording_name(path.name)]
        except FileNotFoundError:
            return RecordingList(files=(), fault="")
        except OSError as why:
            return RecordingList(files=(), fault=str(unusable(str(self._folder), why)))
        files = [
            RecordingFile(name=path.name, size_bytes=status.st_size, unix_s=status.st_mtime)
            for path, status in found
            if status is not None and stat.S_ISREG(status.st_mode)
        ]
        return RecordingList(files=tuple(sorted(files, key=lambda file: -file.unix_s)[:_LISTED]), fault="")

    def ticket(self, name: str, *, flying: bool) -> DownloadAnswer:
        """Return an address that holds once and for a short time, or why there is none."""
        if flying:
            return DownloadAnswer(name=name, address=None, text=IN_FLIGHT)
        if not is_recording_name(name):
            return DownloadAnswer(name=name, address=None, text=NO_NAME)
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
        headers = {"Content-Disposition": f'attachment; filename="{name}"', "Content-Type": "application/octet-stream"}
        self._under_way += 1
        try:
            return await send_file(request, self._folder / name, headers)
        finally:
            self._under_way -= 1


def _status(path: Path) -> os.stat_result | None:
    """Return a file's state, or None if the recorder has removed it since it was listed."""
    try:
        return path.lstat()
    except FileNotFoundError:
        return None
