"""Follow the pad by sightings alone, without the IMU: an arbiter beside the filter, which a lying sensor may have led away.

A Kalman filter of constant velocity for each axis, of a few numbers. It takes what the other checks let pass, in axes of fixed
heading. Where it and the steering estimate are five sigma apart for half a second, nobody steers down. After two seconds, or
where the filter has refused for as long all that the arbiter could follow, the filter is started again: by the same pad where the
arbiter could follow it all the time, and by another one where the picture leapt.
"""

import math
from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from estimator.integrity.tracks import Place

_PSD = 4.0
"""Density of the unknown acceleration of pad and vehicle, (m/s^2)^2/Hz: 2 m/s^2 that last for half a second."""
_SPEED_VAR = 4.0
"""Variance of the velocity at the start, (m/s)^2."""
_FLOOR_M, _FLOOR_FRACTION = 0.05, 0.03
"""Floor of the standard deviation that no covariance contains, m, and by distance: mount, level and frame delay."""
_FLOOR_M_S = 0.4
_SIGMAS = 5.0
_PAUSE_S = 0.5
"""Time without a sighting after which the arbiter begins again."""
_FRESH_S = 0.3
_MISSES = 5
_ESTABLISHED = 15
_APART_S = 0.5
_RESTART_S = 2.0


class FollowedAxis(NamedTuple):
    """Position, m, and velocity, m/s, along one axis with their covariance."""

    p: float
    v: float
    pp: float
    pv: float
    vv: float

    def ahead(self, dt: float) -> "FollowedAxis":
        """Return the axis after a time, s."""
        p, v, pp, pv, vv = self
        return FollowedAxis(
            p + v * dt,
            v,
            pp + dt * (2.0 * pv + dt * vv) + _PSD * dt * dt * dt / 3.0,
            pv + dt * vv + _PSD * dt * dt / 2.0,
            vv + _PSD * dt,
        )

    def measured(self, z: float, var: float) -> "FollowedAxis":
        """Return the axis after a measurement of the position."""
        p, v, pp, pv, vv = self
        k, g = pp / (pp + var), pv / (pp + var)
        return FollowedAxis(p + k * (z - p), v + g * (z - p), pp * (1.0 - k), pv * (1.0 - k), vv - g * pv)


class Arbiter(Struct, frozen=True):
    """The pad's place and velocity by sightings, and for how long the steering estimate has differed."""

    t: int = 0
    """Instant of the newest sighting, ns."""
    axes: tuple[FollowedAxis, ...] = ()
    n: int = 0
    """Number of sightings that it followed without a break."""
    misses: int = 0
    """Number of sightings in a row that it could not follow."""
    apart_since: int | None = None
    """Instant since which the estimate is apart, ns."""
    refused_since: int | None = None
    """Instant of the first of an unbroken series of sightings that it followed and the filter refused, ns."""
    leapt: bool = False
    """The pad leapt in the picture, and the filter has taken no sighting since."""

    def explains(self, seen: Place) -> bool:
        """Return whether a sighting is where the recent ones lead."""
        dt = (seen.t - self.t) * 1e-9
        return self.n >= _ESTABLISHED and 0.0 < dt <= _FRESH_S and _follows(self.axes, dt, seen)

    @property
    def apart(self) -> bool:
        """True if the estimate has been apart for so long that nobody may steer down by it."""
        return self.apart_since is not None and self.t - self.apart_since > _APART_S * 1e9

    @property
    def overrules(self) -> bool:
        """True if the filter has to start again from the sightings."""
        if self.n < _ESTABLISHED or self.misses:
            return False
        return any(at is not None and self.t - at >= _RESTART_S * 1e9 for at in (self.apart_since, self.refused_since))


def follow(state: Arbiter, seen: Place) -> Arbiter:
    """Process a sighting that the other checks let pass."""
    dt = (seen.t - state.t) * 1e-9
    if not state.axes or dt > _PAUSE_S:
        return Arbiter(
            seen.t, tuple(FollowedAxis(p, 0.0, var, 0.0, _SPEED_VAR) for p, var in zip(seen.d, _vars(seen), strict=True)), 1
        )
    if dt <= 0.0:
        return state
    if not _follows(state.axes, dt, seen):
        missed = replace(state, misses=state.misses + 1)
        if missed.misses < _MISSES:
            return missed
        return replace(follow(Arbiter(), seen), leapt=state.leapt or state.n >= _ESTABLISHED)
    axes = tuple(a.ahead(dt).measured(p, var) for a, p, var in zip(state.axes, seen.d, _vars(seen), strict=True))
    return Arbiter(seen.t, axes, state.n + 1, 0, state.apart_since, state.refused_since, state.leapt)


def compare(state: Arbiter, d: tuple[float, ...], v: tuple[float, ...], variances: tuple[float, ...]) -> Arbiter:
    """Compare the steering estimate at the newest sighting with the arbiter's.

    Args:
        d: the estimate's position of the pad, m, in the arbiter's axes.
        v: its velocity, m/s.
        variances: of `d`, then of `v`.
    """
    floor = _FLOOR_M + _FLOOR_FRACTION * math.hypot(*d)
    off = 0.0
    for a, p, u, var_p, var_u in zip(state.axes, d, v, variances[:3], variances[3:], strict=True):
        off = max(off, (p - a.p) ** 2 / (var_p + a.pp + floor * floor), (u - a.v) ** 2 / (var_u + a.vv + _FLOOR_M_S**2))
    if off <= _SIGMAS**2 or state.n < _ESTABLISHED:
        return state if state.apart_since is None else replace(state, apart_since=None)
    return state if state.apart_since is not None else replace(state, apart_since=state.t)


def judged(state: Arbiter, seen_at: int, fused: bool) -> Arbiter:
    """Take note of whether the filter fused the newest sighting."""
    if fused:
        known = state.refused_since is None and not state.leapt
        return state if known else replace(state, refused_since=None, leapt=False)
    if seen_at != state.t or state.refused_since is not None:
        return state
    return replace(state, refused_since=state.t)


def cleared(state: Arbiter) -> Arbiter:
    """Return the arbiter after it had the filter started again."""
    return replace(state, apart_since=None, refused_since=None, leapt=False)


def _vars(seen: Place) -> tuple[float, float, float]:
    side, down = seen.sigma_m**2 + 1e-4, seen.sigma_down_m**2 + 1e-4
    return side, side, down


def _follows(axes: tuple[FollowedAxis, ...], dt: float, seen: Place) -> bool:
    floor = _FLOOR_M + _FLOOR_FRACTION * abs(seen.d[2])
    for a, z, var in zip(axes, seen.d, _vars(seen), strict=True):
        ahead = a.ahead(dt)
        if (z - ahead.p) ** 2 > _SIGMAS**2 * (ahead.pp + var) + floor * floor:
            return False
    return True
