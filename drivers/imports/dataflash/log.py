"""Open an ArduPilot dataflash log through pymavlink, piece by piece where parts of it are damaged.

Its time is `TimeUS`, in logs of 2014 `TimeMS`.
"""

from __future__ import annotations

import contextlib
import io
import os
import struct
import tempfile
import traceback
from enum import IntEnum
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

# DFReader loads a dialect that it does not use. An installed service has only this one (requirements/slim.sh).
os.environ.setdefault("MAVLINK_DIALECT", "common")
os.environ.setdefault("MAVLINK20", "1")
from pymavlink import DFReader

from drivers.file_kinds import DATAFLASH_MAGIC, is_dataflash_text
from drivers.files import Largest, opened
from drivers.log_stamps import Tell, quiet
from estimator.contracts.errors import BadInput, DecklanderError

TEXT_HEAD = 4096
"""Bytes that show whether a file is a log in text."""
_FMT = DATAFLASH_MAGIC + b"\x80"
"""Begin of a message that describes another one."""
_FMT_SIZE = 89  # its length, bytes


class LogEvent(IntEnum):
    """The report of an EV message (LogEvent in AP_Logger)."""

    ARMED = 10
    DISARMED = 11
    LAND_COMPLETE_MAYBE = 17
    LAND_COMPLETE = 18
    NOT_LANDED = 28


def open_log(path: Path, tell: Tell = quiet) -> PartedLog:
    """Open a log; `close` it, or `give_up` after an error.

    Raises:
        BadInput: the file cannot be read or is no dataflash log.
    """
    try:
        with opened(path, Largest.LOG) as file:
            head = file.read(TEXT_HEAD)
        log = None
        if head[:2] == DATAFLASH_MAGIC or is_dataflash_text(head):
            log = PartedLog(path, tell, is_text=head[:2] != DATAFLASH_MAGIC)
    except DecklanderError:
        raise
    except Exception as why:  # pymavlink lets any error of its parser through
        raise BadInput(f"{path}: not a readable dataflash log: {why}") from why
    if log is None:
        raise BadInput(f"{path}: not a dataflash log")
    return log


_FMT_FIELDS = struct.Struct("<BB4s16s64s")


def parts_of(data: bytes | mmap) -> list[bytes]:
    """Return the parts of a binary log between descriptions that replace others; an empty list without such.

    Each part but the first begins with the descriptions that hold there. pymavlink reads a whole file by its last ones.
    """
    known: dict[int, bytes] = {}
    cuts, at = list[tuple[int, bytes]](), data.find(_FMT)
    while at >= 0:
        described = data[at : at + _FMT_SIZE]
        number = _number_of(described)
        if number is None:
            at = data.find(_FMT, at + 1)
            continue
        if known.get(number, described) != described:
            cuts.append((at, b"".join(known.values())))
        known[number] = described
        at = data.find(_FMT, at + _FMT_SIZE)
    if not cuts:
        return []
    begins, ends = [(0, b""), *cuts], [*(at for at, _ in cuts), len(data)]
    return [head + data[begin:end] for (begin, head), end in zip(begins, ends, strict=True)]


def _number_of(described: bytes) -> int | None:
    """Return the number of the message that a FMT describes; None if it is none."""
    if len(described) < _FMT_SIZE:
        return None
    number, size, name, form, columns = _FMT_FIELDS.unpack_from(described, len(_FMT))
    try:
        packed = "<" + "".join(DFReader.FORMAT_TO_STRUCT[letter][0].lstrip("<") for letter in form.rstrip(b"\0").decode())
        plain = (name.rstrip(b"\0") + columns.rstrip(b"\0").replace(b",", b"")).decode("ascii").isprintable()
        return int(number) if plain and struct.calcsize(packed) + 3 == size else None
    except (KeyError, UnicodeDecodeError):
        return None


class PartedLog:
    """A log that pymavlink reads, part by part.

    What pymavlink prints about damage is given to `tell` as one note.
    """

    def __init__(self, path: Path, tell: Tell, *, is_text: bool) -> None:
        self._tell, self._printed = tell, io.StringIO()
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        paths, parts = [path], list[bytes]()
        if not is_text:
            with opened(path, Largest.LOG) as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
                parts = parts_of(data)
        if parts:
            self._folder = tempfile.TemporaryDirectory(prefix="decklander-")
            paths = [Path(self._folder.name) / f"{n}.bin" for n in range(len(parts))]
            for part, described in zip(paths, parts, strict=True):
                part.write_bytes(described)
        self._reader = DFReader.DFReader_text if is_text else DataflashLog
        self._paths = paths
        self._log: Any = None
        try:
            self._next()
        except BaseException as why:
            self.give_up(why)
            raise

    def _next(self) -> None:
        # A reader whose file cannot be read is at hand all the same, to be closed.
        self._log = self._reader.__new__(self._reader)
        with contextlib.redirect_stdout(self._printed), contextlib.redirect_stderr(self._printed):
            self._log.__init__(str(self._paths.pop(0)))

    def recv_match(self, type: list[str]) -> Any:
        """Return the next message of these types, None at the end."""
        while True:
            with contextlib.redirect_stdout(self._printed), contextlib.redirect_stderr(self._printed):
                message = self._log.recv_match(type=type)
            if message is not None or not self._paths:
                return message
            _close(self._log)
            self._next()

    def close(self) -> None:
        """Close the files, and report damage."""
        _close(self._log)
        if self._folder is not None:
            self._folder.cleanup()
        if lines := [line for line in self._printed.getvalue().splitlines() if line.strip()]:
            self._tell(f"damaged: {len(lines)} notes of its parser, the first: {lines[0]}")

    def give_up(self, why: BaseException) -> None:
        """Close the files after an error whose stack frames still refer to them."""
        traceback.clear_frames(why.__traceback__)
        _close(self._log)
        if self._folder is not None:
            self._folder.cleanup()


def _close(log: Any) -> None:
    """Close the files of a reader of pymavlink, which leaves some open."""
    for name in ("filehandle", "data_map"):
        if (opened := getattr(log, name, None)) is not None:
            opened.close()


class DataflashLog(DFReader.DFReader_binary):  # type: ignore[misc]
    """A reader that ends at a message of length 0, at which pymavlink's own loops forever."""

    def _parse_next(self) -> Any:
        before = self.offset
        message = super()._parse_next()
        if message is not None and self.offset <= before:
            raise ValueError(f"a message of no length at byte {before}")
        return message


def time_us(m: Any) -> int | None:
    """Return a message's time since the start of the autopilot, microseconds; None if it has none."""
    if hasattr(m, "TimeUS"):
        return int(m.TimeUS)
    return int(m.TimeMS) * 1000 if hasattr(m, "TimeMS") else None
