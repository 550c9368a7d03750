"""Memory of the process: what is free goes back to the system (glibc), and no full collection stops a flight.

glibc keeps what is freed for later, in one arena for each thread. What the first look at a frame needs beside the maps that it
leaves behind is 25 MB, and no later look needs as much.
"""

import ctypes
import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from estimator.contracts.time import MonoNs, seconds_between

# Keep full garbage collections out of the flight: one stops every thread for some 30 ms on a desktop core.
#
# What exists when the service has started is moved out of the collector's sight. Young objects are collected as ever; the
# oldest generation only while the vehicle is not known to fly.

_PERIOD_S = 60.0  # time between two full collections on the ground
_NEVER = 2**30  # threshold that no number of collections reaches
_M_ARENA_MAX = -8
"""The option of glibc's `mallopt` (malloc.h)."""


class GroundedCollector:
    """Collects the oldest generation once a minute, and only on the ground."""

    def __init__(self) -> None:
        self._last: MonoNs | None = None
        self.collections = 0

    def tick(self, now: MonoNs, flying: bool | None) -> None:
        """Collect if it is time and the vehicle does not fly.

        Args:
            flying: the vehicle's latest word; None while it has given none, as before its link is up.
        """
        if self._last is None:
            self._last = now
        if flying or seconds_between(self._last, now) < _PERIOD_S:
            return
        gc.collect()
        self._last = now
        self.collections += 1


@contextmanager
def no_full_collections() -> Iterator[None]:
    """Collect once, freeze what is left, and let the interpreter start no full collection by itself until the end."""
    before = gc.get_threshold()
    gc.collect()
    gc.freeze()
    gc.set_threshold(*before[:2], _NEVER)
    try:
        yield
    finally:
        gc.set_threshold(*before)
        gc.unfreeze()


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
