"""Falsification: search the smallest disturbance with which a flight fails.

Each searched key runs from LOW, no disturbance, to HIGH, the strongest. The size of a disturbance is the root mean square of the
keys' shares of their ranges. CMA-ES (N. Hansen, The CMA evolution strategy: a tutorial, arXiv 1604.00772) looks for the smallest
that fails; what is left of the budget brings that one nearer to no disturbance by bisection. All candidates fly the same seed, so
that only the disturbance differs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from estimator.contracts.errors import BadInput
from sitl.campaign.design import Axis
from sitl.campaign.plan import Job, Point
from sitl.campaign.task import Flight

RUNS_MIN = 10
_BISECTIONS = 6
_FIRST_SIGMA = 0.3
_FAR_M = 0.4
"""Touchdown error that is as near to failing as a flight which landed can be: the radius of the pad."""

FlyAll = Callable[[Sequence[Job]], Sequence[Flight]]
"""Flies jobs and returns their results in the same order."""


@dataclass(frozen=True, slots=True)
class Falsified:
    """The smallest disturbance that was found to make the flight fail."""

    size: float
    """Root mean square of the shares of the ranges, 0 to 1."""
    shares: tuple[float, ...]
    flight: Flight


def refuse_search(axes: Sequence[Axis], runs: int) -> None:
    """Refuse a search that cannot be made.

    Raises:
        BadInput: an axis has no range, or the budget is too small.
    """
    if runs < RUNS_MIN:
        raise BadInput(f"--search needs --runs of {RUNS_MIN} or more, got {runs}")
    for axis in axes:
        if math.isnan(axis.low):
            raise BadInput(f"--search {axis.text!r}: write KEY=LOW:HIGH, from no disturbance to the strongest")


@dataclass(slots=True)
class Search:
    """A search over some keys with a budget of flights; `refuse_search` says what it cannot search."""

    axes: Sequence[Axis]
    seed: int
    runs: int
    fly: FlyAll
    flown: int = 0
    best: Falsified | None = None

    def run(self) -> Falsified | None:
        """Search until the budget is spent or the search has converged; return what was found, None where nothing failed."""
        import cma

        n = len(self.axes)
        self._costs([(0.0,) * n, (1.0,) * n])
        if self.best is not None and self.best.size == 0.0:
            return self.best  # it fails with no disturbance at all
        # CMA-ES needs two dimensions; the second of a single key is not used.
        options = {"bounds": [0.0, 1.0], "seed": self.seed + 1, "verbose": -9, "maxfevals": self.runs}
        evolution = cma.CMAEvolutionStrategy(max(2, n) * [0.5], _FIRST_SIGMA, options)
        while self.flown + evolution.popsize <= self.runs - _BISECTIONS and not evolution.stop():
            asked = evolution.ask()
            evolution.tell(asked, self._costs([tuple(float(x) for x in one[:n]) for one in asked]))
        self._bisect()
        return self.best

    def _bisect(self) -> None:
        """Bring the best failure nearer to no disturbance along its own line."""
        if self.best is None:
            return
        shares, low, high = self.best.shares, 0.0, 1.0
        for _ in range(min(_BISECTIONS, self.runs - self.flown)):
            middle = 0.5 * (low + high)
            (cost,) = self._costs([tuple(middle * x for x in shares)])
            low, high = (low, middle) if cost <= 1.0 else (middle, high)

    def _costs(self, candidates: Sequence[tuple[float, ...]]) -> list[float]:
        """Return the cost of each candidate: its size if it fails, else more than 1, the less the nearer it came to failing."""
        points: list[Point] = [
            tuple((axis.key, axis.at(x)) for axis, x in zip(self.axes, shares, strict=True)) for shares in candidates
        ]
        flights = self.fly([Job(self.seed, point) for point in points])
        self.flown += len(flights)
        costs = []
        for shares, flight in zip(candidates, flights, strict=True):
            size = math.sqrt(sum(x * x for x in shares) / len(shares))
            if flight["grade"] != "failed":
                costs.append(2.0 - _danger(flight))
                continue
            costs.append(size)
            if self.best is None or size < self.best.size:
                self.best = Falsified(size, shares, flight)
        return costs


def _danger(flight: Flight) -> float:
    """Return how near a flight that did not fail came to failing, 0 to 1 exclusive."""
    if not flight["landed_on_pad"]:
        return 0.0
    return min(0.99, float(flight["touchdown"]["lateral_m"]) / _FAR_M)
