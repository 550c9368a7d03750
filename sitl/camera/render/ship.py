"""Render what a ship shows beside her deck: sides, shadow on the water, wake."""

from __future__ import annotations

import math

import cv2
import numpy as np

from estimator.contracts.geometry import F64
from sitl.camera.light import U16, scene_of
from sitl.camera.projection import Lens
from sitl.camera.render.deck import draw
from sitl.camera.surroundings import Deck

_SIDE = (74, 58, 46)
"""Paint of the hull's sides, BGR."""


def on_water(deck: Deck, rim_ned: F64, R_ned_pad: F64, to_sun: F64, wake_speed_m_s: float) -> list[F64]:
    """Return the outlines on calm water, (N, 2) m to north and east: the hull, its shadow, and the wake of a ship under way."""
    line = rim_ned[:, :2]
    cast = line - to_sun[:2] * (np.minimum(rim_ned[:, 2:], 0.0) / to_sun[2])
    hull = cv2.convexHull(np.concatenate([line, cast]).astype(np.float32))[:, 0].astype(float)
    out = [line, hull]
    speed = wake_speed_m_s
    if speed > 0.2:
        yaw = deck.pad_yaw_rad
        ahead = R_ned_pad.dot(np.array([math.cos(yaw), -math.sin(yaw), 0.0]))[:2]
        ahead = ahead / max(1e-6, math.hypot(*ahead.tolist()))
        side = np.array([-ahead[1], ahead[0]])
        stern = (line[0] + line[-1]) / 2.0
        long, half = 3.0 * speed + 2.0 * deck.length_m, deck.width_m / 2
        end = stern - long * ahead
        out.append(
            np.array([stern - 0.8 * half * side, stern + 0.8 * half * side, end + 1.9 * half * side, end - 1.9 * half * side])
        )
    return out


def hull_side(scene: U16, lens: Lens, rim_ned: F64, R_ned_cam: F64, p_cam_ned: F64, blend: str) -> None:
    """Paint the sides of the hull between the deck's rim, (N, 3) m, and the waterline below it, where the camera sees them."""
    x, y = (rim_ned - p_cam_ned)[:, :2].T
    along_x, along_y = np.concatenate([x[1:], x[:1]]) - x, np.concatenate([y[1:], y[:1]]) - y
    # The camera is outside of a side that runs clockwise around it; a rim below the water shows the other face.
    outside = (x * along_y - y * along_x) * rim_ned[:, 2] > 0
    if not outside.any():
        return
    for i in np.nonzero(outside)[0]:
        quad = rim_ned[[i, (i + 1) % len(rim_ned), (i + 1) % len(rim_ned), i]]
        quad[2:, 2] = 0.0
        draw(scene, lens, (quad - p_cam_ned) @ R_ned_cam, scene_of(_SIDE, blend))
