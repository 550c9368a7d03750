"""The plots of place, velocity, errors and the filter's verdicts, as layers over time."""

import math

import numpy as np

from companion.recording.palette import FUSED, REFUSED, colour
from companion.tools.report.figures import Series
from companion.tools.report.flight_log import FlightLog
from companion.tools.report.innovations import InnovationSeries
from companion.tools.report.layers import Layer, Plot, Section, broken_at_wraps, level
from estimator.contracts.estimates import PathName, RelativeState, Verdict
from estimator.contracts.geometry import F64
from estimator.contracts.time import seconds_between

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
