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
    frequency: float = 1.0
    """Frequency of the tilt over that of its file."""
    frequency_sigma: float = 0.0
    damping: float = 1.0
    """Damping of the tilt over that of its file."""
    softer: float = 1.0
    """Factor by which the place weighs less, so that the margins are kept for all that this may be."""

    @property
    def other_shape(self) -> bool:
        """True if the tilt answers faster, slower, or damped otherwise than its file says."""
        return self.frequency != 1.0 or self.damping != 1.0

    @property
    def contradicts(self) -> bool:
        """True if the flight contradicts its file."""
        return self.state is ResponseState.IDENTIFIED or self.other_shape

    @property
    def text(self) -> str:
        """The state for the operator."""
        return f"{self._shape}; {self._delay}" if self.other_shape else self._delay

    @property
    def _shape(self) -> str:
        by, damped = 100.0 * abs(1.0 - self.frequency), 100.0 * abs(1.0 - self.damping)
        said = "as fast as" if self.frequency == 1.0 else f"{by:.0f} % {'slower' if self.frequency < 1.0 else 'faster'} than"
        less = f", damped {damped:.0f} % {'less' if self.damping < 1.0 else 'more'}" if self.damping != 1.0 else ""
        return f"this vehicle answers {said} its file (sigma {100.0 * self.frequency_sigma:.0f} %){less}"

    @property
    def _delay(self) -> str:
        ms = f"{1e3 * self.delay_s:.0f} ms (sigma {1e3 * (self.sigma_s or 0.0):.0f})"
        if self.state is ResponseState.IDENTIFIED:
            return f"the vehicle answers {1e3 * self.longer_s:.0f} ms longer than its response file says: {ms} is flown with"
        if self.state is ResponseState.KNOWN:
            return f"the vehicle's response is known: delay {ms}"
        return f"the vehicle's response is assumed: delay {1e3 * self.delay_s:.0f} ms, softer gains"
