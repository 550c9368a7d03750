"""The plots of the report as data: layers of columns over time, which the page draws, zooms and reads at its cursor."""

import base64
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64

SPANS = 1500
"""Spans of time that a longer series is thinned to. The extremes of each are kept, so that no outlier is lost."""
_GAP_S = 0.5

Style = Literal["line", "step", "dots", "band", "level"]


class Columns:
    """The numbers of a page: float32 in base64, each column once."""

    def __init__(self) -> None:
        self._numbers: dict[bytes, int] = {}
        self.whole = 0
        self.kept = 0

    def add(self, values: F64) -> int:
        """Return the number of a column with these values; one that is there already is shared."""
        data = np.ascontiguousarray(values, dtype="<f4").tobytes()
        return self._numbers.setdefault(data, len(self._numbers))

    def encoded(self) -> list[str]:
        """Return every column as text."""
        return [base64.b64encode(data).decode() for data in self._numbers]


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """One series in a plot."""

    name: str
    """Name beside the plot; a click on it hides the layer."""
    colour: str
    """A colour, or `ink` for that of the text."""
    style: Style
    t_s: F64
    y: F64
    """(n,) values; nan breaks a line. Of a band it is the lower edge."""
    upper: F64 | None = None
    """(n,) upper edge of a band."""
    wide: bool = False
    """True if the line is drawn thick and pale, as truth is."""
    fits: bool = True
    """True if the plot's height is fitted to it; a wild single measurement must not flatten the rest."""
    read: bool = True
    """True if its value at the cursor is shown."""
    shown: bool = True
    """True if it is shown before a person has switched anything."""

    def packed(self, columns: Columns) -> dict[str, Any]:
        """Return the layer for the page, thinned."""
        kept = thinned(self.t_s, self.y, self.upper)
        columns.whole += len(self.t_s)
        columns.kept += len(kept)
        apart = np.diff(self.t_s)
        gap_s = max(_GAP_S, 4.0 * float(np.median(apart))) if len(apart) else _GAP_S
        out: dict[str, Any] = {
            "name": self.name, "colour": self.colour, "style": self.style, "wide": self.wide, "fits": self.fits,
            "read": self.read, "shown": self.shown, "gap": round(gap_s, 3), "t": columns.add(self.t_s[kept]),
            "y": columns.add(self.y[kept]),
        }  # fmt: skip
        return out if self.upper is None else out | {"upper": columns.add(self.upper[kept])}


@dataclass(frozen=True, slots=True, eq=False)
class Plot:
    """One plot over time."""

    title: str
    unit: str
    layers: list[Layer]
    log: bool = False
    zero: bool = False
    """True if zero is always in sight."""
    least: float = 0.0
    """The least height of the plot, in its unit."""
    names: tuple[str, ...] = ()
    """Names of the whole numbers from 0 on, if the values are kinds and not numbers."""

    @property
    def empty(self) -> bool:
        """True if no layer has a number."""
        return not any(np.isfinite(layer.y).any() for layer in self.layers)

    def in_words(self) -> str:
        """Return what the plot shows, for whoever does not see it."""
        if self.names:
            return f"{self.title} over time: " + ", ".join(self.names)
        reported = []
        for layer in self.layers:
            values = layer.y[np.isfinite(layer.y)]
            if layer.read and layer.style != "level" and len(values):
                reported.append(f"{layer.name} from {np.min(values):.3g} to {np.max(values):.3g}, {values[-1]:.3g} at its end")
        return f"{self.title}, {self.unit}, over time: " + ("; ".join(reported) or "nothing was measured")

    def packed(self, columns: Columns) -> dict[str, Any]:
        """Return the plot for the page."""
        layers = [layer.packed(columns) for layer in self.layers if len(layer.t_s)]
        return {
            "title": self.title, "unit": self.unit, "log": self.log, "zero": self.zero, "least": self.least,
            "names": list(self.names), "layers": layers,
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class Section:
    """Plots under one heading."""

    title: str
    note: str
    plots: list[Plot] = field(default_factory=list)


def thinned(t_s: F64, y: F64, upper: F64 | None = None) -> NDArray[np.intp]:
    """Return the indices that are kept of a series: all where there are few, else the extremes of each of `SPANS` spans of time.

    Indices without a value count as such, so that a gap remains one. Of a band both edges have their extremes.
    """
    n = len(t_s)
    if n <= 2 * SPANS:
        return np.arange(n)
    edges = np.linspace(t_s[0], t_s[-1], SPANS + 1)[1:-1]
    kept = {0, n - 1}
    for part in np.split(np.arange(n), np.searchsorted(t_s, edges)):
        known = part[np.isfinite(y[part])]
        if not len(part):
            continue
        if len(known) < len(part):
            kept.add(int(part[~np.isfinite(y[part])][0]))
        for edge in (y,) if upper is None else (y, upper):
            if len(known):
                kept |= {int(known[np.argmin(edge[known])]), int(known[np.argmax(edge[known])])}
    return np.array(sorted(kept), dtype=np.intp)


def broken_at_wraps(degrees: F64) -> F64:
    """Return degrees over time with a gap where they jump from one end of the circle to the other."""
    out = np.array(degrees, dtype=float)
    out[1:][np.abs(np.diff(degrees)) > 180.0] = np.nan
    return out


def level(value: float, name: str, span: tuple[float, float], colour: str = "ink") -> Layer:
    """Return a horizontal dashed line."""
    return Layer(name, colour, "level", np.array(span), np.full(2, value), fits=False, read=False)
