"""Cost of a calibration's errors: the distance beside the pad's centre at touchdown.

A camera that is turned by an angle sees the pad beside its place by the angle times the distance. Lower than `LAST_SIGHTING_M`
the pad fills the frame, and the filter carries on by the IMU. A delay shows the pad where it was, beside its place by a speed
times the delay, and by the angle that the vehicle has turned meanwhile, times the distance. The law that follows the deck reacts
late as well, so the speed is not that across the pad but what simulated landings show. A readout time that is wrong is a delay
that differs from row to row. A focal length that is wrong by a share makes every distance wrong by it; a pad that stays in the
middle of the frame does not move aside by that, one beside it by the vehicle's tilt does.

Of the vehicle's response: near the deck, at sea state 4, gusts, the deck and the filter's errors drive the loop of
`companion.guidance.law.margins`. Its law is made for the response of a file. With another vehicle than the file's it errs by
more, and the squares' difference is the cost.
"""

import math
from typing import NamedTuple

import numpy as np
from msgspec import structs

from companion.guidance.law.margins import axis_error_m
from companion.settings.guidance import TiltResponse
from estimator.contracts.geometry import F64

LAST_SIGHTING_M = 0.4
"""Distance of the last sighting: lower the pad fills the frame."""
DELAY_SPEED_M_S = 0.9
"""Cost of a second of delay: 50 ms added 4.7 cm rms to ten landings of the scenario demo."""
TURN_RATE_RAD_S = 0.25
"""Rate of roll and pitch while the vehicle follows a deck."""
APPROACH_M = 3.0
"""Height at which guidance begins to descend, where an error costs most."""
LEAN_RAD = math.radians(8.5)
"""Lean of a small vehicle near the deck, against a wind of 2.5 m/s and the way of a ship at 1.5 m/s."""


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
    slopes = np.array([plus.error_cm**2 - plus.own_cm**2 - minus.error_cm**2 + minus.own_cm**2 for plus, minus in costs])
    if np.isfinite(slopes).all() and np.linalg.norm(slopes) > 0.0:
        # Of a cost that changes evenly the worst lies there.
        tried.append(tilt_of_file(found, _tilt_moved(found, slopes / np.linalg.norm(slopes) @ steps)))
    return max(tried, key=lambda cost: cost.cost_cm)


def _tilt_moved(of: TiltResponse, by: F64) -> TiltResponse:
    values = np.array([of.delay_s, of.frequency_rad_s, of.damping]) + by
    delay, frequency, damping = (float(np.clip(v, *within)) for v, within in zip(values, _TILT_RANGES, strict=True))
    return structs.replace(of, delay_s=delay, frequency_rad_s=frequency, damping=damping)
