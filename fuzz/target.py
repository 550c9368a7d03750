"""The table of fuzz targets, the reader of the fuzzer's bytes, and the record of the faults that a run found.

A target is a function of bytes that returns if the code under test kept its contract, and raises if it did not. It suppresses the
errors that the contract names (a `BadInput` of a file, a `Recoverable` of a link) and nothing else. It keeps no state between two
calls, so that an input that fails once fails again. Each fault is recorded once, with the shortest input that shows it.
"""

import hashlib
import importlib
import struct
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

_OF = {
    "ardrone": ("navdata", "pave", "video", "uvlc", "control", "at"),
    "mavlink": ("mavlink_codec", "mavlink_signing"),
    "recordings": ("mcap_bytes", "mcap_messages"),
    "imports": ("dataflash", "ulog", "tlog", "ardrone_capture"),
    "frames": ("v4l2", "vision", "lamps"),
}
MODULES = {name: f"fuzz.{module}" for module, names in _OF.items() for name in names}
"""Every target, and the module whose `TARGETS` holds it."""

SHARED_MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None
"""Folder for inputs that must be files; they are kept in memory if possible, to spare the disk."""
CORPUS = Path(__file__).parent / "corpus"
"""Kept inputs, one folder for each target: the seeds, and every input that once failed."""


@dataclass(frozen=True, slots=True)
class Target:
    """One target."""

    run: Callable[[bytes], None]
    """The function; it returns if the contract was kept and raises if not."""
    seeds: Callable[[], Iterable[bytes]]
    """Well-formed inputs from which the fuzzer starts, made by our own encoders."""
    max_len: int = 4096
    """Length of the longest input that is tried, bytes."""


def target(name: str) -> Target:
    """Return the target of this name.

    Raises:
        KeyError: there is no such target.
    """
    found: Target = importlib.import_module(MODULES[name]).TARGETS[name]
    return found


class Choices:
    """Reads an input as a sequence of choices, with zeros after its end, so that every input is meaningful."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def __bool__(self) -> bool:
        """Return whether any bytes are left."""
        return self._at < len(self._data)

    def number(self, size: int) -> int:
        """Return an unsigned number of `size` bytes, little endian."""
        return int.from_bytes(self.take(size), "little")

    def signed(self, size: int) -> int:
        """Return a signed number of `size` bytes, little endian."""
        return int.from_bytes(self.take(size).ljust(size, b"\0"), "little", signed=True)

    def real(self) -> float:
        """Return any 64-bit float, including infinities and NaN."""
        value: float = struct.unpack("<d", self.take(8).ljust(8, b"\0"))[0]
        return value

    def take(self, size: int) -> bytes:
        """Return the next bytes, fewer at the end."""
        part = self._data[self._at : self._at + size]
        self._at += size
        return part

    def block(self) -> bytes:
        """Return bytes that follow a length of 16 bits."""
        return self.take(self.number(2))

    def blocks(self) -> list[bytes]:
        """Return what is left as blocks."""
        found = []
        while self:
            found.append(self.block())
        return found

    def rest(self) -> bytes:
        """Return all bytes that are left."""
        return self.take(max(0, len(self._data) - self._at))


def block(data: bytes) -> bytes:
    """Return the bytes in the form that `Choices.block` reads."""
    return struct.pack("<H", len(data)) + data


def refused(why: Exception) -> None:
    """Check that a refusal is one line that says what is wrong and where.

    Raises:
        AssertionError: the refusal is not one such line.
    """
    assert "\n" not in str(why).strip(), f"a refusal of more than one line: {why}"


_LONGEST = 20_000
"""Characters of an input's repr and of a traceback that are written down."""


def innermost(why: BaseException) -> BaseException:
    """Return the first error that is not a group."""
    while isinstance(why, BaseExceptionGroup):
        why = why.exceptions[0]
    return why


def signature(why: BaseException, root: Path) -> str:
    """Return the error's kind and the innermost line of ours in its traceback; equal ones count as the same crash."""
    inner = innermost(why)
    ours = [frame for frame in traceback.extract_tb(inner.__traceback__) if Path(frame.filename).is_relative_to(root)]
    ours = [frame for frame in ours if ".venv" not in frame.filename] or ours
    where = f"{Path(ours[-1].filename).relative_to(root)}:{ours[-1].lineno}" if ours else "nowhere"
    return f"{type(inner).__name__} at {where}"


@dataclass(slots=True)
class Finds:
    """Writes each new fault to `folder` as `<target>-<hash>.bin` and `.txt`; a shorter input replaces a longer one.

    Raises:
        OSError: the folder cannot be written to.
    """

    target: str
    folder: Path
    root: Path
    lengths: dict[str, int] = field(default_factory=dict)

    def note(self, data: bytes, why: BaseException) -> None:
        """Record one input that broke the contract."""
        output = signature(why, self.root)
        if len(data) >= self.lengths.get(output, len(data) + 1):
            return
        self.lengths[output] = len(data)
        stem = f"{self.target}-{hashlib.sha256(output.encode()).hexdigest()[:8]}"
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / f"{stem}.bin").write_bytes(data)
        trace = "".join(traceback.format_exception(innermost(why)))
        text = f"{self.target}: {output}\n\ninput ({len(data)} bytes): {data!r:.{_LONGEST}}\n\n{trace[-_LONGEST:]}"
        (self.folder / f"{stem}.txt").write_text(text, encoding="utf-8", errors="backslashreplace")
