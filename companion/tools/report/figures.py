"""The numbers of the report: errors against truth, innovations, and their statistics."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
from msgspec import Struct

from companion.tools.report.flight_log import HORIZONS_KEPT_S, FlightLog, StageTime, TruthSample
from estimator.contracts.estimates import (
    COMPONENTS,
    POSE_COMPONENTS,
    FusionResult,
    PathName,
    RelativeState,
    Sighting,
    Source,
    Verdict,
)
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import MonoNs, seconds_between


class Series(Struct, frozen=True, eq=False):
    """Estimates of one method or path over time."""

    name: str
    is_path: bool
    """True if the series is an estimator's path, drawn as a line, and not a vision method, drawn as dots."""
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
    nees: F64
    """The (n,) squares of a path's errors by its covariance, over their degrees of freedom: place, velocity, and heading where
    known. Empty for a method: the covariance of a sighting leaves out the error of the attitude that levels it."""

    @property
    def lateral_error_m(self) -> F64:
        return np.asarray(np.hypot(self.error[:, 0], self.error[:, 1]))


class ErrorRow(Struct, frozen=True):
    """One line of the table of errors."""

    name: str
    is_path: bool
    count: int
    fraction: float | None
    """The fraction of all frames; None for a path, which is not tied to frames."""
    lateral_median_m: float
    lateral_p95_m: float
    down_median_m: float
    down_p95_m: float
    yaw_median_rad: float
    yaw_p95_rad: float
    nees: float
    """The mean of a path's NEES over its degrees of freedom: 1 where the covariances are right, more where they are too small
    (Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, 5.4.2); nan for a method."""


class DeckRow(Struct, frozen=True):
    """One line of the table of the deck's forecast tilt against truth."""

    ahead_s: float
    """Horizon of the deck's forecast; 0 is the deck as the filter has it."""
    count: int
    tilt_median_rad: float
    """Median angle between the forecast and the true deck."""
    tilt_p95_rad: float
    nees: float
    """The mean of the squares of the errors of roll and pitch over their variances: 1 is right."""


class TimingRow(Struct, frozen=True):
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
        self._values = np.array([[*s.d_body_pad_level, s.yaw_rad, *s.v_pad_level] for s in samples]).reshape(-1, 7)
        if len(samples):
            self._values[:, 3] = np.unwrap(self._values[:, 3])

    def at(self, instants: Iterable[MonoNs]) -> F64:
        """Return the (n, 7) truth: forward, right and down in m, heading in rad (-pi, pi], rates of the first three in m/s."""
        out = _interpolated(self._at, self._values, instants)
        out[:, 3] = np.remainder(out[:, 3] + math.pi, math.tau) - math.pi
        return out


def _interpolated(at: np.ndarray[tuple[int], np.dtype[np.int64]], values: F64, instants: Iterable[MonoNs]) -> F64:
    """Return the (n, k) values at these instants of a table with an (m, k) row for each instant of `at`, ns."""
    t = np.array(list(instants), dtype=np.int64)
    out = np.full((len(t), values.shape[1]), np.nan)
    if not len(at) or not len(t):
        return out
    after = np.searchsorted(at, t).clip(0, len(at) - 1)
    before = np.searchsorted(at, t, side="right").clip(1, None) - 1
    known = (t >= at[0]) & (t <= at[-1]) & (at[after] - at[before] <= 200_000_000)
    origin = at[0]
    for k in range(values.shape[1]):
        out[:, k] = np.interp((t - origin) * 1e-9, (at - origin) * 1e-9, values[:, k])
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
    t_s = np.array([seconds_between(log.started, t) for t in at])
    nees = np.array([_nees(value, row) for value, row in zip(values, true, strict=True) if isinstance(value, RelativeState)])
    return Series(name, is_path, t_s, d, yaw, d - true[:, :3], yaw_error, nees)


def _nees(b: RelativeState, true: F64) -> float:
    """Return the NEES of an estimate over its degrees of freedom; nan where there is no truth."""
    yaw_error = [] if b.yaw_rad is None else [wrap_pi(b.yaw_rad - true[3])]
    error = np.array([*(b.d_body_pad_level - true[:3]), *(b.v_pad_level - true[4:]), *yaw_error])
    n = len(error)
    return float(error @ np.linalg.solve(b.cov[:n, :n], error)) / n if np.isfinite(error).all() else math.nan


def error_rows(log: FlightLog, series: Sequence[Series]) -> list[ErrorRow]:
    """Return the statistics of each series against truth; they are nan where there is none."""
    frames = sum(log.verdicts.values()) or len(log.frames)
    rows = []
    for s in series:
        lateral, down, yaw = s.lateral_error_m, np.abs(s.error[:, 2]), np.abs(s.yaw_error)
        rows.append(
            ErrorRow(
                name=s.name,
                is_path=s.is_path,
                count=len(s.t_s),
                fraction=len(s.t_s) / frames if frames and not s.is_path else None,
                lateral_median_m=_quantile(lateral, 0.5),
                lateral_p95_m=_quantile(lateral, 0.95),
                down_median_m=_quantile(down, 0.5),
                down_p95_m=_quantile(down, 0.95),
                yaw_median_rad=_quantile(yaw, 0.5),
                yaw_p95_rad=_quantile(yaw, 0.95),
                nees=_mean(s.nees),
            )
        )
    return rows


def deck_rows(log: FlightLog) -> list[DeckRow]:
    """Return how the deck's tilt by the steering path differs from truth, now and as it was forecast; empty without either."""
    truths = [(s.at, *s.R_ned_pad.rpy_rad[:2]) for s in log.truth if s.R_ned_pad is not None]
    if not truths:
        return []
    at, tilts = np.array([t for t, _, _ in truths], dtype=np.int64), np.array([rest for _, *rest in truths])
    rows = []
    for ahead_s in HORIZONS_KEPT_S:
        samples = [s for s in log.decks if round(seconds_between(s.made_at, s.at), 3) == ahead_s]
        if not samples:
            continue
        output = np.array([(s.roll_rad, s.pitch_rad, s.sigma_roll_rad, s.sigma_pitch_rad) for s in samples])
        error = output[:, :2] - _interpolated(at, tilts, [s.at for s in samples])
        tilt, normalized = np.hypot(error[:, 0], error[:, 1]), ((error / output[:, 2:]) ** 2).mean(axis=1)
        count = int(np.isfinite(tilt).sum())
        rows.append(DeckRow(ahead_s, count, _quantile(tilt, 0.5), _quantile(tilt, 0.95), _mean(normalized)))
    return rows


def timing_rows(log: FlightLog) -> list[TimingRow]:
    """Return a row for each stage in the log's order, then one for the delay from the exposure to the estimate."""
    named = {name: np.array([one.seconds for one in times]) for name, times in stage_times(log).items() if times}
    return [TimingRow(name, len(v), *(_quantile(v, q) for q in (0.5, 0.95, 0.99, 1.0))) for name, v in named.items()]


def stage_times(log: FlightLog) -> dict[str, list[StageTime]]:
    """Return the durations of every stage, then the delay from the exposure to the estimate."""
    return {**log.stages, "exposure to belief": log.delays}


def _mean(x: F64) -> float:
    x = x[np.isfinite(x)]
    return float(x.mean()) if len(x) else math.nan


def _quantile(x: F64, q: float) -> float:
    x = x[np.isfinite(x)]
    return float(np.quantile(x, q)) if len(x) else math.nan


def body_over_pad(d: F64, yaw_rad: F64) -> F64:
    """Return the body's (n, 3) positions over the pad in m, along the arrow, to starboard, up, from `d_body_pad_level`."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.stack([-(c * d[:, 0] - s * d[:, 1]), -(s * d[:, 0] + c * d[:, 1]), d[:, 2]], axis=1)


class InnovationSeries(Struct, frozen=True, eq=False):
    """The results of one source on one path over time."""

    path: PathName
    source: Source
    verdicts: Counter[Verdict]
    """The counts of verdicts on all measurements, including those that were compared with nothing."""
    components: tuple[str, ...]
    t_s: F64
    """The (n,) times since the flight's start of the measurements that were compared with a prediction, s."""
    innovation: F64
    """The (n, m) innovations; nan where a measurement lacked the component."""
    sigma: F64
    """The (n, m) standard deviations of the innovations that the filter claimed."""
    normalized_nis: F64
    """The (n,) values of NIS divided by the number of components."""
    test_ratio: F64
    """The (n,) test ratios."""
    fused: np.ndarray[tuple[int], np.dtype[np.bool_]]
    """The (n,) flags of whether each measurement was fused."""

    @property
    def name(self) -> str:
        """The path and the source, in words."""
        return f"{self.path}: {self.source}".replace("_", " ")

    @property
    def nis_mean(self) -> float:
        """Mean of NIS over the number of components of what was fused; nan without any."""
        values = self.normalized_nis[self.fused]
        return float(np.mean(values)) if len(values) else math.nan

    @property
    def test_ratio_p95(self) -> float:
        """95 % quantile of the test ratio of everything compared; nan without any."""
        return float(np.quantile(self.test_ratio, 0.95)) if len(self.test_ratio) else math.nan


def innovation_series(log: FlightLog) -> list[InnovationSeries]:
    """Return a series for each path and source that the log holds results of, sightings first, in the order of the paths."""
    grouped: dict[tuple[PathName, Source], list[FusionResult]] = {}
    for result in log.results:
        grouped.setdefault((result.path, result.source), []).append(result)
    paths = list(dict.fromkeys(path for path, _ in grouped))
    order = ["sighting", *COMPONENTS]
    return [
        _innovations(log, *key, grouped[key]) for key in sorted(grouped, key=lambda k: (paths.index(k[0]), order.index(k[1])))
    ]


def _innovations(log: FlightLog, path: PathName, source: Source, results: list[FusionResult]) -> InnovationSeries:
    compared = sorted((r for r in results if math.isfinite(r.nis)), key=lambda r: r.measured_at)
    met = {name for r in compared for name in r.components}
    known = dict.fromkeys((*COMPONENTS[source], *(POSE_COMPONENTS if source == "sighting" else ())))
    components = tuple(name for name in known if name in met)
    column = {name: i for i, name in enumerate(components)}
    innovation = np.full((len(compared), len(components)), np.nan)
    sigma = innovation.copy()
    for i, r in enumerate(compared):
        assert r.innovation is not None
        assert r.innovation_cov is not None
        where = [column[name] for name in r.components]
        innovation[i, where] = r.innovation
        sigma[i, where] = np.sqrt(np.diag(r.innovation_cov))
    return InnovationSeries(
        path,
        source,
        Counter(r.verdict for r in results),
        components,
        np.array([seconds_between(log.started, r.measured_at) for r in compared]),
        innovation,
        sigma,
        np.array([r.normalized_nis for r in compared]),
        np.array([r.test_ratio for r in compared]),
        np.array([r.verdict is Verdict.FUSED for r in compared], dtype=bool),
    )
