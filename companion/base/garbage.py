"""Keep full garbage collections out of the flight: one stops every thread for some 30 ms on a desktop core.

What exists when the service has started is moved out of the collector's sight. Young objects are collected as ever; the
oldest generation only while the vehicle is not known to fly.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

from estimator.contracts.time import MonoNs, seconds_between

_PERIOD_S = 60.0
_NEVER = 2**30


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
