"""Two campaigns compared, seed by seed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from estimator.contracts.geometry import F64
from sitl.campaign.task import Flight, job_of

_RESAMPLES = 2000


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """The mean of a figure in both campaigns, over the flights that have it in both, and the interval of the difference."""

    name: str
    unit: str
    pairs: int
    ours: float
    other: float
    low: float
    high: float

    @property
    def mean(self) -> float:
        """This campaign less the other."""
        return self.ours - self.other

    @property
    def clear(self) -> bool:
        """Whether the interval leaves zero out."""
        return self.low > 0.0 or self.high < 0.0


def _touch(name: str) -> Callable[[Flight], float | None]:
    return lambda f: f["touchdown"][name] if f["landed_on_pad"] else None


FIGURES: tuple[tuple[str, str, Callable[[Flight], float | None]], ...] = (
    ("on the pad", "share", lambda f: float(f["grade"] == "on pad")),
    ("failed", "share", lambda f: float(f["grade"] == "failed")),
    ("touchdown error", "m", _touch("lateral_m")),
    ("speed into the deck", "m/s", _touch("vertical_speed_m_s")),
    ("speed along the deck", "m/s", _touch("lateral_speed_m_s")),
    ("duration", "s", lambda f: f["duration_s"]),
    ("contacts outside commit", "", lambda f: float(f["contacts_outside_commit"])),
)


def differences_of(ours: Iterable[Flight], other: Iterable[Flight]) -> list[PairedDifference]:
    """Return the differences between two campaigns in all figures, over the seeds (and varied values) that both have flown."""
    theirs = {job_of(flight).key: flight for flight in other}
    pairs = [(flight, theirs[key]) for flight in ours if (key := job_of(flight).key) in theirs]
    out = []
    for name, unit, figure in FIGURES:
        both = [(a, b) for one, two in pairs if (a := figure(one)) is not None and (b := figure(two)) is not None]
        if both:
            table = np.array(both, dtype=float)
            low, high = bootstrap_interval(table[:, 0] - table[:, 1])
            out.append(PairedDifference(name, unit, len(both), float(table[:, 0].mean()), float(table[:, 1].mean()), low, high))
    return out


def bootstrap_interval(values: F64, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % interval of the mean of (n,) values by the percentile bootstrap.

    Source: B. Efron, R. J. Tibshirani, An Introduction to the Bootstrap (1993), section 13.3.
    """
    rng = np.random.default_rng(seed)
    means = np.array([values[rng.integers(len(values), size=len(values))].mean() for _ in range(_RESAMPLES)])
    low, high = np.quantile(means, (0.025, 0.975))
    return float(low), float(high)
