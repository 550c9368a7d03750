"""The vehicle's response as it is known in flight."""

import math
from enum import Enum
from typing import NamedTuple

from msgspec import Struct


class ResponseState(Enum):
    """Source of the vehicle's response."""

    ASSUMED = "assumed"
    """Neither the file nor the flight gives the uncertainty of the delay."""
    KNOWN = "known"
    """The delay of its file holds, by the file's own word or by the flight's."""
    IDENTIFIED = "identified"
    """The flight contradicts the delay of its file and takes its place."""


class TiltShape(NamedTuple):
    """Difference of a vehicle's tilt from its file, beside the delay: factors, and how much less the place weighs for it."""

    frequency: float = 1.0
    damping: float = 1.0
    softer: float = 1.0
    """Factor by which the place weighs less, so that the margins are kept for all that this may be."""
    sigma: float = 0.0
    """Standard deviation of the frequency's logarithm."""

    @property
    def slow(self) -> float:
        """The factor on the frequency that gains are made for: one standard deviation slower, and never faster than the file.

        The slow side takes phase. Gains for a faster vehicle than there is have no margin; those of the file stand it.
        """
        return min(1.0, self.frequency * math.exp(-self.sigma))

    @property
    def text(self) -> str:
        """The difference for the operator."""
        by, damped = 100.0 * abs(1.0 - self.frequency), 100.0 * abs(1.0 - self.damping)
        how = "as fast as" if self.frequency == 1.0 else f"{by:.0f} % {'slower' if self.frequency < 1.0 else 'faster'} than"
        less = f", damped {damped:.0f} % {'less' if self.damping < 1.0 else 'more'}" if self.damping != 1.0 else ""
        return f"this vehicle answers {how} its file (sigma {100.0 * self.sigma:.0f} %){less}"


AS_FILED = TiltShape()


class ResponseInUse(Struct, frozen=True):
    """The response that the control law flies by."""

    state: ResponseState
    delay_s: float
    """Delay of the tilt that is flown with."""
    sigma_s: float | None
    """Standard deviation of the delay; None if nothing states it."""
    longer_s: float = 0.0
    """Excess of the delay over its file, s."""
    shape: TiltShape = AS_FILED

    @property
    def contradicts(self) -> bool:
        """True if the flight contradicts its file."""
        return self.state is ResponseState.IDENTIFIED or self.shape != AS_FILED

    @property
    def text(self) -> str:
        """The state for the operator."""
        return self._delay if self.shape == AS_FILED else f"{self.shape.text}; {self._delay}"

    @property
    def _delay(self) -> str:
        ms = f"{1e3 * self.delay_s:.0f} ms (sigma {1e3 * (self.sigma_s or 0.0):.0f})"
        if self.state is ResponseState.IDENTIFIED:
            return f"the vehicle answers {1e3 * self.longer_s:.0f} ms longer than its response file says: {ms} is flown with"
        if self.state is ResponseState.KNOWN:
            return f"the vehicle's response is known: delay {ms}"
        return f"the vehicle's response is assumed: delay {1e3 * self.delay_s:.0f} ms, softer gains"
