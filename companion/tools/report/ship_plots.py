"""The plots of the ship, of the commands and of the delays, as layers over time."""

import math
from collections.abc import Callable

import numpy as np

from companion.recording.palette import STAGES, THREE, colour
from companion.tools.report.estimate_plots import BAND, steering_path
from companion.tools.report.figures import stage_times
from companion.tools.report.flight_log import HORIZONS_KEPT_S, DeckSample, FlightLog
from companion.tools.report.layers import Layer, Plot, Section
from estimator.contracts.commands import Lean, Velocity
from estimator.contracts.geometry import F64
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import seconds_between

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
    return Section("Commands", "What guidance asked of the vehicle." if plots else "No commands were recorded.", plots)


def delays(log: FlightLog) -> Section:
    """Return how long each stage of each frame took."""
    layers = []
    for k, (name, taken) in enumerate(stage_times(log).items()):
        t = np.array([seconds_between(log.started, one.at) for one in taken])
        ms = np.array([max(1e3 * one.seconds, 1e-3) for one in taken])
        layers.append(Layer(name, STAGES[k % len(STAGES)], "dots", t, ms))
    layers = [layer for layer in layers if len(layer.t_s)]
    return Section("Times", "", [Plot("time taken by each stage", "ms", layers, log=True)] if layers else [])
