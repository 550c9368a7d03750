"""The state that vision keeps from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass

from estimator.vision.detect.acquire import FRESH_SEARCH, SearchMemory
from estimator.vision.detect.paint import FRESH, PaintMemory


@dataclass(frozen=True, slots=True, eq=False)
class TrackerMemory:
    """The state that vision keeps from frame to frame."""

    paint: PaintMemory = FRESH
    search: SearchMemory = FRESH_SEARCH
    alike_yaw_rad: float | None = None
    """The heading at which a pad that looks the same from several was last registered: the belief does not take it."""
    lit: bool = False
    """Whether the pad was last seen by its lamps."""
