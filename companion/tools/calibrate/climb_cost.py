"""What an error of a vehicle's climb costs at touchdown: speed of the contact, and centimetres by the thrust that goes with it.

A commit is a step of the wanted rate at the gate, over a deck at sea state 4 (`companion.guidance.climb_loop`). By a wrong
climb the rate is another at the contact and differs more from flight to flight; and the thrust that leaning turns into a push
aside is another, which is all that the climb does to the place.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import structs

from companion.guidance.climb_loop import climb_loop
from companion.guidance.margins import PERIOD_S, stationary
from companion.settings.mission import ConeOptions
from companion.settings.response import ClimbResponse, Response
from estimator.contracts.geometry import F64

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
        """How much faster the one contact in forty is; 0 if it is no faster."""
        return max(0.0, self.by_file.hard_m_s - self.own.hard_m_s)

    @property
    def cost_cm(self) -> float:
        """What the error of the climb adds to the drift, in squares; 0 if it does no harm."""
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


def of_file(file: ClimbResponse, vehicle: Response) -> ClimbCost:
    """Return the cost of a file's climb for a vehicle."""
    return ClimbCost(contact(file, vehicle), contact(vehicle.climb, vehicle))


def of_sigma(found: Response, cov: F64) -> tuple[ClimbCost, ClimbCost]:
    """Return what a climb costs vehicles one standard deviation from it: the worst by its speed, and the worst by its drift.

    Args:
        found: the response that the law is made for.
        cov: covariance of its climb's delay and lag, (2, 2) s^2.
    """
    sizes, axes = np.linalg.eigh(cov)
    steps = (axes * np.sqrt(np.maximum(sizes, 0.0))).T
    tried = [of_file(found.climb, _moved(found, turn)) for turn in (steps[0], -steps[0], steps[1], -steps[1])]
    return max(tried, key=lambda cost: cost.cost_m_s), max(tried, key=lambda cost: cost.cost_cm)


def _moved(of: Response, by: F64) -> Response:
    values = np.array([of.climb.delay_s, of.climb.lag_s]) + by
    delay, lag = (float(np.clip(v, *within)) for v, within in zip(values, _RANGES, strict=True))
    return structs.replace(of, climb=structs.replace(of.climb, delay_s=delay, lag_s=lag))
