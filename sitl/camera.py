"""The simulated camera: a pad on a deck on a sea, through a lens, onto a sensor.

The same exposure and random state give the same bits. The geometry of the pad is exact (pinhole and distortion per pixel,
coverage integrated over pixel and exposure); sea, deck and decals are scenery.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from sitl.light import FULL_SCALE, I16, Development, Light, Sensor, counts
from sitl.projection import F32, SHIFT, Lens, lens_of
from sitl.render_deck import WEAR_ONE, DeckPainter, draw, drone_shadow
from sitl.render_pad import PadInImage, PadPainter, Pose, Stroke
from sitl.render_sea import SeaPainter
from sitl.surroundings import Surroundings

U8 = NDArray[np.uint8]

GAIN_ONE = 16384
"""Value of a factor of one on the light."""


def _zeros() -> F64:
    return np.zeros(3)


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """The pose of every object in the middle of the exposure, and its motion during the exposure."""

    t_s: float
    """Time, s, at which the waves and the vessel's motion are computed."""
    R_ned_body: Rotation
    p_body_ned: F64
    """Position (3,) of the body, m; the surface of calm water is z = 0."""
    R_ned_pad: Rotation
    p_pad_ned: F64
    """Position (3,) of the pad's centre, m."""
    v_body_ned: F64 = field(default_factory=_zeros)
    """Velocity (3,) of the body, m/s."""
    w_body: F64 = field(default_factory=_zeros)
    """Angular velocity (3,) of the body in `body`, rad/s."""
    v_pad_ned: F64 = field(default_factory=_zeros)
    """Velocity (3,) of the pad's centre, m/s."""
    w_pad: F64 = field(default_factory=_zeros)
    """Angular velocity (3,) of the pad in `pad`, rad/s."""


class Renderer:
    """Renders frames of one scene through one camera.

    Args:
        pad: the pad, or None for a scene without one; the deck then lies where the pad would be.
    """

    def __init__(
        self,
        camera: Camera,
        pad: Pad | None,
        surroundings: Surroundings | None = None,
        light: Light | None = None,
        sensor: Sensor | None = None,
    ) -> None:
        self.camera, self.pad = camera, pad
        self.surroundings = surroundings if surroundings is not None else Surroundings()
        self.light = light if light is not None else Light()
        self.sensor = sensor if sensor is not None else Sensor()
        self._lens = lens_of(camera)
        self._pad = PadPainter(self._lens, pad) if pad is not None else None
        self._sea = SeaPainter(self._lens, self.surroundings, self.light)
        deck = self.surroundings.deck
        self._deck = DeckPainter(self._lens, deck, self.light) if deck is not None else None
        self._development = Development(self.light, self.sensor)
        self._paints = self._development.table[0][_paint_codes(pad), np.arange(3)] if pad is not None else None
        self._vignette = _vignette(self._lens, self.light.vignetting)
        self._decals = [(decal.on, decal.polygons()) for decal in self.surroundings.decals]
        e, a = self.light.sun_elevation_rad, self.light.sun_azimuth_rad
        self._to_sun = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), -math.sin(e)])

    def render(self, shot: Exposure, rng: np.random.Generator) -> U8:
        """Return the sensor's image, (H, W, 3) BGR. One number is drawn from `rng`, for the noise."""
        return self._development.sensor_image(self._light_on_sensor(shot), rng)

    def radiance(self, shot: Exposure) -> F32:
        """Return the linear light on the sensor before noise and tone curve, (H, W, 3) BGR; 1 is full scale, clipped at 4."""
        return self._light_on_sensor(shot) * np.float32(1.0 / FULL_SCALE)

    def _light_on_sensor(self, shot: Exposure) -> I16:
        """Return `radiance` in counts."""
        poses = [_pose(shot, self.camera, 0.0)]
        R_cam_pad, t_cam_pad = poses[0]
        half = self.sensor.exposure_s / 2
        ends = [_pose(shot, self.camera, s) for s in (-half, half)] if half > 0 else []

        canvas, gain, added = self._scenery(shot, R_cam_pad, t_cam_pad)
        if ends:
            canvas = _smear(canvas, self._lens, poses[0], ends)
        placed = self._place(shot, poses[0], ends)
        behind = None
        if placed is not None and self.pad is not None:
            behind = self._development.expose(canvas.reshape(-1, 1, 3).take(placed.pixels, axis=0))[:, 0]
            codes = _paint_codes(self.pad)
            for paint, polygon in placed.fills:
                cv2.fillPoly(canvas, [polygon], codes[paint].tolist(), cv2.LINE_8, SHIFT)
        light = self._development.expose(canvas)
        if placed is not None and behind is not None and self._paints is not None:
            mixed = placed.shares[1:].T @ self._paints[1:].astype(np.float32)
            mixed += placed.shares[0][:, None] * behind
            mixed += np.float32(0.5)
            light.reshape(-1, 3)[placed.pixels] = mixed.astype(np.int16)
        gains = cv2.cvtColor(gain.view(np.uint16), cv2.COLOR_GRAY2BGR).view(np.int16)
        cv2.multiply(light, gains, dst=light, scale=1.0 / GAIN_ONE)
        if added is not None:
            level = self._development.gains_bgr
            cv2.add(light, counts(cv2.merge([added * g for g in level])), dst=light)
        return self._development.blur(light)

    def _place(self, shot: Exposure, middle: Pose, ends: list[Pose]) -> PadInImage | None:
        """Return the pad in the frame; the exposure is divided into parts so short that the pad's way is straight in each."""
        if self._pad is None:
            return None
        way = self._pad.travel_px(*ends) if ends else np.zeros(2)
        travel = float(way.max())
        if not travel > 0.3:
            return self._pad.place([Stroke.still(middle)], np.zeros(2))
        n = 1 if travel < 6.0 else 3 if travel < 20.0 else 5
        if n == 1:
            return self._pad.place([Stroke(ends[0], middle, ends[1])], way)
        times = (np.arange(2 * n + 1) / (2 * n) - 0.5) * self.sensor.exposure_s
        poses = [_pose(shot, self.camera, float(s)) for s in times]
        return self._pad.place([Stroke(*poses[2 * i : 2 * i + 3]) for i in range(n)], way)

    def _scenery(self, shot: Exposure, R_cam_pad: F64, t_cam_pad: F64) -> tuple[U8, I16, F32 | None]:
        """Return the paint values of everything except the pad, the factors on its light, and the added light."""
        h, w = self.camera.height, self.camera.width
        gain = self._vignette
        added: F32 | None = None
        normal_distance = float(R_cam_pad[:, 2] @ t_cam_pad)
        plane = self._lens.plane_from_ray(np.stack([R_cam_pad[:, 0], R_cam_pad[:, 1], t_cam_pad], axis=1))
        deck = self._deck if normal_distance > 1e-3 and plane is not None else None
        mask = None
        if deck is not None and plane is not None and not deck.fills(plane):
            mask = deck.mask(R_cam_pad, t_cam_pad)
            mask = None if int(mask.min()) == 255 else mask
        canvas = None if deck is not None and mask is None else self._water(shot, mask)
        if deck is not None and plane is not None and (mask is None or mask.any()):
            x, y, bw, bh = cv2.boundingRect(mask) if mask is not None else (0, 0, w, h)
            part = slice(y, y + bh), slice(x, x + bw)
            footprint = normal_distance / self.camera.fx
            painted = deck.paint(part, plane, footprint)
            paint, worn = cv2.cvtColor(painted, cv2.COLOR_BGRA2BGR), cv2.extractChannel(painted, 3)
            cover = mask[part] if mask is not None else None
            if canvas is None or cover is None:
                canvas = np.asarray(paint, dtype=np.uint8)
            else:
                cv2.copyTo(paint, cv2.inRange(cover, 255, 255), canvas[part])
                edges = np.flatnonzero(cv2.inRange(cover, 1, 254) != 0)
                r, c = np.divmod(edges, bw)
                share = cover[r, c, None].astype(np.float32) / np.float32(255.0)
                edge = canvas[part]
                edge[r, c] = np.round(share * paint[r, c] + (1 - share) * edge[r, c])
                worn = cv2.copyTo(worn, cover, np.full_like(worn, WEAR_ONE))
            gain = gain.copy()
            cv2.multiply(gain[part], worn.astype(np.int16), dst=gain[part], scale=1.0 / WEAR_ONE)
            wet = deck.wet(part, plane, footprint)
            if wet is not None:
                covered = np.float32(1.0) if cover is None else cover.astype(np.float32) * np.float32(1.0 / 255.0)
                gain[part] = np.round(gain[part] * ((wet[0] - np.float32(1.0)) * covered + np.float32(1.0)))
                added = np.zeros((h, w), np.float32)
                added[part] = wet[1] * covered
            for on, polygons in self._decals:
                if on == "deck":
                    for points, rgb in polygons:
                        draw(canvas, self._lens, np.c_[points, np.zeros(len(points))] @ R_cam_pad.T + t_cam_pad, rgb)
        if normal_distance > 1e-3 and plane is not None and (deck is not None or self._pad is not None):
            gain = self._cast_shadow(gain, shot, R_cam_pad, t_cam_pad, mask)
            if self.light.glare > 0:
                added = self._add_glare(added, R_cam_pad, t_cam_pad, plane)
        assert canvas is not None
        return canvas, gain, added

    def _water(self, shot: Exposure, mask: U8 | None) -> U8:
        """Return the sea and what floats on it, (H, W, 3) BGR, where the deck does not cover all; elsewhere it is black."""
        h, w = self.camera.height, self.camera.width
        R_ned_cam = shot.R_ned_body.matrix @ self.camera.T_body_cam.R.matrix
        p_cam_ned = shot.p_body_ned + shot.R_ned_body.matrix @ self.camera.T_body_cam.t
        canvas = np.zeros((h, w, 3), np.uint8)
        rows, cols = slice(0, h), slice(0, w)
        if mask is not None:
            x, y, bw, bh = cv2.boundingRect(cv2.inRange(mask, 0, 254))
            rows, cols = slice(y // 2 * 2, min(h, -(-(y + bh) // 2) * 2)), slice(x // 2 * 2, min(w, -(-(x + bw) // 2) * 2))
        ship = self._ship_on_water(shot) if self._deck is not None else []
        canvas[rows, cols] = self._sea.paint(R_ned_cam, p_cam_ned, shot.t_s, rows, cols, ship)
        for on, polygons in self._decals:
            if on == "sea":
                for points, rgb in polygons:
                    draw(canvas, self._lens, (np.c_[points, np.zeros(len(points))] - p_cam_ned) @ R_ned_cam, rgb)
        if ship:
            self._hull_side(canvas, shot, R_ned_cam, p_cam_ned, ship[0])
        return canvas

    def _ship_on_water(self, shot: Exposure) -> list[F64]:
        """Return the outlines on calm water, (N, 3) m ned: the hull at the waterline, the shadow that it casts, and its wake."""
        deck, painter = self.surroundings.deck, self._deck
        if deck is None or painter is None:
            return []
        rim = painter.rim_pad() @ shot.R_ned_pad.matrix.T + shot.p_pad_ned
        line = rim.copy()
        line[:, 2] = 0.0
        reach = np.minimum(rim[:, 2:], 0.0) / self._to_sun[2]
        cast = rim - self._to_sun * reach
        cast[:, 2] = 0.0
        hull = cv2.convexHull(np.concatenate([line, cast])[:, :2].astype(np.float32))[:, 0].astype(float)
        out = [line, np.c_[hull, np.zeros(len(hull))]]
        speed = self.surroundings.wake_speed_m_s
        if speed > 0.2:
            yaw = deck.pad_yaw_rad
            ahead = shot.R_ned_pad.matrix @ np.array([math.cos(yaw), -math.sin(yaw), 0.0])
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

    def _hull_side(self, canvas: U8, shot: Exposure, R_ned_cam: F64, p_cam_ned: F64, line: F64) -> None:
        if self._deck is None:
            return
        rim = self._deck.rim_pad() @ shot.R_ned_pad.matrix.T + shot.p_pad_ned
        below = np.roll(line, -1, axis=0)
        along, down = np.roll(rim, -1, axis=0) - rim, line - rim
        outward = along[:, [1, 2, 0]] * down[:, [2, 0, 1]] - along[:, [2, 0, 1]] * down[:, [1, 2, 0]]
        for i in np.nonzero(((rim - p_cam_ned) * outward).sum(axis=1) < 0)[0]:
            quad = np.array([rim[i], rim[(i + 1) % len(rim)], below[i], line[i]])
            draw(canvas, self._lens, (quad - p_cam_ned) @ R_ned_cam, (46, 58, 74))

    def _cast_shadow(self, gain: I16, shot: Exposure, R_cam_pad: F64, t_cam_pad: F64, mask: U8 | None) -> I16:
        if self.light.drone_shadow == 0:
            return gain
        R_pad_ned = shot.R_ned_pad.matrix.T
        p_body_pad = R_pad_ned @ (shot.p_body_ned - shot.p_pad_ned)
        cast = drone_shadow(
            self._lens, R_cam_pad, t_cam_pad, R_pad_ned @ shot.R_ned_body.matrix, p_body_pad, R_pad_ned @ self._to_sun
        )
        if cast is None:
            return gain
        depth, rows, cols = cast
        if mask is not None:
            depth = np.asarray(cv2.multiply(depth, mask[rows, cols], scale=1.0 / 255.0), dtype=np.uint8)
        left = GAIN_ONE * (1.0 - self.light.drone_shadow * np.arange(256) / 255.0)
        if gain is self._vignette:
            gain = gain.copy()
        part = gain[rows, cols]
        cv2.multiply(part, cv2.LUT(depth, np.round(left).astype(np.int16)), dst=part, scale=1.0 / GAIN_ONE)
        return gain

    def _add_glare(self, added: F32 | None, R_cam_pad: F64, t_cam_pad: F64, plane: F64) -> F32:
        h, w = self.camera.height, self.camera.width
        out = np.zeros((h, w), np.float32) if added is None else added
        light = self.light
        reach = 2.6 * light.glare_radius_m
        a = np.linspace(0.0, math.tau, 24, endpoint=False)
        around = np.stack([reach * np.cos(a), reach * np.sin(a), 0.0 * a], axis=1) + np.array([*light.glare_centre_m, 0.0])
        uv = self._lens.outline(around @ R_cam_pad.T + t_cam_pad)
        if not len(uv):
            return out
        x0, y0 = np.clip(np.floor(uv.min(axis=0)), 0, (w - 1, h - 1)).astype(int)
        x1, y1 = np.clip(np.ceil(uv.max(axis=0)) + 1, 1, (w, h)).astype(int)
        if x1 - x0 < 1 or y1 - y0 < 1:
            return out
        places = self._lens.meet(plane, (slice(y0, y1), slice(x0, x1))) - np.array(light.glare_centre_m, np.float32)
        r2 = places[..., 0] ** 2 + places[..., 1] ** 2
        # Flat in the middle and soft at the rim, as the image of the sun on varnished paint is: half of it at the radius.
        spot = np.exp(np.float32(-math.log(2.0)) * (r2 * np.float32(1.0 / light.glare_radius_m**2)) ** 2)
        out[y0:y1, x0:x1] += np.float32(light.glare) * spot
        return out


def _pose(shot: Exposure, camera: Camera, later_s: float) -> tuple[F64, F64]:
    """Return the rotation (3, 3) and position (3,) m of the pad in `cam`, `later_s` after the middle of the exposure."""
    R_ned_body, R_ned_pad = shot.R_ned_body.matrix, shot.R_ned_pad.matrix
    p_body, p_pad = shot.p_body_ned, shot.p_pad_ned
    if later_s != 0.0:
        R_ned_body = R_ned_body @ cv2.Rodrigues(shot.w_body * later_s)[0]
        R_ned_pad = R_ned_pad @ cv2.Rodrigues(shot.w_pad * later_s)[0]
        p_body = p_body + shot.v_body_ned * later_s
        p_pad = p_pad + shot.v_pad_ned * later_s
    R_ned_cam = R_ned_body @ camera.T_body_cam.R.matrix
    p_cam = p_body + R_ned_body @ camera.T_body_cam.t
    return R_ned_cam.T @ R_ned_pad, R_ned_cam.T @ (p_pad - p_cam)


def _paint_codes(pad: Pad) -> NDArray[np.intp]:
    """Return the colours (5, 3) BGR of background (unused), rim, disc, orange, white."""
    c = pad.colours
    rim = c.rim if c.rim is not None else c.disc
    return np.array([(0, 0, 0), rim[::-1], c.disc[::-1], c.ring[::-1], c.h[::-1]], dtype=np.intp)


def _vignette(lens: Lens, loss: float) -> I16:
    """Return the (H, W) vignetting: the fourth power of the cosine of the angle off the axis, scaled to the corners' loss."""
    r2 = (lens.rays**2).sum(axis=-1)
    fall = 1.0 - (1.0 + r2) ** -2
    return np.asarray(np.round(GAIN_ONE * (1.0 - loss * fall / fall.max())), dtype=np.int16)


def _smear(canvas: U8, lens: Lens, middle: tuple[F64, F64], ends: list[tuple[F64, F64]]) -> U8:
    """Return the scenery blurred along its motion in the middle of the frame, if that is a pixel or more."""
    camera = lens.camera
    R, t = middle
    axis = np.array([0.0, 0.0, 1.0])
    depth = float(R[:, 2] @ t) / max(0.05, float(R[:, 2] @ axis))
    if not 0 < depth < 1e4:
        return canvas
    on_pad = R.T @ (axis * depth - t)
    uv = camera.project(np.stack([r @ on_pad + p for r, p in ends]))
    way = uv[1] - uv[0]
    length = float(np.hypot(*way))
    if not length >= 1.0:
        return canvas
    way = way * min(1.0, 31.0 / length)
    half = math.floor(min(length, 31.0) / 2) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    for s in (np.arange(64) + 0.5) / 64 - 0.5:
        x, y = half + way[0] * s, half + way[1] * s
        i, j = math.floor(x), math.floor(y)
        fx, fy = x - i, y - j
        for dj, di, share in ((0, 0, (1 - fx) * (1 - fy)), (0, 1, fx * (1 - fy)), (1, 0, (1 - fx) * fy), (1, 1, fx * fy)):
            kernel[j + dj, i + di] += share / 64
    return np.asarray(cv2.filter2D(canvas, -1, kernel, borderType=cv2.BORDER_REPLICATE), dtype=np.uint8)
