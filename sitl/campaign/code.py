"""The code that a flight was flown with: a digest of the packages' sources, and the versions that decide its arithmetic."""

import hashlib
import platform
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np

_PACKAGES = ("companion", "configs", "drivers", "estimator", "sitl")
_SOURCES = (".py", ".toml", ".npz", ".c", ".h")
_TEST_SUPPORT = ("sitl", "testing")
"""Not in the wheel, and no flight needs it."""


@cache
def code_version() -> dict[str, str]:
    """Return what a flight's result depends on beside its scenario, seed and settings, by name."""
    return {
        "sources": sources_digest(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "machine": platform.machine(),
    }


def sources_digest() -> str:
    """Return a digest of the names and contents of all source files of the installed packages."""
    digest = hashlib.blake2b(digest_size=16)
    for package in _PACKAGES:
        spec = find_spec(package)
        assert spec is not None
        assert spec.submodule_search_locations is not None
        root = Path(next(iter(spec.submodule_search_locations)))
        for path in sorted(root.rglob("*")):
            parts = (package, *path.relative_to(root).parts)
            if path.suffix in _SOURCES and parts[:2] != _TEST_SUPPORT:
                content = path.read_bytes()
                digest.update(f"{'/'.join(parts)}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def differences(ours: dict[str, str], other: dict[str, str]) -> str:
    """Return what differs between two versions of the code, in words; empty where they agree."""
    words = []
    for name in sorted(ours.keys() | other.keys()):
        one, two = ours.get(name, "none"), other.get(name, "none")
        if one != two:
            words.append(f"{name} {two[:12]} instead of {one[:12]}")
    return ", ".join(words)
