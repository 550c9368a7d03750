"""Fit the error models of perception to recorded flights whose truth is known.

A table over the height and the share of the disc in the picture holds what matters most; tilt and light are factors on top of it,
each fitted against what the table alone would expect. Sources: the odds factor is that of a logistic model with main effects
only (McCullagh & Nelder, Generalized Linear Models, 1989, ch. 4); the robust scale is the median absolute deviation.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from sitl.perception.estimates import errors_of, fit_estimates
from sitl.perception.looks import Look, looks_of
from sitl.perception.parameters import FORMAT, Factor, LookCell, LookModel, PerceptionModel
from sitl.perception.recorded import Recorded

HEIGHTS_M = (0.15, 0.25, 0.35, 0.5, 0.65, 0.8, 1.0, 1.3, 1.7, 2.3, 3.0, 4.0, 5.0, 7.0, 10.0, 14.0, 20.0, 28.0)
SHOWN = (0.02, 0.12, 0.25, 0.45, 0.7, 0.95)
TILTS_DEG = (3.0, 6.0, 10.0, 15.0, 22.0)
LIGHTS_STOPS = (-4.0, -2.5, -1.5, -0.5, 0.5, 1.5)
LEAST_LOOKS = 12
"""Fewest looks of a cell, and of detections for its errors; smaller cells take the errors of the nearest that has more."""
_OUTLIER = 5.0
"""Robust standard deviations beyond which an error is an outlier's."""
_GAP_FRAMES = 1.5


class _Place(NamedTuple):
    height: int
    shown: int


class _Standard(NamedTuple):
    """A look's error, made standard by its cell."""

    look: Look
    error: F64
    outlier: bool


class Source(NamedTuple):
    """The looks of one recorded flight, and the light they were made in."""

    looks: tuple[Look, ...]
    light_stops: float


def fit(flights: Sequence[Recorded]) -> PerceptionModel:
    """Return the model of recorded flights.

    Raises:
        BadInput: the recordings are of different methods of vision, or hold too few looks or estimates.
    """
    methods = sorted({flight.settings.vision.method for flight in flights})
    if len(methods) != 1:
        raise BadInput(f"recordings of several methods of vision ({', '.join(methods)}) make no model; fit each on its own")
    sources = [Source(looks_of(flight), flight.scenario.light.exposure_ev) for flight in flights]
    names = tuple(f"{flight.name}: {len(source.looks)} looks" for flight, source in zip(flights, sources, strict=True))
    estimates = fit_estimates([errors_of(flight) for flight in flights])
    return PerceptionModel(FORMAT, methods[0], names, fit_looks(sources), estimates)


def fit_looks(sources: Sequence[Source]) -> LookModel:
    """Return the error model of detections.

    Raises:
        BadInput: too few looks or detections.
    """
    looks = [look for source in sources for look in source.looks]
    if sum(look.measured is not None for look in looks) < 10 * LEAST_LOOKS:
        raise BadInput(f"the recordings hold too few detections: {sum(look.measured is not None for look in looks)}")
    frame_s = float(np.median([b.at_s - a.at_s for s in sources for a, b in pairwise(s.looks)]))
    before = _found_before(sources, frame_s)
    by_place: dict[_Place, list[Look]] = defaultdict(list)
    for look in looks:
        by_place[_place(look)].append(look)
    cells: list[LookCell] = []
    standard: dict[int, _Standard] = {}
    for place, here in sorted(by_place.items()):
        if len(here) < LEAST_LOOKS:
            continue
        cell, made = _cell(place, here, before, _with_errors(place, by_place))
        cells.append(cell)
        standard.update({id(s.look): s for s in made})
    if not cells:
        raise BadInput(f"the recordings hold no height with {LEAST_LOOKS} looks or more")
    expected = {(c.height, c.shown): c for c in cells}
    light = {id(look): source.light_stops for source in sources for look in source.looks}
    known = [look for look in looks if _place(look) in expected]

    def factor(edges: tuple[float, ...], value: Callable[[Look], float]) -> Factor:
        return _factor(edges, value, known, before, expected, standard)

    return LookModel(
        HEIGHTS_M,
        SHOWN,
        len(looks),
        frame_s,
        _correlation(sources, standard, frame_s),
        factor(TILTS_DEG, lambda look: math.degrees(look.view.tilt_rad)),
        factor(LIGHTS_STOPS, lambda look: light[id(look)]),
        tuple(cells),
    )


def _place(look: Look) -> _Place:
    return _Place(bisect_right(HEIGHTS_M, look.view.height_m), bisect_right(SHOWN, look.view.shown))


def _found_before(sources: Sequence[Source], frame_s: float) -> dict[int, bool]:
    """Whether the look just before found the pad; a look after a gap counts as one after none."""
    out: dict[int, bool] = {}
    for source in sources:
        last: Look | None = None
        for look in source.looks:
            near = last is not None and look.at_s - last.at_s < _GAP_FRAMES * frame_s
            out[id(look)] = near and last is not None and last.measured is not None
            last = look
    return out


def _with_errors(place: _Place, by_place: dict[_Place, list[Look]]) -> list[Look]:
    """The detections of a cell; of the nearest cell with enough of them if it has too few itself."""
    enough = {
        p: found for p, here in by_place.items() if len(found := [k for k in here if k.measured is not None]) >= LEAST_LOOKS
    }
    if not enough:
        raise BadInput(f"the recordings hold no height with {LEAST_LOOKS} detections or more")
    return enough[min(enough, key=lambda p: (abs(p.height - place.height) + 3 * abs(p.shown - place.shown), p))]


def _cell(
    place: _Place, here: Sequence[Look], before: dict[int, bool], found: Sequence[Look]
) -> tuple[LookCell, list[_Standard]]:
    after_found = [look for look in here if before[id(look)]]
    after_none = [look for look in here if not before[id(look)]]
    hits = sum(look.measured is not None for look in here)
    measured = [look.measured for look in found if look.measured is not None]
    raw = np.array([m.error for m in measured])
    middle = np.median(raw, axis=0)
    spread = 1.4826 * np.median(np.abs(raw - middle), axis=0) + 1e-12
    distance = np.abs((raw - middle) / spread).max(axis=1)
    outlier = distance > _OUTLIER
    core = raw[~outlier]
    bias = core.mean(axis=0)
    cov = np.cov(core.T) if len(core) > 1 else np.diag(spread**2)
    ratio = float(np.median(distance[outlier])) / 2.0 if outlier.any() else 1.0
    claimed = np.mean([m.cov for m, out in zip(measured, outlier, strict=True) if not out], axis=0)
    root = np.sqrt(np.diag(cov)) + 1e-15
    made = [_Standard(look, (e - bias) / root, bool(o)) for look, e, o in zip(found, raw, outlier, strict=True)]
    cell = LookCell(
        place.height, place.shown, len(here), hits,
        _probability(after_found, hits / len(here)), _probability(after_none, hits / len(here)),
        float(np.mean([look.confidence for look in found])),
        float(np.mean([m.ambiguous for m in measured])), float(np.mean([m.turned for m in measured])),
        float(outlier.mean()), max(1.0, ratio), tuple(bias.tolist()), _lower(cov), _lower(claimed),
    )  # fmt: skip
    return cell, made if {id(look) for look in found} <= {id(look) for look in here} else []


def _probability(looks: Sequence[Look], otherwise: float) -> float:
    """Return the probability of a detection by Jeffreys' prior; with no look of this kind at all, that of the whole cell."""
    hits = sum(look.measured is not None for look in looks)
    if not looks:
        return otherwise if hits else min(max(otherwise, 0.02), 0.98)
    if hits == 0 and otherwise == 0.0:
        return 0.0 if len(looks) >= LEAST_LOOKS else 0.5 / (len(looks) + 1.0)
    return (hits + 0.5) / (len(looks) + 1.0)


def _factor(
    edges: tuple[float, ...],
    value: Callable[[Look], float],
    looks: Sequence[Look],
    before: dict[int, bool],
    cells: dict[tuple[int, int], LookCell],
    standard: dict[int, _Standard],
) -> Factor:
    n = len(edges) + 1
    bins = [bisect_right(edges, value(look)) for look in looks]
    counts, odds, ratio = [], [], []
    for i in range(n):
        here = [look for look, b in zip(looks, bins, strict=True) if b == i]
        counts.append(len(here))
        odds.append(_odds(here, before, cells))
        errors = [standard[id(look)].error for look in here if id(look) in standard and not standard[id(look)].outlier]
        ratio.append(float(np.sqrt(np.mean(np.square(errors)))) if len(errors) >= LEAST_LOOKS else 1.0)
    # Most looks are of one kind, which the cells describe by themselves: the factors are those of the others against it.
    usual = counts.index(max(counts))
    return Factor(edges, tuple(counts), tuple(o / odds[usual] for o in odds), tuple(r / ratio[usual] for r in ratio))


def _odds(looks: Sequence[Look], before: dict[int, bool], cells: dict[tuple[int, int], LookCell]) -> float:
    """Return the factor of the odds with which the cells explain how many of these looks found the pad."""
    if len(looks) < LEAST_LOOKS:
        return 1.0
    p = np.array([_expected(look, before, cells) for look in looks])
    open_ = (p > 0.0) & (p < 1.0)
    hits = sum(look.measured is not None for look, is_open in zip(looks, open_, strict=True) if is_open)
    p = p[open_]
    if len(p) < LEAST_LOOKS or not 0 < hits < len(p):
        return 1.0
    low, high = 1e-3, 1e3
    for _ in range(60):
        k = math.sqrt(low * high)
        low, high = (k, high) if float((k * p / (1.0 - p + k * p)).sum()) < hits else (low, k)
    return math.sqrt(low * high)


def _expected(look: Look, before: dict[int, bool], cells: dict[tuple[int, int], LookCell]) -> float:
    cell = cells[_place(look)]
    return cell.kept if before[id(look)] else cell.regained


def _correlation(sources: Sequence[Source], standard: dict[int, _Standard], frame_s: float) -> float:
    products = []
    for source in sources:
        for a, b in pairwise(source.looks):
            one, two = standard.get(id(a)), standard.get(id(b))
            if one is None or two is None or one.outlier or two.outlier or b.at_s - a.at_s > _GAP_FRAMES * frame_s:
                continue
            products.append(one.error * two.error)
    return min(0.99, max(0.0, float(np.mean(products)))) if products else 0.0


def _lower(cov: F64) -> tuple[float, ...]:
    return tuple(cov[np.tril_indices(len(cov))].tolist())
