"""Keep a bug in the handling of one message from ending the service.

A message that makes no sense is refused by its handler, by value. What still raises is a bug of ours: it is counted and logged
here, once with its traceback, and the next message is handled as if nothing had happened.
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
    """Runs handlers, and holds what escapes them.

    Args:
        clock: tells when the last line was logged.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._logged: dict[str, MonoNs] = {}
        self.faults: Counter[str] = Counter()
        """Errors that escaped a handler, by place."""

    @property
    def total(self) -> int:
        """Number of errors that were held."""
        return sum(self.faults.values())

    def run(self, place: str, source: str, handler: Callable[[], _Result]) -> _Result | None:
        """Return the handler's result, or None where it raised.

        Args:
            place: what was being done; the message's name belongs to it. The counter goes by it.
            source: where the message came from, for the log.
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
