"""Keep the service small: memory that is free goes back to the system, where the C library is glibc.

glibc keeps what is freed for later, in one arena for each thread. What the first look at a frame needs beside the maps that it
leaves behind is 25 MB, and no later look needs as much.
"""

from __future__ import annotations

import ctypes
from typing import Any

_M_ARENA_MAX = -8
"""The option of glibc's `mallopt` (malloc.h)."""


def share_one_arena() -> None:
    """Let all threads allocate from one arena; call it before there is a second thread."""
    _call("mallopt", _M_ARENA_MAX, 1)


def give_back() -> None:
    """Return what is free to the system."""
    _call("malloc_trim", ctypes.c_size_t(0))


def _call(name: str, *arguments: int | ctypes.c_size_t) -> None:
    """Call a function of the C library; do nothing where it has none of this name."""
    function: Any = getattr(ctypes.CDLL(None), name, None)
    if function is not None:
        function(*arguments)
