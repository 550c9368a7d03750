"""Choose one of several sources that report the same: places of two receivers with two antennas are not mixed.

The first source that gives a quantity is chosen until it is silent, or another one has been clearly better for some seconds.
"""

from msgspec import Struct

from estimator.contracts.time import MonoNs, seconds_between

SILENT_S = 3.0
"""Silence of the chosen source after which another one takes its place."""
_BETTER, _BETTER_FOR_S = 0.6, 3.0
"""Share of the chosen source's sigma below which another one is better, and the time for which it has to be that."""


class _Source(Struct):
    name: str
    sigma: float
    last: MonoNs
    best_at: MonoNs
    """Arrival of `sigma`, the least one of the last seconds: sentences of one receiver differ in what they know."""
    better_since: MonoNs | None = None

    def gave(self, sigma: float, now: MonoNs) -> None:
        if sigma <= self.sigma or seconds_between(self.best_at, now) > SILENT_S:
            self.sigma, self.best_at = sigma, now
        self.last = now


class SourceChoice:
    """Keeps the chosen source of each quantity of one ship."""

    def __init__(self) -> None:
        self._chosen: dict[str, _Source] = {}
        self._other: dict[str, _Source] = {}

    def takes(self, quantity: str, source: str, sigma: float, now: MonoNs) -> bool:
        """Return whether a report of `quantity` by `source`, received `now`, is used; `sigma` is its standard deviation."""
        chosen = self._chosen.get(quantity)
        if chosen is None or (chosen.name != source and seconds_between(chosen.last, now) > SILENT_S):
            self._chosen[quantity] = _Source(source, sigma, now, now)
            return True
        if chosen.name == source:
            chosen.gave(sigma, now)
            return True
        other = self._other.get(quantity)
        if other is None or other.name != source:
            # The best of the others is watched, and any of them once that one is silent.
            if other is not None and sigma >= other.sigma and seconds_between(other.last, now) <= SILENT_S:
                return False
            other = self._other[quantity] = _Source(source, sigma, now, now)
        other.gave(sigma, now)
        if other.sigma >= _BETTER * chosen.sigma:
            other.better_since = None
            return False
        other.better_since = other.better_since or now
        if seconds_between(other.better_since, now) < _BETTER_FOR_S:
            return False
        self._chosen[quantity] = self._other.pop(quantity)
        return True
