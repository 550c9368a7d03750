"""Count what a calibration flight has shown so far, and name what it lacks."""

import math
from dataclasses import dataclass

import numpy as np

from companion.tools.calibrate.flight_views import FlightViews
from companion.tools.calibrate.gyro_attitude import interpolated
from estimator.contracts.geometry import Rotation, wrap_pi

PAD_S = 40.0
"""Time with the pad in view that a calibration flight needs."""
LEAN_DEG = 4.0
"""Tilts to each side that it needs."""
TURN_DEG = 90.0
"""Turns to each side that it needs."""
_GAP_S = 0.5  # longest gap between two views that counts as the pad in view


@dataclass(slots=True)
class FlightCoverage:
    """Counts what counts while the pad is in view."""

    pad_s: float = 0.0
    roll_deg: tuple[float, float] = (0.0, 0.0)
    """Farthest to the left (negative) and to the right."""
    pitch_deg: tuple[float, float] = (0.0, 0.0)
    """Farthest nose down (negative) and nose up."""
    clockwise_deg: float = 0.0
    """Turned clockwise, in all."""
    counter_deg: float = 0.0
    height_m: tuple[float, float] | None = None
    """Lowest and highest."""
    _last: tuple[float, float] | None = None

    def add(self, t: float, roll_rad: float, pitch_rad: float, heading_rad: float, height_m: float | None) -> None:
        """Take note of the attitude at an instant, s, at which the pad is in view."""
        roll, pitch = math.degrees(roll_rad), math.degrees(pitch_rad)
        self.roll_deg = min(self.roll_deg[0], roll), max(self.roll_deg[1], roll)
        self.pitch_deg = min(self.pitch_deg[0], pitch), max(self.pitch_deg[1], pitch)
        if height_m is not None:
            low, high = self.height_m or (height_m, height_m)
            self.height_m = min(low, height_m), max(high, height_m)
        if self._last is not None and 0.0 < t - self._last[0] <= _GAP_S:
            turned = math.degrees(wrap_pi(heading_rad - self._last[1]))
            self.pad_s += t - self._last[0]
            self.clockwise_deg += max(0.0, turned)
            self.counter_deg += max(0.0, -turned)
        self._last = t, heading_rad

    def missing(self) -> list[str]:
        """Return what the flight should still show, most important first."""
        out = []
        if self.pad_s < PAD_S:
            out.append(f"the pad in view for {PAD_S:.0f} s ({self.pad_s:.0f} s so far)")
        leans = (
            ("left", -self.roll_deg[0]),
            ("right", self.roll_deg[1]),
            ("forward", -self.pitch_deg[0]),
            ("back", self.pitch_deg[1]),
        )
        out += [f"lean {way} by {LEAN_DEG:.0f} degrees or more ({far:.0f} so far)" for way, far in leans if far < LEAN_DEG]
        turns = (("clockwise", self.clockwise_deg), ("counter-clockwise", self.counter_deg))
        out += [
            f"turn about the vertical {way} by {TURN_DEG:.0f} degrees or more ({far:.0f} so far)"
            for way, far in turns
            if far < TURN_DEG
        ]
        return out

    def in_words(self) -> str:
        """Return one line."""
        low, high = self.height_m or (math.nan, math.nan)
        heights = "" if self.height_m is None else f", {low:.1f} to {high:.1f} m"
        return (
            f"pad {self.pad_s:.0f} s{heights}; leans left {-self.roll_deg[0]:.0f}, right {self.roll_deg[1]:.0f}, forward "
            f"{-self.pitch_deg[0]:.0f}, back {self.pitch_deg[1]:.0f} degrees; turns clockwise {self.clockwise_deg:.0f}, "
            f"counter-clockwise {self.counter_deg:.0f} degrees"
        )


def coverage_of(views: FlightViews) -> FlightCoverage:
    """Return what the views of a flight cover."""
    coverage = FlightCoverage()
    attitudes = interpolated(views.t_attitude, views.R_ned_body, views.t)
    for t, R, distance in zip(views.t, attitudes, np.linalg.norm(views.t_cam_pad, axis=1), strict=True):
        coverage.add(float(t), *Rotation(R).rpy_rad, float(distance))
    return coverage
