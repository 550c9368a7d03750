"""Files that settings name are plain files: no device, pipe or folder, and no larger than what they are for, unpacked too."""

import stat
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

from estimator.contracts.errors import BadInput, unusable

LARGEST_BYTES = 1_000_000
"""Largest file of text: a hundred times the longest settings."""


def refuse_special(path: Path, where: str, largest: int = LARGEST_BYTES) -> None:
    """Refuse what is no plain file, before it is opened: a device may have no end, and a pipe no beginning.

    Args:
        where: the path, or the setting that names it, for errors.

    Raises:
        BadInput: it does not exist, is no plain file, or is larger than `largest` bytes.
    """
    try:
        found = path.stat()
    except OSError as why:
        raise unusable(where, why) from why
    except ValueError as why:  # a path with a NUL character
        raise BadInput(f"{where}: {why}") from why
    if stat.S_ISDIR(found.st_mode):
        raise BadInput(f"{where}: Is a directory")
    if not stat.S_ISREG(found.st_mode):
        raise BadInput(f"{where}: not a file, but a device or a pipe")
    if found.st_size > largest:
        raise BadInput(f"{where}: {found.st_size} bytes; such a file has at most {largest}")


_PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""The packings that unpack in bounded steps. Four kilobytes of bzip2 may hold gigabytes, and zipfile unpacks them at once."""


def unzipped(path: Path, largest: int, wanted: Callable[[str], bool] = lambda _: True) -> dict[str, bytes]:
    """Return files of a zip archive by name; their sizes are summed before any memory is taken for them.

    Args:
        largest: most bytes of all of them together.
        wanted: whether a file of this name is read.

    Raises:
        OSError: the archive cannot be read.
        ValueError: it is none, is damaged or encrypted, or the files are larger.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = [entry for entry in archive.infolist() if wanted(entry.filename)]
            size = sum(entry.file_size for entry in entries)
            if size > largest:
                raise ValueError(f"its files unpack to {size} bytes, and at most {largest} are read")
            if any(entry.compress_type not in _PACKINGS for entry in entries):
                raise ValueError("a packing that is neither stored nor deflated")
            return {entry.filename: archive.read(entry) for entry in entries}
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as why:
        raise ValueError(str(why) or type(why).__name__) from why
