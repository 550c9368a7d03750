"""The wind over the drone, by the tilt that holds it in place, and how much of it the vehicle's tilt can fly.

Its own speed pushes as a wind does. So the watch goes on only while the pad is seen or the measured velocity is trusted: a drone
that flies away by a velocity that lies would call its speed wind. Before it has felt the wind for long enough, the ship's
anemometer says where to look, and refuses a wind that is too strong even where the instrument is far off.

What the drone tilts beyond its own acceleration cancels the air's push. The mean over `MEAN_S` is the steady wind; what is left
is gusts. A vehicle can fly a steady tilt up to its tilt limit less `GUST_SIGMAS` standard deviations of the gusts: the rest of
the tilt is for them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct, structs

from companion.guidance.controller import FieldOfView, Knowledge
from companion.settings.guidance import TiltResponse
from estimator.contracts.geometry import F64
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import VesselWind
from estimator.contracts.time import MonoNs, seconds_between

MEAN_S = 5.0
"""Time constant of mean and gusts, and the time before either counts, s."""
GUST_SIGMAS = 2.5
"""Standard deviations of the gusts that are kept for them of the tilt limit."""
_SMOOTH_S = 0.3
"""Time constant that takes the accelerometer's noise from the tilt, s: gusts last longer."""
_QUICK_S = 0.1
"""Time constant that shows a gust which has just begun, s."""
_BEGINS_SIGMAS = 6.0  # standard deviations of the gusts beyond which the air's push is another gust than those before
_BEGINS_M_S2 = 1.0  # the least such push
_GAP_MAX_S = 0.5  # longest gap between two cycles that the push is averaged over
_DRAGGED_M = 0.06
"""Distance by which a vehicle is dragged over the deck, by the tangent of its tilt, m (docs/decisions/wind.md)."""
_FAR_RAD = math.radians(8.0)
"""Lean from which on the nose turns for the view, and push from which on a level vehicle is dragged over the deck."""
_TURNS_S = 1.0
"""Time of watching after which the drone turns, and looks for the pad upwind, s."""
_REPORT_AGE_S = 10.0  # age up to which a ship's wind counts
_REPORT_SIGMA = 0.15
"""Standard deviation of an anemometer's speed by the ship's own flow and by the height, as a share of the speed."""
_REPORT_GUSTS = 0.1  # its gusts, as a share of the speed
_SPENT = 0.95
"""Share of the tilt limit beyond which a steady tilt leaves nothing to hold the place with."""


class WindOverDrone(NamedTuple):
    """The wind as it is known in one cycle."""

    speed_m_s: float
    """Mean speed of the air past the drone, by its drag."""
    gust_m_s: float
    """Standard deviation of the gusts on one axis."""
    limit_m_s: float
    """The largest mean speed that the vehicle's tilt can fly in these gusts."""
    into_level: tuple[float, float]
    """Unit vector into the wind, forward and right; zero in a calm."""
    lean_rad: float
    """The mean tilt against it."""
    spent: bool
    """True if it takes all of the tilt."""
    across_rad: float = 0.0
    """The turn that brings the wider side of the camera's field into the wind, clockwise positive."""
    known: bool = True
    """True if it was watched for long enough to judge by it; before, it says where to look and how to turn."""
    push_rad: float = 0.0
    """The tilt that the present push of the air takes, a gust's as well."""
    begins_m_s: float = 0.0
    """Difference of the air's present speed from its mean."""
    begins_most_m_s: float = math.inf
    """The largest such difference that the gusts before explain."""
    reported: bool = False
    """True if the ship's anemometer says it, and the drone has not felt it."""

    def aim_level(self, feet_below_m: float) -> tuple[float, float]:
        """Return where the pad's centre is wanted at the contact, forward and right, m.

        The feet that touch first stay, and the body that levels over them goes to lee by its height over them times the
        lean. Until the rotors stand the air drags it on.
        """
        lee_m = -(feet_below_m * math.sin(self.lean_rad) + _DRAGGED_M * math.tan(self.lean_rad))
        return lee_m * self.into_level[0], lee_m * self.into_level[1]

    @property
    def leans_far(self) -> bool:
        """True if the lean moves the pad so far towards the picture's edge that the nose turns for it."""
        return self.lean_rad > _FAR_RAD

    @property
    def drags(self) -> bool:
        """True if a level vehicle would be dragged over the deck, by the wind or by a gust."""
        return max(self.lean_rad, self.push_rad) > _FAR_RAD

    @property
    def begins(self) -> bool:
        """True if a push has just begun that the gusts before do not explain."""
        return self.begins_m_s > self.begins_most_m_s

    @property
    def too_strong(self) -> bool:
        return self.known and self.speed_m_s > self.limit_m_s

    @property
    def forbids(self) -> bool:
        """True if the ship reports more than the vehicle can fly, by two standard deviations of the report."""
        return self.reported and (1.0 - 2.0 * _REPORT_SIGMA) * self.speed_m_s > self.limit_m_s


class ReportedWind(NamedTuple):
    """The mean wind over the ground by the ship's anemometer."""

    at: MonoNs
    from_ne_m_s: tuple[float, float]
    """Speed times the direction that it blows from, north and east."""


def reported(before: ReportedWind | None, sample: VesselWind) -> ReportedWind:
    """Return the mean over `MEAN_S` after a report."""
    at, speed = sample.stamp.received_at, sample.speed_m_s
    new = speed * math.cos(sample.from_rad), speed * math.sin(sample.from_rad)
    if before is None or seconds_between(before.at, at) > _REPORT_AGE_S:
        return ReportedWind(at, new)
    share = 1.0 - math.exp(-seconds_between(before.at, at) / MEAN_S)
    (north, east), was = new, before.from_ne_m_s
    return ReportedWind(at, (was[0] + share * (north - was[0]), was[1] + share * (east - was[1])))


class WindWatch(Struct, frozen=True):
    """The watch's memory, in axes that do not turn with the nose; accelerations in m/s^2."""

    at: MonoNs | None = None
    known_s: float = 0.0
    """Time that has been watched."""
    quick: tuple[float, float] = (0.0, 0.0)
    """The newest push."""
    smooth: tuple[float, float] = (0.0, 0.0)
    mean: tuple[float, float] = (0.0, 0.0)
    before: tuple[float, float] = (0.0, 0.0)
    """Mean of the mean, as late behind it as it is behind a wind that changes steadily, as on the way down."""
    var: float = 0.0
    """Variance of the gusts on one axis."""


def watched(watch: WindWatch, knowledge: Knowledge) -> WindWatch:
    """Return the memory after one guidance cycle; one without a body's motion, or in which nothing holds it, changes nothing."""
    body, now = knowledge.body, knowledge.at
    in_sight = knowledge.relative is not None and knowledge.relative.age_s(now) <= _GAP_MAX_S
    if body is None or not (knowledge.trusts_velocity or in_sight):
        return watch
    c, s = math.cos(body.heading_rad), math.sin(body.heading_rad)
    (forward, right), (ahead, aside, _) = body.lean_m_s2, body.a_level.tolist()
    x, y = forward - ahead, right - aside
    north, east = c * x - s * y, s * x + c * y
    dt = 0.0 if watch.at is None else seconds_between(watch.at, now)
    if not 0.0 < dt <= _GAP_MAX_S:
        fresh = watch.at is None
        return structs.replace(watch, at=now, quick=(north, east), smooth=(north, east) if fresh else watch.smooth)
    known_s = watch.known_s + dt
    slow = dt / min(MEAN_S, known_s)
    quick, smooth = (
        (was[0] + share * (north - was[0]), was[1] + share * (east - was[1]))
        for was, share in ((watch.quick, 1.0 - math.exp(-dt / _QUICK_S)), (watch.smooth, 1.0 - math.exp(-dt / _SMOOTH_S)))
    )
    off = smooth[0] - watch.mean[0], smooth[1] - watch.mean[1]
    mean = watch.mean[0] + slow * off[0], watch.mean[1] + slow * off[1]
    before = watch.before[0] + slow * (mean[0] - watch.before[0]), watch.before[1] + slow * (mean[1] - watch.before[1])
    # A steady change is no gust. What of the difference has gone into the mean is none either (Welford's update of a variance).
    gust = off[0] - watch.mean[0] + watch.before[0], off[1] - watch.mean[1] + watch.before[1]
    var = watch.var + slow * (0.5 * (1.0 - slow) * (gust[0] ** 2 + gust[1] ** 2) - watch.var)
    return WindWatch(now, known_s, quick, smooth, mean, before, max(0.0, var))


def trim_level(watch: WindWatch, heading_rad: float) -> F64:
    """Return the acceleration that holds against the mean wind, (2,) m/s^2 forward and right of a heading."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    north, east = watch.mean
    return np.array([c * north + s * east, c * east - s * north])


def wind_over_drone(
    watch: WindWatch, tilt: TiltResponse, heading_rad: float, view: FieldOfView | None = None
) -> WindOverDrone | None:
    """Return the wind by what was watched; None before `MEAN_S`.

    Args:
        tilt: the vehicle's, with its limit and its drag.
        heading_rad: of `level` in the axes of the memory.
        view: the camera's field; None where it does not lean with the body.
    """
    if watch.known_s < _TURNS_S:
        return None
    gust, known = math.sqrt(watch.var), watch.known_s >= MEAN_S
    felt = _over(watch.mean, gust, tilt, heading_rad, view)
    return felt._replace(
        spent=known and felt.lean_rad > _SPENT * math.atan(tilt.max_m_s2 / G_M_S2),
        known=known,
        push_rad=math.atan(math.hypot(*watch.quick) / G_M_S2),
        begins_m_s=math.dist(watch.quick, watch.mean) / tilt.drag_1_s,
        begins_most_m_s=max(_BEGINS_M_S2, _BEGINS_SIGMAS * gust) / tilt.drag_1_s,
    )


def wind_by_ship(
    ship: ReportedWind | None,
    now: MonoNs,
    v_ship_ne_m_s: F64 | None,
    tilt: TiltResponse,
    heading_rad: float,
    view: FieldOfView | None = None,
) -> WindOverDrone | None:
    """Return the wind over a drone that holds over the ship, by her anemometer; None without a fresh report.

    Args:
        v_ship_ne_m_s: (2,) her velocity north and east, if she reports it.
        tilt: as of `wind_over_drone`, and so are heading and view.
    """
    if ship is None or seconds_between(ship.at, now) > _REPORT_AGE_S:
        return None
    north, east = ship.from_ne_m_s if v_ship_ne_m_s is None else np.add(ship.from_ne_m_s, v_ship_ne_m_s).tolist()
    push, gust = (north * tilt.drag_1_s, east * tilt.drag_1_s), _REPORT_GUSTS * math.hypot(*ship.from_ne_m_s) * tilt.drag_1_s
    return _over(push, gust, tilt, heading_rad, view)._replace(known=False, reported=True)


def _over(
    push: tuple[float, float], gust: float, tilt: TiltResponse, heading_rad: float, view: FieldOfView | None
) -> WindOverDrone:
    """Return the wind by the acceleration, north and east, that holds against its mean, and the gusts' standard deviation."""
    size = math.hypot(*push)
    left_rad = max(0.0, math.atan(tilt.max_m_s2 / G_M_S2) - GUST_SIGMAS * math.atan(gust / G_M_S2))
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    north, east = (push[0] / size, push[1] / size) if size > 0.0 else (0.0, 0.0)
    forward, right = c * north + s * east, c * east - s * north
    return WindOverDrone(
        size / tilt.drag_1_s,
        gust / tilt.drag_1_s,
        G_M_S2 * math.tan(left_rad) / tilt.drag_1_s,
        (forward, right),
        math.atan(size / G_M_S2),
        spent=False,
        across_rad=0.0 if view is None else _turn_across_rad(math.atan2(right, forward), view),
    )


def _turn_across_rad(bearing_rad: float, view: FieldOfView) -> float:
    """Return the smaller turn that brings the wind, seen at this bearing off the nose, to the wider side of the field."""
    side_rad = 0.5 * math.pi if view.half_right_rad > view.half_forward_rad else 0.0
    off_rad = (bearing_rad - side_rad) % math.pi
    return off_rad - math.pi if off_rad > 0.5 * math.pi else off_rad
