"""The simulated camera: a pad on a deck on a sea, through a lens, onto a sensor.

The same exposure and random state give the same bits. The geometry of the pad is exact (pinhole and distortion per pixel,
coverage integrated over pixel and exposure); sea, deck and decals are scenery.

A drop on the front glass is far out of focus: it shows as a soft disc with a small, blurred, upside-down picture of what lies
around it. It falls at a random place, stays, then runs off towards the tail with the airflow.
"""

import math
from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.pad import Pad
from sitl.camera.light import FULL_SCALE, I16, U16, Development, Light, PadBlur, PadInImage, Sensor, counts, scene_of
from sitl.camera.projection import F32, SHIFT, fixed_point, lens_of
from sitl.camera.render.deck import DeckPainter, Part, bounds, draw, drone_shadow, hull_side, on_water
from sitl.camera.render.pad import PadPainter, Pose, Stroke, moved, moved_scene, row_map, smear, vignette
from sitl.camera.render.sea import Lamps, SeaPainter, glint, mast_shadow, through_haze
from sitl.camera.settings import CLEAR_M, DropSettings, LampSettings
from sitl.camera.surroundings import Surroundings
from sitl.core.abi import DL_GAIN_ONE, DL_PAD_EDGE, DL_PAD_NONE

_SHOWN_WIDTHS = 4.0
"""Width of the scene that a drop shows, in its own radii."""
_SPRAY_DROPS = 12
"""Drops of a gust of spray."""
_RADIUS_PX = 28.0  # radius of a drop's blurred disc (assumed)
_STAYS_S = 6.0  # time until a drop has run off, on average (assumed)
_CELL_S = 1.5 * _STAYS_S
"""Span of time whose drops are drawn together."""
_RUNS_OFF = 0.7
"""Part of its life after which a drop runs off."""
_GLARE_RADIUS_M = 0.225
"""Radius at which the spot of glare has fallen to a half: it covers a third of the thesis' disc."""
_MAST_SHADOW = 0.6
"""Share of light missing in the mast's shadow."""


class Drop(Struct, frozen=True):
    """A drop at one instant, px."""

    x: float
    y: float
    radius: float


class Drops(Struct, frozen=True):
    """The water that falls on a lens: the same at an instant whatever was computed before."""

    settings: DropSettings
    seed: int = 0

    def present(self, t_s: float, width: int, height: int) -> list[Drop]:
        """Return the drops on the lens at an instant of the flight, the oldest first."""
        newest = math.floor(t_s / _CELL_S)
        return [drop for cell in (newest - 1, newest) for drop in self._of_cell(cell, t_s, width, height)]

    def _of_cell(self, cell: int, t_s: float, width: int, height: int) -> list[Drop]:
        """Return the drops that fell in one span of time and are still there."""
        rng = np.random.default_rng([self.seed, 0xD409, cell + 1000])
        rain_per_s, spray_per_s = self.settings.rain_per_minute / 60.0, self.settings.spray_per_minute / 60.0
        single = rng.uniform(0.0, _CELL_S, rng.poisson(rain_per_s * _CELL_S))
        gusts = rng.uniform(0.0, _CELL_S, rng.poisson(spray_per_s * _CELL_S))
        fell_s = cell * _CELL_S + np.concatenate([single, np.repeat(gusts, _SPRAY_DROPS)])
        n = len(fell_s)
        x, y = rng.uniform(-0.05, 1.05, n) * width, rng.uniform(-0.05, 1.05, n) * height
        radius = _RADIUS_PX * np.exp(rng.normal(-0.08, 0.4, n))
        life_s, aside = _STAYS_S * rng.uniform(0.5, 1.5, n), rng.normal(0.0, 0.25, n)
        age = (t_s - fell_s) / life_s
        out = []
        for i in np.nonzero((age >= 0.0) & (age < 1.0))[0]:
            gone = max(0.0, float(age[i]) - _RUNS_OFF) / (1.0 - _RUNS_OFF)
            way = (height + 2.0 * radius[i]) * gone**2
            size = float(radius[i] * (1.0 - 0.35 * gone))
            out.append(Drop(float(x[i] + way * aside[i]), float(y[i] + way), size))
        return out


def wet_lens(light: I16, drops: list[Drop]) -> None:
    """Change linear light (H, W, 3) to what arrives through drops."""
    h, w = light.shape[:2]
    for drop in drops:
        reach = 1.3 * drop.radius
        x0, x1 = max(0, math.floor(drop.x - reach)), min(w, math.ceil(drop.x + reach) + 1)
        y0, y1 = max(0, math.floor(drop.y - reach)), min(h, math.ceil(drop.y + reach) + 1)
        if x1 - x0 < 3 or y1 - y0 < 3:
            continue
        half = 0.5 * _SHOWN_WIDTHS * drop.radius
        cx, cy = min(max(drop.x, 0.0), w - 1.0), min(max(drop.y, 0.0), h - 1.0)
        seen = light[max(0, int(cy - half)) : int(cy + half) + 2, max(0, int(cx - half)) : int(cx + half) + 2]
        coarse = cv2.flip(cv2.resize(seen, (12, 12), interpolation=cv2.INTER_AREA), -1)
        inside = cv2.resize(cv2.GaussianBlur(coarse, (5, 5), 1.1), (x1 - x0, y1 - y0), interpolation=cv2.INTER_CUBIC)
        across = (np.arange(x0, x1, dtype=np.float32) - np.float32(drop.x)) / np.float32(drop.radius)
        down = (np.arange(y0, y1, dtype=np.float32) - np.float32(drop.y)) / np.float32(drop.radius)
        distance = np.sqrt(across[None] ** 2 + down[:, None] ** 2)
        cover = np.clip((np.float32(1.25) - distance) / np.float32(0.55), 0.0, 1.0)
        cover = (cover * cover * (3.0 - 2.0 * cover))[..., None] * np.float32(0.92)
        # The upper rim of a drop mirrors the sky below the drone's hull, the lower one is in its own shadow.
        shade = (1.0 - 0.18 * np.clip(down, -1.0, 1.0))[:, None, None].astype(np.float32)
        part = light[y0:y1, x0:x1]
        part[:] = np.clip(part * (1.0 - cover) + np.maximum(inside, 0) * shade * cover, 0.0, 32767.0)


U8 = NDArray[np.uint8]


def _zeros() -> F64:
    return np.zeros(3)


class Exposure(Struct, frozen=True, eq=False):
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


class _View(Struct, frozen=True, eq=False):
    """View of a camera during an exposure."""

    pose: Pose
    """Pose of the pad, in the middle of the exposure."""
    scene: U16
    """(H, W, 4) everything except the pad."""
    gain: I16
    """(H, W) factors on its light."""
    added: F32 | None
    """(H, W) light beside it."""
    rows: F32 | None
    """(H, W, 2) where the rows of a rolling shutter look, px."""
    pad: PadInImage | None


class Renderer:
    """Renders frames of one scene through one camera.

    Args:
        pad: the pad, or None for a scene without one; the deck then lies where the pad would be.
        drops: water on the lens; None for a dry one.
    """

    def __init__(
        self,
        camera: Camera,
        pad: Pad | None,
        surroundings: Surroundings | None = None,
        light: Light | None = None,
        sensor: Sensor | None = None,
        lamps: LampSettings | None = None,
        drops: Drops | None = None,
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
        self.lamps, self.drops = Lamps(lamps or LampSettings(), pad.lamps if pad is not None else ()), drops
        self._development = self.development(self.light, self.sensor)
        self._vignette = vignette(self._lens, self.light.vignetting)
        self._even = np.full_like(self._vignette, DL_GAIN_ONE)
        self._darkened, self._dark_part = self._vignette.copy(), (slice(0), slice(0))
        # The largest arrays of a frame: requesting their memory each time costs as much as filling it.
        self._scene = np.empty((camera.height, camera.width, 4), np.uint16)
        self._room = np.empty((camera.height, camera.width, 3), np.int16)
        self._pad_scene = _pad_scene(pad) if pad is not None else None
        self._decals = [
            (decal.on, [(points, scene_of(rgb[::-1])) for points, rgb in decal.polygons()]) for decal in self.surroundings.decals
        ]
        self._to_sun = self.light.to_sun_ned

    def development(self, light: Light, sensor: Sensor) -> Development:
        """Return the sensor model with another exposure, amplification or white balance than this renderer's own."""
        return Development(light, sensor, self.lamps.most_bgr(light) if self.lamps.floods else None)

    def render(self, shot: Exposure, rng: np.random.Generator, development: Development | None = None) -> U8:
        """Return the sensor's image, (H, W, 3) BGR. One number is drawn from `rng`, for the noise."""
        development = development or self._development
        view = self._view(shot, development)
        if self.lamps.floods or self.lamps.has_small or self.drops is not None or view.added is not None:
            light, blur = self._light_on_sensor(shot, development, view)
            return development.sensor_image(light, rng, blur)
        return development.image(view.scene, view.gain, view.pad, self._pad_scene, rng)

    def order(self, shot: Exposure, rng: np.random.Generator) -> Callable[[], U8]:
        """Return the function that renders a frame; it may be called again."""
        return cache(lambda: self.render(shot, rng))

    def radiance(self, shot: Exposure) -> F32:
        """Return the linear light on the sensor before noise and tone curve, (H, W, 3) BGR; 1 is full scale, clipped at 4."""
        development = self._development
        light, blur = self._light_on_sensor(shot, development, self._view(shot, development))
        return development.blur(light, blur) * np.float32(1.0 / FULL_SCALE)

    def _view(self, shot: Exposure, development: Development) -> _View:
        """Return what the camera sees during an exposure, before the light is counted."""
        poses = [pose_at(shot, self.camera)]
        exposure_s = development.sensor.exposure_s
        ends = [pose_at(shot, self.camera, s * exposure_s) for s in (-0.5, 0.5)] if exposure_s > 0 else []

        scene, gain, added = self._scenery(shot, *poses[0])
        if ends:
            scene = smear(scene, self._lens, poses[0], ends)
        half = development.sensor.readout_s / 2
        rows = None
        if half > 0:
            cells = row_map(self._lens, pose_at(shot, self.camera, -half), poses[0], pose_at(shot, self.camera, half))
            if cells is not None:
                rows, scene = self._lens.spread(cells), moved_scene(scene, cells)
                gain = np.asarray(moved(gain, rows), np.int16)
                added = None if added is None else np.asarray(moved(added, rows), np.float32)
        return _View(poses[0], scene, gain, added, rows, self._place(shot, poses[0], ends, development.sensor))

    def _light_on_sensor(self, shot: Exposure, development: Development, view: _View) -> tuple[I16, PadBlur | None]:
        """Return the light before the blur of the lens, (H, W, 3) in counts, and what that blur makes of the pad's edges."""
        gain, added, rows = view.gain, view.added, view.rows
        # Floodlights differ in colour from the sky: their light and the sky's are added up for each channel.
        even = self._even if self.lamps.floods else gain
        light = development.expose(view.scene, even, view.pad, self._pad_scene, self._room)
        # Drops refract the blurred image, and blur more than the lens does.
        blur = development.pad_blur(view.scene, even, view.pad, self._pad_scene) if self.drops is None else None
        if self.lamps.floods:
            gains = self._gains(gain, development, *view.pose)
            cv2.multiply(light, gains, dst=light, scale=1.0 / DL_GAIN_ONE)
            blur = blur.under(gains) if blur is not None else None
        if added is not None:
            cv2.add(light, counts(cv2.merge([added * g for g in development.gains_bgr])), dst=light)
        if self.lamps.has_small:
            own = np.zeros(gain.shape, np.float32)
            self.lamps.shine(own, self._lens, *view.pose)
            own = own if rows is None else np.asarray(moved(own, rows), np.float32)
            level = np.float32(2.0**-self.light.daylight_ev)
            cv2.add(light, counts(cv2.merge([own * g * level for g in development.gains_bgr])), dst=light)
        if self.drops is not None:
            wet_lens(light, self.drops.present(shot.t_s, self.camera.width, self.camera.height))
        return light, blur

    def _gains(self, gain: I16, development: Development, R_cam_pad: F64, t_cam_pad: F64) -> I16:
        """Return the factors (H, W, 3) on the light of sky and floodlights from those under the sky alone (H, W)."""
        plane = self._lens.plane_at(R_cam_pad, t_cam_pad)
        if plane is not None and float(R_cam_pad[:, 2] @ t_cam_pad) > 1e-3:
            # Only the sun casts shadows: the light of the lamps is added undimmed.
            lamp = self.lamps.on_plane(self._lens, plane) * (self._vignette * np.float32(1.0))
            each = [
                np.clip((gain + lamp * ratio) / lifted, 0.0, 32767.0).astype(np.int16)
                for ratio, lifted in zip(self.lamps.ratios_bgr(self.light), development.lifted_bgr, strict=True)
            ]
            return np.asarray(cv2.merge(each), dtype=np.int16)
        each = [(gain / lifted).astype(np.int16) for lifted in development.lifted_bgr]
        return np.asarray(cv2.merge(each), dtype=np.int16)

    def _place(self, shot: Exposure, middle: Pose, ends: list[Pose], sensor: Sensor) -> PadInImage | None:
        """Return the pad in the frame; the exposure is divided into parts so short that the pad's way is straight in each."""
        if self._pad is None:
            return None
        half = sensor.readout_s / 2

        def rows(at_s: float) -> tuple[Pose, Pose] | None:
            return (pose_at(shot, self.camera, at_s - half), pose_at(shot, self.camera, at_s + half)) if half > 0 else None

        way = self._pad.travel_px(*ends) if ends else np.zeros(2)
        travel = float(way.max())
        if not travel > 0.3:
            return self._uncovered(self._pad.place([Stroke.still(middle, rows(0.0))]), middle)
        n = 1 if travel < 6.0 else 3 if travel < 20.0 else 5
        if n == 1:
            return self._uncovered(self._pad.place([Stroke(ends[0], middle, ends[1], rows(0.0))]), middle)
        times = (np.arange(2 * n + 1) / (2 * n) - 0.5) * sensor.exposure_s
        poses = [pose_at(shot, self.camera, float(s)) for s in times]
        strokes = [Stroke(poses[2 * i], poses[2 * i + 1], poses[2 * i + 2], rows(float(times[2 * i + 1]))) for i in range(n)]
        return self._uncovered(self._pad.place(strokes), middle)

    def _uncovered(self, pad: PadInImage | None, pose: Pose) -> PadInImage | None:
        """Return the pad without the pixels that something on it covers in the middle of the exposure."""
        things = [points for on, polygons in self._decals if on == "pad" for points, _ in polygons]
        if pad is None or not things:
            return pad
        R, t = pose
        over = np.zeros(pad.kinds.shape, np.uint8)
        for points in things:
            uv = self._lens.outline(np.c_[points, np.zeros(len(points))] @ R.T + t, 6)
            if len(uv) > 2:
                cv2.fillPoly(over, [fixed_point(uv)], 1, cv2.LINE_8, SHIFT)
        kinds, hidden = pad.kinds, over.ravel()[pad.edges] > 0
        kinds[(over > 0) & (kinds != DL_PAD_EDGE)] = DL_PAD_NONE
        for shares in (pad.shares, pad.parts):
            if shares is not None:
                shares[hidden] = 0.0
                shares[hidden, DL_PAD_NONE] = 1.0
        return pad

    def _scenery(self, shot: Exposure, R_cam_pad: F64, t_cam_pad: F64) -> tuple[U16, I16, F32 | None]:
        """Return the scene (H, W, 4) of everything except the pad, the factors on its light, and the added light."""
        h, w = self.camera.height, self.camera.width
        gain = self._vignette
        added: F32 | None = None
        normal_distance = float(R_cam_pad[:, 2].dot(t_cam_pad))
        plane = self._lens.plane_at(R_cam_pad, t_cam_pad)
        deck = self._deck if normal_distance > 1e-3 and plane is not None else None
        mask = None
        part = around = slice(0, h), slice(0, w)
        if deck is not None and plane is not None and not deck.fills(plane):
            mask = deck.mask(R_cam_pad, t_cam_pad)
            part, around = bounds(mask)
            mask = mask if around[0].stop else None
        scene = self._scene
        if deck is None or mask is not None:
            self._paint_water(scene, shot, mask, around)
        if deck is not None and plane is not None and part[0].stop:
            footprint = normal_distance / self.camera.fx
            deck.paint(scene, part, plane, footprint, mask)
            wet = deck.wet(part, plane, footprint)
            if wet is not None:
                covered = np.float32(1.0) if mask is None else mask[part].astype(np.float32) * np.float32(1.0 / 255.0)
                gain = gain.copy()
                gain[part] = np.round(gain[part] * ((wet[0] - np.float32(1.0)) * covered + np.float32(1.0)))
                added = np.zeros((h, w), np.float32)
                added[part] = wet[1] * covered
        if normal_distance > 1e-3:
            for on, polygons in self._decals:
                if on != "sea" and (deck is not None or on == "pad"):
                    for points, colour in polygons:
                        draw(scene, self._lens, np.c_[points, np.zeros(len(points))] @ R_cam_pad.T + t_cam_pad, colour)
        if normal_distance > 1e-3 and plane is not None and (deck is not None or self._pad is not None):
            gain = self._cast_shadow(gain, shot, R_cam_pad, t_cam_pad, plane, mask)
            if self.light.glare > 0:
                added = self._add_glare(added, R_cam_pad, t_cam_pad, plane)
        if self.light.glint > 0:
            added = self._add_glint(added, shot, R_cam_pad, plane if deck is not None else None, mask)
        if self.light.visibility_m < CLEAR_M:
            gain, added = self._haze(gain, added, shot, R_cam_pad, normal_distance if deck is not None else None)
        return scene, gain, added

    def _paint_water(self, scene: U16, shot: Exposure, mask: U8 | None, part: Part) -> None:
        """Paint the sea and what floats on it in a part of the frame; elsewhere the scene stays as it is."""
        h, w = self.camera.height, self.camera.width
        R_ned_cam = shot.R_ned_body.matrix.dot(self.camera.T_body_cam.R.matrix)
        p_cam_ned = shot.p_body_ned + shot.R_ned_body.matrix.dot(self.camera.T_body_cam.t)
        rows, cols = (slice(side.start // 2 * 2, min(n, -(-side.stop // 2) * 2)) for side, n in zip(part, (h, w), strict=True))
        ship, rim = [], np.empty((0, 3))
        if self._deck is not None and self.surroundings.deck is not None:
            R_ned_pad = shot.R_ned_pad.matrix
            rim = self._deck.rim_pad.dot(R_ned_pad.T) + shot.p_pad_ned
            ship = on_water(self.surroundings.deck, rim, R_ned_pad, self._to_sun, self.surroundings.wake_speed_m_s)
        self._sea.paint(scene, R_ned_cam, p_cam_ned, shot.t_s, (rows, cols), ship, mask)
        for on, polygons in self._decals:
            if on == "sea":
                for points, colour in polygons:
                    draw(scene, self._lens, (np.c_[points, np.zeros(len(points))] - p_cam_ned) @ R_ned_cam, colour)
        if ship:
            hull_side(scene, self._lens, rim, R_ned_cam, p_cam_ned)

    def _cast_shadow(self, gain: I16, shot: Exposure, R_cam_pad: F64, t_cam_pad: F64, plane: F64, mask: U8 | None) -> I16:
        R_pad_ned = shot.R_ned_pad.matrix.T
        if (mast := self.light.mast) is not None:
            fallen = mast_shadow(self._lens, mast, R_cam_pad, t_cam_pad, R_pad_ned @ self._to_sun)
            gain = gain if fallen is None else self._shaded(gain, fallen, mask)
        if self.light.drone_shadow == 0:
            return gain
        if gain is self._vignette:
            # The vignetting in room of our own, where the last frame's shadow is taken off.
            self._darkened[self._dark_part] = self._vignette[self._dark_part]
            self._dark_part = slice(0), slice(0)
            gain = self._darkened
        p_body_pad = R_pad_ned.dot(shot.p_body_ned - shot.p_pad_ned)
        body, pose = (R_pad_ned.dot(shot.R_ned_body.matrix), p_body_pad), (R_cam_pad, t_cam_pad)
        to_sun_pad, share = R_pad_ned.dot(self._to_sun), self.light.drone_shadow
        part = drone_shadow(gain, self._lens, plane, pose, body, to_sun_pad, share, mask)
        if gain is self._darkened and part is not None:
            self._dark_part = part
        return gain

    def _shaded(self, gain: I16, cast: tuple[U8, slice, slice], mask: U8 | None) -> I16:
        """Return the factors on the light with the mast's shadow, where the deck is."""
        depth, rows, cols = cast
        if mask is not None:
            depth = np.asarray(cv2.multiply(depth, mask[rows, cols], scale=1.0 / 255.0), dtype=np.uint8)
        left = np.asarray(np.round(DL_GAIN_ONE * (1.0 - _MAST_SHADOW * np.arange(256) / 255.0)), dtype=np.int16)
        if gain is self._vignette:
            gain = gain.copy()
        part = gain[rows, cols]
        cv2.multiply(part, cv2.LUT(depth, left), dst=part, scale=1.0 / DL_GAIN_ONE)
        return gain

    def _add_glint(self, added: F32 | None, shot: Exposure, R_cam_pad: F64, deck_plane: F64 | None, mask: U8 | None) -> F32:
        """Add the mirrored sun: on the sea, and on the deck as far as it is wet."""
        h, w = self.camera.height, self.camera.width
        out = np.zeros((h, w), np.float32) if added is None else added
        whole = slice(0, h), slice(0, w)
        R_ned_cam = shot.R_ned_body.matrix @ self.camera.T_body_cam.R.matrix
        p_cam_ned = shot.p_body_ned + shot.R_ned_body.matrix @ self.camera.T_body_cam.t
        on_deck = deck_plane is not None
        cover = (
            np.float32(0.0) if not on_deck else np.float32(1.0) if mask is None else mask.astype(np.float32) / np.float32(255.0)
        )
        sea = self._lens.plane_from_ray(np.stack([R_ned_cam[0], R_ned_cam[1], -(R_ned_cam.T @ p_cam_ned)], axis=1))
        if sea is not None and p_cam_ned[2] < 0 and not (on_deck and mask is None):
            places, px_m = self._lens.meet_halves(sea, whole), -float(p_cam_ned[2]) / self.camera.fx
            spots = glint(self._lens, R_ned_cam, self._to_sun, places, px_m, sea=True, t_s=shot.t_s)
            out += np.float32(self.light.glint) * (np.float32(1.0) - cover) * spots
        if deck_plane is not None and self.light.wetness > 0:
            places, px_m = (
                self._lens.meet_halves(deck_plane, whole),
                abs(float(p_cam_ned[2] - shot.p_pad_ned[2])) / self.camera.fx,
            )
            to_sun_pad = shot.R_ned_pad.matrix.T @ self._to_sun
            spots = glint(self._lens, R_cam_pad.T, to_sun_pad, places, px_m, sea=False, t_s=0.0)
            out += np.float32(self.light.glint * self.light.wetness) * cover * spots
        return out

    def _haze(self, gain: I16, added: F32 | None, shot: Exposure, R_cam_pad: F64, deck_m: float | None) -> tuple[I16, F32]:
        """Return the factors on the light and the added light through haze; `deck_m` is the distance from a deck in sight."""
        R_ned_cam = shot.R_ned_body.matrix @ self.camera.T_body_cam.R.matrix
        height = -float((shot.p_body_ned + shot.R_ned_body.matrix @ self.camera.T_body_cam.t)[2])
        normal, away = (R_ned_cam[2], height) if deck_m is None else (R_cam_pad[:, 2], deck_m)
        share, air = through_haze(self._lens, normal, max(0.0, away), self.light.visibility_m)
        left = np.asarray(np.round(gain * share), dtype=np.int16)
        return left, air if added is None else added * share + air

    def _add_glare(self, added: F32 | None, R_cam_pad: F64, t_cam_pad: F64, plane: F64) -> F32:
        h, w = self.camera.height, self.camera.width
        out = np.zeros((h, w), np.float32) if added is None else added
        light = self.light
        reach = 2.6 * _GLARE_RADIUS_M
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
        spot = np.exp(np.float32(-math.log(2.0)) * (r2 * np.float32(1.0 / _GLARE_RADIUS_M**2)) ** 2)
        out[y0:y1, x0:x1] += np.float32(light.glare) * spot
        return out


def pose_at(shot: Exposure, camera: Camera, later_s: float = 0.0) -> tuple[F64, F64]:
    """Return the rotation (3, 3) and position (3,) m of the pad in `cam`, `later_s` after the middle of the exposure."""
    R_ned_body, R_ned_pad = shot.R_ned_body.matrix, shot.R_ned_pad.matrix
    away = shot.p_pad_ned - shot.p_body_ned
    if later_s != 0.0:
        R_ned_body = R_ned_body.dot(cv2.Rodrigues(shot.w_body * later_s)[0])
        R_ned_pad = R_ned_pad.dot(cv2.Rodrigues(shot.w_pad * later_s)[0])
        away = away + (shot.v_pad_ned - shot.v_body_ned) * later_s
    R_cam_ned = R_ned_body.dot(camera.T_body_cam.R.matrix).T
    return R_cam_ned.dot(R_ned_pad), R_cam_ned.dot(away - R_ned_body.dot(camera.T_body_cam.t))


def _pad_scene(pad: Pad) -> U16:
    """Return the paints (6, 4) of the background (unused), rim, disc, orange, white, upper lettering, as pixels of a scene."""
    c = pad.markings.colours
    rim, upper = c.rim if c.rim is not None else c.disc, c.upper if c.upper is not None else c.h
    return scene_of(np.array([(0, 0, 0), rim[::-1], c.disc[::-1], c.ring[::-1], c.h[::-1], upper[::-1]]))
