"""The plots of the report, as layers over time: place, velocity, errors, the filter's verdicts, the ship, commands and delays."""

import base64
import math
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from companion.recording.palette import FUSED, REFUSED, STAGES, THREE, colour
from companion.tools.report.figures import InnovationSeries, Series, stage_times
from companion.tools.report.flight_log import HORIZONS_KEPT_S, DeckSample, FlightLog
from estimator.contracts.commands import Lean, Velocity
from estimator.contracts.estimates import PathName, RelativeState, Verdict
from estimator.contracts.geometry import F64
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import seconds_between

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


class Layer(Struct, frozen=True, eq=False):
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


class Plot(Struct, frozen=True, eq=False):
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


class Section(Struct, frozen=True):
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


BAND = 2.0
"""Half the width of the bands, in standard deviations."""
_AXES = ("forward", "right", "down")


def steering_path(log: FlightLog) -> PathName | None:
    """Return the path that steered, or else the first one; None if nothing was estimated or measured."""
    if log.steering is None and log.estimates:
        return log.estimates[0].path
    return log.results[0].path if log.steering is None and log.results else log.steering


def steering_states(log: FlightLog) -> list[RelativeState]:
    """Return the estimates of the steering path in order of time."""
    path = steering_path(log)
    return sorted((e for e in log.estimates if e.path == path), key=lambda e: e.at)


def times(log: FlightLog, states: list[RelativeState]) -> F64:
    """Return the (n,) times of estimates since the flight's start, s."""
    return np.array([seconds_between(log.started, e.at) for e in states])


def place(log: FlightLog, series: list[Series]) -> Section:
    """Return the vector to the pad and the heading: truth, the steering path with its band, other paths, single looks."""
    states = steering_states(log)
    path, t = steering_path(log), times(log, states)
    t_true = np.array([seconds_between(log.started, s.at) for s in log.truth])
    true = np.array([[*s.d_body_pad_level, math.degrees(s.yaw_rad)] for s in log.truth]).reshape(-1, 4)
    sigma = np.sqrt(np.array([np.diagonal(e.cov)[[0, 1, 2, 6]] for e in states]).reshape(-1, 4))
    plots = []
    for k, name in enumerate((*_AXES, "heading")):
        layers = []
        scale, turns = (math.degrees(1.0), True) if k == 3 else (1.0, False)
        if len(t_true):
            layers.append(Layer("truth", "ink", "line", t_true, _line(true[:, k], turns), wide=True))
        for s in series:
            y = s.d[:, k] if k < 3 else np.degrees(s.yaw_rad)
            if s.name == path:
                half = BAND * scale * np.where(np.isfinite(y), sigma[:, k], np.nan)
                layers.append(Layer(s.name, colour(s.name), "band", t, y - half, y + half, read=False, fits=False))
                layers.append(Layer(s.name, colour(s.name), "line", s.t_s, _line(y, turns)))
            elif s.is_path:
                layers.append(Layer(s.name, colour(s.name), "line", s.t_s, _line(y, turns), fits=False, read=False))
            else:
                fits = path is None and not len(t_true)
                shown = s.name != "selected"
                layers.append(Layer(s.name, colour(s.name), "dots", s.t_s, y, fits=fits, read=False, shown=shown))
        plots.append(Plot(name, "degrees" if k == 3 else "m", layers, least=10.0 if k == 3 else 0.4))
    note = "The vector from the drone to the pad, levelled, nose first, and the heading against the arrow. Dots: single looks."
    return Section("Place", f"{note} Band: two sigma of the path that steered.", plots)


def _line(y: F64, turns: bool) -> F64:
    return broken_at_wraps(y) if turns else y


def velocity(log: FlightLog) -> Section:
    """Return the velocity of the pad against the drone by the steering path, with its band, and the true one."""
    states = steering_states(log)
    t, path = times(log, states), str(steering_path(log))
    v = np.array([e.v_pad_level for e in states]).reshape(-1, 3)
    half = BAND * np.sqrt(np.array([np.diagonal(e.cov)[3:6] for e in states]).reshape(-1, 3))
    t_true = np.array([seconds_between(log.started, s.at) for s in log.truth])
    true = np.array([s.v_pad_level for s in log.truth]).reshape(-1, 3)
    plots = []
    for k, name in enumerate(_AXES):
        layers = [Layer("truth", "ink", "line", t_true, true[:, k], wide=True)] if len(t_true) else []
        layers.append(Layer(path, colour(path), "band", t, (v - half)[:, k], (v + half)[:, k], read=False, fits=False))
        layers.append(Layer(path, colour(path), "line", t, v[:, k]))
        plots.append(Plot(name, "m/s", layers, zero=True, least=0.4))
    return Section("Velocity", "Of the pad against the drone: down is positive while the drone climbs away.", plots)


def errors(log: FlightLog, series: list[Series]) -> Section:
    """Return the steering path's errors with the band that it claimed, and the size of every series' lateral error."""
    if not log.truth:
        return Section("Errors", "No truth was recorded, so there are no errors to show.")
    states = steering_states(log)
    sigma = np.sqrt(np.array([np.diagonal(e.cov)[[0, 1, 2, 6]] for e in states]).reshape(-1, 4))
    plots = []
    for s in (s for s in series if s.name == steering_path(log)):
        values = [*s.error.T, np.degrees(s.yaw_error)]
        for k, name in enumerate((*_AXES, "heading")):
            half = BAND * sigma[:, k] * (math.degrees(1.0) if k == 3 else 1.0)
            claimed = Layer("claimed", colour(s.name), "band", s.t_s, -half, half, read=False, fits=False)
            plots.append(
                Plot(
                    f"{name}, {s.name} minus truth",
                    "degrees" if k == 3 else "m",
                    [claimed, Layer(s.name, colour(s.name), "line", s.t_s, values[k])],
                    zero=True,
                    least=0.5 if k == 3 else 0.02,
                )
            )
    sizes = [
        Layer(s.name, colour(s.name), "line" if s.is_path else "dots", s.t_s, np.maximum(s.lateral_error_m, 1e-4),
              read=s.is_path, fits=s.is_path, shown=s.name != "selected")
        for s in series
    ]  # fmt: skip
    plots.append(Plot("lateral error, size", "m", sizes, log=True))
    return Section("Errors", "Estimate minus truth; the band is two sigma as the filter claimed it.", plots)


def innovations(log: FlightLog, found: list[InnovationSeries]) -> Section:
    """Return every component of every source of the steering path, with the sigma that the filter claimed, and NIS."""
    path = steering_path(log)
    plots = []
    for s in found:
        if s.path != path or not len(s.t_s):
            continue
        span = (float(s.t_s[0]), float(s.t_s[-1]))
        for k, component in enumerate(s.components):
            name, unit = quantity_and_unit(component)
            scale = math.degrees(1.0) if unit == "rad" else 1.0
            y, half = scale * s.innovation[:, k], BAND * scale * s.sigma[:, k]
            layers = [Layer("claimed", FUSED, "band", s.t_s, -half, half, read=False)]
            layers += _by_verdict(s, y)
            plots.append(Plot(f"{s.source}: {name}", "degrees" if unit == "rad" else unit, layers, zero=True))
        # The gate's limit is NIS over the test ratio.
        gate = s.normalized_nis / np.maximum(s.test_ratio, 1e-12)
        layers = _by_verdict(s, np.clip(s.normalized_nis, 1e-3, 1e4))
        layers += [Layer("gate", REFUSED, "line", s.t_s, gate, read=False), level(1.0, "expected", span)]
        plots.append(Plot(f"{s.source}: NIS over the number of components", "", layers, log=True))
    note = (
        "Measured minus predicted, by the path that steered. Band: two sigma as the filter claims them. NIS is expected at the "
        "dashed line and refused above the other."
    )
    return Section("Innovations", note if plots else "No results of the estimator were recorded.", plots)


def _by_verdict(s: InnovationSeries, y: F64) -> list[Layer]:
    fused = Layer("fused", FUSED, "dots", s.t_s[s.fused], y[s.fused])
    refused = Layer("refused", REFUSED, "dots", s.t_s[~s.fused], y[~s.fused], fits=not s.fused.any())
    return [layer for layer in (fused, refused) if len(layer.t_s)]


def quantity_and_unit(component: str) -> tuple[str, str]:
    """Split the name of a component, as in x_m and down_m_s."""
    for ending, unit in (("_m_s", "m/s"), ("_rad", "rad"), ("_m", "m")):
        if component.endswith(ending):
            return component.removesuffix(ending).replace("_", " "), unit
    return component, ""


def verdicts(log: FlightLog) -> Section:
    """Return what became of each frame, over time."""
    kinds = [v for v in Verdict if any(f.verdict is v for f in log.frames)]
    layers = []
    for k, verdict in enumerate(kinds):
        t = np.array([seconds_between(log.started, f.exposed_at) for f in log.frames if f.verdict is verdict])
        ink = FUSED if verdict is Verdict.FUSED else REFUSED
        layers.append(Layer(verdict.value.replace("_", " "), ink, "dots", t, np.full(len(t), float(k)), read=False))
    names = tuple(v.value.replace("_", " ") for v in kinds)
    return Section("Frames", "", [Plot("verdict on each frame", "", layers, names=names)] if layers else [])


_AHEAD = {0.0: "", 1.0: " 1 s ago", 2.0: " 2 s ago"}
_INKS = {0.0: colour("ekf"), 1.0: THREE[0], 2.0: THREE[1]}


def ship(log: FlightLog) -> Section:
    """Return heave, roll and pitch of the deck, as it was, as the filter had it, and as it was forecast; and the ship's place."""
    quantities: list[tuple[str, str, float, Callable[[DeckSample], tuple[float, float]], F64 | None]] = [
        ("heave", "m", 1.0, lambda s: (s.height_m, s.sigma_height_m), _true_heave(log)),
        ("deck roll", "degrees", math.degrees(1.0), lambda s: (s.roll_rad, s.sigma_roll_rad), _true_tilt(log, 0)),
        ("deck pitch", "degrees", math.degrees(1.0), lambda s: (s.pitch_rad, s.sigma_pitch_rad), _true_tilt(log, 1)),
    ]
    t_true = np.array([seconds_between(log.started, s.at) for s in log.truth])
    plots = []
    for name, unit, scale, of, true in quantities:
        layers = [] if true is None else [Layer("truth", "ink", "line", t_true, scale * true, wide=True)]
        for ahead in HORIZONS_KEPT_S:
            samples = [s for s in log.decks if round((s.at - s.made_at) * 1e-9, 3) == ahead]
            if samples:
                t = np.array([seconds_between(log.started, s.at) for s in samples])
                mean, sigma = (scale * np.array([of(s)[k] for s in samples]) for k in (0, 1))
                label = f"filter{_AHEAD[ahead]}" if not ahead else f"forecast{_AHEAD[ahead]}"
                half = BAND * sigma
                if ahead == 1.0:
                    band = Layer(label, _INKS[ahead], "band", t, mean - half, mean + half, read=False, fits=False)
                    layers.append(band)
                layers.append(Layer(label, _INKS[ahead], "line", t, mean, shown=ahead < 2.0))
        plots.append(Plot(name, unit, layers, zero=True, least=0.2 if unit == "m" else 2.0))
    plots += _place(log)
    plots = [plot for plot in plots if not plot.empty]
    if not plots:
        return Section("Ship", "Neither the deck's motion nor the ship's place was recorded.")
    note = "Heave is positive up, roll positive with starboard down, pitch positive with the arrow up."
    return Section("Ship", f"{note} A forecast stands at the instant that it was made for; its band is two sigma.", plots)


def _true_heave(log: FlightLog) -> F64 | None:
    down = [math.nan if s.p_pad_ned is None else float(s.p_pad_ned[2]) for s in log.truth]
    return None if not np.isfinite(down).any() else np.nanmean(down) - np.array(down)


def _true_tilt(log: FlightLog, axis: int) -> F64 | None:
    found = [math.nan if s.R_ned_pad is None else float(s.R_ned_pad.rpy_rad[axis]) for s in log.truth]
    return None if not np.isfinite(found).any() else np.array(found)


def _place(log: FlightLog) -> list[Plot]:
    """Return the ship's true place since the beginning, and her velocity as the filter has it."""
    plots = []
    known = [(seconds_between(log.started, s.at), s.p_pad_ned) for s in log.truth if s.p_pad_ned is not None]
    if known:
        t, p = np.array([at for at, _ in known]), np.array([where for _, where in known])
        p = p - p[0]
        layers = [Layer(name, THREE[k], "line", t, p[:, k]) for k, name in enumerate(("north", "east"))]
        plots.append(Plot("place of the pad since the start, truth", "m", layers, zero=True, least=0.5))
    moving = []
    for estimate in log.estimates:
        if estimate.path == steering_path(log):
            details = dict(estimate.details)
            if "v_vessel_north_m_s" in details:
                v = (details["v_vessel_north_m_s"], details.get("v_vessel_east_m_s", math.nan))
                moving.append((seconds_between(log.started, estimate.at), *v))
    if moving:
        rows = np.array(moving)
        layers = [Layer(name, THREE[k], "line", rows[:, 0], rows[:, k + 1]) for k, name in enumerate(("north", "east"))]
        plots.append(Plot("velocity of the ship, filter", "m/s", layers, zero=True, least=0.5))
    return plots


def commands(log: FlightLog) -> Section:
    """Return the commanded velocity, tilt and turn."""
    t = np.array([seconds_between(log.started, c.at) for c in log.commands])
    rows, leans = np.full((len(t), 4), np.nan), np.full((len(t), 2), np.nan)
    for i, record in enumerate(log.commands):
        if isinstance(record.command, Velocity | Lean):
            rows[i] = [*record.command.v_level, math.degrees(record.command.yaw_rate_rad_s)]
        if isinstance(record.command, Lean):
            leans[i] = np.degrees(np.arctan((record.command.a_level + record.command.trim_level) / G_M_S2))
    names = ("forward", "right", "down")
    steps = [Layer(name, THREE[k], "step", t, rows[:, k]) for k, name in enumerate(names)]
    tilts = [Layer(name, THREE[k], "step", t, leans[:, k]) for k, name in enumerate(names[:2])]
    plots = [
        Plot("velocity", "m/s", steps, zero=True, least=0.4),
        Plot("tilt", "degrees", tilts, zero=True, least=2.0),
        Plot("turn", "degrees/s", [Layer("turn", THREE[2], "step", t, rows[:, 3])], zero=True, least=5.0),
    ]
    plots = [plot for plot in plots if not plot.empty]
    return Section("Commands", "What guidance commanded." if plots else "No commands were recorded.", plots)


def delays(log: FlightLog) -> Section:
    """Return how long each stage of each frame took."""
    layers = []
    for k, (name, taken) in enumerate(stage_times(log).items()):
        t = np.array([seconds_between(log.started, one.at) for one in taken])
        ms = np.array([max(1e3 * one.seconds, 1e-3) for one in taken])
        layers.append(Layer(name, STAGES[k % len(STAGES)], "dots", t, ms))
    layers = [layer for layer in layers if len(layer.t_s)]
    return Section("Times", "", [Plot("time taken by each stage", "ms", layers, log=True)] if layers else [])
