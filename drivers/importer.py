"""The port of an importer: what reads others' files into samples and frames, for `decklander record import`.

Decklander's own are functions that read a `FileKind`, in the table of capabilities. A package offers an `Importer` of its own as
an entry point of the group `decklander.importers`.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Protocol

from msgspec import Struct

from drivers.log_stamps import Tell, quiet
from estimator.contracts.samples import Frame, Sample


class ForeignFile(Struct, frozen=True):
    """A file that is imported, with what its reader may need to know."""

    path: Path
    size: tuple[int, int]
    """Width and height of the camera in the settings, px."""
    tell: Tell = quiet
    """Receives notes on what is left out."""
    topic: str = ""
    """Topic of a bag's camera that is read; empty for the best."""


Read = Callable[[ForeignFile], Iterable[Sample | Frame]]
"""Yields what a file holds in order of time, the first at 0 of its own clock.

Raises:
    BadInput: the file cannot be read, or holds nothing that is imported.
"""


class Importer(Protocol):
    """A reader of another package."""

    def recognizes(self, path: Path) -> bool:
        """Return whether a file or folder is of its kind. It is queried before the kinds that are known here."""
        ...

    def read(self, file: ForeignFile) -> Iterable[Sample | Frame]:
        """Read a file of its kind, as `Read`."""
        ...
