"""The numbers of the report: errors against truth, and their statistics."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.report.flight_log import FlightLog, StageTime, TruthSample
from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import MonoNs, seconds_between


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Estimates of one method or path over time."""

    name: str
    is_path: bool
    """Whether the series is an estimator's path, drawn as a line, and not a vision method, drawn as dots."""
    t_s: F64
    """The (n,) times since the flight's start, s."""
    d: F64
    """The (n, 3) values of `d_body_pad_level`, m."""
    yaw_rad: F64
    """The (n,) headings, rad; nan if not measured."""
    error: F64
    """The (n, 3) errors, estimate minus truth, m; nan where there is no truth."""
    yaw_error: F64
    """The (n,) heading errors, rad."""

    @property
    def lateral_error_m(self) -> F64:
        return np.asarray(np.hypot(self.error[:, 0], self.error[:, 1]))


@dataclass(frozen=True, slots=True)
class ErrorRow:
    """One line of the table of errors."""

    name: str
    is_path: bool
    count: int
    fraction: float | None
    """The fraction of all frames; None for a path, which is not tied to frames."""
    lateral_median_m: float
    lateral_p95_m: float
    down_bias_m: float
    down_p95_m: float
    yaw_median_rad: float
    yaw_p95_rad: float


@dataclass(frozen=True, slots=True)
class TimingRow:
    """One line of the table of times."""

    name: str
    count: int
    median_s: float
    p95_s: float
    p99_s: float
    max_s: float


class TruthTrack:
    """Interpolates truth at any instant between its samples; it is nan outside, and across gaps of more than 0.2 s."""

    def __init__(self, samples: Sequence[TruthSample]) -> None:
        self._at = np.array([s.at for s in samples], dtype=np.int64)
        self._values = np.array([[*s.d_body_pad_level, s.yaw_rad] for s in samples]).reshape(-1, 4)
        if len(samples):
            self._values[:, 3] = np.unwrap(self._values[:, 3])

    def at(self, instants: Iterable[MonoNs]) -> F64:
        """Return the (n, 4) truth: forward, right and down in m, heading in rad (-pi, pi]."""
        t = np.array(list(instants), dtype=np.int64)
        out = np.full((len(t), 4), np.nan)
        if not len(self._at) or not len(t):
            return out
        after = np.searchsorted(self._at, t).clip(0, len(self._at) - 1)
        before = np.searchsorted(self._at, t, side="right").clip(1, None) - 1
        gap = self._at[after] - self._at[before]
        known = (t >= self._at[0]) & (t <= self._at[-1]) & (gap <= 200_000_000)
        origin = self._at[0]
        for k in range(4):
            out[:, k] = np.interp((t - origin) * 1e-9, (self._at - origin) * 1e-9, self._values[:, k])
        out[:, 3] = np.remainder(out[:, 3] + math.pi, math.tau) - math.pi
        out[~known] = np.nan
        return out


def all_series(log: FlightLog) -> list[Series]:
    """Return a series for every method and path in the log, methods first, each in order of time."""
    truth = TruthTrack(log.truth)
    methods: dict[str, list[Sighting]] = {}
    for sighting in log.sightings:
        methods.setdefault(sighting.method, []).append(sighting)
    paths: dict[str, list[RelativeState]] = {}
    for estimate in log.estimates:
        paths.setdefault(estimate.path, []).append(estimate)
    out = []
    for name, seen in methods.items():
        seen = sorted(seen, key=lambda s: s.stamp.measured_at)
        out.append(_series(log, truth, name, False, [s.stamp.measured_at for s in seen], seen))
    for path, states in paths.items():
        states = sorted(states, key=lambda s: s.at)
        out.append(_series(log, truth, path, True, [s.at for s in states], states))
    return out


def _series(
    log: FlightLog,
    truth: TruthTrack,
    name: str,
    is_path: bool,
    at: list[MonoNs],
    values: Sequence[Sighting] | Sequence[RelativeState],
) -> Series:
    d = np.array([v.d_body_pad_level for v in values]).reshape(-1, 3)
    yaw = np.array([math.nan if v.yaw_rad is None else v.yaw_rad for v in values])
    true = truth.at(at)
    yaw_error = np.array([wrap_pi(e) for e in yaw - true[:, 3]])
    return Series(name, is_path, np.array([seconds_between(log.started, t) for t in at]), d, yaw, d - true[:, :3], yaw_error)


def error_rows(log: FlightLog, series: Sequence[Series]) -> list[ErrorRow]:
    """Return the statistics of each series against truth; they are nan where there is none."""
    frames = sum(log.verdicts.values()) or len(log.frames)
    rows = []
    for s in series:
        lateral, down, yaw = s.lateral_error_m, s.error[:, 2], np.abs(s.yaw_error)
        rows.append(
            ErrorRow(
                name=s.name,
                is_path=s.is_path,
                count=len(s.t_s),
                fraction=len(s.t_s) / frames if frames and not s.is_path else None,
                lateral_median_m=_quantile(lateral, 0.5),
                lateral_p95_m=_quantile(lateral, 0.95),
                down_bias_m=_quantile(down, 0.5),
                down_p95_m=_quantile(np.abs(down), 0.95),
                yaw_median_rad=_quantile(yaw, 0.5),
                yaw_p95_rad=_quantile(yaw, 0.95),
            )
        )
    return rows


def timing_rows(log: FlightLog) -> list[TimingRow]:
    """Return a row for each stage in the log's order, then one for the delay from the exposure to the estimate."""
    named = {name: np.array([one.seconds for one in times]) for name, times in stage_times(log).items() if times}
    return [TimingRow(name, len(v), *(_quantile(v, q) for q in (0.5, 0.95, 0.99, 1.0))) for name, v in named.items()]


def stage_times(log: FlightLog) -> dict[str, list[StageTime]]:
    """Return the durations of every stage, then the delay from the exposure to the estimate."""
    return {**log.stages, "exposure to belief": log.delays}


def _quantile(x: F64, q: float) -> float:
    x = x[np.isfinite(x)]
    return float(np.quantile(x, q)) if len(x) else math.nan


def body_over_pad(d: F64, yaw_rad: F64) -> F64:
    """Return the body's (n, 3) positions over the pad in m, along the arrow, to starboard, up, from `d_body_pad_level`."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.stack([-(c * d[:, 0] - s * d[:, 1]), -(s * d[:, 0] + c * d[:, 1]), d[:, 2]], axis=1)
