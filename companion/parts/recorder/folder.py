"""Choose the files of recordings: a folder with a bound on its size, whose oldest files are removed first, or one file."""

from __future__ import annotations

import logging
import os
import re
import shutil
import time
from contextlib import suppress
from datetime import datetime, timedelta
from pathlib import Path
from typing import Literal

from msgspec import Struct

log = logging.getLogger(__name__)

_STARTED = "%Y%m%dT%H%M%SZ"
_NAME = re.compile(r"decklander-\d{8}T\d{6}Z-\d{4}\.mcap")

MB = 1_000_000
"""Bytes of a megabyte."""


def recordings(folder: Path) -> list[Path]:
    """Return the recordings that the service has written into this folder, the oldest first. Raises OSError."""
    return sorted(p for p in folder.iterdir() if _NAME.fullmatch(p.name))


def start_of(folder: Path) -> str:
    """Return the time that names this start of the service, as YYYYMMDDTHHMMSSZ in UTC.

    A computer without a clock of its own starts in the past. Then it is a second after the newest recording of the folder: the
    names give the order in which recordings are removed.
    """
    now, newest = time.strftime(_STARTED, time.gmtime()), ""
    with suppress(OSError, IndexError):
        newest = recordings(folder)[-1].name[len("decklander-") :][: len(now)]
    if newest <= now:
        return now
    with suppress(ValueError, OverflowError):
        later = (datetime.strptime(newest, _STARTED) + timedelta(seconds=1)).strftime(_STARTED)
        log.warning("recorder: this computer's clock (%s) is behind the newest recording in %s: named %s", now, folder, later)
        return later
    return now


def digest_file(recording: Path) -> Path:
    """Return the file that says that a recording is uploaded, by its digest."""
    return recording.with_name(f"{recording.name}.sha256")


class Folder(Struct):
    """A folder of the numbered files of this and earlier starts of the service; the oldest are removed first.

    Only files named as this class names them are counted and taken away.
    """

    path: Path
    started_utc: str
    """The service's start in UTC, as YYYYMMDDTHHMMSSZ."""
    max_file_mb: float
    max_total_mb: float
    min_free_mb: float
    delete: Literal["oldest", "uploaded"] = "oldest"
    """The files that are removed: the oldest, or the oldest of those that were uploaded (`decklander record upload`)."""
    not_removed: int = 0
    """The number of times that a surplus file could not be removed."""
    _next: int = 1
    _too_much: bool = False

    @property
    def max_file_bytes(self) -> int | None:
        """The size after which a new file begins, bytes; None sets no limit."""
        return round(self.max_file_mb * MB)

    def next_path(self) -> Path:
        """Return a path that does not exist yet, in a folder that does. Raises OSError if there is none."""
        _made(self.path)
        # A dangling link occupies its name as well.
        while os.path.lexists(path := self.path / f"decklander-{self.started_utc}-{self._next:04d}.mcap"):
            self._next += 1
        return path

    def tidy(self, current: Path | None) -> None:
        """Remove surplus files, but never `current`. It never raises: a file that cannot be removed is counted."""
        try:
            files = recordings(self.path)
        except OSError:
            self.not_removed += 1
            return
        sizes = {path: size for path in files if (size := _size(path)) is not None}
        total = sum(sizes.values())
        for path, size in sizes.items():
            if total <= self.max_total_mb * MB:
                break
            if path == current or (self.delete == "uploaded" and not digest_file(path).exists()):
                continue
            try:
                path.unlink(missing_ok=True)
                digest_file(path).unlink(missing_ok=True)
            except OSError:
                self.not_removed += 1
                continue
            total -= size
        self._too_much = self.delete == "uploaded" and total > self.max_total_mb * MB

    def lacks_room(self, least_mb: float = 0.0) -> str | None:
        """Return why nothing may be written now, or None if at least `least_mb` is free. Raises OSError."""
        _made(self.path)
        if self._too_much:
            self.tidy(None)
        if self._too_much:
            return f"more than {self.max_total_mb:g} MB of recordings in {self.path} are not uploaded"
        return _lacking(self.path, max(least_mb, self.min_free_mb))


class SingleFile(Struct):
    """One file of a given name, replaced if it exists, without bounds; after a pause or a full disk, NAME-2 continues it."""

    path: Path
    not_removed: int = 0
    _next: int = 1

    @property
    def max_file_bytes(self) -> int | None:
        return None

    def next_path(self) -> Path:
        if self._next == 1:
            self._next = 2
            self.path.unlink(missing_ok=True)
            return self.path
        while os.path.lexists(path := self.path.with_stem(f"{self.path.stem}-{self._next}")):
            self._next += 1
        return path

    def tidy(self, current: Path | None) -> None:
        return None

    def lacks_room(self, least_mb: float = 0.0) -> str | None:
        return _lacking(self.path.parent, least_mb)


def in_words(why: OSError) -> str:
    """Return a readable text that names the failure and its file."""
    reason = why.strerror or str(why)
    return f"{why.filename}: {reason}" if why.filename else reason


def _made(folder: Path) -> None:
    """Make the folder if it is absent. Raises OSError, which names a dangling link."""
    if folder.is_symlink() and not folder.exists():
        raise OSError(f"{folder} is a link to {os.readlink(folder)}, which does not exist")
    folder.mkdir(parents=True, exist_ok=True)


def _size(path: Path) -> int | None:
    """Return the size of a file (of a link itself) in bytes, or None if it is gone."""
    try:
        return path.lstat().st_size
    except OSError:
        return None


def _lacking(folder: Path, least_mb: float) -> str | None:
    free = shutil.disk_usage(folder).free
    return None if free >= least_mb * MB else f"{free / MB:.0f} MB free in {folder}, and {least_mb:g} MB are to be"
