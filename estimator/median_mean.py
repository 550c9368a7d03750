"""The path `median_mean`: sightings through a moving median and a moving mean, held until the next one."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct, structs

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, FusionResult, PathName, RelativeState, Sighting, Verdict, uncompared
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import MonoNs, seconds_between
from estimator.options import EstimatorOptions
from estimator.paths import GAP_S, Path

_SIGMA_V_M_S = 0.5  # Standard deviation of the relative velocity that a held value ignores
MEDIAN = 3  # Sightings whose median the thesis takes
MEAN = 3  # Medians whose mean it takes
_KEPT = MEDIAN + MEAN - 1  # Sightings that both need
VARIANCE_RATIO = (1.0, 0.625, 0.475, 0.322, 0.286)
"""Variance of the output over that of one sample, by the number of samples (1, 2, ... 5 and more); for white Gaussian noise."""


class _Entry(Struct, frozen=True, eq=False):
    t: MonoNs
    d: F64
    yaw_rad: float | None
    ambiguous: bool


class Filtered(Struct, frozen=True, eq=False):
    """The filter's output for the newest sightings."""

    measured_at: MonoNs
    """Measurement instant of the newest sighting that took part."""
    holds_at: MonoNs
    """Instant that the output describes under uniform motion: two samples back once the window is full."""
    d_body_pad_level: F64
    """Position of the pad, (3,) m."""
    v_pad_level: F64 | None
    """Relative velocity, (3,) m/s: slope of the medians, including the rotation of `level`; None from a single sighting."""
    yaw_rad: float | None
    """Heading; None while no sighting in the window has one."""
    yaw_ambiguous: bool
    """True if no sighting since the last gap resolved the heading's branch."""
    samples: int
    """Number of sightings that took part, 1 to 5."""


class MedianMean(Struct, frozen=True, eq=False):
    """The last five sightings and the last certain heading: a moving median of three, then a moving mean of three.

    Source: Sundvoll, A Camera-Based Perception System for Autonomous Quadcopter Landing on a Marine Vessel, 2020, sec. 4.2, eq.
    4.15. The cost is delay: a ramp comes out two samples late (one from the median, one from the mean). The filter therefore also
    runs over the time stamps and reports the instant at which its output holds under uniform motion, so that a consumer with a
    motion model can propagate the value instead of using it late. It starts empty, never with zeros.
    """

    entries: tuple[_Entry, ...] = ()
    heading_rad: float | None = None
    """The last filtered heading whose branch was certain."""

    def step(self, t: MonoNs, d: F64, yaw_rad: float | None, ambiguous: bool) -> tuple[MedianMean, Filtered | None]:
        """Process one sighting.

        The window counts sightings, not time; the first outputs use as many as there are. A heading that is ambiguous by 180
        degrees is first turned to the branch of the last certain heading since the last gap.

        Args:
            t: measurement instant of the sighting.
            d: (3,) m, `d_body_pad_level`.
            yaw_rad: heading against the arrow, or None.
            ambiguous: the heading may be 180 degrees off.

        Returns:
            The new state and the filtered value; the old state and None for a sighting that is not newer than the last.
        """
        entries, heading = self.entries, self.heading_rad
        if entries:
            gap_s = seconds_between(entries[-1].t, t)
            if gap_s <= 0.0:
                return self, None
            if gap_s > GAP_S:  # they carry no information about the new ones
                entries, heading = (), None
        entries = (*entries, _Entry(t, np.array(d, dtype=float), yaw_rad, ambiguous))[-_KEPT:]

        position = np.array([e.d for e in entries])
        times_s = np.array([seconds_between(t, e.t) for e in entries])
        medians, median_times = _medians(position), _medians(times_s[:, None])[:, 0]
        span_s = float(median_times[-1] - median_times[0])
        yaw, certain = _heading(entries, heading)
        out = Filtered(
            measured_at=t,
            holds_at=MonoNs(t + round(1e9 * float(median_times.mean()))),
            d_body_pad_level=medians.mean(axis=0),
            v_pad_level=(medians[-1] - medians[0]) / span_s if span_s > 0.0 else None,
            yaw_rad=yaw,
            yaw_ambiguous=yaw is not None and not certain,
            samples=len(entries),
        )
        return structs.replace(self, entries=entries, heading_rad=yaw if yaw is not None and certain else heading), out

    def smooth(self, sighting: Sighting) -> tuple[MedianMean, Sighting | None]:
        """Run `step` on a whole sighting; the result is a sighting stamped with the instant at which it holds.

        Its covariance is the newest sighting's, scaled by `VARIANCE_RATIO`. This is right for noise that is white from frame to
        frame and too small for errors that persist (tilt, camera mount), so the noise must not include such biases.
        """
        after, out = self.step(sighting.stamp.measured_at, sighting.d_body_pad_level, sighting.yaw_rad, sighting.yaw_ambiguous)
        if out is None:
            return self, None
        cov = sighting.cov * VARIANCE_RATIO[out.samples - 1]
        if out.yaw_rad is None or sighting.yaw_rad is None:
            cov[3, :] = cov[:, 3] = 0.0
            cov[3, 3] = UNKNOWN_YAW_VAR
        newest = sighting.stamp
        stamp = structs.replace(newest, measured_at=min(out.holds_at, newest.measured_at))
        yaw = out.yaw_rad if sighting.yaw_rad is not None else None
        return after, structs.replace(
            sighting,
            stamp=stamp,
            d_body_pad_level=out.d_body_pad_level,
            yaw_rad=yaw,
            yaw_ambiguous=out.yaw_ambiguous and yaw is not None,
            cov=cov,
            pose6=None,
        )


def circular_mean(angles_rad: Sequence[float]) -> float:
    """Return the direction of the sum of unit vectors, in (-pi, pi]; the last angle if they cancel.

    Source: Mardia & Jupp, Directional Statistics, 2000, sec. 2.2.1.
    """
    s, c = math.fsum(map(math.sin, angles_rad)), math.fsum(map(math.cos, angles_rad))
    if math.hypot(s, c) < 1e-9 * len(angles_rad):
        return wrap_pi(angles_rad[-1])
    return wrap_pi(math.atan2(s, c))


def circular_median(angles_rad: Sequence[float]) -> float:
    """Return the sample with the least sum of arcs to the others; the circular mean of the best if several tie.

    Source: Mardia & Jupp, Directional Statistics, 2000, sec. 2.2.2.
    """
    cost = [math.fsum(abs(wrap_pi(a - b)) for b in angles_rad) for a in angles_rad]
    best = min(cost)
    return circular_mean([a for a, c in zip(angles_rad, cost, strict=True) if c <= best + 1e-9])


def _medians(x: F64) -> F64:
    """Return the (min(n, MEAN), k) newest running medians, each of up to MEDIAN values, of an (n, k) array."""
    n = len(x)
    return np.array([np.median(x[max(0, i - MEDIAN + 1) : i + 1], axis=0) for i in range(max(0, n - MEAN), n)])


def _heading(entries: tuple[_Entry, ...], believed: float | None) -> tuple[float | None, bool]:
    """Return the filtered heading, and whether its branch is certain."""
    known = [(e.yaw_rad, e.ambiguous) for e in entries if e.yaw_rad is not None]
    if not known:
        return None, False
    plain = [yaw for yaw, ambiguous in known if not ambiguous]
    if believed is None and plain:
        believed = circular_median(plain)
    reference = known[-1][0] if believed is None else believed
    # Of an ambiguous one, the opposite angle where that is nearer.
    yaws = [yaw + math.pi if ambiguous and math.cos(yaw - reference) < 0.0 else yaw for yaw, ambiguous in known]
    n = len(yaws)
    running = [circular_median(yaws[max(0, i - MEDIAN + 1) : i + 1]) for i in range(max(0, n - MEAN), n)]
    return circular_mean(running), believed is not None


class MedianMeanPath(Path):
    """The filtered sightings alone, held until the next one.

    The velocity is the slope of the running medians. The covariance includes the motion of the drone since the sighting.
    """

    name: PathName = "median_mean"

    def __init__(self, _: EstimatorOptions | None = None) -> None:
        self._filter = MedianMean()
        self._newest: Filtered | None = None
        self._sighting: Sighting | None = None

    def sight(self, sighting: Sighting) -> FusionResult:
        memory, out = self._filter.step(
            sighting.stamp.measured_at, sighting.d_body_pad_level, sighting.yaw_rad, sighting.yaw_ambiguous
        )
        if out is None:
            return uncompared(self.name, sighting, Verdict.TOO_OLD)
        self._filter, self._newest, self._sighting = memory, out, sighting
        return uncompared(self.name, sighting, Verdict.FUSED)

    def at(self, now: MonoNs) -> RelativeState | None:
        if self._newest is None or self._sighting is None:
            return None
        out = self._newest
        late_s = max(0.0, seconds_between(out.holds_at, now))
        moved_var, v_var = (_SIGMA_V_M_S * late_s) ** 2, _SIGMA_V_M_S**2
        yaw_var = UNKNOWN_YAW_VAR if out.yaw_rad is None else min(UNKNOWN_YAW_VAR, float(self._sighting.cov[3, 3]))
        cov = np.diag([moved_var, moved_var, moved_var, v_var, v_var, v_var, yaw_var])
        cov[:3, :3] += self._sighting.cov[:3, :3] * VARIANCE_RATIO[out.samples - 1]
        return RelativeState(
            at=now,
            path=self.name,
            d_body_pad_level=out.d_body_pad_level,
            v_pad_level=np.zeros(3) if out.v_pad_level is None else out.v_pad_level,
            yaw_rad=out.yaw_rad,
            cov=cov,
            sighted=out.measured_at,
            consistent=True,
            details=(("yaw_ambiguous", float(out.yaw_ambiguous)),),
        )
