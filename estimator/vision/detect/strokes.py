"""Find the H marking from its strokes, if the disc's outline is out of the frame or occluded.

In a plane parallel to the pad the H has two perpendicular directions and strokes of one width. The directions follow from the
gradients (four times their angles agree), and the width from the commonest run of white along either direction. With both known,
correlation with the H at one size and two headings gives its position. All of this runs on a frame a quarter the size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import Rotation
from estimator.vision.camera import Camera
from estimator.vision.detect.heading import marks_are_bright
from estimator.vision.detect.plane import Plane
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose

U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]

_STROKE_PX = 5.0
"""Width of a stroke in the image that is correlated."""
_MARGIN_M = 0.035
"""Width of the disc around the H that counts as background."""
_LEAST_WIDTH = 4
"""Smallest width of a stroke, px; thinner ones cannot be separated from noise."""
_LEAST_FRACTION = 0.22
"""Smallest fraction of the H that must be in view."""
_LEAST_SCORE = 0.55


@dataclass(frozen=True, slots=True, eq=False)
class HMarking:
    """A possible position of the H; its heading is known up to 180 degrees."""

    pose: PadPose
    score: float
    """Mean of the mask on the H minus the mean around it, halved, -1..1."""


def h_markings(px: U8, step: int, camera: Camera, pad: Pad, plane: Plane, most: int = 3) -> list[HMarking]:
    """Return the likeliest positions of the H, best first.

    Args:
        px: the frame, `step` times smaller than the camera's.
    """
    of = px if marks_are_bright(pad) else cv2.bitwise_not(px)
    least = np.asarray(cv2.min(cv2.min(of[:, :, 0], of[:, :, 1]), of[:, :, 2]), np.uint8)
    out: list[HMarking] = []
    limit, _ = cv2.threshold(least, 0, 255, cv2.THRESH_OTSU)
    above = least[least > limit]
    limits = [limit]
    if above.size > 50:
        upper, _ = cv2.threshold(above, 0, 255, cv2.THRESH_OTSU)
        if upper > limit + 12:
            limits.append(upper)
    angle = _direction(least)
    if angle is None:
        return []
    for value in limits:
        mask = np.where(least > value, np.float32(1.0), np.float32(-1.0))
        out += _places(mask, angle, step, camera, pad, plane)
    out.sort(key=lambda f: -f.score)
    return out[:most]


def _direction(least: U8) -> float | None:
    """Return the angle in the frame, modulo 90 degrees, that most strong gradients have; None if there are few."""
    gx = cv2.Sobel(least, cv2.CV_32F, 1, 0)
    gy = cv2.Sobel(least, cv2.CV_32F, 0, 1)
    z2 = (gx + 1j * gy) ** 2
    strength = np.abs(z2)
    strong = strength > 0.15 * float(strength.max(initial=0.0))
    if np.count_nonzero(strong) < 20:
        return None
    z4 = z2[strong] ** 2 / np.maximum(strength[strong], 1e-6) ** 1.5
    return float(np.angle(z4.sum()) / 4.0)


def _places(mask: F32, angle: float, step: int, camera: Camera, pad: Pad, plane: Plane) -> list[HMarking]:
    """Return the H markings in a mask of +1 and -1."""
    h, w = mask.shape
    f = camera.fx / step
    K = np.array(
        [[f, 0.0, (camera.cx + 0.5) / step - 0.5], [0.0, camera.fy / step, (camera.cy + 0.5) / step - 0.5], [0.0, 0.0, 1.0]]
    )
    centre = np.array([(w - 1) / 2, (h - 1) / 2])
    at = plane.places(camera, (centre[None] + 0.5) * step - 0.5)[0]
    if not np.isfinite(at).all():
        return []
    # Transfer the direction in the frame to the plane at the frame's centre.
    ends = np.array([centre, centre + 4.0 * np.array([math.cos(angle), math.sin(angle)])])
    p = plane.places(camera, (ends + 0.5) * step - 0.5)
    turn = math.atan2(p[1, 1] - p[0, 1], p[1, 0] - p[0, 0])
    size = int(math.hypot(w, h)) + 2
    mid = (size - 1) / 2
    c, s = math.cos(turn), math.sin(turn)
    from_upright = np.array(
        [[c / f, -s / f, at[0] - (c - s) * mid / f], [s / f, c / f, at[1] - (s + c) * mid / f], [0.0, 0.0, 1.0]]
    )
    warp = K @ plane.R_cam_plane @ from_upright
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    upright = np.asarray(cv2.warpPerspective(mask, warp, (size, size), flags=flags, borderValue=0.0), np.float32)
    out = []
    for width in _stroke_widths(upright):
        k = _STROKE_PX / width
        n = max(8, round(size * k))
        small = np.asarray(cv2.resize(upright, (n, n), interpolation=cv2.INTER_AREA if k < 1 else cv2.INTER_LINEAR), np.float32)
        k = n / size
        for score, u, v, across in _correlate(small, pad):
            # Map from the small upright image to the plane, and to metres by the stroke's width.
            x, y = (u + 0.5) / k - 0.5, (v + 0.5) / k - 0.5
            place = (from_upright @ np.array([x, y, 1.0]))[:2]
            depth = pad.markings.leg_width_m * f / width
            R = Rotation(plane.R_cam_plane) @ Rotation.from_rpy(0.0, 0.0, turn + (math.pi / 2 if across else 0.0))
            t = plane.R_cam_plane @ np.array([place[0] * depth, place[1] * depth, depth])
            if t[2] > 0.02:
                out.append(HMarking(PadPose(R, t), score))
    return out


def _stroke_widths(upright: F32) -> list[float]:
    """Return the commonest lengths of runs of white between black along rows and columns, at most two."""
    counts = np.zeros(max(upright.shape) + 2)
    for m in (upright, upright.T):
        padded = np.zeros((m.shape[0], m.shape[1] + 2), np.float32)
        padded[:, 1:-1] = m
        row, rise = np.nonzero((padded[:, :-1] <= 0) & (padded[:, 1:] > 0))
        _, fall = np.nonzero((padded[:, :-1] > 0) & (padded[:, 1:] <= 0))
        ok = (padded[row, rise] < 0) & (padded[row, fall + 1] < 0)
        counts += np.bincount((fall - rise)[ok], minlength=len(counts))[: len(counts)]
    lengths = np.arange(len(counts))
    counts[:_LEAST_WIDTH] = 0.0
    counts[70:] = 0.0
    widths: list[float] = []
    for _ in range(2):
        smooth = counts.copy()
        smooth[1:-1] += 0.7 * (counts[:-2] + counts[2:])
        smooth[2:-2] += 0.4 * (counts[:-4] + counts[4:]) * (lengths[2:-2] > 8)
        k = int(np.argmax(smooth))
        if smooth[k] < 8:
            break
        reach = max(1, round(0.15 * k))
        near = slice(k - reach, k + reach + 1)
        widths.append(float((counts[near] * lengths[near]).sum() / max(1.0, counts[near].sum())))
        counts[near] = 0.0
    return widths


def _correlate(small: F32, pad: Pad) -> list[tuple[float, float, float, bool]]:
    """Return (score, u, v, legs across) of the best positions for the H's two headings."""
    k = _STROKE_PX / pad.markings.leg_width_m
    half_long, half_wide = pad.markings.h_length_m / 2 * k, pad.markings.h_width_m / 2 * k
    leg, bar, margin = pad.markings.leg_width_m * k, pad.markings.bar_width_m / 2 * k, _MARGIN_M * k
    reach = math.ceil(half_long + margin) + 1
    image = cv2.copyMakeBorder(small, reach, reach, reach, reach, cv2.BORDER_CONSTANT, value=0.0)
    sums = [np.asarray(cv2.integral(m, sdepth=cv2.CV_32F), np.float32) for m in (image, np.abs(image))]
    rows, cols = small.shape

    def box(integral: F32, u0: float, u1: float, v0: float, v1: float) -> F32:
        """Return the sum over this box around every pixel of `small`."""
        a, b, c, d = (reach + round(x + 0.5) for x in (v0, v1, u0, u1))
        return np.asarray(
            integral[b : b + rows, d : d + cols] - integral[a : a + rows, d : d + cols]
            - integral[b : b + rows, c : c + cols] + integral[a : a + rows, c : c + cols]
        )  # fmt: skip

    out = []
    strokes = [
        (-half_long, half_long, -half_wide, leg - half_wide),
        (-half_long, half_long, half_wide - leg, half_wide),
        (-bar, bar, leg - half_wide, half_wide - leg),
    ]
    area_l = sum((b - a) * (d - c) for a, b, c, d in strokes)
    around = (-half_long - margin, half_long + margin, -half_wide - margin, half_wide + margin)
    area_r = (around[1] - around[0]) * (around[3] - around[2]) - area_l
    for across in (False, True):
        parts = []
        for integral in sums:
            boxes = [box(integral, *((c, d, a, b) if across else (a, b, c, d))) for a, b, c, d in (*strokes, around)]
            h_marking = boxes[0] + boxes[1] + boxes[2]
            parts.append((h_marking, boxes[3] - h_marking))
        (sl, sr), (nl, nr) = parts
        fraction = np.minimum(nl / area_l, 1.0)
        least_l, least_r = _LEAST_FRACTION * area_l, _LEAST_FRACTION * area_r
        score = 0.5 * (sl / np.maximum(nl, least_l) - sr / np.maximum(nr, least_r)) * (0.7 + 0.3 * fraction)
        score[(nl < least_l) | (nr < least_r)] = -1.0
        for _ in range(2):
            _, best, _, (u, v) = cv2.minMaxLoc(score)
            if best < _LEAST_SCORE:
                break
            out.append((float(best), float(u), float(v), across))
            near = round(_STROKE_PX)
            score[max(0, v - near) : v + near + 1, max(0, u - near) : u + near + 1] = -1.0
    return out
