"""What a vehicle did while no service was there to command it, by the truth."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from estimator.contracts.geometry import F64
from sitl.emulators.autopilots.body import BodyState

_STOPPED_M_S = 0.3


@dataclass(slots=True, eq=False)
class Silence:
    """One time without a service."""

    at_s: float
    """Its begin, s after the order to land."""
    phase: str | None
    """Phase of guidance in which the service was killed."""
    height_m: float
    """Height over the deck then, m."""
    lasted_s: float = 0.0
    modes: list[str] = field(default_factory=list)
    """Modes of the autopilot in their order, as a ground station heard them."""
    sank_m: float = 0.0
    """Largest loss of altitude, m."""
    lowest_m: float = 0.0
    """Least height over the deck, m."""
    moved_m: float = 0.0
    """Distance over the ground from where it began to where it ended, m."""
    stopped_s: float | None = None
    """Time until its velocity over the ground fell below 0.3 m/s and stayed there, s; None if it did not."""
    touched: bool = False
    """Whether it touched anything."""
    _p_ned: F64 | None = None
    _contacts: int = 0

    def step(self, since_s: float, state: BodyState, height_m: float, mode: str, contacts: int) -> None:
        """Note the true state.

        Args:
            since_s: time since its begin, s.
            height_m: height over the deck, m.
            mode: the autopilot's mode, as a ground station heard it.
            contacts: number of contacts so far.
        """
        if self._p_ned is None:
            self._p_ned, self.lowest_m, self._contacts = state.p_ned.copy(), height_m, contacts
        self.touched = contacts > self._contacts
        moved = state.p_ned - self._p_ned
        self.lasted_s, self.moved_m = since_s, float(np.hypot(moved[0], moved[1]))
        self.sank_m, self.lowest_m = max(self.sank_m, float(moved[2])), min(self.lowest_m, height_m)
        if not self.modes or self.modes[-1] != mode:
            self.modes.append(mode)
        if float(np.linalg.norm(state.v_ned)) >= _STOPPED_M_S:
            self.stopped_s = None
        elif self.stopped_s is None:
            self.stopped_s = since_s

    def as_json(self) -> dict[str, object]:
        """Return plain values; lengths in m, times in s."""
        return {
            "phase": self.phase,
            "at_s": round(self.at_s, 2),
            "lasted_s": round(self.lasted_s, 2),
            "modes": list(self.modes),
            "height_m": round(self.height_m, 3),
            "lowest_m": round(self.lowest_m, 3),
            "sank_m": round(self.sank_m, 3),
            "moved_m": round(self.moved_m, 2),
            "stopped_s": None if self.stopped_s is None else round(self.stopped_s, 2),
            "touched": self.touched,
        }

    def in_words(self) -> str:
        """Return a line for people."""
        stopped = "did not stop" if self.stopped_s is None else f"stopped after {self.stopped_s:.1f} s"
        touched = ", touched the deck" if self.touched else ""
        return (
            f"service killed at {self.at_s:.1f} s in {self.phase}, {self.height_m:.2f} m over the deck, back after "
            f"{self.lasted_s:.1f} s: {' -> '.join(self.modes)}, sank {self.sank_m:.2f} m, at least {self.lowest_m:.2f} m over "
            f"the deck, moved {self.moved_m:.1f} m over the ground, {stopped}{touched}"
        )
