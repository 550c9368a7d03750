"""Render what a ship shows beside her deck: sides, shadow on the water, wake."""

from __future__ import annotations

import math

import cv2
import numpy as np

from estimator.contracts.geometry import F64
from sitl.light import U16, scene_of
from sitl.projection import Lens
from sitl.render_deck import draw
from sitl.surroundings import Deck

_SIDE = (74, 58, 46)
"""Paint of the hull's sides, BGR."""


def on_water(deck: Deck, rim_ned: F64, R_ned_pad: F64, to_sun: F64, wake_speed_m_s: float) -> list[F64]:
    """Return the outlines on calm water, (N, 3) m ned: the hull at the waterline, the shadow that it casts, and its wake."""
    rim = rim_ned
    line = rim.copy()
    line[:, 2] = 0.0
    reach = np.minimum(rim[:, 2:], 0.0) / to_sun[2]
    cast = rim - to_sun * reach
    cast[:, 2] = 0.0
    hull = cv2.convexHull(np.concatenate([line, cast])[:, :2].astype(np.float32))[:, 0].astype(float)
    out = [line, np.c_[hull, np.zeros(len(hull))]]
    speed = wake_speed_m_s
    if speed > 0.2:
        yaw = deck.pad_yaw_rad
        ahead = R_ned_pad @ np.array([math.cos(yaw), -math.sin(yaw), 0.0])
        ahead = np.array([ahead[0], ahead[1], 0.0]) / max(1e-6, math.hypot(ahead[0], ahead[1]))
        side = np.array([-ahead[1], ahead[0], 0.0])
        stern = line[[0, -1]].mean(axis=0)
        long, half = 3.0 * speed + 2.0 * deck.length_m, deck.width_m / 2
        out.append(
            np.array(
                [
                    stern - 0.8 * half * side, stern + 0.8 * half * side,
                    stern - long * ahead + 1.9 * half * side, stern - long * ahead - 1.9 * half * side,
                ]
            )
        )  # fmt: skip
    return out


def hull_side(scene: U16, lens: Lens, rim_ned: F64, line: F64, R_ned_cam: F64, p_cam_ned: F64, blend: str) -> None:
    """Paint the sides of the hull between the deck's rim and the waterline, both (N, 3) m, where the camera sees them."""
    rim = rim_ned
    below = np.roll(line, -1, axis=0)
    along, down = np.roll(rim, -1, axis=0) - rim, line - rim
    outward = along[:, [1, 2, 0]] * down[:, [2, 0, 1]] - along[:, [2, 0, 1]] * down[:, [1, 2, 0]]
    for i in np.nonzero(((rim - p_cam_ned) * outward).sum(axis=1) < 0)[0]:
        quad = np.array([rim[i], rim[(i + 1) % len(rim)], below[i], line[i]])
        draw(scene, lens, (quad - p_cam_ned) @ R_ned_cam, scene_of(_SIDE, blend))
