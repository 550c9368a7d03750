"""The motion of a vessel as somebody recorded it, in a CSV file: read, checked, and interpolated twice differentiably."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64

COLUMNS = ("time_s", "surge_m", "sway_m", "heave_down_m", "roll_deg", "pitch_deg", "yaw_deg")
"""The header; `heave_up_m` may stand in place of `heave_down_m`."""
ROWS_MAX = 500_000
GAP_MAX_S = 2.0
"""A longer gap holds motion that nobody recorded."""
_FARTHEST = (1e4, 1e4, 50.0, 80.0, 80.0, 1e5)
"""m and degrees: beyond these a column holds something else."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedMotion:
    """Natural cubic splines through the samples: positions are C2, velocities C1, accelerations continuous."""

    t_s: F64
    """(N,) from 0, ascending."""
    eta: F64
    """(N, 6) surge forward, sway to starboard, heave down in m; roll, pitch, yaw in rad."""
    bend: F64
    """(N, 6) second derivatives."""
    blend_s: float | None = None
    """How long the end is blended into the beginning when it is flown again; None: it is not."""

    @staticmethod
    def read(path: Path, blend_s: float | None = None) -> RecordedMotion:
        """Return the motion in a CSV file.

        Raises:
            BadInput: the file cannot be read, its header is another, a row has another number of cells or one that is no finite
                number, time does not ascend or has a gap, or the motion is too short for the blend. One line with file and row.
        """
        try:
            with path.open(newline="", encoding="utf-8") as file:
                rows = _rows(csv.reader(file), path)
        except (OSError, ValueError, csv.Error) as why:
            raise BadInput(f"{path}: not readable as a CSV file: {why}") from why
        t, eta = rows[:, 0] - rows[0, 0], rows[:, 1:].copy()
        eta[:, 3:] = np.radians(eta[:, 3:])
        eta[:, 5] = np.unwrap(eta[:, 5])
        if blend_s is not None and t[-1] < 3.0 * blend_s:
            raise BadInput(f"{path}: {t[-1]:.1f} s of motion are too short to blend {blend_s:g} s of them")
        return RecordedMotion(t, eta, _second_derivatives(t, eta), blend_s)

    @property
    def lasts_s(self) -> float:
        """How long it lasts; infinite when it is flown again and again."""
        return math.inf if self.blend_s is not None else float(self.t_s[-1])

    @property
    def period_s(self) -> float:
        """Time after which it comes again, if it does."""
        return float(self.t_s[-1]) - (self.blend_s or 0.0)

    def at(self, t_s: F64) -> tuple[F64, F64, F64]:
        """Return displacement, rate and acceleration at times (T,), each (T, 6)."""
        if self.blend_s is None:
            return self._spline(t_s)
        t = np.mod(t_s, self.period_s)
        now = self._spline(t)
        ends = t < self.blend_s
        if not ends.any():
            return now
        last = self._spline(np.where(ends, t + self.period_s, t))
        x = np.where(ends, t / self.blend_s, 1.0)[:, None]
        s = x**3 * (10.0 + x * (6.0 * x - 15.0))
        s1 = np.where(ends[:, None], 30.0 * x**2 * (1.0 - x) ** 2 / self.blend_s, 0.0)
        s2 = np.where(ends[:, None], 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / self.blend_s**2, 0.0)
        d = tuple(b - a for a, b in zip(last, now, strict=True))
        return (
            last[0] + s * d[0],
            last[1] + s * d[1] + s1 * d[0],
            last[2] + s * d[2] + 2.0 * s1 * d[1] + s2 * d[0],
        )

    def _spline(self, t_s: F64) -> tuple[F64, F64, F64]:
        i = np.clip(np.searchsorted(self.t_s, t_s, side="right") - 1, 0, self.t_s.size - 2)
        h = (self.t_s[i + 1] - self.t_s[i])[:, None]
        b = np.clip((t_s - self.t_s[i])[:, None] / h, 0.0, 1.0)
        a = 1.0 - b
        y0, y1, m0, m1 = self.eta[i], self.eta[i + 1], self.bend[i], self.bend[i + 1]
        return (
            a * y0 + b * y1 + ((a**3 - a) * m0 + (b**3 - b) * m1) * h**2 / 6.0,
            (y1 - y0) / h + ((3.0 * b**2 - 1.0) * m1 - (3.0 * a**2 - 1.0) * m0) * h / 6.0,
            a * m0 + b * m1,
        )


def _rows(reader: object, path: Path) -> F64:
    """Return (N, 7) numbers of a checked file, heave down."""
    assert hasattr(reader, "__iter__")
    lines = iter(reader)
    header = tuple(cell.strip() for cell in next(lines, ()))
    up = header == tuple("heave_up_m" if c == "heave_down_m" else c for c in COLUMNS)
    if header != COLUMNS and not up:
        raise BadInput(f"{path}: the first line must be {','.join(COLUMNS)} (or heave_up_m), found {','.join(header)[:120]!r}")
    rows: list[list[float]] = []
    for n, cells in enumerate(lines, 2):
        if not cells:
            continue
        if len(rows) == ROWS_MAX:
            raise BadInput(f"{path}: more than {ROWS_MAX} rows")
        if len(cells) != len(COLUMNS):
            raise BadInput(f"{path}: line {n} has {len(cells)} cells, not {len(COLUMNS)}")
        row = [_cell(cell, name, n, path) for cell, name in zip(cells, header, strict=True)]
        for value, most, name in zip(row[1:], _FARTHEST, header[1:], strict=True):
            if abs(value) > most:
                raise BadInput(f"{path}: line {n}: {name} must lie within {most:g}, found {value:g}")
        if rows and row[0] <= rows[-1][0]:
            raise BadInput(f"{path}: line {n}: time_s must ascend, found {row[0]:g} after {rows[-1][0]:g}")
        if rows and row[0] - rows[-1][0] > GAP_MAX_S:
            raise BadInput(f"{path}: line {n}: a gap of {row[0] - rows[-1][0]:g} s; {GAP_MAX_S:g} s at most can be bridged")
        rows.append(row)
    if len(rows) < 4:
        raise BadInput(f"{path}: {len(rows)} rows of motion; four or more are needed")
    out = np.array(rows)
    if up:
        out[:, 3] = -out[:, 3]
    return out


def _cell(text: str, name: str, line: int, path: Path) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadInput(f"{path}: line {line}: {name} must be a finite number, found {text[:40]!r}")
    return value


def _second_derivatives(t: F64, y: F64) -> F64:
    """Return those of the natural cubic spline through (N,) times and (N, 6) values: Thomas' algorithm, all columns at once."""
    h = np.diff(t)
    slope = np.diff(y, axis=0) / h[:, None]
    n = t.size
    c, d = np.zeros(n), np.zeros_like(y)
    for i in range(1, n - 1):
        left, right = h[i - 1], h[i]
        scale = 2.0 * (left + right) - left * c[i - 1]
        c[i] = right / scale
        d[i] = (6.0 * (slope[i] - slope[i - 1]) - left * d[i - 1]) / scale
    m = np.zeros_like(y)
    for i in range(n - 2, 0, -1):
        m[i] = d[i] - c[i] * m[i + 1]
    return m
