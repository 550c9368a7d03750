"""Keep a bug in the handling of one message from ending the service.

Handlers refuse a senseless message by value. An exception that still escapes a handler is a bug of this program: it is counted
and logged once with its traceback, and the next message is handled as usual.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from typing import TypeVar

from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, seconds_between

_log = logging.getLogger(__name__)
_Result = TypeVar("_Result")

_PLACES_MAX = 256
_QUIET_S = 10.0


class Containment:
    """Run handlers and contain the exceptions that escape them.

    Args:
        clock: source of the time, which limits how often an error is logged.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._logged: dict[str, MonoNs] = {}
        self.faults: Counter[str] = Counter()
        """Number of errors that escaped a handler, by place."""

    @property
    def total(self) -> int:
        """Number of errors that were contained."""
        return sum(self.faults.values())

    def run(self, place: str, source: str, handler: Callable[[], _Result]) -> _Result | None:
        """Return the handler's result, or None if it raised an exception.

        Args:
            place: what is being done, with the name of the message; errors are counted under it.
            source: sender of the message, for the log.
            handler: the function to run.
        """
        try:
            return handler()
        except Exception as why:
            self._hold(place, source, why)
            return None

    def _hold(self, place: str, source: str, why: Exception) -> None:
        if place not in self.faults and len(self.faults) >= _PLACES_MAX:
            place = "others"
        self.faults[place] += 1
        now, last = self._clock.now(), self._logged.get(place)
        if last is None:
            _log.error("a bug in %s (from %s); the service goes on without this message", place, source, exc_info=why)
        elif seconds_between(last, now) >= _QUIET_S:
            _log.error(
                "a bug in %s (from %s), %d times so far: %s: %s", place, source, self.faults[place], type(why).__name__, why
            )
        else:
            return
        self._logged[place] = now
