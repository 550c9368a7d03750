"""Compare the measured velocity with the accelerometer's integral, and with the pad's sightings where there are any.

A velocity that lies is dangerous where a loop is closed on it: one of the wrong sign is flown away from at full tilt. So what is
compared are changes within two seconds, as a vehicle that begins to fly away makes them: the velocity and the integral, each
less its mean and less the difference of both that has been there (`Steady`). A surface that moves below a flow sensor makes
neither a large difference nor a wrong sign: in clean flights up to weather_5 the difference is 0.5 m/s, a root mean square, at
most. A leap of the velocity alone begins the comparison again: below the vehicle the deck has ended and the water begun.

In sight of the pad its sightings decide who of both is right, and for 10 s after them that holds, unless the difference grows
beyond what an attitude that errs makes. Later nobody decides, and the velocity is not flown by.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64
from estimator.integrity.parity import Parity

_WINDOW_NS = 2_000_000_000
_POINTS = 8
_LEAP_M_S = 0.8
_APART_M_S, _SHARE, _SWINGS_M_S = 0.6, 0.25, 0.25
"""Difference, a root mean square; largest share of the integral's swing that the velocity has; and least swing that shows it."""
_FAR_APART_M_S = 0.9
"""Difference that is wrong whatever the share: of a velocity that comes half a second late the share is of the right sign."""
_AGAINST_M_S, _AGAINST_SHARE, _AGAINST_SWINGS_M_S = 0.45, -0.4, 0.2
"""Limits where the velocity swings against the integral."""
_WELL_M_S, _WELL_SHARE = 0.35, 0.5
_STEADY_M_S2, _STEADY_WEIGHT = 1.2, 0.02
"""Largest difference that is no lie, m/s^2: an attitude that errs by 6 degrees makes it; and the weight of a bin, 5 s of them."""
_SEEN_M, _SEEN_SHARE = 0.08, 0.4
"""Least way against the pad, a root mean square, that shows something, and the share of it from which the velocity is right."""


class Steady(NamedTuple):
    """The acceleration by the velocity less that of the levelled accelerometer that has been there, m/s^2.

    A bias makes it, and an attitude that errs; it turns with the body.
    """

    bins: int = 0
    ahead: float = 0.0
    aside: float = 0.0

    def after(self, rate: tuple[float, float], heading: tuple[float, float]) -> "Steady":
        """Return it after one bin more.

        Args:
            rate: the difference's, m/s^2 north and east.
            heading: its cosine and sine.
        """
        k, (c, s), (x, y) = max(1.0 / (self.bins + 1), _STEADY_WEIGHT), heading, rate
        ahead, aside = self.ahead + k * (c * x + s * y - self.ahead), self.aside + k * (c * y - s * x - self.aside)
        within = min(1.0, _STEADY_M_S2 / max(1e-9, math.hypot(ahead, aside)))
        return Steady(self.bins + 1, within * ahead, within * aside)

    def ned(self, heading: tuple[float, float]) -> tuple[float, float]:
        """Return it north and east."""
        c, s = heading
        return c * self.ahead - s * self.aside, s * self.ahead + c * self.aside


class Compared(NamedTuple):
    """The velocity's change against the accelerometer's within the window."""

    rate: tuple[float, float]
    """Rate of their difference, m/s^2 north and east."""
    apart_m_s: float
    swings_m_s: float
    share: float
    """Part of the integral's swing that the velocity has, 1 where both agree."""

    @property
    def far(self) -> bool:
        """True if one of both is wrong by more than an attitude that errs makes."""
        return self.apart_m_s > _FAR_APART_M_S

    @property
    def contradicts(self) -> bool:
        """True if one of both is wrong."""
        apart = self.apart_m_s > _APART_M_S and self.share < _SHARE and self.swings_m_s > _SWINGS_M_S
        swings = self.swings_m_s > _AGAINST_SWINGS_M_S
        return self.far or apart or (self.apart_m_s > _AGAINST_M_S and self.share < _AGAINST_SHARE and swings)

    @property
    def agrees(self) -> bool:
        """True if both move, and alike."""
        return self.swings_m_s > _AGAINST_SWINGS_M_S and self.apart_m_s < _WELL_M_S and self.share > _WELL_SHARE


def compared(p: Parity, steady: Steady) -> Compared | None:
    """Return the comparison over the newest window; None with too few velocities in it."""
    t, flow, felt = _window(p)
    if len(t) < _POINTS:
        return None
    flow, felt = flow - flow.mean(axis=0), felt - felt.mean(axis=0)
    apart, x = flow - felt, (t - t.mean()) * 1e-9
    north, east = (x @ apart / (x @ x)).tolist()
    there = np.outer(x, steady.ned(p.bins[-1].heading))
    apart, felt = apart - there, felt + there
    square = float((felt * felt).sum())
    return Compared(
        (north, east),
        math.sqrt(float((apart * apart).sum()) / len(t)),
        math.sqrt(square / len(t)),
        float((flow * felt).sum()) / square if square > 0.0 else 1.0,
    )


def seen_right(p: Parity) -> bool | None:
    """Return whether the velocity leads along the way that the pad's sightings show; None where they show too little.

    Where they show no way, it is right that shows none either, if the accelerometer shows one.
    """
    t, flow, felt = _window(p)
    if len(t) < _POINTS:
        return None
    seen = [(at, value[:2]) for at, value in p.sight if t[0] <= at <= t[-1]]
    places = [(at, place) for at, value in seen if (place := _place(p, at, value)) is not None]
    if len(places) < _POINTS:
        return None
    at = np.array([instant for instant, _ in places], dtype=np.float64)
    x = at - at.mean()

    def swings(y: F64) -> F64:
        # Over the ground a ship's own way is a steady difference.
        swung: F64 = y - y.mean(axis=0) - np.outer(x, x @ (y - y.mean(axis=0)) / (x @ x))
        return swung

    def way_of(v: F64) -> F64:
        steps = 0.5 * (v[1:] + v[:-1]) * (np.diff(t) * 1e-9)[:, None]
        by_v = np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0)))
        return swings(np.column_stack([np.interp(at, t, by_v[:, axis]) for axis in range(2)]))

    way, flown, least = swings(np.array([place for _, place in places])), way_of(flow), len(places) * _SEEN_M**2
    square = float((way * way).sum())
    if square < least:
        return True if float((flown * flown).sum()) < least < 0.5 * float((way_of(felt) ** 2).sum()) else None
    return float((way * flown).sum()) > _SEEN_SHARE * square


def _window(p: Parity) -> tuple[F64, F64, F64]:
    """Return the instants, (N,) ns, the velocities and the accelerometer's integrals, (N, 2) m/s each in `ned`."""
    end = p.flow[-1][0] if p.flow else 0
    rows = []
    for t, off in p.flow:
        if t > end - _WINDOW_NS and (within := next((b for b in reversed(p.bins) if b.t <= t), None)) is not None:
            (x, y, _), _ = within.at(t)
            rows.append((t, off[0] + x, off[1] + y, x, y))
    both = np.array([row for row in rows if not math.isnan(row[1])], dtype=np.float64).reshape(-1, 5)
    off = np.hypot(*(np.diff(both[:, 1:3], axis=0) - np.diff(both[:, 3:5], axis=0)).T)
    leaps = np.nonzero(off > _LEAP_M_S)[0]
    both = both[leaps[-1] + 1 :] if len(leaps) else both
    return both[:, 0], both[:, 1:3], both[:, 3:5]


def _place(p: Parity, at: int, value: tuple[float, ...]) -> tuple[float, float] | None:
    """Return the body's place against the pad at a sighting, m north and east, from one less the accelerometer's way."""
    within = next((b for b in reversed(p.bins) if b.t <= at), None)
    if within is None:
        return None
    _, (x, y, _) = within.at(at)
    return value[0] + x, value[1] + y
