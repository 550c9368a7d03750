"""Records of a soak in a temporary file: what the run remembers of itself must not look like growth of what it watches.

A day of flights is thousands of records of half a kilobyte, some per cent of the process' memory.
"""

from __future__ import annotations

import sys
import tempfile
import weakref
from collections.abc import Iterator
from typing import Generic, TypeVar

import msgspec

T = TypeVar("T")


class Records(Generic[T]):
    """Records in the order in which they came.

    If the temporary folder is full, later records are kept in memory, and stderr says so once.

    Args:
        kind: the type of the records, a dataclass.
    """

    def __init__(self, kind: type[T]) -> None:
        self._encoder, self._decoder = msgspec.json.Encoder(), msgspec.json.Decoder(kind)
        self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - it lives as long as the records
        weakref.finalize(self, self._file.close)
        self._written = 0
        self._rest: list[T] = []

    def append(self, record: T) -> None:
        """Add a record."""
        if not self._rest:
            try:
                whole = self._encoder.encode(record) + b"\n"
                if self._file.write(whole) == len(whole):
                    self._written += 1
                    return
                why = "no space left"
            except OSError as error:
                why = error.strerror or str(error)
            sys.stderr.write(f"{tempfile.gettempdir()}: {why}; the run keeps its further records in memory\n")
        self._rest.append(record)

    def __len__(self) -> int:
        return self._written + len(self._rest)

    def __iter__(self) -> Iterator[T]:
        # A place of its own in the file, so that records may come while one reads.
        with open(f"/proc/self/fd/{self._file.fileno()}", "rb") as lines:
            for _, line in zip(range(self._written), lines, strict=False):
                yield self._decoder.decode(line)
        yield from self._rest
