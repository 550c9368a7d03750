"""The gains of the tilt for each response that may be flown by: the file's, softer until it is known, or with another delay.

Softer gains let the place weigh a third and take the vehicle to answer 50 ms later than its file says: with the shipped AR.Drone
they stand 196 ms of further delay instead of 92, and err by 2.8 cm a side instead of 1.8 (`companion.guidance.margins`). A longer
delay that is known takes gains of its own, with the place weighing less the longer it is, so that the margin of 60 ms is kept.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from msgspec import structs

from companion.base.response_in_use import ResponseInUse, ResponseState
from companion.guidance.disturbance import SIGMAS_P_M, chosen
from companion.guidance.tilt_law import TiltGains, TiltWeights, tilt_gains
from companion.settings.response import TiltResponse

_STIFF_M = 0.01
"""Standard deviation of the place up to which the regulator is as stiff as its weights say, m."""
_SOFTER = 0.02 / 0.006
"""By how much less the place weighs while the response is only assumed."""
SOFTER_LONGER_S = 0.05
"""By how much later it is taken to answer."""
_SOFTER_PER_S = 5.0
"""By how much less the place weighs for each second of further delay."""
_LONGEST_S = 0.6
"""Longest delay that a response may have, s."""
_STEP_S = 0.01
"""Delays are distinguished in steps of this, s."""


class TuningChoice(NamedTuple):
    """Which gains to fly by."""

    longer_s: float = 0.0
    """Delay beyond the one of the response file."""
    soft: bool = False


AS_GIVEN = TuningChoice()
"""The response file as it is."""


def chosen_tuning(in_use: ResponseInUse | None) -> TuningChoice:
    """Return the gains for the response in use; None flies by the file as it is."""
    if in_use is None:
        return AS_GIVEN
    return TuningChoice(_STEP_S * round(in_use.longer_s / _STEP_S), in_use.state is ResponseState.ASSUMED)


def tuned(given: TiltResponse, weights: TiltWeights, choice: TuningChoice) -> tuple[TiltResponse, TiltWeights]:
    """Return the response that the gains are made for, and their weights."""
    longer = choice.longer_s + (SOFTER_LONGER_S if choice.soft else 0.0)
    delay_s = min(_LONGEST_S, max(0.0, given.delay_s + longer))
    softer = (_SOFTER if choice.soft else 1.0) * (1.0 + _SOFTER_PER_S * max(0.0, choice.longer_s))
    return structs.replace(given, delay_s=delay_s), weights._replace(p_m=weights.p_m * softer)


class TiltTuning:
    """One response with its gains, each solved when it is first asked for.

    Args:
        response, weights: of `tuned`.
        period_s: the guidance period.
        delay_line: whether commands under way are in the state.
    """

    def __init__(self, response: TiltResponse, weights: TiltWeights, period_s: float, *, delay_line: bool) -> None:
        self.response = response
        self.under_way = max(1, math.ceil(response.delay_s / period_s - 1e-9))
        self._weights, self._period_s, self._delay_line = weights, period_s, delay_line
        self._solved: dict[float, TiltGains] = {}

    def gains(self, sigma_p_m: float) -> TiltGains:
        """Return the gains for a standard deviation of the place: the worse it is known, the softer."""
        # Higher up the place is known to decimetres, and a stiff loop would only fly after its errors.
        sigma = chosen(SIGMAS_P_M, sigma_p_m)
        if sigma not in self._solved:
            weights = self._weights._replace(p_m=self._weights.p_m * max(1.0, sigma / _STIFF_M))
            self._solved[sigma] = tilt_gains(self.response, weights, self._period_s, delay_line=self._delay_line)
        return self._solved[sigma]

    def solve(self) -> TiltTuning:
        """Solve all gains beforehand.

        Raises:
            ValueError: there are no gains that stabilise such a vehicle.
        """
        for sigma in SIGMAS_P_M:
            self.gains(sigma)
        return self
