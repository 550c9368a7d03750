"""The surroundings of the pad: the deck's drawing, the sea's waves, and objects that only look like a pad."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from sitl.sea.sea import Waves
from sitl.vessel.seakeeping import Hull

U8 = NDArray[np.uint8]
RGB = tuple[int, int, int]

DecalKind = Literal["raft", "awning", "helipad", "bare_h", "green_disc", "ring", "lifebuoy", "towel", "crate", "rope"]


class Deck(Struct, frozen=True):
    """A flat deck in the pad's plane. Its own axes: x to the bow, y to starboard, origin in the pad's centre."""

    length_m: float = 5.0
    width_m: float = 2.8
    centre_m: tuple[float, float] = (0.6, 0.0)
    """Centre of the deck, in its own axes."""
    pad_yaw_rad: float = 0.0
    """Angle of the pad's arrow from the bow, clockwise from above."""
    bow_taper_m: float = 0.0
    freeboard_m: float = 0.55
    paint: RGB = (112, 118, 122)
    seed: int = 1

    def __post_init__(self) -> None:
        if not (self.length_m > 0.5 and self.width_m > 0.5 and 0.0 <= self.bow_taper_m < self.length_m and self.freeboard_m >= 0):
            raise BadInput("deck: length_m and width_m over 0.5, bow_taper_m within the length, freeboard_m 0 or more")

    @staticmethod
    def of(hull: Hull, pad_yaw_rad: float = 0.0, seed: int = 1) -> Deck:
        """Return the deck of a hull preset, with the pad where the hull carries it."""
        x, y = hull.d_vessel_pad_m
        return Deck(*hull.deck_m, (-x, -y), pad_yaw_rad, hull.bow_taper_m, hull.freeboard_m, seed=seed)

    def outline(self) -> F64:
        """Return the outline, (N, 2) m in the deck's axes. It starts at the port quarter and runs clockwise from above."""
        x0, x1 = self.centre_m[0] - self.length_m / 2, self.centre_m[0] + self.length_m / 2
        y, half = self.centre_m[1], self.width_m / 2
        if self.bow_taper_m == 0:
            return np.array([(x0, y - half), (x1, y - half), (x1, y + half), (x0, y + half)])
        s = np.linspace(-1.0, 1.0, 13)
        bow = np.stack([x1 - self.bow_taper_m * np.abs(s) ** 2.2, y + half * s], axis=1)
        return np.concatenate([[(x0, y - half)], bow, [(x0, y + half)]])


class Decal(Struct, frozen=True):
    """A flat object on deck or on the pad (position in `pad`) or on the water (position in `ned`), `size_m` across."""

    kind: DecalKind
    centre_m: tuple[float, float]
    size_m: float
    yaw_rad: float = 0.0
    on: Literal["deck", "sea", "pad"] = "sea"
    """Surface that it lies on; the pad's paint covers what lies on the deck, and lies below what lies on the pad."""
    colour: RGB | None = None
    """Colour of its main part; None for the usual colour."""

    def __post_init__(self) -> None:
        if not (self.size_m > 0 and math.isfinite(self.size_m)):
            raise BadInput(f"decal {self.kind}: size_m must be positive, got {self.size_m!r}")

    def polygons(self) -> list[tuple[F64, RGB]]:
        """Return the polygons ((N, 2) m, sRGB) in paint order, in the plane of the decal."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        turn = np.array([[c, s], [-s, c]]) * self.size_m / 2
        usual, parts = _DRAWINGS[self.kind]
        return [(points @ turn + self.centre_m, rgb or self.colour or usual) for points, rgb in parts]


class Surroundings(Struct, frozen=True, eq=False):
    """Everything in the frame except the pad and the light."""

    deck: Deck | None = Deck()
    """The deck; None for open sea."""
    waves: Waves | None = None
    """The sea's waves, a batch of 1; None for a calm sea that only ripples."""
    decals: tuple[Decal, ...] = ()
    water: RGB = (16, 52, 66)
    """Colour of deep water, seen from straight above."""
    wake_speed_m_s: float = 0.0
    """Speed of the ship through the water, which draws a wake behind it."""
    seed: int = 0

    def __post_init__(self) -> None:
        if self.waves is not None and self.waves.batch != 1:
            raise ValueError(f"a frame shows one sea, got a batch of {self.waves.batch}")


def _disc(radius: float = 1.0, n: int = 40) -> F64:
    a = np.linspace(0.0, math.tau, n, endpoint=False)
    return radius * np.stack([np.cos(a), np.sin(a)], axis=1)


def _box(x: float, y: float, half_x: float, half_y: float) -> F64:
    return np.array([(x - half_x, y - half_y), (x + half_x, y - half_y), (x + half_x, y + half_y), (x - half_x, y + half_y)])


def _h_marking(scale: float, rgb: RGB) -> list[tuple[F64, RGB]]:
    return [
        (_box(0.0, -0.40 * scale, 0.70 * scale, 0.10 * scale), rgb),
        (_box(0.0, 0.40 * scale, 0.70 * scale, 0.10 * scale), rgb),
        (_box(0.0, 0.0, 0.10 * scale, 0.40 * scale), rgb),
    ]


def _quarter(n: int) -> F64:
    a = n * math.pi / 2 + np.linspace(-0.2, 0.2, 5)
    arc = np.stack([np.cos(a), np.sin(a)], axis=1)
    return np.concatenate([arc, 0.55 * arc[::-1]])


_DRAWINGS: dict[str, tuple[RGB, list[tuple[F64, RGB | None]]]] = {
    "raft": (
        (255, 120, 20),
        [
            (_disc(1.0, 12), None),
            (_disc(0.78, 12), (60, 40, 30)),
            (_disc(0.62, 12), (200, 80, 20)),
            (_box(0, 0, 0.62, 0.04), (220, 220, 210)),
        ],
    ),
    "awning": (
        (20, 110, 50),
        [(_box(0, 0, 1.0, 0.7), None), *((_box(0, y, 1.0, 0.07), (225, 228, 215)) for y in (-0.42, 0.0, 0.42))],
    ),
    "helipad": (
        (70, 95, 75),
        [(_disc(1.0, 8), None), (_disc(0.80), (235, 195, 40)), (_disc(0.70), None), *_h_marking(0.55, (240, 240, 240))],
    ),
    "bare_h": ((10, 100, 20), [(_box(0, 0, 1.0, 1.0), None), *_h_marking(0.75, (245, 245, 245))]),
    "green_disc": ((0, 102, 0), [(_disc(), None)]),
    "ring": ((255, 149, 0), [(_disc(), None), (_disc(0.86), (110, 115, 118))]),
    "lifebuoy": (
        (240, 80, 25),
        [(_disc(), None), *((_quarter(n), (240, 240, 235)) for n in range(4)), (_disc(0.55), (20, 55, 68))],
    ),
    "towel": (
        (30, 120, 60),
        [(_box(0, 0, 1.0, 0.5), None), (_box(0, 0, 0.25, 0.5), (250, 150, 30)), (_box(0, 0, 0.1, 0.3), (240, 240, 240))],
    ),
    "crate": ((150, 112, 70), [(_box(0, 0, 1.0, 1.0), None)]),
    "rope": ((205, 190, 150), [(_box(0, 0, 1.0, 0.16), None)]),
}
"""Usual colour of the main part of each decal, and polygons about its centre, in half sizes; None for the main part's colour."""


class DeckDrawing(Struct, frozen=True, eq=False):
    """Painted steel around the pad, BGR."""

    paint: U8
    texels_per_m: float
    corner_m: tuple[float, float]
    """Position of the first texel's outer corner, in the deck's axes; rows run with x, columns with y."""


@lru_cache(maxsize=8)
def draw_deck(deck: Deck) -> DeckDrawing:
    """Draw plates, weld seams, non-slip lanes, safety lines, hatches and cleats; nothing within 0.75 m of the pad's centre.

    The drawing of a long ship covers 12 m about the pad and continues by reflection further out.
    """
    rng = np.random.default_rng([deck.seed, 0xDEC])
    x0 = max(deck.centre_m[0] - deck.length_m / 2, -12.0)
    x1 = min(deck.centre_m[0] + deck.length_m / 2, 12.0)
    y0 = max(deck.centre_m[1] - deck.width_m / 2, -12.0)
    y1 = min(deck.centre_m[1] + deck.width_m / 2, 12.0)
    ppm = min(250.0, 1500.0 / max(x1 - x0, y1 - y0))
    rows, cols = math.ceil((x1 - x0) * ppm), math.ceil((y1 - y0) * ppm)
    x = x0 + (np.arange(rows) + 0.5) / ppm
    y = y0 + (np.arange(cols) + 0.5) / ppm

    def blotches(cell_m: float) -> NDArray[np.float32]:
        shape = (max(2, math.ceil((x1 - x0) / cell_m) + 1), max(2, math.ceil((y1 - y0) / cell_m) + 1))
        return np.asarray(cv2.resize(rng.standard_normal(shape, dtype=np.float32), (cols, rows), interpolation=cv2.INTER_CUBIC))

    stain = 0.5 * blotches(1.6) + 0.35 * blotches(0.5) + 0.2 * blotches(0.15)
    # Channel by channel: numpy takes three times as long where the innermost of its loops runs over three.
    bare = np.array(deck.paint[::-1], np.float32)[:, None, None] * (1.0 + 0.05 * stain)
    rust = np.clip(0.8 * blotches(0.9) + 0.7 * blotches(0.25) + 0.5 * blotches(0.06) - 1.75, 0.0, 1.2) * 0.35
    bare += rust * (np.array([38.0, 66.0, 112.0], np.float32)[:, None, None] - bare)

    plate_x, plate_y = 1.5, 1.2
    line = 0.006
    for places, centres, axis in ((x, np.arange(math.floor(x0 / plate_x), x1 / plate_x + 1) * plate_x + 0.75, 0),
                                  (y, np.arange(math.floor(y0 / plate_y), y1 / plate_y + 1) * plate_y + 0.6, 1)):  # fmt: skip
        gap = np.abs(places[:, None] - centres).min(axis=1)
        seam = np.clip((line + 0.5 / ppm - gap) * ppm, 0.0, 1.0).astype(np.float32) * 0.35
        bead = np.clip(1.0 - np.abs(gap - 3 * line) / (2 * line), 0.0, 1.0).astype(np.float32) * 0.06
        factor = 1.0 - seam + bead
        bare *= factor[:, None] if axis == 0 else factor
    image = np.asarray(cv2.merge(list(bare)))

    def place(points: list[tuple[float, float]] | F64) -> NDArray[np.int32]:
        p = np.asarray(points, dtype=float)
        return np.round(np.stack([(p[:, 1] - y0) * ppm - 0.5, (p[:, 0] - x0) * ppm - 0.5], axis=1) * 16).astype(np.int32)

    def fill(points: list[tuple[float, float]] | F64, rgb: tuple[float, float, float]) -> None:
        cv2.fillPoly(image, [place(points)], rgb[::-1], cv2.LINE_AA, 4)

    edge_x = (deck.centre_m[0] - deck.length_m / 2, deck.centre_m[0] + deck.length_m / 2 - deck.bow_taper_m)
    edge_y = (deck.centre_m[1] - deck.width_m / 2, deck.centre_m[1] + deck.width_m / 2)
    for side, sign in ((edge_y[0], 1.0), (edge_y[1], -1.0)):
        for near, far, rgb in ((0.0, 0.07, (58, 60, 62)), (0.16, 0.21, (196, 176, 70))):
            near, far = side + sign * near, side + sign * far
            fill([(x0, near), (x1, near), (x1, far), (x0, far)], rgb)
    if edge_x[0] >= x0:
        fill([(edge_x[0], y0), (edge_x[0], y1), (edge_x[0] + 0.07, y1), (edge_x[0] + 0.07, y0)], (58, 60, 62))
        for n in range(math.ceil(deck.width_m / 0.24)):
            s = edge_y[0] + 0.07 + 0.24 * n
            aft, fore = edge_x[0] + 0.07, edge_x[0] + 0.19
            if s + 0.24 < edge_y[1]:
                fill([(aft, s), (aft, s + 0.12), (fore, s + 0.24), (fore, s + 0.12)], (205, 180, 60))
    if deck.bow_taper_m == 0 and edge_x[1] <= x1:
        fill([(edge_x[1], y0), (edge_x[1], y1), (edge_x[1] - 0.07, y1), (edge_x[1] - 0.07, y0)], (58, 60, 62))

    def hatch(cx: float, cy: float, half_x: float, half_y: float) -> None:
        fill(_box(cx + 0.03, cy + 0.03, half_x, half_y), (62, 66, 68))
        fill(_box(cx, cy, half_x, half_y), (128, 133, 136))
        fill(_box(cx, cy, half_x - 0.03, half_y - 0.03), (118, 123, 126))
        for bx in (-half_x + 0.06, half_x - 0.06):
            for by in (-half_y + 0.06, half_y - 0.06):
                fill(_disc(0.012, 10) + np.array([cx + bx, cy + by]), (70, 72, 74))
        fill(_box(cx, cy + half_y - 0.10, 0.05, 0.012), (60, 62, 64))

    def cleat(cx: float, cy: float) -> None:
        fill(_box(cx + 0.015, cy + 0.015, 0.11, 0.022), (50, 52, 54))
        fill(_box(cx, cy, 0.11, 0.020), (158, 160, 160))
        fill(_box(cx, cy, 0.04, 0.032), (140, 142, 143))

    if deck.width_m > 2.0 and edge_x[1] > 2.0:
        hatch(min(1.7, edge_x[1] - 0.6), deck.centre_m[1] - 0.5, 0.32, 0.32)
        if edge_x[1] > 2.8:
            hatch(2.5, deck.centre_m[1] + 0.45, 0.22, 0.40)
    for cx in np.arange(edge_x[0] + 0.5, min(edge_x[1], 12.0), max(1.3, deck.length_m / 6)):
        for side, sign in ((edge_y[0], 1.0), (edge_y[1], -1.0)):
            if math.hypot(cx, side) > 0.9:
                cleat(float(cx), side + sign * 0.115)
    if deck.length_m > 20.0:
        for s in (-4.0, 4.0):
            fill([(x0, s - 0.06), (x1, s - 0.06), (x1, s + 0.06), (x0, s + 0.06)], (210, 210, 205))
        for cx, cy in ((5.5, -6.5), (8.5, -6.5), (5.5, 6.2), (-7.5, 6.4)):
            fill(_box(cx + 0.5, cy + 0.35, 1.2, 0.6), (60, 64, 66))
            fill(_box(cx, cy, 1.2, 0.6), (40, 84, 128) if cy < 0 else (140, 60, 48))
            for rib in np.linspace(-1.0, 1.0, 9):
                fill(_box(cx + rib * 1.1, cy, 0.02, 0.6), (34, 70, 108) if cy < 0 else (118, 50, 42))
    rubbed = np.clip(0.35 * blotches(0.3) + 0.35 * blotches(0.08) - 0.15, 0.0, 0.55)
    painted = [
        np.clip(over + rubbed * (below - over), 0, 255).astype(np.uint8)
        for over, below in zip(cv2.split(image), bare, strict=True)
    ]
    return DeckDrawing(np.asarray(cv2.merge(painted), np.uint8), ppm, (x0, y0))
