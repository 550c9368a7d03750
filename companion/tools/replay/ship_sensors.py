"""Judge a ship's own sensors by what they reported: rates, gaps, digits, how far two of them differ, and which heave is none.

Nothing but their reports is needed: two motion sensors of one ship see the same waves, and the heave of a ship swings as fast as
waves do, about a mean that stands still.
"""

import itertools
import math
from collections.abc import Callable

import numpy as np
from msgspec import Struct

from companion.base.observer import NullObserver
from estimator.contracts.geometry import F64
from estimator.contracts.samples import GeoFix, Sample, VesselMotion, VesselReport, VesselWind
from estimator.ship_motion import between, wander

_MINUTE_S = 60.0
"""Time over which a heave is judged, as in flight."""
_FEWEST = 20  # reports from which on a figure is given
_GAP = 3.0
"""A gap is longer than so many of a sensor's usual intervals."""
_LAG_MAX_S = 0.95  # longest delay that is searched
_LAGS_S = np.arange(-1.0, 1.001, 0.02)

_HEAVE, _PLACE = "heave", "place"


class Part(Struct, frozen=True):
    """One number of a sensor over its whole record, in the unit of its name."""

    name: str
    unit: str
    count: int
    sd: float
    """Standard deviation."""
    step: float | None
    """Least difference between two values: its digits; None if all are the same."""


class SensorVerdict(Struct, frozen=True):
    """One sensor of the ship over a record."""

    sensor: str
    count: int
    rate_hz: float
    """Instants of reports in a second of the time without its gaps."""
    gaps: int
    """Number of intervals longer than three usual ones."""
    longest_gap_s: float
    parts: tuple[Part, ...]
    waves_m: float | None = None
    """Standard deviation of the waves in its heave; None if it gives none, or for less than a minute."""
    wanders_m: float | None = None
    """Standard deviation of what is slower."""
    fault: str | None = None
    """Reason why it can be none, or its heave."""


class Difference(Struct, frozen=True):
    """Difference of two motion sensors of one ship in one number: the second minus the first."""

    sensors: tuple[str, str]
    part: str
    unit: str
    mean: float
    sd: float
    lag_s: float
    """Time by which the second one is late, at which they differ least."""


class SensorJudge(NullObserver):
    """Collects the reports of a ship's sensors, and judges them."""

    def __init__(self) -> None:
        self._rows: dict[str, list[tuple[float, dict[str, float]]]] = {}
        self._motion: set[str] = set()

    def on_sample(self, sample: Sample) -> None:
        """Take one sample; those of the vehicle are passed over."""
        match sample:
            case VesselMotion():
                self._motion.add(sample.sensor)
                self._put(
                    sample, sample.sensor, {
                        "roll": (sample.roll_rad, math.degrees), "pitch": (sample.pitch_rad, math.degrees),
                        _HEAVE: (sample.heave_down_m, None),
                    },
                )  # fmt: skip
            case VesselWind():
                self._put(sample, f"wind of {sample.sensor}", {"speed": (sample.speed_m_s, None)})
            case VesselReport():
                speed = None if sample.v_vessel_ned is None else math.hypot(*sample.v_vessel_ned[:2].tolist())
                self._put(sample, "speed over ground", {"speed": (speed, None)})
                self._put(sample, "heading", {"heading": (sample.heading_rad, math.degrees)})
                self._put(sample, "rate of turn", {"turn": (sample.turn_rad_s, math.degrees)})
            case GeoFix(whose="vessel"):
                self._put(sample, _PLACE, {"sigma": (sample.sigma_m, None)})

    def _put(self, sample: Sample, sensor: str, parts: dict[str, tuple[float | None, Callable[[float], float] | None]]) -> None:
        given = {name: value if of is None else of(value) for name, (value, of) in parts.items() if value is not None}
        if given:
            self._rows.setdefault(sensor, []).append((sample.stamp.measured_at * 1e-9, given))

    def verdicts(self) -> list[SensorVerdict]:
        """Return the verdict on each sensor that reported twice or more, by name."""
        return [_verdict(sensor, rows) for sensor, rows in sorted(self._rows.items()) if len(rows) > 1]

    def differences(self) -> list[Difference]:
        """Return how far each two motion sensors differ in what both give for some time."""
        out = []
        for a, b in itertools.combinations(sorted(self._motion), 2):
            for part in ("roll", "pitch", _HEAVE):
                first, second = (_series(self._rows[sensor], part) for sensor in (a, b))
                if min(len(first), len(second)) >= _FEWEST and (found := _least(first, second)) is not None:
                    out.append(Difference((a, b), part, _UNITS[part], *found))
        return out

    def turns_against_heading(self) -> float | None:
        """Return by how much the heading turns for each degree that the rate of turn says; None if that cannot be judged."""
        turn, bow = (_series(self._rows.get(name, []), part) for name, part in (("rate of turn", "turn"), ("heading", "heading")))
        if min(len(turn), len(bow)) < _FEWEST:
            return None
        bow[:, 1] = np.unwrap(bow[:, 1], period=360.0)
        turned = np.diff(bow[:, 1])
        reported_turn = np.interp(0.5 * (bow[1:, 0] + bow[:-1, 0]), turn[:, 0], turn[:, 1]) * np.diff(bow[:, 0])
        squares = float(reported_turn @ reported_turn)
        return float(reported_turn @ turned) / squares if squares > float(turned @ turned) * 1e-3 else None

    def in_words(self) -> list[str]:
        """Return one line for each sensor, each two that differ, and each fault."""
        out = [_line(one) for one in self.verdicts()]
        for d in self.differences():
            late = f", the second {d.lag_s:+.2f} s late" if abs(d.lag_s) >= 0.05 else ""
            out.append(f"{d.sensors[1]} minus {d.sensors[0]}: {d.part} {d.mean:+.2f} +- {d.sd:.2f} {d.unit}{late}")
        if (turns := self.turns_against_heading()) is not None:
            out.append(f"the heading turns by {turns:.2f} deg for each degree of the rate of turn")
        return ["the ship's sensors:", *(f"  {line}" for line in out)] if out else []


_UNITS = {"roll": "deg", "pitch": "deg", _HEAVE: "m", "speed": "m/s", "heading": "deg", "turn": "deg/s", "sigma": "m"}


def _series(rows: list[tuple[float, dict[str, float]]], part: str) -> F64:
    """Return (N, 2) of instants, s, and one number, in order of time and one for each instant."""
    found = np.array(sorted((at, given[part]) for at, given in rows if part in given), float).reshape(-1, 2)
    return found[np.concatenate([[True], np.diff(found[:, 0]) > 0.0])] if len(found) else found


def _verdict(sensor: str, rows: list[tuple[float, dict[str, float]]]) -> SensorVerdict:
    # Roll and heave may come in messages of their own: the part that comes most often has the rate.
    series = {part: _series(rows, part) for part in dict.fromkeys(name for _, given in rows for name in given)}
    at = max(series.values(), key=len)[:, 0]
    between = np.diff(at) if len(at) > 1 else np.zeros(1)
    # Two sources, or two messages of one receiver, come within one interval: the longer ones are usual.
    gap_s = _GAP * max(float(np.percentile(between, 90.0)), 1e-3)
    gaps, steady_s = between[between > gap_s], float(between[between <= gap_s].sum())
    parts = []
    for part, values in ((part, found[:, 1]) for part, found in series.items()):
        turning = np.unwrap(values, period=360.0) if part == "heading" else values
        steps = np.diff(np.unique(np.round(values, 7)))
        parts.append(Part(part, _UNITS[part], len(values), float(np.std(turning)), float(steps.min()) if len(steps) else None))
    rate_hz = (len(between) - len(gaps)) / steady_s if steady_s > 0.0 else math.inf
    longest_s = float(between.max())
    waves_m, wanders_m, fault = _heave(series.get(_HEAVE, np.empty((0, 2))))
    of_motion = {part.name for part in parts} <= {"roll", "pitch", _HEAVE}  # a ship's speed may stay the same, and a wind
    if len(at) >= _FEWEST and of_motion and all(part.step is None for part in parts):
        fault = "its numbers never change"
    return SensorVerdict(sensor, len(at), rate_hz, len(gaps), longest_s, tuple(parts), waves_m, wanders_m, fault)


def _heave(series: F64) -> tuple[float | None, float | None, str | None]:
    """Return the waves in a heave and what is slower, m, of the usual one of its minutes, and why it is none, if it is none."""
    minutes = [series[series[:, 0] // _MINUTE_S == n, :] for n in np.unique(series[:, 0] // _MINUTE_S)] if len(series) else []
    found = [
        wander(one[:, 1], span) for one in minutes if len(one) >= _FEWEST and (span := float(np.ptp(one[:, 0]))) > 0.9 * _MINUTE_S
    ]
    if not found:
        return None, None, None
    waves_m, slow_m, worst = sorted(found, key=lambda one: one[2])[len(found) // 2]
    if worst <= 1.0:
        return waves_m, slow_m, None
    return (
        waves_m,
        slow_m,
        f"its heave wanders by {slow_m:.2f} m more slowly than a sea does, and its waves are {waves_m:.2f} m: it is none",
    )


def _least(first: F64, second: F64) -> tuple[float, float, float] | None:
    """Return mean, standard deviation and delay of the second series against the first, where they differ least."""
    usual_s = float(np.median(np.diff(first[:, 0])))
    found: list[tuple[float, float, float]] = []
    for lag_s in _LAGS_S:
        at = second[:, 0] - lag_s
        i = np.searchsorted(first[:, 0], at) - 1
        inside = (i >= 0) & (i < len(first) - 1)
        inside[inside] &= np.diff(first[:, 0])[i[inside]] <= _GAP * usual_s
        if inside.sum() < _FEWEST:
            return None
        apart = second[inside, 1] - between(first[:, 0], first[:, 1:], at[inside])[:, 0]
        found.append((float(np.std(apart)), float(np.mean(apart)), float(lag_s)))
    sd, mean, lag_s = min(found)
    if abs(lag_s) > _LAG_MAX_S:  # they do not move alike: no delay makes them
        sd, mean, lag_s = min(found, key=lambda one: abs(one[2]))
    return mean, sd, lag_s


def _line(one: SensorVerdict) -> str:
    numbers = [
        f"{p.name} sd {p.sd:.3g} {p.unit}" + ("" if p.step is None else f" in steps of {p.step:.2g}")
        for p in one.parts if p.name != "sigma"
    ]  # fmt: skip
    gaps = f", {one.gaps} gap{'s' * (one.gaps > 1)} up to {one.longest_gap_s:.1f} s" if one.gaps else ""
    fault = "" if one.fault is None else f"; {one.fault}"
    return f"{one.sensor}: {one.count} reports at {one.rate_hz:.1f} Hz{gaps}" + "".join(f"; {n}" for n in numbers) + fault
