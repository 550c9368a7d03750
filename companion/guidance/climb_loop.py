"""The loop of the climb over a heaving deck as one matrix: the law made for one response around a vehicle with another.

The law's own cycle (`law_step` of the native core) is asked what it does to each unit vector, as in `companion.guidance.margins`.
It goes down at a wanted rate, as in a commit. A drone that leans against the wind is pushed aside as its thrust changes; the
horizontal axis of `margins` takes that push as a gust.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from msgspec import structs

from companion.guidance.controller import HORIZONS_S
from companion.guidance.disturbance import ObserverNoise, chosen, observer_gains
from companion.guidance.law_records import COMMAND_SIZE, MEMORY_SIZE, packed_gains, packed_observer, packed_params
from companion.guidance.margins import PERIOD_S, GaussMarkov, pushed_axis
from companion.guidance.riccati import exponential
from companion.guidance.tilt_law import TiltWeights, tilt_gains
from companion.settings.response import ClimbResponse, Response
from estimator.contracts.geometry import F64
from estimator.core.interface import places_of
from estimator.core.library import CORE, address
from estimator.core.records import record

LEAN_RAD = math.radians(8.5)
"""Lean of a small vehicle near the deck, against a wind of 2.5 m/s and the way of a ship at 1.5 m/s."""
_SMALL = 1e-3
"""Size of the vectors that the law is asked for, within each of its limits."""
_LARGEST_M_S = 5.0
_STEP = CORE.function("law_step")
_SPEED_OF = places_of("law_command")["v"].start + 2
_PUSHED_OF = places_of("law_memory")["pushed_down_m_s2"].start
_V, _DECK, _DECK_ACCEL, _UNKNOWN, _GUST, _SPEED, _ACCEL, _PUSHED, _UNDER_WAY = range(9)
"""The state: speeds of the vehicle and of the deck down, the deck's acceleration, what disturbs them, and the law's memory."""


class HeaveDisturbances(NamedTuple):
    """What disturbs the climb at sea state 4, near the deck.

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
    params = packed_params(vehicle.tilt, climb, PERIOD_S, remembered, looks_ahead=True, over_ground=False)
    tilt = tilt_gains(vehicle.tilt, TiltWeights(), PERIOD_S)
    gains = packed_gains(tilt, len(tilt.under_way), delay, vehicle.tilt.slowness_s)
    observer = packed_observer(chosen(observer_gains(ObserverNoise(), PERIOD_S), 0.01))
    horizons = np.array(HORIZONS_S)
    ahead = np.array([exponential(deck * h)[0] for h in HORIZONS_S])
    course = np.zeros((horizons.size, 3))
    fixed = {
        "goes_on": 1, "steers": 1, "has_deck": 1, "horizons": horizons.size, "has_rate": 1, "dt": PERIOD_S, "share": 1.0,
        "d": (0.0, 0.0, 1.0), "speed_max_m_s": 1.0,
    }  # fmt: skip

    def law(state: F64, rate: float) -> tuple[float, float]:
        x = _SMALL * state
        course[:, 2] = ahead @ x[[_DECK, _DECK_ACCEL]]
        down = {
            "v": x[_DECK] - x[_V] + x[_SPEED], "a_body": accel @ x + x[_ACCEL], "v_deck": x[_DECK], "a_deck": x[_DECK_ACCEL]
        }  # fmt: skip
        cycle = record("law_cycle", {**fixed, **{k: (0.0, 0.0, v) for k, v in down.items()}, "rate_m_s": _SMALL * rate})
        before = record("law_memory", {"begun": 1, "pushed_down_m_s2": x[_PUSHED], "climbs": x[_UNDER_WAY:]})
        after, out = np.zeros(MEMORY_SIZE), np.zeros(COMMAND_SIZE)
        _STEP(
            params.address, gains.address, gains.address, observer.address, address(cycle), address(horizons), address(course),
            address(before), address(after), address(out),
        )  # fmt: skip
        return float(out[_SPEED_OF]) / _SMALL, float(after[_PUSHED_OF]) / _SMALL

    return law
