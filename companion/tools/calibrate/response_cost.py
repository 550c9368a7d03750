"""What an error of a vehicle's response costs at touchdown: the error of the closed loop whose law is made for another vehicle.

Near the deck, at sea state 4, gusts, the deck and the filter's errors drive the loop of `companion.guidance.margins`. Its law is
made for the response of a file. With another vehicle than the file's it errs by more, and the squares' difference is the cost,
as for mount and delay. What a wrong climb costs is in `companion.tools.calibrate.climb_cost`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import structs

from companion.guidance.margins import axis_error_m
from companion.settings.response import TiltResponse
from estimator.contracts.geometry import F64

_RANGES = ((0.0, 0.6), (1.0, 60.0), (0.2, 3.0))
"""Delay, frequency and damping that a response may have."""


class ResponseCost(NamedTuple):
    """Root mean square distance from the pad's centre at touchdown, both axes."""

    error_cm: float
    """By the file's response; inf if the loop is unstable."""
    own_cm: float
    """By the vehicle's own."""

    @property
    def cost_cm(self) -> float:
        """What the error of the response adds, in squares; 0 if it does no harm."""
        return math.sqrt(max(0.0, self.error_cm**2 - self.own_cm**2))


def of_file(file: TiltResponse, vehicle: TiltResponse) -> ResponseCost:
    """Return the cost of a file's response for a vehicle."""
    return ResponseCost(*(100.0 * math.sqrt(2.0) * axis_error_m(assumed, vehicle) for assumed in (file, vehicle)))


def of_sigma(found: TiltResponse, cov: F64) -> ResponseCost:
    """Return the cost of a response for the worst vehicle that is one standard deviation from it.

    Args:
        found: the response that the law is made for.
        cov: covariance of its delay, frequency and damping, (3, 3), in s, rad/s and 1.
    """
    sizes, axes = np.linalg.eigh(cov)
    steps = (axes * np.sqrt(np.maximum(sizes, 0.0))).T
    costs = [[of_file(found, _moved(found, sign * step)) for sign in (1.0, -1.0)] for step in steps]
    tried = [cost for pair in costs for cost in pair]
    slopes = np.array([_squares(plus) - _squares(minus) for plus, minus in costs])
    if np.isfinite(slopes).all() and np.linalg.norm(slopes) > 0.0:
        # Of a cost that changes evenly the worst lies there.
        tried.append(of_file(found, _moved(found, slopes / np.linalg.norm(slopes) @ steps)))
    return max(tried, key=lambda cost: cost.cost_cm)


def _squares(cost: ResponseCost) -> float:
    return cost.error_cm**2 - cost.own_cm**2


def _moved(of: TiltResponse, by: F64) -> TiltResponse:
    values = np.array([of.delay_s, of.frequency_rad_s, of.damping]) + by
    delay, frequency, damping = (float(np.clip(v, *within)) for v, within in zip(values, _RANGES, strict=True))
    return structs.replace(of, delay_s=delay, frequency_rad_s=frequency, damping=damping)
