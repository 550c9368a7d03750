"""A few sources of the native core in a folder of their own: a test that needs no more compiles no more."""

from __future__ import annotations

import shutil
from pathlib import Path

from supply import core

WITH_HEADERS = f"-I{core.FOLDER}"
"""The compiler's flag for the headers, which stay where they are."""


def part(folder: Path, *names: str) -> Path:
    """Copy the sources whose names match into a new folder, and what every library has: the digest of the interface."""
    folder.mkdir()
    for name in ("core.c", *names):
        for path in core.FOLDER.glob(name):
            shutil.copy2(path, folder)
    return folder
