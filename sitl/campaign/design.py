"""Designs: the points at which a campaign flies each of its seeds, when keys of scenario or settings are varied.

A search looks for the smallest disturbance with which a flight fails. Each searched key runs from LOW, no disturbance, to HIGH,
the strongest. The size of a disturbance is the root mean square of the keys' shares of their ranges. CMA-ES (N. Hansen, The CMA
evolution strategy: a tutorial, arXiv 1604.00772) looks for the smallest that fails; bisection with the rest of the budget brings
that one nearer to no disturbance. All candidates fly the same seed, so that only the disturbance differs.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from companion.settings.overrides import Value, finite
from estimator.contracts.errors import BadInput
from sitl.campaign.lab import require_lab
from sitl.campaign.overrides import Overridable
from sitl.campaign.plan import Job, Point
from sitl.campaign.task import Flight, error_m

POINTS_MAX = 1_000_000
_DIGITS = 9
"""Significant digits of a value: enough for any key, and short enough to read."""
SAMPLED = ("sobol", "lhs")


@dataclass(frozen=True, slots=True)
class Axis:
    """One varied key: either its values one by one, or a range."""

    key: str
    text: str
    """Text as the person wrote it."""
    values: tuple[Value, ...] = ()
    low: float = math.nan
    high: float = math.nan
    whole: bool = False
    """True if the key takes whole numbers only."""

    def at(self, share: float) -> Value:
        """Return the value at a share of the range, 0 for its low and 1 for its high end."""
        value = self.low + share * (self.high - self.low)
        return round(value) if self.whole else rounded(value)


def rounded(value: float) -> float:
    """Return the value with the significant digits that a command line shows."""
    return float(f"{value:.{_DIGITS}g}")


def parse_axis(text: str, given: Overridable, where: str) -> Axis:
    """Return the axis that `KEY=LOW:HIGH:STEP`, `KEY=LOW:HIGH` or `KEY=A,B,C` means.

    Raises:
        BadInput: it has another form, or the key is unknown.
    """
    key, equals, span = text.partition("=")
    if not equals or not span:
        raise BadInput(f"{where} {text!r}: write KEY=LOW:HIGH:STEP or KEY=A,B,C, as in wind.speed_m_s=0:10:2")
    if ":" not in span:
        return Axis(key, text, values=tuple(given.value(key, item, where) for item in span.split(",")))
    parts = span.split(":")
    if len(parts) not in (2, 3):
        raise BadInput(f"{where} {text!r}: a range is LOW:HIGH or LOW:HIGH:STEP")
    present = given.value(key, parts[0], where)
    if isinstance(present, bool | str):
        raise BadInput(f"{where} {text!r}: {key} holds no number; list its values, as in {key}=A,B")
    low, high = (finite(part, f"{where}: {key}") for part in parts[:2])
    whole = given.holds_whole_number(key, where)
    if len(parts) == 2:
        if low == high:
            raise BadInput(f"{where} {text!r}: the range is empty")
        return Axis(key, text, low=low, high=high, whole=whole)
    step = finite(parts[2], f"{where}: {key}")
    if step == 0.0 or (high - low) / step < 0.0:
        raise BadInput(f"{where} {text!r}: steps of {step:g} do not lead from {low:g} to {high:g}")
    count = math.floor((high - low) / step * (1.0 + 1e-9)) + 1
    if count > POINTS_MAX:
        raise BadInput(f"{where} {text!r}: {count} values are more than {POINTS_MAX}")
    steps = [rounded(low + n * step) for n in range(count)]
    return Axis(key, text, tuple(int(v) if whole and v == int(v) else v for v in steps), low, high, whole)


def refuse_repeated(axes: Sequence[Axis], where: str) -> None:
    """Refuse a key that is varied twice.

    Raises:
        BadInput: there is one.
    """
    keys = [axis.key for axis in axes]
    for key in keys:
        if keys.count(key) > 1:
            raise BadInput(f"{where}: {key} is given twice")


def factorial(axes: Sequence[Axis]) -> list[Point]:
    """Return all combinations of the axes' values; a single empty point without axes.

    Raises:
        BadInput: an axis is a range without a step, or there are too many combinations.
    """
    for axis in axes:
        if not axis.values:
            raise BadInput(f"--vary {axis.text!r}: a range needs a step (LOW:HIGH:STEP), or --design sobol or lhs with --points")
    if (count := math.prod(len(axis.values) for axis in axes)) > POINTS_MAX:
        raise BadInput(f"--vary: {count} combinations are more than {POINTS_MAX}")
    return [
        tuple((axis.key, value) for axis, value in zip(axes, values, strict=True))
        for values in itertools.product(*(axis.values for axis in axes))
    ]


def sampled(axes: Sequence[Axis], kind: str, points: int, seed: int) -> list[Point]:
    """Return points that fill the ranges of the axes evenly, by scipy.stats.qmc.

    Args:
        kind: `sobol`, a scrambled Sobol' sequence, or `lhs`, a Latin hypercube.
        seed: of the scrambling.

    Raises:
        BadInput: an axis has no range, there are too many points, or SciPy is missing.
    """
    require_lab(f"--design {kind}", "scipy")
    if not 1 <= points <= POINTS_MAX:
        raise BadInput(f"--points must lie in 1 to {POINTS_MAX}, got {points}")
    for axis in axes:
        if math.isnan(axis.low):
            raise BadInput(f"--vary {axis.text!r}: --design {kind} needs a range, LOW:HIGH")
    from scipy.stats import qmc

    sampler = qmc.Sobol(len(axes), rng=seed) if kind == "sobol" else qmc.LatinHypercube(len(axes), rng=seed)
    # A Sobol' sequence is balanced over powers of two only; more is drawn than flown.
    drawn = sampler.random(1 << (points - 1).bit_length())[:points] if kind == "sobol" else sampler.random(points)
    return [tuple((axis.key, axis.at(float(x))) for axis, x in zip(axes, row, strict=True)) for row in drawn]


def described(kind: str, axes: Sequence[Axis], **more: Any) -> dict[str, Any]:
    """Return a design as plain values, for the manifest."""
    return {"kind": kind, "axes": [axis.text for axis in axes], "keys": [axis.key for axis in axes], **more}


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
    return min(0.99, error_m(flight) / _FAR_M)
