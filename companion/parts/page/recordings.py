"""Files for a browser: the page's own, and the recordings that it offers, with their reports and one-time addresses.

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
from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path
from types import MappingProxyType

from aiohttp import web

from companion.base.worker import Worker
from companion.parts.page.files import send_file
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
from companion.parts.page.viewer import PageService, PageViewer, Tool
from drivers.mailbox import Line
from estimator.contracts.errors import in_words, unusable
from estimator.contracts.time import MonoNs, seconds_between

_WAITING = 4  # requests of either kind that may wait
_KEPT = 3
"""Reports that stay on the disk, the newest."""
_MAKING_S = 600.0  # time of a report
_LOOKS_S = 0.2  # interval at which a flight that begins ends it
_BYTES_MAX = 400_000_000
"""Recordings beyond this, some four minutes with pictures, would take too much of a small computer's memory."""
_NICE = 19  # priority of the report: the lowest
_OOM_SCORE = 500
"""If memory runs short the kernel ends the report, not the service."""
_LISTED = 50  # recordings that are listed, the newest
_TICKETS = 16  # tickets for downloads that are kept
_TICKET_S = 30.0  # time for which a ticket is good
_DOWNLOADS = 2  # downloads at a time


# The reports that the page shows of recordings are each made by a process of its own while the vehicle is on the ground.
# A report holds texts of all senders to the service, so it is served into a sandbox: it is of no origin, and reaches neither
# this page nor its token.

HEADERS: Mapping[str, str] = MappingProxyType(
    {
        "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
        "media-src blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; sandbox allow-scripts",
        "Content-Type": "text/html; charset=utf-8",
    }
)
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}\.mcap")
"""Names of the recorder's files: without a path."""
IN_FLIGHT = "the vehicle flies, and its link is not to be shared with a download; ask again on the ground"


class Recordings(Tool):
    """Lists the recordings, sends one to a browser that has its address, and makes their reports, one at a time."""

    kinds = (RecordingsRequest, DownloadRequest, ReportRequest)

    def __init__(self, service: PageService) -> None:
        self._service = service
        self._folder = Path(service.settings.recorder.folder)
        self._lists: Line[PageViewer] = Line(_WAITING)
        self._tickets: dict[str, tuple[str, MonoNs]] = {}
        self._downloads = 0
        self._wanted: Line[tuple[PageViewer, str]] = Line(_WAITING)
        self._reports: dict[str, Path] = {}
        self._making = False
        service.server.serve("/recordings/{ticket}", self._send_recording)
        service.server.serve("/reports/{ticket}", self._send_report)

    def ask(self, viewer: PageViewer, request: ToolRequest) -> None:
        """Send a viewer the list of recordings or the address of a report soon, and the address of a recording at once."""
        if isinstance(request, DownloadRequest):
            refusal = self._refusal(request.name, self._downloads, _DOWNLOADS, "downloads are under way already")
            address = None if refusal else f"recordings/{self._ticket(request.name)}"
            viewer.tell(DownloadAnswer(name=request.name, address=address, text=refusal))
        elif isinstance(request, ReportRequest):
            refusal = self._refusal(request.name, len(self._wanted), _WAITING, "reports wait already")
            progress = "waits for another one" if self._making or len(self._wanted) > 0 else "is being made"
            viewer.tell(ReportAnswer(name=request.name, address=None, text=refusal or progress))
            if not refusal:
                self._wanted.offer((viewer, request.name))
        else:
            self._lists.offer(viewer)

    async def run(self) -> None:
        """List recordings and make reports for those who ask, until cancelled; then the reports are deleted."""
        async with asyncio.TaskGroup() as group:
            group.create_task(self._list())
            group.create_task(self._make_reports())

    def _refusal(self, name: str, under_way: int, most: int, what: str) -> str:
        """Return why a recording is neither sent nor read now; empty if it is."""
        if self._service.flying:
            return IN_FLIGHT
        if not _NAME.fullmatch(name):
            return "that is no recording's name"
        return f"{most} {what}" if under_way >= most else ""

    async def _list(self) -> None:
        with closing(Worker("page lists")) as worker:
            async for viewer in self._lists:
                viewer.tell(await worker.run(recordings_in, self._folder))

    def _ticket(self, name: str) -> str:
        """Return what an address ends with that holds once and for a short time."""
        while len(self._tickets) >= _TICKETS:
            self._tickets.pop(next(iter(self._tickets)))
        ticket = secrets.token_urlsafe(24)
        self._tickets[ticket] = name, self._service.clock.now()
        return ticket

    async def _send_recording(self, request: web.Request) -> web.StreamResponse:
        """Send the recording that a ticket is for, as far as it is written at this moment, and void the ticket."""
        name, given = self._tickets.pop(request.match_info["ticket"], ("", None))
        too_late = given is None or seconds_between(given, self._service.clock.now()) > _TICKET_S
        if too_late or self._downloads >= _DOWNLOADS:
            return web.Response(status=404, text="this address holds once, and only for a short time\n")
        headers = {"Content-Disposition": f'attachment; filename="{name}"', "Content-Type": "application/octet-stream"}
        self._downloads += 1
        try:
            return await self._send(request, self._folder / name, headers, "downloads")
        finally:
            self._downloads -= 1

    async def _send_report(self, request: web.Request) -> web.StreamResponse:
        path = self._reports.get(request.match_info["ticket"])
        if path is None:
            return web.Response(status=404, text="this report is no longer kept; ask for it again on the page\n")
        return await self._send(request, path, HEADERS, "reports")

    async def _send(self, request: web.Request, path: Path, headers: Mapping[str, str], counter: str) -> web.StreamResponse:
        self._service.counts[counter] += 1
        self._service.server.limits.lift(request.transport)
        return await send_file(request, path, headers)

    async def _make_reports(self) -> None:
        with tempfile.TemporaryDirectory(prefix="decklander-reports-", ignore_cleanup_errors=True) as folder:
            try:
                async for viewer, name in self._wanted:
                    self._making = True
                    viewer.tell(await self._make(name, Path(folder)))
                    self._making = False
            finally:
                self._reports.clear()

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
        while len(self._reports) >= _KEPT:
            oldest = next(iter(self._reports))
            self._reports.pop(oldest).unlink(missing_ok=True)
        self._reports[ticket] = page
        return ReportAnswer(name=name, address=f"reports/{ticket}", text="")

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
            sys.executable, "-m", "decklander", "report", str(recording), "--output", str(page),
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
                    if self._service.flying:
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


def recordings_in(folder: Path) -> RecordingList:
    """Return the newest recordings of a folder. It reads the disk, so it belongs on a thread."""
    files = []
    try:
        for path in folder.iterdir():
            with suppress(FileNotFoundError):  # the recorder has removed it since it was listed
                status = path.lstat()
                if _NAME.fullmatch(path.name) and stat.S_ISREG(status.st_mode):
                    files.append(RecordingFile(name=path.name, size_bytes=status.st_size, unix_s=status.st_mtime))
    except FileNotFoundError:
        return RecordingList(files=(), fault="")
    except OSError as why:
        return RecordingList(files=(), fault=str(unusable(str(folder), why)))
    return RecordingList(files=tuple(sorted(files, key=lambda file: -file.unix_s)[:_LISTED]), fault="")
