"""The effect of picture faults on a finished frame, and the bodies that stand, walk or fly about the pad, as polygons."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.settings.load import find_file, read_toml
from estimator.contracts.geometry import F64
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.geometry import outlines_of
from estimator.vision.pad.pad import Pad
from estimator.vision.srgb import linear_light
from sitl.camera.camera import Exposure, pose_at
from sitl.camera.light import Light, srgb_values
from sitl.camera.projection import SHIFT as BITS
from sitl.camera.projection import Lens, fixed_point, lens_of
from sitl.camera.surroundings import RGB, Decal
from sitl.faults.kinds import Bystander, FocalLength, Glint, LightFalls, ObjectOnPad, OtherPad, PadCovered, PictureFault, WetLens

U8 = NDArray[np.uint8]
Polygon = tuple[F64, RGB]
"""Points (N, 2) m in the pad's plane or (N, 3) in `pad`, and the paint, sRGB."""
_TARPAULIN: RGB = (92, 96, 98)
_DECK: RGB = (104, 110, 112)
_NOISE = 2.0
"""Standard deviation of the noise on drawn parts, grey levels."""
_SLICE_M = 0.04
"""Height of a person's slices."""


class PictureEffects:
    """Draws faults into the frames of one camera over one pad.

    Args:
        light: the light on the scene, which colours what is drawn.
        seed: of the drops on the lens.
    """

    def __init__(self, camera: Camera, pad: Pad, light: Light, seed: int) -> None:
        self._camera, self._pad, self._seed = camera, pad, seed
        self._lens: Lens = lens_of(camera)
        self._gains = light.gains_bgr().astype(float)

    def drawn(self, px: U8, faults: Sequence[PictureFault], shot: Exposure, rng: np.random.Generator) -> U8:
        """Return the frame (H, W, 3) with the faults, of the scene in the middle of its exposure."""
        out = px.copy()
        R, t = pose_at(shot, self._camera)
        polygons = [polygon for fault in faults for polygon in self._polygons(fault, shot.t_s, -R.T @ t)]
        if polygons and R[:, 2] @ t > 0.01:
            self._draw(out, polygons, R, t, rng)
        for fault in faults:
            match fault:
                case Glint():
                    out = self._glint(out, fault, R, t)
                case ObjectOnPad() if fault.thing == "wet patch":
                    out = self._wetted(out, fault, R, t)
                case LightFalls():
                    # Less light, and the noise that the sensor then has: 8000 electrons of full scale, 12 of read noise.
                    light = fault.fraction * linear_light(out)
                    sigma = np.sqrt(light / 8000.0 + (12.0 / 8000.0) ** 2)
                    out = srgb_values(light + sigma * rng.standard_normal(light.shape))
        for fault in faults:
            match fault:
                case FocalLength():
                    out = self._zoomed(out, fault.scale)
                case WetLens():
                    out = _behind_drops(out, fault, self._seed)
        return out

    def _polygons(self, fault: PictureFault, t_s: float, camera_m: F64) -> list[Polygon]:
        match fault:
            case Bystander():
                return _standing(fault, t_s, camera_m)
            case PadCovered():
                reach = 1.15 * self._pad.disc_radius_m
                from_m = (1.0 - 2.0 * fault.fraction) * self._pad.disc_radius_m
                sheet = np.array([(from_m, -reach), (reach, -reach), (reach, reach), (from_m, reach)])
                return [(_moved(sheet, fault.from_deg, 0.0, 0.0), _TARPAULIN)]
            case ObjectOnPad():
                return _thing(fault)
            case OtherPad():
                path = find_file(fault.file, "pads", Path(), "other_pad.file")
                there = Pad.from_mapping(read_toml(path), str(path))
                hidden = [(self._pad.circle(1.1 * self._pad.disc_radius_m)[:, :2], _DECK)] if fault.instead else []
                own = [
                    (_moved(fault.size * points, fault.turned_deg, fault.forward_m, fault.right_m), there.rgb(region))
                    for region in there.regions
                    for points in outlines_of(region)
                ]
                return [*hidden, *own]
        return []

    def _draw(self, out: U8, polygons: list[Polygon], R: F64, t: F64, rng: np.random.Generator) -> None:
        touched = np.zeros(out.shape[:2], np.uint8)
        for points, rgb in polygons:
            uv = self._lens.outline(points @ R[:, : points.shape[1]].T + t, 6)
            if len(uv) < 3:
                continue
            paint = srgb_values(linear_light(np.array(rgb[::-1])) * self._gains)
            cv2.fillPoly(out, [fixed_point(uv)], paint.tolist(), cv2.LINE_AA, BITS)
            cv2.fillPoly(touched, [fixed_point(uv)], 255, cv2.LINE_8, BITS)
        rows, cols = np.nonzero(touched)
        if len(rows):
            noisy = out[rows, cols] + _NOISE * rng.standard_normal((len(rows), 3))
            out[rows, cols] = np.clip(np.round(noisy), 0, 255).astype(np.uint8)

    def _wetted(self, px: U8, fault: ObjectOnPad, R: F64, t: F64) -> U8:
        """Return the frame with a disc of wet paint: darker by a third, and a little of the sky in it."""
        mask, a = np.zeros(px.shape[:2], np.uint8), np.linspace(0.0, math.tau, 24, endpoint=False)
        rim = 0.5 * fault.size_m * np.stack([np.cos(a), np.sin(a)], axis=1) + (fault.forward_m, fault.right_m)
        uv = self._lens.outline(rim @ R[:, :2].T + t, 6)
        if len(uv) < 3 or R[:, 2] @ t <= 0.01:
            return px
        cv2.fillPoly(mask, [fixed_point(uv)], 255, cv2.LINE_AA, BITS)
        share, light = mask[..., None] / 255.0, linear_light(px)
        return np.where(mask[..., None] > 0, srgb_values(light * (1.0 - 0.35 * share) + 0.02 * share * self._gains), px)

    def _glint(self, px: U8, fault: Glint, R: F64, t: F64) -> U8:
        plane = self._lens.plane_from_ray(np.stack([R[:, 0], R[:, 1], t], axis=1))
        if plane is None or R[:, 2] @ t <= 0.01:
            return px
        places = cv2.perspectiveTransform(np.ascontiguousarray(self._lens.rays), plane).astype(float)
        r2 = (places[..., 0] - fault.forward_m) ** 2 + (places[..., 1] - fault.right_m) ** 2
        # Flat in the middle and soft at the rim, as the renderer's own mirrored sun: half of it at the radius.
        spot = fault.brightness * np.exp(-math.log(2.0) * (r2 / fault.radius_m**2) ** 2)
        near = spot > 1e-3
        out = px.copy()
        out[near] = srgb_values(linear_light(px[near]) + spot[near][:, None] * self._gains)
        return out

    def _zoomed(self, px: U8, scale: float) -> U8:
        c = self._camera
        away = np.array([[scale, 0.0, (1.0 - scale) * c.cx], [0.0, scale, (1.0 - scale) * c.cy]])
        return np.asarray(
            cv2.warpAffine(px, away, (c.width, c.height), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101), np.uint8
        )


def _thing(fault: ObjectOnPad) -> list[Polygon]:
    place, turned = (fault.forward_m, fault.right_m), math.radians(fault.turned_deg)
    if fault.thing == "wet patch":
        return []
    if fault.thing != "vest":
        grey = int(srgb_values(np.array(fault.brightness)))
        colour = (grey, grey, grey) if fault.brightness and fault.thing in ("crate", "rope") else None
        return Decal(fault.thing, place, fault.size_m, turned, "deck", colour).polygons()
    neck, starboard = [(1, -0.6), (1, -0.2), (0.8, 0.0)], [(1, 0.2), (1, 0.6), (0.45, 0.6), (0.3, 0.75), (-1, 0.7)]
    body = np.array([*neck, *starboard, (-1, -0.7), (0.3, -0.75), (0.45, -0.6)])
    stripes = [np.array([(x, -0.7), (x + 0.16, -0.7), (x + 0.16, 0.7), (x, 0.7)]) for x in (-0.75, -0.25)]
    parts: list[Polygon] = [(body, (255, 105, 15)), *[(stripe, (226, 230, 214)) for stripe in stripes]]
    return [(_moved(0.5 * fault.size_m * points, fault.turned_deg, *place), rgb) for points, rgb in parts]


def _moved(points: F64, turned_deg: float, forward_m: float, right_m: float) -> F64:
    c, s = math.cos(math.radians(turned_deg)), math.sin(math.radians(turned_deg))
    return np.asarray(points @ np.array([[c, s], [-s, c]]) + (forward_m, right_m))


def _behind_drops(px: U8, fault: WetLens, seed: int) -> U8:
    """Return a frame as seen past drops, which stay where they are."""
    rng = np.random.default_rng([seed, 0xD309])
    h, w = px.shape[:2]
    mask = np.zeros((h, w), np.uint8)
    for x, y, size in rng.random((fault.drops, 3)):
        cv2.circle(mask, (round(x * w), round(y * h)), max(1, round(fault.radius * h * (0.5 + size))), 255, -1, cv2.LINE_AA)
    share = cv2.GaussianBlur(mask, (0, 0), 0.02 * h)[..., None].astype(np.float32) / 255.0
    blurred = cv2.GaussianBlur(px, (0, 0), fault.blur_px)
    return np.asarray(np.round(share * blurred + (1.0 - share) * px), np.uint8)


def _standing(body: Bystander, t_s: float, camera_m: F64) -> list[tuple[F64, RGB]]:
    """Return the polygons of a body ((N, 3) m in `pad`, sRGB), those behind first.

    Args:
        t_s: time of the flight.
        camera_m: place of the camera, (3,) m in `pad`.
    """
    x, y = body.place_m(t_s).tolist()
    half, top = 0.5 * body.width_m, -body.height_m
    if body.thing == "box":
        return _box(x, y, half, top, camera_m)
    if body.thing == "person":
        return _person(x, y, half, body.height_m)
    if body.thing == "bird":
        beat = 0.3 * half * math.sin(25.0 * t_s)
        wings = [(0.0, -half, beat), (0.3 * half, 0.0, 0.0), (0.0, half, beat), (-0.25 * half, 0.0, 0.0)]
        trunk = [(0.5 * half, 0.0, 0.0), (0.0, 0.12 * half, 0.0), (-0.5 * half, 0.0, 0.0), (0.0, -0.12 * half, 0.0)]
        there = np.array([x, y, top])
        return [(np.array(wings) + there, (205, 208, 210)), (np.array(trunk) + there, (240, 240, 240))]
    arms = [(_disc(x + 0.7 * half * a, y + 0.7 * half * b, 0.3 * half, top), (40, 42, 44)) for a in (-1, 1) for b in (-1, 1)]
    return [*arms, (_disc(x, y, 0.35 * half, top), (180, 40, 36))]


def _disc(x: float, y: float, radius: float, z: float, aspect: float = 1.0) -> F64:
    a = np.linspace(0.0, math.tau, 16, endpoint=False)
    return np.stack([x + radius * np.cos(a), y + aspect * radius * np.sin(a), np.full_like(a, z)], axis=1)


def _box(x: float, y: float, half: float, top: float, camera_m: F64) -> list[tuple[F64, RGB]]:
    corners = np.array([(x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)])
    planks: list[tuple[F64, RGB]] = []
    order = sorted(range(4), key=lambda i: -float(np.hypot(*((corners[i] + corners[(i + 1) % 4]) / 2 - camera_m[:2]))))
    for i in order:
        a, b = corners[i], corners[(i + 1) % 4]
        rows = np.linspace(0.0, top, 5)
        for k in range(4):
            side = np.array([(*a, rows[k]), (*b, rows[k]), (*b, rows[k + 1]), (*a, rows[k + 1])])
            planks.append((side, (96, 72, 45) if k % 2 else (118, 90, 58)))
    for k in range(4):
        y0, y1 = y - half + 0.5 * half * k, y - half + 0.5 * half * (k + 1)
        lid = np.array([(x - half, y0, top), (x + half, y0, top), (x + half, y1, top), (x - half, y1, top)])
        planks.append((lid, (150, 112, 70) if k % 2 else (166, 128, 84)))
    return planks


def _person(x: float, y: float, half: float, height_m: float) -> list[tuple[F64, RGB]]:
    """Boots, trousers, a vest with reflecting stripes and a helmet, in slices from below."""
    slices: list[tuple[F64, RGB]] = []
    for k in range(math.ceil(height_m / _SLICE_M)):
        up = (k + 1) * _SLICE_M
        share = up / height_m
        if share < 0.5:
            colour, wide = (34, 40, 62) if k % 3 else (52, 58, 80), 0.55
        elif share < 0.84:
            colour, wide = (226, 230, 214) if k % 5 == 0 else (225, 120, 20), 1.0
        else:
            colour, wide = (235, 235, 230), 0.5 * math.sqrt(max(0.05, 1.0 - ((share - 0.92) / 0.09) ** 2))
        slices.append((_disc(x, y, wide * half, -up, 0.6 if wide == 1.0 else 1.0), colour))
    return slices
