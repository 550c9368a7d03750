"""The effect of picture faults on a finished frame."""

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.settings.load import find_file, read_toml
from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.regions import outlines_of
from estimator.vision.srgb import linear_light
from sitl.camera.camera import Exposure, pose_at
from sitl.camera.light import Light, srgb_values
from sitl.camera.projection import SHIFT as BITS
from sitl.camera.projection import Lens, fixed_point, lens_of
from sitl.camera.solids import Solid
from sitl.camera.surroundings import RGB, Decal
from sitl.faults.kinds import Bystander, FocalLength, Glint, LightFalls, ObjectOnPad, OtherPad, PadCovered, PictureFault, WetLens

U8 = NDArray[np.uint8]
Polygon = tuple[F64, RGB]
"""Points (N, 2) m in the pad's plane or (N, 3) in `pad`, and the paint, sRGB."""
_TARPAULIN: RGB = (92, 96, 98)
_DECK: RGB = (104, 110, 112)
_NOISE = 2.0
"""Standard deviation of the noise on drawn parts, grey levels."""


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
                    out = _darker(out, fault.fraction, rng)
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
                return Solid.of(fault).polygons(t_s, camera_m)
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
                    (_moved(fault.size * points, fault.turned_deg, fault.forward_m, fault.right_m), rgb)
                    for points, rgb in pad_polygons(there)
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


def pad_polygons(pad: Pad) -> list[tuple[F64, RGB]]:
    """Return the outlines of a pad's regions, (N, 2) m, in paint order."""
    return [(line, pad.rgb(region)) for region in pad.regions for line in outlines_of(region)]


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


def _darker(px: U8, fraction: float, rng: np.random.Generator) -> U8:
    """Return a frame with less light and the noise that its sensor then has: 8000 electrons of full scale, 12 of read noise."""
    light = fraction * linear_light(px)
    sigma = np.sqrt(light / 8000.0 + (12.0 / 8000.0) ** 2)
    return srgb_values(light + sigma * rng.standard_normal(light.shape))


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
