"""What the thesis printed: tables 5.1 to 5.4 (Sundvoll 2020), the error while hovering at six heights.

The text of the source has lost two cells of the lowest height of tables 5.1 and 5.3, and of all of table 5.4 at 3 m no more is
kept than that no method gave a heading; what cannot be read is left out rather than guessed.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

Quantity = Literal["x", "y", "z", "yaw"]
HEIGHTS_M = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0)


class Printed(NamedTuple):
    """One row of a table of the thesis."""

    mean: float | None
    """Mean error, mm, or degrees for the heading; None where nothing was found or the cell cannot be read."""
    std: float | None
    """Standard deviation of the error, in the same unit."""
    available: float
    """Fraction of the samples with an estimate."""


_ROWS: dict[Quantity, dict[tuple[float, str], tuple[float, float, float]]] = {
    "x": {
        (0.5, "corners"): (-3.57, 1.91, 1.0),
        (1.0, "ellipse"): (-12.15, 2.85, 1.0), (1.0, "arrow"): (-3.41, 4.31, 1.0), (1.0, "corners"): (-3.72, 6.20, 1.0),
        (2.0, "ellipse"): (-9.17, 9.54, 1.0), (2.0, "arrow"): (6.55, 11.95, 1.0),
        (3.0, "ellipse"): (-13.48, 12.01, 1.0),
        (5.0, "ellipse"): (-22.41, 21.33, 1.0), (5.0, "arrow"): (12.34, 12.71, 0.04),
        (10.0, "ellipse"): (-42.30, 42.74, 1.0),
    },
    "y": {
        (0.5, "arrow"): (-4.45, 2.76, 0.11), (0.5, "corners"): (-2.30, 3.22, 1.0),
        (1.0, "ellipse"): (-1.40, 4.16, 0.11), (1.0, "arrow"): (-3.56, 4.88, 1.0), (1.0, "corners"): (-3.09, 6.20, 1.0),
        (2.0, "ellipse"): (-4.91, 11.70, 1.0), (2.0, "arrow"): (-7.00, 14.29, 1.0),
        (3.0, "ellipse"): (-6.50, 13.91, 1.0),
        (5.0, "ellipse"): (-9.23, 22.67, 1.0), (5.0, "arrow"): (14.22, 8.84, 0.04),
        (10.0, "ellipse"): (-11.64, 41.28, 1.0),
    },
    "z": {
        (0.5, "corners"): (-6.13, 12.45, 1.0),
        (1.0, "ellipse"): (-13.56, 0.61, 1.0), (1.0, "arrow"): (-7.65, 4.64, 1.0), (1.0, "corners"): (-0.76, 43.86, 1.0),
        (2.0, "ellipse"): (-12.96, 1.33, 1.0), (2.0, "arrow"): (191.92, 69.48, 1.0),
        (3.0, "ellipse"): (-7.08, 1.53, 1.0),
        (5.0, "ellipse"): (22.52, 9.79, 1.0), (5.0, "arrow"): (643.13, 104.21, 0.04),
        (10.0, "ellipse"): (40.07, 25.45, 1.0),
    },
    "yaw": {
        (0.5, "arrow"): (-0.01, 0.16, 0.11), (0.5, "corners"): (-0.12, 1.33, 1.0),
        (1.0, "arrow"): (0.02, 0.28, 1.0), (1.0, "corners"): (-0.42, 2.83, 1.0),
        (2.0, "arrow"): (-0.04, 0.65, 1.0),
        (5.0, "arrow"): (101.09, 45.24, 0.04),
    },
}  # fmt: skip


def printed(quantity: Quantity, height_m: float, method: str) -> Printed | None:
    """Return what the thesis printed for a method at a height; None where it printed nothing or it cannot be read."""
    row = _ROWS[quantity].get((height_m, method))
    return None if row is None else Printed(*row)
