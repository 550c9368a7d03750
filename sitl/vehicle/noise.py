"""Standard normal numbers for the steps of the physics: rows of them, drawn in blocks and read by the core."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from estimator.contracts.geometry import F64
from estimator.core.library import start_of

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
        self._start = self._stride = 0
        self._at = self._end = 0

    @staticmethod
    def of(seed: np.random.SeedSequence, width: int) -> NoiseRows:
        """Return rows of so many numbers, all from one generator."""
        rng = np.random.Generator(np.random.PCG64(seed))
        return NoiseRows(lambda: rng.standard_normal((BLOCK, width)))

    def prepare(self) -> int:
        """Draw the next block if none is left; return the number of rows that lie ready at `address`, 1 or more."""
        if self._at == self._end:
            self._rows = self._draw()
            self._start, self._stride = start_of(self._rows), self._rows.strides[0]
            self._at, self._end = 0, len(self._rows)
        return self._end - self._at

    @property
    def address(self) -> int:
        """Address of the next row, after `prepare`."""
        return self._start + self._at * self._stride

    def used(self, rows: int) -> None:
        """Note that the next rows are used."""
        self._at += rows

    def next(self) -> list[float]:
        """Use one row and return it."""
        self.prepare()
        row: list[float] = self._rows[self._at].tolist()
        self._at += 1
        return row
