"""Durations of one stage of the service: quantiles of the newest, and a histogram of all."""

from bisect import bisect_left
from dataclasses import dataclass, field

EDGES_S = (
    0.0002, 0.0005, 0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.015, 0.02, 0.03, 0.05, 0.075, 0.1, 0.15, 0.25, 0.5, 1.0,
)  # fmt: skip
"""Upper edges of the histogram's buckets, s; longer durations lie above the last."""


@dataclass(slots=True)
class Delays:
    """The durations of one stage, seconds; quantiles are of the newest `capacity`."""

    capacity: int = 600
    count: int = 0
    """Number of durations since the start."""
    sum_s: float = 0.0
    """Sum of all of them."""
    buckets: list[int] = field(default_factory=lambda: [0] * (len(EDGES_S) + 1))
    """Number of durations up to each edge and above the one before; the last is above all edges."""
    _values: list[float] = field(default_factory=list)
    _next: int = 0

    def add(self, seconds: float) -> None:
        self.count += 1
        self.sum_s += seconds
        self.buckets[bisect_left(EDGES_S, seconds)] += 1
        if len(self._values) < self.capacity:
            self._values.append(seconds)
        else:
            self._values[self._next] = seconds
            self._next = (self._next + 1) % self.capacity

    def quantile(self, q: float) -> float | None:
        """Return the q-quantile, seconds; None before the first value."""
        return self.quantiles(q)[0]

    def quantiles(self, *qs: float) -> tuple[float | None, ...]:
        """Return several quantiles, seconds, and sort only once."""
        if not self._values:
            return (None,) * len(qs)
        ordered = sorted(self._values)
        return tuple(ordered[min(len(ordered) - 1, int(q * len(ordered)))] for q in qs)
