"""Cost of a calibration error at touchdown: centimetres beside the pad's centre, and speed by the climb.

A camera that is turned by an angle sees the pad beside its place by the angle times the distance. Lower than
`LAST_SIGHTING_M` the pad fills the frame, and the filter carries on by the IMU. A delay shows the pad where it was, beside its
place by a speed times the delay, and by the angle that the vehicle has turned meanwhile, times the distance. The law that follows
the deck reacts late as well, so the speed is not that across the pad but what simulated landings show. A readout time that is
wrong is a delay that differs from row to row. A focal length that is wrong by a share makes every distance wrong by it; a pad
that stays in the middle of the frame does not move aside by that, one beside it by the vehicle's tilt does.

Of the vehicle's response: near the deck, at sea state 4, gusts, the deck and the filter's errors drive the loop of
`companion.guidance.law.margins`. Its law is made for the response of a file. With another vehicle than the file's it errs by
more, and the squares' difference is the cost, as for mount and delay. In the climb a commit is a step of the wanted rate at the
gate. By a wrong climb the rate is another at the contact and differs more from flight to flight; and the thrust that tilting
turns into a push aside is another, which is all that the climb does to the place.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from msgspec import structs

from companion.guidance.controller import HORIZONS_S
from companion.guidance.law.gains import ObserverNoise, TiltWeights, chosen, exponential, observer_gains, tilt_gains
from companion.guidance.law.margins import PERIOD_S, GaussMarkov, axis_error_m, pushed_axis, stationary
from companion.guidance.law.records import law_gains, law_in_use, law_params
from companion.settings.mission import ConeOptions
from companion.settings.response import ClimbResponse, Response, TiltResponse
from estimator.contracts.geometry import F64
from estimator.core.library import CORE

LAST_SIGHTING_M = 0.4
DELAY_SPEED_M_S = 0.9
"""Cost of a second of delay: 50 ms added 4.7 cm rms to ten landings of the scenario demo."""
TURN_RATE_RAD_S = 0.25
"""Rate of roll and pitch while the vehicle follows a deck."""
APPROACH_M = 3.0
"""Height at which guidance begins to descend, where an error costs most."""


class TouchdownCost(NamedTuple):
    """Centimetres at touchdown, and at the beginning of the descent."""

    touchdown_cm: float
    approach_cm: float


def of_mount(rotvec_rad: F64) -> TouchdownCost:
    """Return the cost of a camera turned by a rotation vector in `body`; a turn about the vertical does not shift the pad."""
    angle = float(np.hypot(rotvec_rad[0], rotvec_rad[1]))
    return TouchdownCost(100.0 * angle * LAST_SIGHTING_M, 100.0 * angle * APPROACH_M)


def of_mount_sigma(cov: F64) -> TouchdownCost:
    """Return the cost of a mount that is known with this covariance, (3, 3) rad^2: one standard deviation."""
    return of_mount(np.array([math.sqrt(cov[0, 0]), math.sqrt(cov[1, 1]), 0.0]))


def of_distance(share: float) -> tuple[TouchdownCost, TouchdownCost]:
    """Return what distances that are wrong by a share cost: of the height, and aside by the tilt of a vehicle in wind."""
    height = TouchdownCost(100.0 * share * LAST_SIGHTING_M, 100.0 * share * APPROACH_M)
    return height, TouchdownCost(*(math.tan(LEAN_RAD) * cm for cm in height))


def of_delay(seconds: float) -> TouchdownCost:
    """Return the cost of a delay that is wrong by this much."""
    late = abs(seconds)
    touchdown, approach = (
        math.hypot(DELAY_SPEED_M_S, TURN_RATE_RAD_S * distance_m) * late for distance_m in (LAST_SIGHTING_M, APPROACH_M)
    )
    return TouchdownCost(100.0 * touchdown, 100.0 * approach)


def of_readout(seconds: float) -> TouchdownCost:
    """Return the cost of a readout time that is wrong by this much, for a pad a quarter of the frame off the middle row."""
    return of_delay(0.25 * seconds)


# The loop of the climb over a heaving deck as one matrix: the law made for one response around a vehicle with another.
#
# The law's own cycle (`law_step` of the native core) is applied to each unit vector, as in
# `companion.guidance.law.margins`. It goes down at a wanted rate, as in a commit. A drone that tilts against the wind is pushed
# aside as its thrust changes; the horizontal axis of `margins` takes that push as a gust.

LEAN_RAD = math.radians(8.5)
"""Lean of a small vehicle near the deck, against a wind of 2.5 m/s and the way of a ship at 1.5 m/s."""
_SMALL = 1e-3
"""Size of the vectors for which the law is computed, within each of its limits."""
_LARGEST_M_S = 5.0
_V, _DECK, _DECK_ACCEL, _UNKNOWN, _GUST, _SPEED, _ACCEL, _PUSHED, _UNDER_WAY = range(9)
"""The state: speeds of the vehicle and of the deck down, the deck's acceleration, what disturbs them, and the law's memory."""


class HeaveDisturbances(NamedTuple):
    """Disturbances of the climb at sea state 4, near the deck.

    The deck's speed and frequency are the means of twelve flights of `sea_state_4`; its band, the gust and the rest are assumed.
    """

    deck_m_s: float = 0.37
    """Standard deviation of the pad's vertical speed."""
    deck_rad_s: float = 0.77
    """Its middle frequency."""
    deck_damping: float = 0.15
    """Half its band over the middle frequency."""
    unknown_m_s2: GaussMarkov = GaussMarkov(0.06, 1.2)
    """Acceleration of the deck that no forecast knows."""
    gust_m_s2: GaussMarkov = GaussMarkov(0.05, 1.0)
    speed_m_s: GaussMarkov = GaussMarkov(0.012, 1.0)
    """Errors of the filter's relative speed, and of the levelled accelerometer."""
    accel_m_s2: GaussMarkov = GaussMarkov(0.04, 4.0)


class ClimbLoop(NamedTuple):
    """x(k+1) = M x(k) + by_rate r, with the horizontal axis behind the climb's own states."""

    M: F64
    Q: F64
    """Covariance of what comes in a period."""
    by_rate: F64
    closing: F64
    """The row that gives the speed against the deck, m/s."""
    aside: int
    """The place of the horizontal axis in x, m."""

    @property
    def stable(self) -> bool:
        return float(np.abs(np.linalg.eigvals(self.M)).max()) < 1.0


def climb_loop(assumed: ClimbResponse, vehicle: Response, around: HeaveDisturbances | None = None) -> ClimbLoop:
    """Return the loop of a vehicle whose law is made for another climb.

    Args:
        assumed: the climb that the law is made for.
        vehicle: the vehicle's own response; the law knows its tilt.
        around: what disturbs it.
    """
    a = around or HeaveDisturbances()
    late = max(1.0, vehicle.climb.delay_s / PERIOD_S)
    delay = max(1, round(assumed.delay_s / PERIOD_S))
    n = _UNDER_WAY + max(delay, math.floor(late) + 1) + 1
    accel = _acceleration(vehicle.climb.lag_s, late, n)
    deck = np.array([[0.0, 1.0], [-(a.deck_rad_s**2), -2.0 * a.deck_damping * a.deck_rad_s]])
    law = _law(assumed, vehicle, delay, n - _UNDER_WAY, accel, deck)
    axis, push = pushed_axis(vehicle.tilt)
    M, Q = np.zeros((n + len(axis), n + len(axis))), np.zeros((n + len(axis), n + len(axis)))
    M[n:, n:], M[n:, :n] = axis, -math.tan(LEAN_RAD) * np.outer(push, accel)
    M[_V, :n] = PERIOD_S * accel
    M[_V, _V] += 1.0
    M[_DECK : _DECK_ACCEL + 1, _DECK : _DECK_ACCEL + 1] = exponential(deck * PERIOD_S)
    M[_DECK, _UNKNOWN] = PERIOD_S
    Q[_DECK_ACCEL, _DECK_ACCEL] = PERIOD_S * 4.0 * a.deck_damping * a.deck_rad_s**3 * a.deck_m_s**2
    for i, w in ((_UNKNOWN, a.unknown_m_s2), (_GUST, a.gust_m_s2), (_SPEED, a.speed_m_s), (_ACCEL, a.accel_m_s2)):
        M[i, i] = math.exp(-PERIOD_S / w.time_s)
        Q[i, i] = w.sigma**2 * (1.0 - M[i, i] ** 2)
    M[_UNDER_WAY + 1 : n, _UNDER_WAY : n - 1] = np.eye(n - _UNDER_WAY - 1)
    M[[_UNDER_WAY, _PUSHED], :n] = np.array([law(e, 0.0) for e in np.eye(n)]).T
    by_rate, closing = np.zeros(len(M)), np.zeros(len(M))
    by_rate[[_UNDER_WAY, _PUSHED]] = law(np.zeros(n), 1.0)
    closing[[_V, _DECK]] = 1.0, -1.0
    return ClimbLoop(M, Q, by_rate, closing, n)


def _acceleration(lag_s: float, late: float, n: int) -> F64:
    """Return the row that gives the vehicle's acceleration down, m/s^2; its commands act after `late` periods."""
    row, whole = np.zeros(n), math.floor(late)
    row[_UNDER_WAY + whole - 1 : _UNDER_WAY + whole + 1] = (1.0 - late + whole) / lag_s, (late - whole) / lag_s
    row[[_V, _GUST]] = -1.0 / lag_s, 1.0
    return row


def _law(
    assumed: ClimbResponse, vehicle: Response, delay: int, remembered: int, accel: F64, deck: F64
) -> Callable[[F64, float], tuple[float, float]]:
    """Return the law: from the state and a wanted rate to the vertical speed that it commands, and the push that it remembers."""
    climb = structs.replace(assumed, max_m_s=_LARGEST_M_S)
    params = law_params(vehicle.tilt, climb, PERIOD_S, remembered, looks_ahead=True, over_ground=False)
    tilt = tilt_gains(vehicle.tilt, TiltWeights(), PERIOD_S)
    gains = law_gains(tilt, len(tilt.under_way), delay, vehicle.tilt.slowness_s)
    flown = law_in_use(params, gains, chosen(observer_gains(ObserverNoise(), PERIOD_S), 0.01))
    ahead = np.array([exponential(deck * h)[0] for h in HORIZONS_S])
    fixed = {
        "goes_on": 1, "steers": 1, "has_deck": 1, "has_rate": 1, "dt": PERIOD_S, "share": 1.0, "d": (0.0, 0.0, 1.0),
        "speed_max_m_s": 1.0,
    }  # fmt: skip

    def law(state: F64, rate: float) -> tuple[float, float]:
        x = _SMALL * state
        down = {
            "v": x[_DECK] - x[_V] + x[_SPEED], "a_body": accel @ x + x[_ACCEL], "v_deck": x[_DECK], "a_deck": x[_DECK_ACCEL]
        }  # fmt: skip
        new = CORE.ffi.new
        cycle = new("dl_law_cycle *", {**fixed, **{k: (0.0, 0.0, v) for k, v in down.items()}, "rate_m_s": _SMALL * rate})
        rates = [(0.0, 0.0, v) for v in ahead @ x[[_DECK, _DECK_ACCEL]]]
        course = new("dl_law_course *", {"n": len(HORIZONS_S), "horizons_s": HORIZONS_S, "rates_m_s": rates})
        before = new("dl_law_memory *", {"begun": 1, "pushed_down_m_s2": x[_PUSHED], "climbs": x[_UNDER_WAY:].tolist()})
        after, out = new("dl_law_memory *"), new("dl_law_command *")
        if not CORE.lib.dl_law_step(flown, cycle, course, before, after, out):
            raise ValueError("the law has no room for its commands")
        return out.v[2] / _SMALL, after.pushed_down_m_s2 / _SMALL

    return law


_RANGES = ((0.0, 0.6), (0.02, 3.0))
"""Delay and lag that a climb may have."""


class ClimbContact(NamedTuple):
    """The contacts that the loop makes."""

    speed_m_s: float
    """Mean speed against the deck; inf if the loop is unstable."""
    spread_m_s: float
    """Its standard deviation."""
    drift_cm: float
    """Root mean square distance along the deck that the changes of thrust push the drone."""

    @property
    def hard_m_s(self) -> float:
        """The speed that one contact in forty exceeds."""
        return self.speed_m_s + 2.0 * self.spread_m_s


_CONE = ConeOptions()


class ClimbCost(NamedTuple):
    """Contacts by a file's climb beside those by the vehicle's own."""

    by_file: ClimbContact
    own: ClimbContact

    @property
    def cost_m_s(self) -> float:
        """Excess speed of one contact in forty; 0 if it is no faster."""
        return max(0.0, self.by_file.hard_m_s - self.own.hard_m_s)

    @property
    def cost_cm(self) -> float:
        """Further drift by the climb's error, in squares; 0 if it does no harm."""
        return math.sqrt(max(0.0, self.by_file.drift_cm**2 - self.own.drift_cm**2))


def contact(assumed: ClimbResponse, vehicle: Response, cone: ConeOptions = _CONE) -> ClimbContact:
    """Return the contacts of a vehicle whose law is made for the climb `assumed`.

    Args:
        cone: height of the gate, and rate from there to the contact.
    """
    loop = climb_loop(assumed, vehicle)
    if not loop.stable:
        return ClimbContact(math.inf, math.inf, math.inf)
    cov = stationary(loop.M, loop.Q)
    x, left_m = np.zeros(len(loop.M)), cone.gate_height_m
    while left_m > 0.0:
        x = loop.M @ x + cone.commit_rate_m_s * loop.by_rate
        left_m -= PERIOD_S * float(loop.closing @ x)
    drift_m = math.hypot(float(x[loop.aside]), math.sqrt(float(cov[loop.aside, loop.aside])))
    return ClimbContact(float(loop.closing @ x), math.sqrt(float(loop.closing @ cov @ loop.closing)), 100.0 * drift_m)


def climb_of_file(file: ClimbResponse, vehicle: Response) -> ClimbCost:
    """Return the cost of a file's climb for a vehicle."""
    return ClimbCost(contact(file, vehicle), contact(vehicle.climb, vehicle))


def climb_of_sigma(found: Response, cov: F64) -> tuple[ClimbCost, ClimbCost]:
    """Return what a climb costs vehicles one standard deviation from it: the worst by its speed, and the worst by its drift.

    Args:
        found: the response that the law is made for.
        cov: covariance of its climb's delay and lag, (2, 2) s^2.
    """
    sizes, axes = np.linalg.eigh(cov)
    steps = (axes * np.sqrt(np.maximum(sizes, 0.0))).T
    tried = [climb_of_file(found.climb, _moved(found, turn)) for turn in (steps[0], -steps[0], steps[1], -steps[1])]
    return max(tried, key=lambda cost: cost.cost_m_s), max(tried, key=lambda cost: cost.cost_cm)


def _moved(of: Response, by: F64) -> Response:
    values = np.array([of.climb.delay_s, of.climb.lag_s]) + by
    delay, lag = (float(np.clip(v, *within)) for v, within in zip(values, _RANGES, strict=True))
    return structs.replace(of, climb=structs.replace(of.climb, delay_s=delay, lag_s=lag))


_TILT_RANGES = ((0.0, 0.6), (1.0, 60.0), (0.2, 3.0))
"""Delay, frequency and damping that a response may have."""


class ResponseCost(NamedTuple):
    """Root mean square distance from the pad's centre at touchdown, both axes."""

    error_cm: float
    """Error by the file's response; inf if the loop is unstable."""
    own_cm: float
    """Error by the vehicle's own response."""

    @property
    def cost_cm(self) -> float:
        """Further drift by the response's error, in squares; 0 if it does no harm."""
        return math.sqrt(max(0.0, self.error_cm**2 - self.own_cm**2))


def tilt_of_file(file: TiltResponse, vehicle: TiltResponse) -> ResponseCost:
    """Return the cost of a file's response for a vehicle."""
    return ResponseCost(*(100.0 * math.sqrt(2.0) * axis_error_m(assumed, vehicle) for assumed in (file, vehicle)))


def tilt_of_sigma(found: TiltResponse, cov: F64) -> ResponseCost:
    """Return the cost of a response for the worst vehicle that is one standard deviation from it.

    Args:
        found: the response that the law is made for.
        cov: covariance of its delay, frequency and damping, (3, 3), in s, rad/s and 1.
    """
    sizes, axes = np.linalg.eigh(cov)
    steps = (axes * np.sqrt(np.maximum(sizes, 0.0))).T
    costs = [[tilt_of_file(found, _tilt_moved(found, sign * step)) for sign in (1.0, -1.0)] for step in steps]
    tried = [cost for pair in costs for cost in pair]
    slopes = np.array([_squares(plus) - _squares(minus) for plus, minus in costs])
    if np.isfinite(slopes).all() and np.linalg.norm(slopes) > 0.0:
        # Of a cost that changes evenly the worst lies there.
        tried.append(tilt_of_file(found, _tilt_moved(found, slopes / np.linalg.norm(slopes) @ steps)))
    return max(tried, key=lambda cost: cost.cost_cm)


def _squares(cost: ResponseCost) -> float:
    return cost.error_cm**2 - cost.own_cm**2


def _tilt_moved(of: TiltResponse, by: F64) -> TiltResponse:
    values = np.array([of.delay_s, of.frequency_rad_s, of.damping]) + by
    delay, frequency, damping = (float(np.clip(v, *within)) for v, within in zip(values, _TILT_RANGES, strict=True))
    return structs.replace(of, delay_s=delay, frequency_rad_s=frequency, damping=damping)
