"""The random disturbances of the vehicle: gusts, drifting attitude errors, optical-flow noise, and the draw of their numbers.

Standard normal numbers for the steps of the physics are rows, drawn in blocks and read by the core.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimator.contracts.geometry import F64
from sitl.core.library import SIM


@dataclass(frozen=True, slots=True)
class Wind:
    """Steady wind with gusts, uniform around the vehicle.

    Each component of the gust is a first-order Gauss-Markov process, whose spectrum is Dryden's longitudinal one
    (MIL-F-8785C, 3.7.1.2) with a correlation time of length scale over airspeed.
    """

    v_ned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity of the steady air in ned, m/s."""
    gust_sigma_m_s: float = 0.0
    """Sigma of each horizontal component; the vertical component has half of it."""
    gust_time_s: float = 2.0


def keep_and_fresh(sigma: float, time_s: float, step_s: float) -> tuple[float, float]:
    """Return the factors of x' = keep x + fresh n, a first-order Gauss-Markov process that is exact for any step length.

    Args:
        sigma: standard deviation of x.
        time_s: correlation time.
    """
    keep = math.exp(-step_s / time_s)
    return keep, sigma * math.sqrt(1.0 - keep**2)


BLOCK = 256
"""Rows of a block."""


class NoiseRows:
    """Rows of standard normal numbers, one for each step.

    Args:
        draw: draws the next block of `BLOCK` rows, contiguous.
    """

    def __init__(self, draw: Callable[[], F64]) -> None:
        self._draw = draw
        self._rows: F64 = np.empty((0, 0))
        self._first: Any = None
        self._at = self._end = 0

    @staticmethod
    def of(seed: np.random.SeedSequence, width: int) -> NoiseRows:
        """Return rows of this many numbers, all from one generator."""
        rng = np.random.Generator(np.random.PCG64(seed))
        return NoiseRows(lambda: rng.standard_normal((BLOCK, width)))

    def prepare(self) -> int:
        """Draw the next block if none is left; return the number of rows that lie ready at `row`, 1 or more."""
        if self._at == self._end:
            self._rows = self._draw()
            self._first = SIM.array("double", self._rows)
            self._at, self._end = 0, len(self._rows)
        return self._end - self._at

    @property
    def row(self) -> Any:
        """The next row as the core reads it, after `prepare`."""
        return self._first + self._at * self._rows.shape[1]

    def used(self, rows: int) -> None:
        """Note that the next rows are used."""
        self._at += rows

    def next(self) -> list[float]:
        """Use one row and return it."""
        self.prepare()
        row: list[float] = self._rows[self._at].tolist()
        self._at += 1
        return row
