"""The vehicle's response as it is known in flight."""

from dataclasses import dataclass
from enum import Enum


class ResponseState(Enum):
    """Source of the vehicle's response."""

    ASSUMED = "assumed"
    """Neither the file nor the flight gives the uncertainty of the delay."""
    KNOWN = "known"
    """The delay of its file holds, by the file's own word or by the flight's."""
    IDENTIFIED = "identified"
    """The flight contradicts the delay of its file and takes its place."""


@dataclass(frozen=True, slots=True)
class ResponseInUse:
    """The response that the control law flies by."""

    state: ResponseState
    delay_s: float
    """Delay of the tilt that is flown with."""
    sigma_s: float | None
    """Standard deviation of the delay; None if nothing states it."""
    longer_s: float = 0.0
    """Excess of the delay over its file, s."""

    @property
    def text(self) -> str:
        """The state for the operator."""
        ms = f"{1e3 * self.delay_s:.0f} ms (sigma {1e3 * (self.sigma_s or 0.0):.0f})"
        if self.state is ResponseState.IDENTIFIED:
            return f"the vehicle answers {1e3 * self.longer_s:.0f} ms longer than its response file says: {ms} is flown with"
        if self.state is ResponseState.KNOWN:
            return f"the vehicle's response is known: delay {ms}"
        return f"the vehicle's response is assumed: delay {1e3 * self.delay_s:.0f} ms, softer gains"
