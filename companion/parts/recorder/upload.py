"""Upload finished recordings to object storage: a folder, S3 or whatever else fsspec has a file system for.

A recording counts as uploaded when the storage has given back its very bytes. Then its digest lies beside it in both places, as
`NAME.sha256` in the form of `sha256sum`. Nothing here writes to a recording or takes one away.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any, NamedTuple

from companion.base import signals
from companion.parts.recorder.storage_policy import digest_file, recordings
from companion.recording.container import MAGIC
from estimator.contracts.errors import BadInput

_BLOCK_BYTES = 1 << 20
_ABANDONED_S = 60.0
"""A recording without an end that did not grow for so long was cut short by a crash, and is uploaded as it is."""


class Storage(NamedTuple):
    """A place in object storage: the file system of fsspec, and the path in it."""

    system: Any
    root: str

    def at(self, name: str) -> str:
        """Return the path of a file."""
        return f"{self.root.rstrip('/')}/{name}"


def storage(url: str) -> Storage:
    """Return the storage that a URL names, as `s3://bucket/drone_1` or `/mnt/ship/drone_1`.

    Raises:
        BadInput: fsspec or its file system for this URL is not installed, or the URL names none.
    """
    if find_spec("fsspec") is None:
        raise BadInput("record upload needs fsspec, which is not installed: install the extra decklander[fleet]")
    import fsspec

    try:
        system, root = fsspec.core.url_to_fs(url, use_listings_cache=False)
    except (ImportError, ValueError) as why:
        raise BadInput(f"--to {url}: {why}") from why
    return Storage(system, root)


class Uploaded(NamedTuple):
    """A recording that was tried: the reason why the storage does not have it, or None, and its size in bytes."""

    path: Path
    why: str | None
    size: int


def upload(folder: Path, to: Storage) -> Iterator[Uploaded]:
    """Upload the finished recordings of a folder, the oldest first, and yield each result.

    What the storage has is left out. A broken link costs one file, and the next call sends that file again.

    Raises:
        BadInput: the folder cannot be read.
    """
    try:
        waiting = [path for path in recordings(folder) if not digest_file(path).exists()]
    except OSError as why:
        raise BadInput(f"{folder}: {why.strerror or why}") from why
    for path in waiting:
        try:
            if not finished(path):
                continue
            size = path.stat().st_size
            yield Uploaded(path, _sent(path, to), size)
        except Exception as why:  # each file system of fsspec has errors of its own
            yield Uploaded(path, f"{type(why).__name__}: {why}", 0)


def finished(path: Path) -> bool:
    """Return whether nobody writes this recording any more. Raises OSError."""
    with path.open("rb") as stream:
        stream.seek(0, 2)
        if stream.tell() >= 2 * len(MAGIC):
            stream.seek(-len(MAGIC), 2)
            if stream.read() == MAGIC:
                return True
    return time.time() - path.stat().st_mtime > _ABANDONED_S


def _sent(path: Path, to: Storage) -> str | None:
    """Send a recording and compare what arrived; return why it is not there, else None."""
    there = to.at(path.name)
    if not to.system.exists(there) or to.system.size(there) != path.stat().st_size:
        to.system.makedirs(to.root, exist_ok=True)
        to.system.put_file(str(path), there)
    digest = _digest(path.open("rb"))
    if _digest(to.system.open(there, "rb")) != digest:
        to.system.rm_file(there)
        return "what the storage gives back differs; it is sent again"
    line = f"{digest}  {path.name}\n"
    to.system.pipe_file(to.at(digest_file(path).name), line.encode())
    digest_file(path).write_text(line)
    return None


def _digest(stream: IO[bytes]) -> str:
    found = hashlib.sha256()
    with stream:
        while block := stream.read(_BLOCK_BYTES):
            signals.check()
            found.update(block)
    return found.hexdigest()
