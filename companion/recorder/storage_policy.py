"""Where recordings lie: their names, how much room they may take, and what goes when there is too little."""

from __future__ import annotations

import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

MB = 1_000_000
_NAME = re.compile(r"decklander-\d{8}T\d{6}Z-\d{4}\.mcap")


class StoragePolicy(Protocol):
    """Gives out paths for files and says when there is no room."""

    def next_path(self) -> Path:
        """A path that does not exist yet, in a folder that does. Raises OSError where that cannot be had."""
        ...

    def tidy(self, current: Path | None) -> None:
        """Take away what is too much, never `current`. It never raises: what cannot be removed is counted."""
        ...

    def lacks_room(self, least_mb: float = 0.0) -> str | None:
        """Why nothing may be written now, None when it may and at least this much is free. Raises OSError."""
        ...

    @property
    def max_file_bytes(self) -> int | None:
        """After this many a new file begins."""
        ...

    @property
    def not_removed(self) -> int:
        """Number of times that a surplus file could not be removed."""
        ...


@dataclass(slots=True)
class Folder:
    """A folder of numbered files of one start of the service, beside those of earlier ones; the oldest go first.

    Only files named as this class names them are counted and taken away.
    """

    path: Path
    started_utc: str
    """As YYYYMMDDTHHMMSSZ."""
    max_file_mb: float
    max_total_mb: float
    min_free_mb: float
    not_removed: int = 0
    _next: int = 1

    @property
    def max_file_bytes(self) -> int | None:
        return round(self.max_file_mb * MB)

    def next_path(self) -> Path:
        _made(self.path)
        # A link that leads nowhere takes its name as well.
        while os.path.lexists(path := self.path / f"decklander-{self.started_utc}-{self._next:04d}.mcap"):
            self._next += 1
        return path

    def tidy(self, current: Path | None) -> None:
        try:
            files = sorted(p for p in self.path.iterdir() if _NAME.fullmatch(p.name))
        except OSError:
            self.not_removed += 1
            return
        sizes = {path: size for path in files if (size := _size(path)) is not None}
        total = sum(sizes.values())
        for path, size in sizes.items():
            if total <= self.max_total_mb * MB:
                return
            if path != current:
                try:
                    path.unlink(missing_ok=True)
                except OSError:
                    self.not_removed += 1
                    continue
                total -= size

    def lacks_room(self, least_mb: float = 0.0) -> str | None:
        _made(self.path)
        return _lacking(self.path, max(least_mb, self.min_free_mb))


@dataclass(slots=True)
class SingleFile:
    """One file of a given name, replaced when it is there, without bounds; after a pause or a full disk it goes on in NAME-2."""

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
    """Return what failed and on which file, for people."""
    reason = why.strerror or str(why)
    return f"{why.filename}: {reason}" if why.filename else reason


def _made(folder: Path) -> None:
    """Make the folder if it is absent. Raises OSError, which names a link that leads nowhere."""
    if folder.is_symlink() and not folder.exists():
        raise OSError(f"{folder} is a link to {os.readlink(folder)}, which does not exist")
    folder.mkdir(parents=True, exist_ok=True)


def _size(path: Path) -> int | None:
    """Return the bytes of a file, those of a link itself; None when it is gone."""
    try:
        return path.lstat().st_size
    except OSError:
        return None


def _lacking(folder: Path, least_mb: float) -> str | None:
    free = shutil.disk_usage(folder).free
    return None if free >= least_mb * MB else f"{free / MB:.0f} MB free in {folder}, and {least_mb:g} MB are to be"
