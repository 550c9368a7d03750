"""Store events on disk until the broker has them: in append-only files, bounded, in order, readable after a crash.

A spool is a folder. `events-<first number>.log` holds one record a line: CRC-32 of the rest as 8 hexadecimal digits, the
event's number, the event as JSON. `delivered` holds the number up to which the broker has acknowledged. Numbers count up
without a gap for the life of the folder, whose own name is in `name`. Only after a power cut may a number that was never
synced be given again; what identifies an event is in the event.

A record torn by a power cut is cut off when the spool is opened; so is what follows a damaged one in the same file. Losing
`delivered` only means that events are sent again. When the bound is reached, the oldest file is removed, and its undelivered
events are counted. Events that cannot be written (a full or failing disk) wait in memory, bounded too, until writing works again.
"""

import logging
import os
import uuid
import zlib
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from estimator.contracts.errors import BadInput, unusable

log = logging.getLogger(__name__)


FILES = 8
"""The number of files that share the bound, so an eighth of it is removed at a time."""
AHEAD = 512
"""The number of events that are read at a time."""
UNWRITTEN = 1000
"""The number of events that may wait in memory while the disk fails."""


@dataclass(frozen=True, slots=True)
class Record:
    """One spooled event."""

    number: int
    body: bytes


@dataclass(slots=True)
class _File:
    path: Path
    first: int
    count: int
    size: int
    """The size of the whole records, bytes."""
    read_bytes: int = 0


class Spool:
    """A folder of undelivered events. Its methods block, so keep it off the event loop. It has one writer.

    Args:
        folder: the folder, made if it is missing; None keeps events in memory only.
        max_bytes: the bound of all files together.

    Raises:
        BadInput: the named folder cannot be made or read. A failing disk raises nothing: events then stay in memory.
    """

    def __init__(self, folder: Path | None, max_bytes: int) -> None:
        self._folder = folder
        self._file_bytes = max(1, max_bytes // FILES)
        self._unwritten: deque[Record] = deque()
        self._ahead: deque[Record] = deque()
        self._read = 0
        self._dirty: int | None = None
        self._refused = False
        self.torn = self.dropped = self.write_errors = 0
        self.name = uuid.uuid4().hex[:12]
        self.delivered = 0
        self._files: list[_File] = []
        if folder is not None:
            self._open(folder)
        newest = max((f.first + f.count for f in self._files), default=1)
        self.next_number = max(newest, self.delivered + 1)
        self._tidy()

    def _open(self, folder: Path) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self.name = self._named(folder)
            ours = [path for path in sorted(folder.glob("events-*.log")) if path.stem.removeprefix("events-").isdigit()]
            self._files = [self._opened(path) for path in ours]
            self.delivered = self._read_delivered(folder)
        except OSError as why:
            fault = unusable(f"mqtt.spool: {folder}", why)
            if isinstance(fault, BadInput):
                raise fault from why
            # A disk that fails must not keep a drone on the ground, nor a service from coming back in flight.
            log.error("%s: events wait in memory alone until the service is started again", fault)
            self.write_errors += 1
            self._folder, self._files, self.delivered = None, [], 0

    @property
    def waiting(self) -> int:
        """The number of events that are not delivered yet."""
        on_disk = sum(max(0, f.first + f.count - max(f.first, self.delivered + 1)) for f in self._files)
        return on_disk + len(self._unwritten)

    @property
    def size_bytes(self) -> int:
        return sum(f.size for f in self._files)

    def append(self, bodies: list[bytes]) -> None:
        """Append events in order. Events that the disk refuses wait in memory."""
        for body in bodies:
            self._unwritten.append(Record(self.next_number, body))
            self.next_number += 1
        self._write_down()
        while len(self._unwritten) > UNWRITTEN:
            self._unwritten.popleft()
            self.dropped += 1

    def sync(self) -> None:
        """Sync the appended events to disk, so that they survive a power cut."""
        dirty, self._dirty = self._dirty, None
        if dirty is not None:
            try:
                os.fsync(dirty)
            except OSError:
                self.write_errors += 1
            finally:
                os.close(dirty)

    def peek(self, most: int) -> list[Record]:
        """Return the oldest undelivered events."""
        while self._ahead and self._ahead[0].number <= self.delivered:
            self._ahead.popleft()
        if len(self._ahead) < most:
            self._read_on()
        return list(islice(self._ahead, most))

    def deliver(self, number: int) -> None:
        """Record that the broker has every event up to `number`."""
        if number <= self.delivered:
            return
        self.delivered = number
        while self._unwritten and self._unwritten[0].number <= number:
            self._unwritten.popleft()
        self._write_delivered()
        self._tidy()

    def close(self) -> None:
        """Write and sync the remaining events."""
        self._write_down()
        self.sync()

    def _write_down(self) -> None:
        while self._unwritten and self._folder is not None:
            file = self._current(self._folder, self._unwritten[0].number)
            lines, size, count = [], file.size, 0
            for record in self._unwritten:
                line = _line(record)
                if count and size + len(line) > self._file_bytes:
                    break
                lines.append(line)
                size += len(line)
                count += 1
            if not self._wrote(file, b"".join(lines)):
                return
            file.size, file.count = size, file.count + count
            for _ in range(count):
                self._unwritten.popleft()
            self._tidy()

    def _wrote(self, file: _File, data: bytes) -> bool:
        try:
            descriptor = os.open(file.path, os.O_WRONLY | os.O_CREAT, 0o640)
        except OSError as why:
            self._refuses(why)
            return False
        try:
            done = 0
            while done < len(data):
                done += os.pwrite(descriptor, data[done:], file.size + done)
        except OSError as why:
            self._refuses(why)
            with suppress(OSError):
                os.ftruncate(descriptor, file.size)
            os.close(descriptor)
            return False
        if self._refused:
            self._refused = False
            log.warning("mqtt.spool: %s takes events again", self._folder)
        if self._dirty is not None:
            os.close(self._dirty)
        self._dirty = descriptor
        return True

    def _refuses(self, why: OSError) -> None:
        """Log a failure of the disk once: each event tries again, and a disk may fail for the rest of the flight."""
        self.write_errors += 1
        if not self._refused:
            self._refused = True
            log.error("mqtt.spool: %s: %s: events wait in memory, %d at most", self._folder, why.strerror or why, UNWRITTEN)

    def _current(self, folder: Path, number: int) -> _File:
        while self._files and self._files[-1].count == 0:
            self._files.pop()
        newest = self._files[-1] if self._files else None
        if newest is None or newest.size >= self._file_bytes or newest.first + newest.count != number:
            self.sync()
            newest = _File(folder / f"events-{number:020d}.log", number, 0, 0)
            self._files.append(newest)
        return newest

    def _tidy(self) -> None:
        """Remove delivered files, and the oldest file while the bound is exceeded."""
        while self._files and self._files[0].first + self._files[0].count <= self.delivered + 1 and len(self._files) > 1:
            self._remove(self._files.pop(0))
        while len(self._files) > FILES:
            oldest = self._files.pop(0)
            last = oldest.first + oldest.count - 1
            self.dropped += max(0, last - max(oldest.first - 1, self.delivered))
            self.delivered = max(self.delivered, last)
            self._remove(oldest)

    def _remove(self, file: _File) -> None:
        try:
            file.path.unlink(missing_ok=True)
        except OSError:
            self.write_errors += 1

    def _read_on(self) -> None:
        """Fill `_ahead` from the position where reading stopped; every record is read once."""
        for file in self._files:
            if file.read_bytes < file.size and len(self._ahead) < AHEAD:
                self._read_file(file)
        for record in self._unwritten:
            if len(self._ahead) < AHEAD:
                self._add(record)

    def _read_file(self, file: _File) -> None:
        try:
            with file.path.open("rb") as opened:
                opened.seek(file.read_bytes)
                data = opened.read(file.size - file.read_bytes)
        except OSError:
            self.write_errors += 1
            return
        for line in data.splitlines(keepends=True):
            if len(self._ahead) >= AHEAD:
                return
            file.read_bytes += len(line)
            if (record := _record(line.rstrip(b"\n"))) is not None:
                self._add(record)

    def _add(self, record: Record) -> None:
        if record.number > max(self._read, self.delivered):
            self._read = record.number
            self._ahead.append(record)

    def _opened(self, path: Path) -> _File:
        """Return the file with its whole records; cut off the rest."""
        data = path.read_bytes()
        first = int(path.stem.rpartition("-")[2])
        size = count = 0
        for line in data.splitlines(keepends=True):
            record = _record(line.rstrip(b"\n"))
            if not line.endswith(b"\n") or record is None or record.number != first + count:
                self.torn += 1
                os.truncate(path, size)
                break
            size += len(line)
            count += 1
        return _File(path, first, count, size)

    def _named(self, folder: Path) -> str:
        path = folder / "name"
        if path.exists() and (name := path.read_text(errors="replace").strip()) and name.isascii():
            return name
        path.write_text(self.name + "\n")
        return self.name

    def _write_delivered(self) -> None:
        if self._folder is None:
            return
        text = f"{self.delivered}\n".encode()
        try:
            temporary = self._folder / "delivered.new"
            temporary.write_bytes(b"%08x %s" % (zlib.crc32(text), text))
            temporary.replace(self._folder / "delivered")
        except OSError:
            self.write_errors += 1

    def _read_delivered(self, folder: Path) -> int:
        oldest = self._files[0].first - 1 if self._files else 0
        path = folder / "delivered"
        data = path.read_bytes() if path.exists() else b""
        check, _, text = data.partition(b" ")
        if not data or check != b"%08x" % zlib.crc32(text):
            return oldest
        return max(oldest, int(text))


def _line(record: Record) -> bytes:
    body = b"%d %s" % (record.number, record.body)
    return b"%08x %s\n" % (zlib.crc32(body), body)


def _record(line: bytes) -> Record | None:
    check, _, rest = line.partition(b" ")
    number, _, body = rest.partition(b" ")
    if check != b"%08x" % zlib.crc32(rest) or not number.isdigit():
        return None
    return Record(int(number), body)
