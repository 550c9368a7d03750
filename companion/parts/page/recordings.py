"""The recordings that the page offers: which there are, their reports, and one-time addresses from which a browser may load one.

A browser's download carries no token, so the page requests an address over its own connection first.
"""

import asyncio
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from pathlib import Path
from types import MappingProxyType

from aiohttp import web

from companion.base.http_server import HttpServer
from companion.base.worker import Worker
from companion.parts.page.file_answer import send_file
from companion.parts.page.messages import (
    DownloadAnswer,
    DownloadRequest,
    RecordingFile,
    RecordingList,
    RecordingsRequest,
    ReportAnswer,
    ReportRequest,
    ToolRequest,
)
from companion.parts.page.viewer import PageViewer, Tool
from drivers.mailbox import Line
from estimator.contracts.errors import in_words, unusable
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, seconds_between

# The reports that the page shows of recordings, each made by a process of its own while the vehicle is on the ground.
#
# A report holds texts of whoever spoke to the service, so it is served into a sandbox: it is of no origin, and reaches neither
# this page nor its token.

HEADERS: Mapping[str, str] = MappingProxyType(
    {
        "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
        "media-src blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; sandbox allow-scripts",
        "Content-Type": "text/html; charset=utf-8",
    }
)
_WAITING = 4
_KEPT = 3
"""Reports that stay on the disk, the newest."""
_MAKING_S = 600.0
_LOOKS_S = 0.2
_BYTES_MAX = 400_000_000
"""Recordings beyond this, some four minutes with pictures, would take too much of a small computer's memory."""
_NICE = 19
_OOM_SCORE = 500
"""If memory runs short the kernel ends the report, not the service."""


class ReportMaker(Tool):
    """Makes the reports of recordings, one at a time.

    Args:
        folder: the recorder's folder.
        flying: whether the vehicle flies now.
        counts: the counters of the page.
    """

    kinds = (ReportRequest,)

    def __init__(self, server: HttpServer, folder: Path, flying: Callable[[], bool], counts: Counter[str]) -> None:
        self._server = server
        self._folder = folder
        self._flying = flying
        self._counts = counts
        self._asked: Line[tuple[PageViewer, str]] = Line(_WAITING)
        self._made: dict[str, Path] = {}
        self._under_way = False
        server.serve("/reports/{ticket}", self._serve)

    def ask(self, viewer: PageViewer, request: ToolRequest) -> None:
        """Make a report of a recording soon and send the viewer its address, or at once the reason for none."""
        assert isinstance(request, ReportRequest)
        name = request.name
        refusal = self._refusal(name)
        if refusal is not None:
            viewer.tell(ReportAnswer(name=name, address=None, text=refusal))
            return
        waits = self._under_way or len(self._asked) > 0
        viewer.tell(ReportAnswer(name=name, address=None, text="waits for another one" if waits else "is being made"))
        self._asked.offer((viewer, name))

    async def _serve(self, request: web.Request) -> web.StreamResponse:
        path = self._made.get(request.match_info["ticket"])
        if path is None:
            return web.Response(status=404, text="this report is no longer kept; ask for it again on the page\n")
        self._counts["reports"] += 1
        self._server.limits.lift(request.transport)
        return await send_file(request, path, HEADERS)

    async def run(self) -> None:
        """Make reports, one after another, until cancelled; then they are deleted."""
        with tempfile.TemporaryDirectory(prefix="decklander-reports-", ignore_cleanup_errors=True) as folder:
            try:
                async for viewer, name in self._asked:
                    self._under_way = True
                    viewer.tell(await self._make(name, Path(folder)))
                    self._under_way = False
            finally:
                self._made.clear()

    def _refusal(self, name: str) -> str | None:
        if self._flying():
            return IN_FLIGHT
        if not is_recording_name(name):
            return NO_NAME
        if len(self._asked) >= _WAITING:
            return f"{_WAITING} reports wait already"
        return None

    async def _make(self, name: str, folder: Path) -> ReportAnswer:
        ticket = secrets.token_urlsafe(24)
        page = folder / f"{ticket}.html"
        try:
            fault = await asyncio.to_thread(self._unfit, name) or await self._written(self._folder / name, page)
        except OSError as why:
            fault = in_words(why)
        if fault is not None:
            page.unlink(missing_ok=True)
            return ReportAnswer(name=name, address=None, text=fault)
        while len(self._made) >= _KEPT:
            oldest = next(iter(self._made))
            self._made.pop(oldest).unlink(missing_ok=True)
        self._made[ticket] = page
        return ReportAnswer(name=name, address=f"/reports/{ticket}", text="")

    def _unfit(self, name: str) -> str | None:
        status = (self._folder / name).lstat()
        if not stat.S_ISREG(status.st_mode):
            return "not a file"
        if status.st_size > _BYTES_MAX:
            return f"has {status.st_size / 1e6:.0f} MB, over {_BYTES_MAX / 1e6:.0f}: download it, then `decklander report {name}`"
        free = shutil.disk_usage(tempfile.gettempdir()).free
        return None if free > status.st_size else f"needs {status.st_size / 1e6:.0f} MB in {tempfile.gettempdir()}, which is full"

    async def _written(self, recording: Path, page: Path) -> str | None:
        """Let a process write a report; return why it did not."""
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "companion.cli.main", "report", str(recording), "--output", str(page),
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        async with asyncio.TaskGroup() as group:
            printed = group.create_task(_last_line(process))
            try:
                _stand_back(process.pid)
                fault = await self._ended(process)
            finally:
                if process.returncode is None:
                    process.kill()
                await process.wait()
        if fault is None and process.returncode != 0:
            return printed.result() or f"ended with {process.returncode}"
        return fault

    async def _ended(self, process: asyncio.subprocess.Process) -> str | None:
        """Wait until the process ends; return why it has to end before that."""
        try:
            async with asyncio.timeout(_MAKING_S):
                while process.returncode is None:
                    if self._flying():
                        return IN_FLIGHT
                    with suppress(TimeoutError):
                        await asyncio.wait_for(process.wait(), _LOOKS_S)
        except TimeoutError:
            return f"was not made within {_MAKING_S:.0f} s"
        return None


def _stand_back(pid: int) -> None:
    """Let a process take what the service leaves, as far as this system allows to say so."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, pid, _NICE)
    with suppress(OSError):
        Path(f"/proc/{pid}/oom_score_adj").write_text(str(_OOM_SCORE))


async def _last_line(process: asyncio.subprocess.Process) -> str:
    assert process.stderr is not None
    lines = (await process.stderr.read()).decode(errors="replace").splitlines()
    return lines[-1].strip().removeprefix("decklander: ")[:300] if lines else ""


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


class Recordings(Tool):
    """See the module's docstring.

    Args:
        folder: the recorder's folder; it may be missing.
        flying: whether the vehicle flies now.
        counts: the counters of the page.
    """

    kinds = (RecordingsRequest, DownloadRequest)

    def __init__(self, server: HttpServer, folder: Path, clock: Clock, flying: Callable[[], bool], counts: Counter[str]) -> None:
        self._server = server
        self._folder = folder
        self._clock = clock
        self._flying = flying
        self._counts = counts
        self._tickets: dict[str, tuple[str, MonoNs]] = {}
        self._under_way = 0
        self._asked: Line[PageViewer] = Line(_WAITING)
        server.serve("/recordings/{ticket}", self._serve)

    def ask(self, viewer: PageViewer, request: ToolRequest) -> None:
        """Send a viewer the list of recordings soon, or at once the address of one."""
        if isinstance(request, DownloadRequest):
            viewer.tell(self._ticket(request.name))
        else:
            self._asked.offer(viewer)

    async def run(self) -> None:
        """List recordings for those who ask, until cancelled."""
        with closing(Worker("page lists")) as worker:
            async for viewer in self._asked:
                viewer.tell(await worker.run(recordings_in, self._folder))

    def _ticket(self, name: str) -> DownloadAnswer:
        """Return an address that holds once and for a short time, or why there is none."""
        refusal = IN_FLIGHT if self._flying() else None if is_recording_name(name) else NO_NAME
        if refusal is None and self._under_way >= _DOWNLOADS:
            refusal = f"{_DOWNLOADS} downloads are under way already"
        if refusal is not None:
            return DownloadAnswer(name=name, address=None, text=refusal)
        while len(self._tickets) >= _TICKETS:
            self._tickets.pop(next(iter(self._tickets)))
        ticket = secrets.token_urlsafe(24)
        self._tickets[ticket] = name, self._clock.now()
        return DownloadAnswer(name=name, address=f"/recordings/{ticket}", text="")

    async def _serve(self, request: web.Request) -> web.StreamResponse:
        """Send the recording that a ticket is for, as far as it is written at this moment, and void the ticket."""
        name, given = self._tickets.pop(request.match_info["ticket"], ("", None))
        if given is None or seconds_between(given, self._clock.now()) > _TICKET_S or self._under_way >= _DOWNLOADS:
            return web.Response(status=404, text="this address holds once, and only for a short time\n")
        self._counts["downloads"] += 1
        self._server.limits.lift(request.transport)
        headers = {"Content-Disposition": f'attachment; filename="{name}"', "Content-Type": "application/octet-stream"}
        self._under_way += 1
        try:
            return await send_file(request, self._folder / name, headers)
        finally:
            self._under_way -= 1


def recordings_in(folder: Path) -> RecordingList:
    """Return the newest recordings of a folder. It reads the disk, so it belongs on a thread."""
    try:
        found = [(path, _status(path)) for path in folder.iterdir() if is_recording_name(path.name)]
    except FileNotFoundError:
        return RecordingList(files=(), fault="")
    except OSError as why:
        return RecordingList(files=(), fault=str(unusable(str(folder), why)))
    files = [
        RecordingFile(name=path.name, size_bytes=status.st_size, unix_s=status.st_mtime)
        for path, status in found
        if status is not None and stat.S_ISREG(status.st_mode)
    ]
    return RecordingList(files=tuple(sorted(files, key=lambda file: -file.unix_s)[:_LISTED]), fault="")


def _status(path: Path) -> os.stat_result | None:
    """Return a file's state, or None if the recorder has removed it since it was listed."""
    try:
        return path.lstat()
    except FileNotFoundError:
        return None
