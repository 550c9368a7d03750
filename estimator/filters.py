"""Moving median of three, then moving mean of three, over sightings.

Source: Sundvoll, A Camera-Based Perception System for Autonomous Quadcopter Landing on a Marine Vessel, 2020, sec. 4.2, eq. 4.15.

The cost is delay: a ramp comes out two samples late (one from the median, one from the mean). The filter therefore also runs over
the time stamps and reports the instant at which its output holds under uniform motion, so that a consumer with a motion model can
propagate the value instead of using it late.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Sighting
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import MonoNs, Stamp, seconds_between

MEDIAN = 3
MEAN = 3
GROUP_DELAY_SAMPLES = (MEDIAN - 1) // 2 + (MEAN - 1) // 2
_KEPT = MEDIAN + MEAN - 1

VARIANCE_RATIO = (1.0, 0.625, 0.475, 0.322, 0.286)
"""Variance of the output over that of one sample, by the number of samples (1, 2, ... 5 and more); for white Gaussian noise."""


@dataclass(frozen=True, slots=True, eq=False)
class _Entry:
    t: MonoNs
    d: F64
    yaw_rad: float | None
    ambiguous: bool


@dataclass(frozen=True, slots=True, eq=False)
class Filtered:
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


@dataclass(frozen=True, slots=True, eq=False)
class MedianMean:
    """The filter's memory: the last five sightings and the last certain heading. It starts empty, never with zeros."""

    max_gap_s: float = 0.5
    """Pause after which the old sightings are dropped, because they carry no information about the new ones."""
    entries: tuple[_Entry, ...] = ()
    heading_rad: float | None = None
    """The last filtered heading whose branch was certain."""

    def __post_init__(self) -> None:
        if not self.max_gap_s > 0.0:
            raise ValueError(f"max_gap_s must be positive, got {self.max_gap_s}")


def step(state: MedianMean, t: MonoNs, d: F64, yaw_rad: float | None, ambiguous: bool) -> tuple[MedianMean, Filtered | None]:
    """Process one sighting.

    The window counts sightings, not time; the first outputs use as many as there are. A heading that is ambiguous by 180 degrees
    is first turned to the branch of the last certain heading since the last gap.

    Args:
        t: measurement instant of the sighting.
        d: (3,) m, `d_body_pad_level`.
        yaw_rad: heading against the arrow, or None.
        ambiguous: the heading may be 180 degrees off.

    Returns:
        The new state and the filtered value; the old state and None for a sighting that is not newer than the last.
    """
    entries, heading = state.entries, state.heading_rad
    if entries:
        gap_s = seconds_between(entries[-1].t, t)
        if gap_s <= 0.0:
            return state, None
        if gap_s > state.max_gap_s:
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
    return replace(state, entries=entries, heading_rad=yaw if yaw is not None and certain else heading), out


def smooth(state: MedianMean, sighting: Sighting) -> tuple[MedianMean, Sighting | None]:
    """Run `step` on a whole sighting; the result is a sighting stamped with the instant at which it holds.

    Its covariance is the newest sighting's, scaled by `VARIANCE_RATIO`. This is right for noise that is white from frame to frame
    and too small for errors that persist (tilt, camera mount), so the noise must not include such biases.
    """
    state, out = step(state, sighting.stamp.measured_at, sighting.d_body_pad_level, sighting.yaw_rad, sighting.yaw_ambiguous)
    if out is None:
        return state, None
    cov = sighting.cov * VARIANCE_RATIO[out.samples - 1]
    if out.yaw_rad is None or sighting.yaw_rad is None:
        cov[3, :] = cov[:, 3] = 0.0
        cov[3, 3] = UNKNOWN_YAW_VAR
    stamp = Stamp(
        min(out.holds_at, sighting.stamp.measured_at), sighting.stamp.received_at, sighting.stamp.sigma_s, sighting.stamp.source
    )
    yaw = out.yaw_rad if sighting.yaw_rad is not None else None
    return state, structs.replace(
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
    yaws = [_nearest_branch(yaw, reference) if ambiguous else yaw for yaw, ambiguous in known]
    n = len(yaws)
    running = [circular_median(yaws[max(0, i - MEDIAN + 1) : i + 1]) for i in range(max(0, n - MEAN), n)]
    return circular_mean(running), believed is not None


def _nearest_branch(yaw_rad: float, reference_rad: float) -> float:
    """Return `yaw_rad` or the opposite angle, whichever is nearer to the reference."""
    return yaw_rad if abs(wrap_pi(yaw_rad - reference_rad)) <= math.pi / 2 else wrap_pi(yaw_rad + math.pi)
