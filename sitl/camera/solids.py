"""Bodies that stand, walk or fly about the pad, as polygons in space."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from estimator.contracts.geometry import F64
from sitl.camera.surroundings import RGB
from sitl.faults.kinds import Bystander

SolidKind = Literal["box", "person", "bird", "drone"]
_SLICE_M = 0.04
"""Height of a person's slices."""


@dataclass(frozen=True, slots=True)
class Solid:
    """A body on or over the deck, at rest or on its way to another place and back. Places are in `pad`."""

    kind: SolidKind
    at_m: tuple[float, float]
    width_m: float
    height_m: float
    """Height of its top over the deck."""
    to_m: tuple[float, float] | None = None
    """Place where it turns; None for a body at rest."""
    speed_m_s: float = 0.0

    @staticmethod
    def of(fault: Bystander) -> "Solid":
        """Return the body of a fault."""
        turns = (fault.to_forward_m, fault.to_right_m) if fault.speed_m_s > 0.0 else None
        return Solid(fault.thing, (fault.forward_m, fault.right_m), fault.width_m, fault.height_m, turns, fault.speed_m_s)

    def place_m(self, t_s: float) -> F64:
        """Return its place on the deck, (2,) m, at an instant."""
        start = np.array(self.at_m)
        if self.to_m is None or self.speed_m_s <= 0.0:
            return start
        way = np.array(self.to_m) - start
        length = max(1e-6, float(np.hypot(*way)))
        gone = math.fmod(self.speed_m_s * t_s, 2.0 * length)
        return np.asarray(start + way / length * min(gone, 2.0 * length - gone))

    def polygons(self, t_s: float, camera_m: F64) -> list[tuple[F64, RGB]]:
        """Return its polygons ((N, 3) m in `pad`, sRGB), those behind first.

        Args:
            t_s: time of the flight.
            camera_m: place of the camera, (3,) m in `pad`.
        """
        x, y = self.place_m(t_s).tolist()
        half, top = 0.5 * self.width_m, -self.height_m
        if self.kind == "box":
            return _box(x, y, half, top, camera_m)
        if self.kind == "person":
            return _person(x, y, half, self.height_m)
        if self.kind == "bird":
            beat = 0.3 * half * math.sin(25.0 * t_s)
            wings = [(0.0, -half, beat), (0.3 * half, 0.0, 0.0), (0.0, half, beat), (-0.25 * half, 0.0, 0.0)]
            body = [(0.5 * half, 0.0, 0.0), (0.0, 0.12 * half, 0.0), (-0.5 * half, 0.0, 0.0), (0.0, -0.12 * half, 0.0)]
            there = np.array([x, y, top])
            return [(np.array(wings) + there, (205, 208, 210)), (np.array(body) + there, (240, 240, 240))]
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
