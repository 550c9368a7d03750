"""The experiments of the thesis' chapter 5 (Sundvoll 2020), each flown again and reduced to its figures.

The thesis flew a motionless ship in Gazebo without wind, with a camera of 81 degrees; the same here. Where methods are compared
the drone reports its attitude without error, as Gazebo's nearly did; dead reckoning and the landings fly with the errors of a
real AR.Drone as they were measured.

The printed rows are tables 5.1 to 5.4, the error while hovering at six heights. The text of the source has lost two cells of the
lowest height of tables 5.1 and 5.3, and of table 5.4 at 3 m it keeps no more than that no method gave a heading. A cell that
cannot be read is left out.
"""

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from companion.base.mission import FlightOutcome
from companion.settings.model import Settings
from estimator.contracts.geometry import F64, wrap_pi
from sitl.study.experiments.flown import METHODS, Estimate, ExperimentFlight, fly_by_hand, fly_pilot
from sitl.study.experiments.hand import ExternalPilot, HeldPose, around_the_ship, full_turn, hold, up_and_down, way

Quantity = Literal["x", "y", "z", "yaw"]
HEIGHTS_M = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0)


class Printed(NamedTuple):
    """One row of a table of the thesis."""

    mean: float
    """Mean error, mm, or degrees for the heading."""
    std: float
    """Standard deviation of the error, in the same unit."""
    available: float
    """Fraction of the samples with an estimate."""


_ROWS: dict[Quantity, dict[tuple[float, str], tuple[float, float, float]]] = {
    "x": {
        (0.5, "corners"): (-3.57, 1.91, 1.0),
        (1.0, "ellipse"): (-12.15, 2.85, 1.0), (1.0, "arrow"): (-3.41, 4.31, 1.0), (1.0, "corners"): (-3.72, 6.20, 1.0),
        (2.0, "ellipse"): (-9.17, 9.54, 1.0), (2.0, "arrow"): (6.55, 11.95, 1.0),
        (3.0, "ellipse"): (-13.48, 12.01, 1.0),
        (5.0, "ellipse"): (-22.41, 21.33, 1.0), (5.0, "arrow"): (12.34, 12.71, 0.04),
        (10.0, "ellipse"): (-42.30, 42.74, 1.0),
    },
    "y": {
        (0.5, "arrow"): (-4.45, 2.76, 0.11), (0.5, "corners"): (-2.30, 3.22, 1.0),
        (1.0, "ellipse"): (-1.40, 4.16, 0.11), (1.0, "arrow"): (-3.56, 4.88, 1.0), (1.0, "corners"): (-3.09, 6.20, 1.0),
        (2.0, "ellipse"): (-4.91, 11.70, 1.0), (2.0, "arrow"): (-7.00, 14.29, 1.0),
        (3.0, "ellipse"): (-6.50, 13.91, 1.0),
        (5.0, "ellipse"): (-9.23, 22.67, 1.0), (5.0, "arrow"): (14.22, 8.84, 0.04),
        (10.0, "ellipse"): (-11.64, 41.28, 1.0),
    },
    "z": {
        (0.5, "corners"): (-6.13, 12.45, 1.0),
        (1.0, "ellipse"): (-13.56, 0.61, 1.0), (1.0, "arrow"): (-7.65, 4.64, 1.0), (1.0, "corners"): (-0.76, 43.86, 1.0),
        (2.0, "ellipse"): (-12.96, 1.33, 1.0), (2.0, "arrow"): (191.92, 69.48, 1.0),
        (3.0, "ellipse"): (-7.08, 1.53, 1.0),
        (5.0, "ellipse"): (22.52, 9.79, 1.0), (5.0, "arrow"): (643.13, 104.21, 0.04),
        (10.0, "ellipse"): (40.07, 25.45, 1.0),
    },
    "yaw": {
        (0.5, "arrow"): (-0.01, 0.16, 0.11), (0.5, "corners"): (-0.12, 1.33, 1.0),
        (1.0, "arrow"): (0.02, 0.28, 1.0), (1.0, "corners"): (-0.42, 2.83, 1.0),
        (2.0, "arrow"): (-0.04, 0.65, 1.0),
        (5.0, "arrow"): (101.09, 45.24, 0.04),
    },
}  # fmt: skip


def printed(quantity: Quantity, height_m: float, method: str) -> Printed | None:
    """Return what the thesis printed for a method at a height; None where it printed nothing or it cannot be read."""
    row = _ROWS[quantity].get((height_m, method))
    return None if row is None else Printed(*row)


QUANTITIES: tuple[Quantity, ...] = ("x", "y", "z", "yaw")
HOVER_S = 15.0
_START = HeldPose(1.0, 2.0, 3.5, -90.0)
"""Start of the landings of sections 5.1.7 and 5.1.8."""
_GONE_S = 1.0
"""Time without a sighting after which the pad counts as out of view."""


class Spread(NamedTuple):
    """The errors of one estimate of one quantity."""

    mean: float
    """mm, or degrees for the heading."""
    std: float
    least: float
    most: float
    available: float
    """Fraction of the frames with an estimate."""


def error_of(estimate: Estimate, quantity: Quantity) -> float | None:
    """Return the error of a quantity in mm, or in degrees for the heading; None where the heading is unknown.

    The corners of an H look the same after half a turn: as in the thesis, their heading counts up to half a turn.
    """
    if quantity == "yaw":
        if estimate.yaw_rad is None:
            return None
        off = estimate.yaw_rad - estimate.true_yaw_rad
        return math.degrees(0.5 * wrap_pi(2.0 * off) if estimate.name == "corners" else wrap_pi(off))
    i = "xyz".index(quantity)
    return 1e3 * float(estimate.xyz_m[i] - estimate.true_xyz_m[i])


def spread(flown: ExperimentFlight, name: str, quantity: Quantity) -> Spread | None:
    """Return the spread of a method's errors (equations 5.1 and 5.2); None where it gave no estimate."""
    errors = [e for one in flown.of(name) if (e := error_of(one, quantity)) is not None]
    if not errors:
        return None
    a = np.array(errors)
    return Spread(float(a.mean()), float(a.std()), float(a.min()), float(a.max()), len(a) / max(1, flown.frames))


HoverFlights = dict[float, ExperimentFlight]
"""The flights of section 5.1.3 by height."""


def hover_table(flights: HoverFlights, quantity: Quantity) -> dict[tuple[float, str], Spread]:
    """Return the spreads of one quantity by height and method."""
    rows = {(height_m, method): spread(flown, method, quantity) for height_m, flown in flights.items() for method in METHODS}
    return {key: found for key, found in rows.items() if found is not None}


class Lag(NamedTuple):
    """Lag of an estimator's path behind the truth on the way up."""

    path: str
    lag_s: float
    error_after_mm: float
    """Standard deviation of the height's error at rest."""


class Drift(NamedTuple):
    """The error of a path without sight of the pad."""

    path: str
    blind_s: float
    """Duration without sight."""
    held_s: float
    """Time after which the path gave up; the same where it did not."""
    end_m: float
    """Horizontal error then."""
    sigma_m: float
    """Standard deviation of one axis that it claimed then."""
    most_m: float


class Landed(NamedTuple):
    """A landing from (1, 2, 3.5) at -90 degrees."""

    flown: ExperimentFlight
    outcome: FlightOutcome | None
    lateral_m: float | None
    """Distance of the first contact with the deck from the pad's centre."""
    duration_s: float


class Chapter5(NamedTuple):
    """Chapter 5 as a whole."""

    up_and_down: ExperimentFlight
    hover: HoverFlights
    step: ExperimentFlight
    around: ExperimentFlight
    turn: ExperimentFlight
    landing: Landed
    external: Landed


def fly_up_and_down(settings: Settings, seed: int) -> ExperimentFlight:
    """Fly section 5.1.2 with all methods of vision."""
    return fly_by_hand(with_all_methods(settings), *up_and_down(0.2, 5.0, 0.4, x_m=-0.1), seed)


def with_all_methods(settings: Settings) -> Settings:
    """Return the settings with every method of vision."""
    return msgspec.structs.replace(settings, vision=msgspec.structs.replace(settings.vision, method="fused"))


def fly_chapter(settings: Settings, seed: int, say: Callable[[str], None]) -> Chapter5:
    """Fly every experiment of the simulator, with all methods of vision, which the tables compare.

    Args:
        say: receives the title of each before it begins.

    Raises:
        BadInput: the settings name a camera or pad file with a fault.
    """
    say("5.1.2 up and down between 0.2 and 5 m")
    up = fly_up_and_down(settings, seed)
    settings = with_all_methods(settings)
    hovering = {}
    for height_m in HEIGHTS_M:
        say(f"5.1.3 hovering at {height_m:g} m")
        hovering[height_m] = fly_by_hand(settings, hold(HeldPose(0.0, 0.0, height_m)), HOVER_S, seed)
    say("5.1.4 a step from 1 to 3 m")
    low, high = HeldPose(0.0, 0.0, 1.0), HeldPose(0.0, 0.0, 3.0)
    step = fly_by_hand(settings, way([(0.0, low), (3.0, low), (6.5, high), (10.0, high)]), 10.0, seed)
    say("5.1.5 dead reckoning around the ship")
    around = fly_by_hand(settings, *around_the_ship(0.6), seed, exact_attitude=False)
    say("5.1.6 a full turn")
    turn = fly_by_hand(settings, *full_turn(1.0, 20.0), seed)
    say("5.1.7 landing with PID and planner")
    landing = _landed(fly_pilot(settings, _START, seed))
    say("5.1.8 landing with an external controller")
    external = _landed(fly_pilot(settings, _START, seed, ExternalPilot))
    return Chapter5(up, hovering, step, around, turn, landing, external)


def lags(step: ExperimentFlight) -> list[Lag]:
    """Return each path's lag behind the truth during the climb of section 5.1.4, by the best match of the height, 10 ms apart."""
    times = np.array([t for t, _, _ in step.truth])
    heights = np.array([xyz[2] for _, xyz, _ in step.truth])
    speed = np.gradient(heights, times)
    out = []
    for path in ("median_mean", "dead_reckoning", "ekf"):
        reported = step.of(path)
        if not reported:
            continue
        t, z = np.array([e.t_s for e in reported]), np.array([e.xyz_m[2] for e in reported])
        climbing = np.interp(t, times, speed) > 0.3
        shifts = np.arange(-0.2, 1.0, 0.01)
        misses = [float(np.mean((np.interp(t[climbing] - s, times, heights) - z[climbing]) ** 2)) for s in shifts]
        rest = t > t[-1] - 2.0
        still = 1e3 * float(np.std(z[rest] - np.interp(t[rest], times, heights)))
        out.append(Lag(path, float(shifts[int(np.argmin(misses))]), still))
    return out


def drifts(around: ExperimentFlight) -> list[Drift]:
    """Return how far each path errs while the pad is out of view (section 5.1.5)."""
    seen = np.array([e.t_s for e in around.of("best")])
    gaps = np.diff(seen)
    if not len(gaps) or gaps.max() < _GONE_S:
        return []
    i = int(np.argmax(gaps))
    out = []
    for path in ("dead_reckoning", "ekf"):
        blind = [e for e in around.of(path) if seen[i] < e.t_s < seen[i + 1]]
        if blind:
            errors = [math.hypot(*(e.xyz_m - e.true_xyz_m)[:2]) for e in blind]
            held_s = blind[-1].t_s - float(seen[i])
            out.append(Drift(path, float(gaps[i]), held_s, errors[-1], blind[-1].sigma_m, max(errors)))
    return out


def headings(turn: ExperimentFlight) -> dict[str, tuple[F64, F64]]:
    """Return by method (times, heading errors in degrees) of the full turn of section 5.1.6."""
    out = {}
    for name in METHODS:
        rows = [(e.t_s, error) for e in turn.of(name) if (error := error_of(e, "yaw")) is not None]
        if rows:
            t, errors = np.array(rows).T
            out[name] = (t, errors)
    return out


def _landed(flown: ExperimentFlight) -> Landed:
    result = flown.result
    assert result is not None
    return Landed(flown, result.outcome, None if result.contact is None else result.contact.lateral_m, result.duration_s)
