"""Fit the error models of perception to recorded flights whose truth is known.

A table over the height and the fraction of the disc in the image has the main effects; tilt and light are factors on top of it,
each fitted against what the table alone would expect. Sources: the odds factor is that of a logistic model with main effects
only (McCullagh & Nelder, Generalized Linear Models, 1989, ch. 4); the robust scale is the median absolute deviation.

The error of the filter's estimate is fitted over height and time since the newest sighting.
"""

import math
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, wrap_pi
from sitl.perception.parameters import FORMAT, DetectionCell, DetectionModel, EstimateCell, EstimateModel, Factor, PerceptionModel
from sitl.study.perception.recorded import DetectionSample, Measured, Recorded, detection_samples

_ESTIMATE_HEIGHTS_M = (0.2, 0.35, 0.5, 0.8, 1.3, 2.0, 3.0, 4.5, 7.0, 10.0, 15.0, 22.0)
AGES_S = (0.2, 0.35, 0.6, 1.0, 1.7, 3.0, 5.0)
LEAST = 30
"""Fewest samples of a cell."""
_SETTLED_S = 1.0
"""Time after the first sighting from which the estimate counts."""
_LEAST_M = 0.1
"""Lowest height that counts: below it the drone stands."""
_LAGS = (5, 10, 20, 40)
"""Lags, in guidance cycles, over which the correlation time is fitted."""
_COMPONENTS = 7


class Errors(NamedTuple):
    """The estimate's errors in one flight, one row a guidance cycle in which there was an estimate."""

    at_s: F64
    """(N,)"""
    height_m: F64
    """(N,) true height of the body over the pad's centre."""
    age_s: F64
    """(N,) time since the newest sighting."""
    error: F64
    """(N, 7) estimate less truth: position over the height, velocity m/s, heading rad."""


def errors_of(recorded: Recorded) -> Errors:
    """Return the errors of a recorded flight's steering estimate, from its first second to the first contact."""
    first = min((b.sighted for b in recorded.beliefs), default=0)
    rows = []
    for b in recorded.beliefs:
        truth = recorded.truths.get(b.at)
        if truth is None or (b.at - first) * 1e-9 < _SETTLED_S or b.yaw_rad is None or truth.touchdown is not None:
            continue
        height = truth.d_body_pad_level[2]
        if height < _LEAST_M:
            continue
        d = (b.d_body_pad_level - np.array(truth.d_body_pad_level)) / height
        v = b.v_pad_level - np.array(truth.v_pad_level)
        rows.append((b.at * 1e-9, height, b.age_s(b.at), *d, *v, wrap_pi(b.yaw_rad - truth.yaw_rad)))
    table = np.array(rows, dtype=float).reshape(-1, 3 + _COMPONENTS)
    return Errors(table[:, 0], table[:, 1], table[:, 2], table[:, 3:])


def fit_estimates(flights: Sequence[Errors]) -> EstimateModel:
    """Return the error model of the estimate.

    Raises:
        BadInput: too few estimates beside a truth.
    """
    places: dict[tuple[int, int], list[F64]] = defaultdict(list)
    samples = 0
    for flight in flights:
        for height, age, error in zip(flight.height_m, flight.age_s, flight.error, strict=True):
            if abs(error[6]) > math.pi / 2:  # half a turn: an ambiguity of vision and no error of the filter
                continue
            places[bisect_right(_ESTIMATE_HEIGHTS_M, height), bisect_right(AGES_S, age)].append(error)
            samples += 1
    cells = []
    for (height, age), errors in sorted(places.items()):
        if len(errors) < LEAST:
            continue
        e = np.array(errors)
        cov = e.T.dot(e) / len(e)
        cells.append(EstimateCell(height, age, len(e), tuple(cov[np.tril_indices(_COMPONENTS)].tolist())))
    if not cells:
        raise BadInput(f"the recordings hold no height with {LEAST} estimates beside a truth")
    return EstimateModel(_ESTIMATE_HEIGHTS_M, AGES_S, samples, _correlation_times(flights), tuple(cells))


def _correlation_times(flights: Sequence[Errors]) -> tuple[float, ...]:
    """Return the time in which the correlation of each component falls to 1/e, by a fit of log correlation over the lag."""
    out = []
    for k in range(_COMPONENTS):
        times = []
        for lag in _LAGS:
            products, squares, lag_s = 0.0, 0.0, []
            for flight in flights:
                e = flight.error[:, k]
                near = flight.age_s < AGES_S[0]
                if len(e) <= lag:
                    continue
                a, b, both = e[:-lag], e[lag:], near[:-lag] & near[lag:]
                products += float((a * b)[both].sum())
                squares += float((0.5 * (a * a + b * b))[both].sum())
                lag_s.append(float(np.median(flight.at_s[lag:] - flight.at_s[:-lag])))
            if squares > 0.0 and 0.0 < products < squares:
                times.append(float(np.median(lag_s)) / -math.log(products / squares))
        out.append(float(np.clip(np.median(times), 0.05, 60.0)) if times else 1.0)
    return tuple(out)


HEIGHTS_M = (0.15, 0.25, 0.35, 0.5, 0.65, 0.8, 1.0, 1.3, 2.0, 3.0, 5.0, 8.0, 14.0, 20.0, 28.0)
SHOWN = (0.02, 0.06, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.45, 0.7, 0.95)
"""Grid of apparent sizes.

From high up, the detection probability rises from 0 to 1 between a quarter and two fifths of the disc.
"""
TILTS_DEG = (3.0, 6.0, 10.0, 15.0, 22.0)
LIGHTS_STOPS = (-4.0, -2.5, -1.5, -0.5, 0.5, 1.5)
LEAST_FRAMES = 10
"""Fewest samples of a cell, and of detections for its errors; smaller cells take the errors of the nearest that has more."""
_OUTLIER = 5.0
"""Robust standard deviations beyond which an error is an outlier's."""
_GAP_FRAMES = 1.5


class _Place(NamedTuple):
    height: int
    shown: int


class _Standard(NamedTuple):
    """The error of a sample, divided by its own scale and its cell's standard deviation."""

    sample: DetectionSample
    error: F64
    scale: float
    """Ratio of the sample's claimed standard deviations to the cell's geometric mean."""
    outlier: bool


class Source(NamedTuple):
    """The samples of one recorded flight, and the light they were made in."""

    samples: tuple[DetectionSample, ...]
    light_stops: float


def fit(flights: Sequence[Recorded]) -> PerceptionModel:
    """Return the model of recorded flights.

    Raises:
        BadInput: the recordings are of different methods of vision, or hold too few samples or estimates.
    """
    methods = sorted({flight.settings.vision.method for flight in flights})
    if len(methods) != 1:
        raise BadInput(f"recordings of several methods of vision ({', '.join(methods)}) make no model; fit each on its own")
    sources = [Source(detection_samples(flight), flight.scenario.light.exposure_ev) for flight in flights]
    names = tuple(f"{flight.name}: {len(source.samples)} frames" for flight, source in zip(flights, sources, strict=True))
    estimates = fit_estimates([errors_of(flight) for flight in flights])
    return PerceptionModel(FORMAT, methods[0], names, fit_detections(sources), estimates)


def fit_detections(sources: Sequence[Source]) -> DetectionModel:
    """Return the error model of detections.

    Raises:
        BadInput: too few samples or detections.
    """
    samples = [sample for source in sources for sample in source.samples]
    if sum(sample.measured is not None for sample in samples) < 10 * LEAST_FRAMES:
        raise BadInput(f"the recordings hold too few detections: {sum(sample.measured is not None for sample in samples)}")
    frame_s = float(np.median([b.at_s - a.at_s for s in sources for a, b in pairwise(s.samples)]))
    before = _found_before(sources, frame_s)
    by_place: dict[_Place, list[DetectionSample]] = defaultdict(list)
    for sample in samples:
        by_place[_place(sample)].append(sample)
    cells: list[DetectionCell] = []
    standard: dict[int, _Standard] = {}
    for place, here in sorted(by_place.items()):
        if len(here) < LEAST_FRAMES:
            continue
        cell, made = _cell(place, here, before, _with_errors(place, by_place))
        cells.append(cell)
        standard.update({id(s.sample): s for s in made})
    if not cells:
        raise BadInput(f"the recordings hold no height with {LEAST_FRAMES} frames or more")
    expected = {(c.height, c.shown): c for c in cells}
    light = {id(sample): source.light_stops for source in sources for sample in source.samples}
    known = [sample for sample in samples if _place(sample) in expected]

    def factor(edges: tuple[float, ...], value: Callable[[DetectionSample], float]) -> Factor:
        return _factor(edges, value, known, before, expected, standard)

    return DetectionModel(
        HEIGHTS_M,
        SHOWN,
        len(samples),
        frame_s,
        _correlation(sources, standard, frame_s, lambda one: one.error),
        factor(TILTS_DEG, lambda sample: math.degrees(sample.view.tilt_rad)),
        factor(LIGHTS_STOPS, lambda sample: light[id(sample)]),
        tuple(cells),
        _correlation(sources, standard, frame_s, lambda one: np.log([one.scale])),
    )


def _place(sample: DetectionSample) -> _Place:
    return _Place(bisect_right(HEIGHTS_M, sample.view.height_m), bisect_right(SHOWN, sample.view.shown))


def _found_before(sources: Sequence[Source], frame_s: float) -> dict[int, bool]:
    """Return by sample whether the pad was found in the frame before it; after a gap it counts as not found."""
    out: dict[int, bool] = {}
    for source in sources:
        last: DetectionSample | None = None
        for sample in source.samples:
            near = last is not None and sample.at_s - last.at_s < _GAP_FRAMES * frame_s
            out[id(sample)] = near and last is not None and last.measured is not None
            last = sample
    return out


def _with_errors(place: _Place, by_place: dict[_Place, list[DetectionSample]]) -> list[DetectionSample]:
    """Return the detections of a cell, or of the nearest cell with enough of them if it has too few."""
    enough = {
        p: found for p, here in by_place.items() if len(found := [k for k in here if k.measured is not None]) >= LEAST_FRAMES
    }
    if not enough:
        raise BadInput(f"the recordings hold no height with {LEAST_FRAMES} detections or more")
    return enough[min(enough, key=lambda p: (abs(p.height - place.height) + 3 * abs(p.shown - place.shown), p))]


def _cell(
    place: _Place, here: Sequence[DetectionSample], before: dict[int, bool], found: Sequence[DetectionSample]
) -> tuple[DetectionCell, list[_Standard]]:
    after_found = [sample for sample in here if before[id(sample)]]
    after_none = [sample for sample in here if not before[id(sample)]]
    hits = sum(sample.measured is not None for sample in here)
    measured = [sample.measured for sample in found if sample.measured is not None]
    scales = _scales(measured)
    raw = np.array([m.error for m in measured]) / scales[:, None]
    middle = np.median(raw, axis=0)
    spread = 1.4826 * np.median(np.abs(raw - middle), axis=0) + 1e-12
    distance = np.abs((raw - middle) / spread).max(axis=1)
    outlier = distance > _OUTLIER
    core = raw[~outlier]
    bias = core.mean(axis=0)
    cov = np.cov(core.T) if len(core) > 1 else np.diag(spread**2)
    ratio = float(np.median(distance[outlier])) / 2.0 if outlier.any() else 1.0
    claimed = np.mean([m.cov / s**2 for m, s, out in zip(measured, scales, outlier, strict=True) if not out], axis=0)
    root = np.sqrt(np.diag(cov)) + 1e-15
    made = [_Standard(*one) for one in zip(found, (raw - bias) / root, scales.tolist(), outlier.tolist(), strict=True)]
    cell = DetectionCell(
        place.height, place.shown, len(here), hits,
        _probability(after_found, hits / len(here)), _probability(after_none, hits / len(here)),
        float(np.mean([sample.confidence for sample in found])),
        float(np.mean([m.ambiguous for m in measured])), float(np.mean([m.turned for m in measured])),
        float(outlier.mean()), max(1.0, ratio), tuple(bias.tolist()), _lower(cov), _lower(claimed), _spread(np.log(scales)),
    )  # fmt: skip
    return cell, made if {id(sample) for sample in found} <= {id(sample) for sample in here} else []


def _scales(measured: Sequence[Measured]) -> F64:
    """Return how large the standard deviations are that each detection claims, against the cell's geometric mean, (n,).

    A detection that says that it is worse is allowed to be: only what is left over its own claim makes an outlier.
    """
    logs = 0.5 * np.log(np.array([np.diag(m.cov) for m in measured]) + 1e-18).mean(axis=1)
    return np.asarray(np.exp(logs - logs.mean()))


def _spread(logs: F64) -> float:
    """Return the standard deviation by the median absolute deviation: a few wild claims in a small cell do not count."""
    return float(1.4826 * np.median(np.abs(logs - np.median(logs))))


def _probability(samples: Sequence[DetectionSample], otherwise: float) -> float:
    """Return the probability of a detection by Jeffreys' prior; with no sample of this kind at all, that of the whole cell."""
    hits = sum(sample.measured is not None for sample in samples)
    if not samples:
        return otherwise if hits else min(max(otherwise, 0.02), 0.98)
    if hits == 0 and otherwise == 0.0:
        return 0.0 if len(samples) >= LEAST_FRAMES else 0.5 / (len(samples) + 1.0)
    return (hits + 0.5) / (len(samples) + 1.0)


def _factor(
    edges: tuple[float, ...],
    value: Callable[[DetectionSample], float],
    samples: Sequence[DetectionSample],
    before: dict[int, bool],
    cells: dict[tuple[int, int], DetectionCell],
    standard: dict[int, _Standard],
) -> Factor:
    n = len(edges) + 1
    bins = [bisect_right(edges, value(sample)) for sample in samples]
    counts, odds, ratio = [], [], []
    for i in range(n):
        here = [sample for sample, b in zip(samples, bins, strict=True) if b == i]
        counts.append(len(here))
        odds.append(_odds(here, before, cells))
        made = [standard[id(sample)] for sample in here if id(sample) in standard]
        errors = [one.scale * one.error for one in made if not one.outlier]
        ratio.append(float(np.sqrt(np.mean(np.square(errors)))) if len(errors) >= LEAST_FRAMES else 1.0)
    # Most samples are of one kind, which the cells describe by themselves: the factors are those of the others against it.
    usual = counts.index(max(counts))
    known = [count >= LEAST_FRAMES for count in counts]
    return Factor(
        edges,
        tuple(counts),
        tuple(o / odds[usual] if is_known else 1.0 for o, is_known in zip(odds, known, strict=True)),
        tuple(r / ratio[usual] if is_known else 1.0 for r, is_known in zip(ratio, known, strict=True)),
    )


def _odds(samples: Sequence[DetectionSample], before: dict[int, bool], cells: dict[tuple[int, int], DetectionCell]) -> float:
    """Return the factor of the odds with which the cells explain how many of these samples found the pad."""
    if len(samples) < LEAST_FRAMES:
        return 1.0
    p = np.array([_expected(sample, before, cells) for sample in samples])
    open_ = (p > 0.0) & (p < 1.0)
    hits = sum(sample.measured is not None for sample, is_open in zip(samples, open_, strict=True) if is_open)
    p = p[open_]
    if len(p) < LEAST_FRAMES or not 0 < hits < len(p):
        return 1.0
    low, high = 1e-3, 1e3
    for _ in range(60):
        k = math.sqrt(low * high)
        low, high = (k, high) if float((k * p / (1.0 - p + k * p)).sum()) < hits else (low, k)
    return math.sqrt(low * high)


def _expected(sample: DetectionSample, before: dict[int, bool], cells: dict[tuple[int, int], DetectionCell]) -> float:
    cell = cells[_place(sample)]
    return cell.kept if before[id(sample)] else cell.regained


def _correlation(
    sources: Sequence[Source], standard: dict[int, _Standard], frame_s: float, of: Callable[[_Standard], F64]
) -> float:
    """Return the correlation of a quantity whose mean is zero, over successive frames without an outlier."""
    products, squares = [], []
    for source in sources:
        for a, b in pairwise(source.samples):
            one, two = standard.get(id(a)), standard.get(id(b))
            if one is None or two is None or one.outlier or two.outlier or b.at_s - a.at_s > _GAP_FRAMES * frame_s:
                continue
            x, y = of(one), of(two)
            products.append(x * y)
            squares.append(0.5 * (x * x + y * y))
    if not products or not np.any(squares):
        return 0.0
    return min(0.99, max(0.0, float(np.mean(products) / np.mean(squares))))


def _lower(cov: F64) -> tuple[float, ...]:
    return tuple(cov[np.tril_indices(len(cov))].tolist())
