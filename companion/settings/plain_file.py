"""Files that settings name are files: neither a device, a pipe nor a folder, and no larger than what they are for."""

import stat
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
