"""Two GNSS receivers that measure the vector between their antennas by carrier phase, and how they err.

The white noise of the phases; reflections that wander; now and then a wrong whole number of wavelengths, for seconds and with the
same claim as a right one; floats while the numbers are found again, and epochs without a solution.

Source: Teunissen & Montenbruck, Springer Handbook of GNSS, 2017, sections 23.1 (ambiguities) and 15.6 (multipath); sizes assumed.
"""

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import Struct

from estimator.contracts.geometry import F64
from estimator.contracts.keys import check_ranges, choice, number

_WHITE_M = (0.004, 0.004, 0.008)
"""Standard deviation of an epoch's white noise, north, east and down."""
_WANDER_M = (0.006, 0.006, 0.01)
"""Standard deviation of the wander by reflections, on the same axes."""
_WANDER_S = 40.0  # correlation time of that wander
_FLOAT_M = (0.25, 0.25, 0.4)
"""Standard deviation of the error while the ambiguities are estimated, on the same axes."""
_FLOAT_S = 15.0  # correlation time of that error
_CLAIMED_M = {"fixed": 0.01, "float": 0.2}
"""Standard deviation that the receiver states for each kind of solution."""
_WAVELENGTH_M = 0.19
_CYCLES_MOST = 4
_WRONG_S, _FLOATS_S, _DROPS_S = (2.0, 8.0), (4.0, 15.0), (0.3, 2.0)
"""Shortest and longest time of a wrong solution, of a float, and without a solution."""


class RtkSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The two receivers, one on the vehicle and one on the vessel."""

    rate_hz: Annotated[float, number("rate of the baselines; 0 for no receivers", "Hz", 0.0, 20.0)] = 0.0
    latency_s: Annotated[float, number("time from an epoch to the arrival of its baseline", "s", 0.0, 0.5, "assumed")] = 0.2
    antenna_m: Annotated[
        tuple[float, float, float], choice("the vehicle's antenna from the body's origin: metres forward, right, down")
    ] = (0.05, 0.0, -0.08)
    ship_antenna_m: Annotated[
        tuple[float, float, float], choice("the ship's antenna from the pad's centre: metres forward, to starboard, down")
    ] = (-0.9, 0.5, -0.4)
    wrong_fraction: Annotated[
        float, number("share of the epochs at which a wrong whole number of wavelengths begins", "1", 0.0, 1.0)
    ] = 0.001
    floats_per_minute: Annotated[float, number("average number of losses of the whole numbers", "per min", 0.0, 60.0)] = 0.3
    drops_per_minute: Annotated[float, number("average number of gaps without a solution", "per min", 0.0, 60.0)] = 0.5
    heading_hz: Annotated[
        float, number("rate at which two antennas on the ship give her heading; 0 for one antenna", "Hz", 0.0, 20.0)
    ] = 0.0
    alone: Annotated[bool, choice("whether the service may land by them without ever seeing the pad")] = False

    def __post_init__(self) -> None:
        check_ranges(self)


class Epoch(NamedTuple):
    """The solution of an epoch."""

    fix: Literal["fixed", "float"]
    error_m: F64
    """(3,) north, east, down."""
    claimed_m: float
    """The standard deviation on each axis that the receiver states."""
    right: bool
    """True if the whole numbers are known and right."""


class RtkErrors:
    """The errors of one pair, epoch after epoch.

    Args:
        seed: of its own random numbers, apart from all others of the flight.
    """

    def __init__(self, settings: RtkSettings, seed: list[int]) -> None:
        self._s, self._rng = settings, np.random.default_rng(seed)
        self._period_s = 1.0 / settings.rate_hz
        self._wander = np.array(_WANDER_M) * self._rng.standard_normal(3)
        self._floating = np.zeros(3)
        self._offset = np.zeros(3)
        self._left_s = {"wrong": 0.0, "float": 0.0, "drop": 0.0}

    def epoch(self, *, wrong: bool = False, floating: bool = False) -> Epoch | None:
        """Return the next solution; None where there is none.

        Args:
            wrong: whether a fault makes it wrong now.
            floating: whether a fault keeps the receiver from finding the whole numbers.
        """
        rng = self._rng
        chances, noise = rng.random(3), rng.standard_normal((3, 3))
        per_epoch = self._period_s / 60.0
        began = self._runs("wrong", _WRONG_S, chances[0] < self._s.wrong_fraction or (wrong and self._left_s["wrong"] <= 0.0))
        if began:
            along = rng.standard_normal(3)
            self._offset = _WAVELENGTH_M * rng.integers(1, _CYCLES_MOST + 1) * along / np.linalg.norm(along)
        refound = self._left_s["float"] > 0.0
        self._runs("float", _FLOATS_S, floating or chances[1] < self._s.floats_per_minute * per_epoch)
        self._runs("drop", _DROPS_S, chances[2] < self._s.drops_per_minute * per_epoch)
        self._wander = _kept(self._wander, _WANDER_M, _WANDER_S, self._period_s, noise[0])
        if self._left_s["float"] > 0.0 and not refound:
            self._floating = np.array(_FLOAT_M) * rng.standard_normal(3)
        self._floating = _kept(self._floating, _FLOAT_M, _FLOAT_S, self._period_s, noise[1])
        if self._left_s["drop"] > 0.0:
            return None
        error = self._wander + np.array(_WHITE_M) * noise[2]
        if self._left_s["float"] > 0.0:
            return Epoch("float", error + self._floating, _CLAIMED_M["float"], right=False)
        right = self._left_s["wrong"] <= 0.0
        return Epoch("fixed", error if right else error + self._offset, _CLAIMED_M["fixed"], right)

    def _runs(self, what: str, lasts_s: tuple[float, float], begins: bool) -> bool:
        """Count the remaining time of an event down; if that is over and `begins`, begin it again and return True."""
        self._left_s[what] = max(0.0, self._left_s[what] - self._period_s)
        if begins and self._left_s[what] <= 0.0:
            self._left_s[what] = self._rng.uniform(*lasts_s)
            return True
        return False


def _kept(error: F64, sigma: tuple[float, ...], time_s: float, dt: float, noise: F64) -> F64:
    """Return a first-order Gauss-Markov error after one step, (3,) m."""
    keep = math.exp(-dt / time_s)
    kept: F64 = keep * error + math.sqrt(1.0 - keep * keep) * np.array(sigma) * noise
    return kept
