"""Decide whether a flight in real time failed because the machine was too slow."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from estimator.contracts.estimates import Verdict

STOOD_STILL_MAX_S = 1.0
FILMED_MIN, REPLACED_MAX, SKIPPED_MAX, NO_ATTITUDE_MAX = 0.5, 0.4, 0.7, 0.15
"""Limits on shares of a flight's frames: rendered in time, replaced before vision processed them, left out by vision to keep its
share of a core, without an attitude since the samples came late."""
GUIDANCE_LATE_MAX_S = 0.02
"""Limit on the median delay of guidance cycles: one period of the shipped settings, at which guidance runs at half its rate."""
_FRAMES_HZ = 30.0


@dataclass(frozen=True, slots=True)
class Load:
    """The load of the machine during a flight in real time."""

    duration_s: float
    frames_sent: int
    """Number of frames that the simulated drone rendered and sent."""
    stood_still_s: float
    """Time in which the simulator did not advance, seconds."""
    frames: Counter[Verdict]
    """Number of received frames by verdict."""
    guidance_late_s: float | None = None
    """Median lateness of the guidance cycles, seconds; None if it was not measured."""

    def starved(self) -> str | None:
        """Return what shows that the machine was too slow, or None if it kept up."""
        said = []
        if self.stood_still_s > STOOD_STILL_MAX_S:
            said.append(f"the simulated drone stood still for {self.stood_still_s:.1f} s")
        filmed = self.frames_sent / max(1.0, _FRAMES_HZ * self.duration_s)
        if filmed < FILMED_MIN:
            said.append(f"{filmed:.0%} of the frames were rendered in time")
        every = max(1, self.frames.total())
        if (share := self.frames[Verdict.REPLACED] / every) > REPLACED_MAX:
            said.append(f"{share:.0%} of the frames were overtaken by newer ones")
        if (share := self.frames[Verdict.SKIPPED] / every) > SKIPPED_MAX:
            said.append(f"{share:.0%} of the frames were skipped")
        if (share := self.frames[Verdict.NO_ATTITUDE] / every) > NO_ATTITUDE_MAX:
            said.append(f"{share:.0%} of the frames had no attitude")
        if self.guidance_late_s is not None and self.guidance_late_s > GUIDANCE_LATE_MAX_S:
            said.append(f"half of the guidance cycles came {1e3 * self.guidance_late_s:.0f} ms late or later")
        return "; ".join(said) or None
