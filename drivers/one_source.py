"""Choose one of several sources that report the same: places of two receivers with two antennas are not mixed.

The first source that gives a quantity is chosen until it is silent, or another one has been clearly better for some seconds.
"""

from collections.abc import Callable

from msgspec import Struct

from estimator.contracts.time import MonoNs, seconds_between

SILENT_S = 3.0
"""Silence of the chosen source after which another one takes its place."""
_SILENT_GAPS = 3.0  # such a silence of one that reports seldom, in its own intervals
_SILENT_MAX_S = 30.0  # such a silence at most
_BETTER = 0.6  # share of the chosen source's sigma below which another one is better
_BETTER_FOR_S = 3.0  # time for which another source has to be better
_SOURCES_MAX = 16  # sources that are kept


class _Source(Struct):
    sigma: float
    last: MonoNs
    best_at: MonoNs
    """Arrival of `sigma`, the least one of the last seconds: sentences of one receiver differ in what they know."""
    gap_s: float = 0.0
    """Usual interval of its reports."""
    better_since: MonoNs | None = None

    def silent(self, now: MonoNs) -> bool:
        return seconds_between(self.last, now) > min(_SILENT_MAX_S, max(SILENT_S, _SILENT_GAPS * self.gap_s))

    def gave(self, sigma: float, now: MonoNs) -> None:
        if sigma <= self.sigma or seconds_between(self.best_at, now) > SILENT_S:
            self.sigma, self.best_at = sigma, now
        if self.silent(now):
            self.better_since = None
        between_s = seconds_between(self.last, now)
        self.gap_s += (0.3 if self.gap_s else 1.0) * (between_s - self.gap_s)
        self.last = now


class SourceChoice:
    """Keeps the chosen source of each quantity of one ship.

    Args:
        tell: is given a line where another source takes the place of the chosen one, whose place on board it may not have.
    """

    def __init__(self, tell: Callable[[str], None] = lambda text: None) -> None:
        self._tell = tell
        self._names: dict[str, str] = {}
        """The name of the chosen source of each quantity."""
        self._sources: dict[str, dict[str, _Source]] = {}
        self._chosen: dict[str, _Source] = {}

    def takes(self, quantity: str, source: str, sigma: float, now: MonoNs) -> bool:
        """Return whether a report of `quantity` by `source`, received `now`, is used; `sigma` is its standard deviation."""
        sources = self._sources.setdefault(quantity, {})
        one = sources[source] = sources.pop(source) if source in sources else _Source(sigma, now, now)
        if len(sources) > _SOURCES_MAX:
            del sources[next(iter(sources))]  # the one that was silent for longest
        one.gave(sigma, now)
        chosen = self._chosen.get(quantity)
        if chosen is None or chosen.silent(now):
            chosen = self._choose(quantity, source, one, "is silent")
        if chosen is one:
            return True
        if one.sigma >= _BETTER * chosen.sigma:
            one.better_since = None
            return False
        one.better_since = one.better_since or now
        if seconds_between(one.better_since, now) < _BETTER_FOR_S:
            return False
        self._choose(quantity, source, one, "is less certain")
        return True

    def _choose(self, quantity: str, source: str, one: _Source, why: str) -> _Source:
        before = self._names.get(quantity, source)
        if before != source:
            self._tell(f"the ship's {quantity} comes from {source} from now on: {before} {why}")
        self._chosen[quantity], self._names[quantity] = one, source
        return one
