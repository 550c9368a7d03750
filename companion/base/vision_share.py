"""Limit the share of a core that looking at frames may take: on a machine too slow for each frame some are skipped.

Vision and event loop share the interpreter's lock. A thread that is never idle makes samples, guidance and commands late,
and each sighting older; half of the frames, seen in time, land a drone better than all of them, seen late.
"""

from __future__ import annotations

from estimator.contracts.time import MonoNs, after

_WEIGHT = 0.2
"""Weight of the newest look in the mean: five frames tell a slow machine from one slow look."""
_PAUSE_MAX_S = 0.2
"""Longest time without a look: a sighting at least each 0.2 s keeps an estimate fresh, whatever a look costs."""


class VisionShare:
    """Decides which frames are looked at.

    Args:
        core_fraction: the largest share of the time that looks may take, 0 to 1; at 1 no frame is skipped.
    """

    def __init__(self, core_fraction: float) -> None:
        self._core_fraction = core_fraction
        self._mean_s: float | None = None
        self._not_before = MonoNs(0)

    def admits(self, now: MonoNs) -> bool:
        """Return whether a frame that arrives now is to be looked at."""
        return self._core_fraction >= 1.0 or now >= self._not_before

    def looked(self, began: MonoNs, duration_s: float) -> None:
        """Take how long a look took, by the clock on the wall: what else keeps the core busy counts."""
        self._mean_s = duration_s if self._mean_s is None else self._mean_s + _WEIGHT * (duration_s - self._mean_s)
        self._not_before = after(began, min(self._mean_s / self._core_fraction, self._mean_s + _PAUSE_MAX_S))
