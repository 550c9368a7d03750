"""Flights that many tests read: flown once for a state of the product, and kept in the user's cache for the next run.

Other sources, settings or libraries are another state. Workers that want the same flight wait for the one that flies it.
"""

import fcntl
import hashlib
import os
import platform
import shutil
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).parents[2]
DECIDES = ("companion", "configs", "drivers", "estimator", "sitl", "tests/fly.py", "tests/make.py", "tests/support/kept.py")
"""Files and folders that decide what a flight is."""
KEPT_S = 7 * 86_400.0
"""Time for which a state's flights stay after their last use, s."""


@cache
def state() -> str:
    """Return the digest of the product's sources, files and libraries."""
    digest = hashlib.sha256(repr((sys.version, platform.machine(), np.__version__, cv2.__version__)).encode())
    found = (path for start in DECIDES for path in ([ROOT / start] if "." in start else sorted((ROOT / start).rglob("*"))))
    for path in found:
        if path.is_file() and path.suffix != ".pyc":
            digest.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:24]


def folder() -> Path:
    """Return the folder of this state's flights; those of states that were not used for a week are removed."""
    cached = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "decklander-tests"
    own = cached / state()
    own.mkdir(parents=True, exist_ok=True)
    own.touch()
    for other in cached.iterdir():
        if time.time() - other.stat().st_mtime > KEPT_S:
            shutil.rmtree(other, ignore_errors=True)
    return own


class KeptFlights:
    """Recordings by name."""

    def __init__(self, where: Path) -> None:
        self._folder = where

    def __call__(self, name: str, fly: Callable[[Path], object]) -> Path:
        """Return the recording `name`, which is only read; `fly` records it into a path if it is not kept yet."""
        path, new = self._folder / f"{name}.mcap", self._folder / f"new-{name}.mcap"
        with path.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                new.unlink(missing_ok=True)
                fly(new)
                new.replace(path)
        return path
