"""Where the experiments fly: wanted poses over time, in the thesis' axes.

The thesis tells the drone's place over the pad in the axes of the drone's own heading: x ahead of the pad along its nose, y to
the left, z up, and the heading counter-clockwise from a nose that points to the left of the arrow (facts on its code, section 5).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64, wrap_pi


class HeldPose(NamedTuple):
    """A place over the pad in the thesis' axes, and the heading."""

    x_m: float
    y_m: float
    z_m: float
    yaw_deg: float = 0.0


Path = Callable[[float], HeldPose]
"""The wanted pose at a time in seconds after the start."""


def thesis_axes(d_body_pad_level: F64) -> F64:
    """Return (3,) m x, y, z of the drone over the pad, from the vector to the pad (forward, right, down)."""
    return np.array([-d_body_pad_level[0], d_body_pad_level[1], d_body_pad_level[2]])


def level_axes(pose: HeldPose) -> F64:
    """Return (3,) m forward, right, down to the pad: the inverse of `thesis_axes`."""
    return np.array([-pose.x_m, pose.y_m, pose.z_m])


def thesis_yaw_rad(yaw_rad: float) -> float:
    """Return the thesis' heading of a heading against the arrow, clockwise; the same formula leads back."""
    return wrap_pi(-yaw_rad - 0.5 * math.pi)


def hold(pose: HeldPose) -> Path:
    """Return the path that stays in one place."""
    return lambda t_s: pose


def way(points: Sequence[tuple[float, HeldPose]]) -> Path:
    """Return the path through poses at times, straight and at an even speed between them."""
    times = [t for t, _ in points]
    poses = np.array([p for _, p in points])

    def at(t_s: float) -> HeldPose:
        return HeldPose(*(float(np.interp(t_s, times, poses[:, i])) for i in range(4)))

    return at


def up_and_down(low_m: float, high_m: float, speed_m_s: float, x_m: float = 0.0) -> tuple[Path, float]:
    """Return the path from a height to another and back with a rest at each end, and its duration in seconds."""
    rest_s, climb_s = 4.0, (high_m - low_m) / speed_m_s
    low, high = HeldPose(x_m, 0.0, low_m), HeldPose(x_m, 0.0, high_m)
    times = np.cumsum([0.0, rest_s, climb_s, rest_s, climb_s, rest_s])
    return way(list(zip(times.tolist(), [low, low, high, high, low, low], strict=True))), float(times[-1])


def around_the_ship(speed_m_s: float) -> tuple[Path, float]:
    """Return the path of section 5.1.5: from over the pad ahead, around the ship and back, and its duration in seconds."""
    corners = [(0.0, 0.0), (6.0, 0.0), (6.0, 4.0), (-6.0, 4.0), (-6.0, -4.0), (6.0, -4.0), (6.0, 0.0), (0.0, 0.0)]
    t_s, points = 6.0, [(0.0, HeldPose(0.0, 0.0, 1.0))]
    for before, after in zip([corners[0], *corners], corners, strict=False):
        t_s += math.dist(before, after) / speed_m_s
        points.append((t_s, HeldPose(*after, 1.0)))
    points.append((t_s + 6.0, HeldPose(0.0, 0.0, 1.0)))
    return way(points), t_s + 6.0


def full_turn(height_m: float, rate_deg_s: float) -> tuple[Path, float]:
    """Return the path that turns once counter-clockwise over the pad, and its duration in seconds."""
    turn_s = 360.0 / rate_deg_s

    def at(t_s: float) -> HeldPose:
        turned = rate_deg_s * min(max(t_s - 3.0, 0.0), turn_s)
        return HeldPose(0.0, 0.0, height_m, math.degrees(wrap_pi(math.radians(turned))))

    return at, turn_s + 6.0
