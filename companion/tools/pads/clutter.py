"""Views without a pad that a pad is priced by: sea, decks, grass, asphalt, roofs, rooms, and strange marks; all are generated.

What a camera sees over each of them is drawn at random: textures by filtered noise, things by their outlines, then the light, the
blur and the noise of a camera. No view is a photograph. A view is a function of its number alone.
"""

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]
WIDTH, HEIGHT = 320, 180
VIEWS = 504
"""Number of views that a pad is priced by."""
_LETTERS = "HXTLIAVENPRO8305"


def view(number: int) -> U8:
    """Return one view, (HEIGHT, WIDTH, 3) BGR."""
    rng = np.random.default_rng([0xC1A77E2, number])
    made = _KINDS[number % len(_KINDS)](rng)
    light = (0.3 + 1.1 * float(rng.beta(2.0, 1.5))) * (1.0 + _smooth(rng, 200.0, 0.15)[..., None])
    seen = cv2.GaussianBlur(made * light.astype(np.float32), (0, 0), float(rng.uniform(0.5, 1.6)))
    noise = float(rng.uniform(0.5, 5.0)) * rng.standard_normal(seen.shape, np.float32)
    return np.asarray(np.clip(seen + noise, 0, 255), np.uint8)


def kind_of(number: int) -> str:
    """Return what a view shows."""
    return _KINDS[number % len(_KINDS)].__name__.removeprefix("_")


def _smooth(rng: np.random.Generator, scale_px: float, sigma: float, stretch: float = 1.0) -> F32:
    """Return noise of a scale, (HEIGHT, WIDTH), longer along the rows by a factor."""
    h, w = (max(3, math.ceil(size / scale) + 3) for size, scale in ((HEIGHT, scale_px), (WIDTH, scale_px * stretch)))
    coarse = rng.normal(0.0, sigma, (h, w)).astype(np.float32)
    return np.asarray(cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC), np.float32)


def _colour(rng: np.random.Generator) -> tuple[float, float, float]:
    b, g, r = (rng.uniform(0.0, 255.0, 3) if rng.random() < 0.6 else np.full(3, rng.choice([15.0, 60.0, 128.0, 235.0]))).tolist()
    return b, g, r


def _ground(rng: np.random.Generator, colour: tuple[float, float, float], rough: float) -> F32:
    out = np.empty((HEIGHT, WIDTH, 3), np.float32)
    out[:] = np.array(colour, np.float32)
    texture = sum((_smooth(rng, scale, 1.0) for scale in (2.0, 6.0, 20.0, 70.0)), np.zeros((HEIGHT, WIDTH), np.float32))
    return np.asarray(out * np.clip(1.0 + rough * texture, 0.1, 3.0)[..., None], np.float32)


def _place(rng: np.random.Generator) -> tuple[int, int]:
    return int(rng.uniform(0, WIDTH)), int(rng.uniform(0, HEIGHT))


def _size(rng: np.random.Generator, least: float = 6.0, most: float = 120.0) -> float:
    return float(np.exp(rng.uniform(math.log(least), math.log(most))))


def _box(rng: np.random.Generator, image: F32, fill: bool = True) -> None:
    centre, size = _place(rng), _size(rng)
    box = cv2.boxPoints((centre, (size, size * float(rng.uniform(0.2, 1.0))), float(rng.uniform(0, 180)))).astype(np.int32)
    cv2.polylines(image, [box], True, _colour(rng), int(rng.integers(1, 5))) if not fill else cv2.fillPoly(image, [box], _colour(rng))


def _round(rng: np.random.Generator, image: F32) -> None:
    centre, size, slant = _place(rng), _size(rng, 4.0, 90.0), float(rng.uniform(0.6, 1.0))
    for _ in range(int(rng.integers(1, 4))):
        width = -1 if rng.random() < 0.5 else max(1, int(size * rng.uniform(0.05, 0.3)))
        cv2.ellipse(image, (centre, (2 * size, 2 * size * slant), float(rng.uniform(0, 180))), _colour(rng), width, cv2.LINE_AA)
        size *= float(rng.uniform(0.4, 0.9))
        if size < 2.0:
            return


def _outline(rng: np.random.Generator, image: F32) -> None:
    n, centre, size = int(rng.integers(3, 9)), np.array(_place(rng)), _size(rng, 5.0, 80.0)
    angles = np.sort(rng.uniform(0.0, math.tau, n))
    points = centre + size * rng.uniform(0.3, 1.0, n)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    cv2.fillPoly(image, [points.astype(np.int32)], _colour(rng), cv2.LINE_AA)


def _written(rng: np.random.Generator, image: F32) -> None:
    text = "".join(rng.choice(list(_LETTERS), int(rng.integers(1, 4))))
    scale, thick = _size(rng, 0.5, 6.0), int(rng.integers(1, 12))
    cv2.putText(image, text, _place(rng), cv2.FONT_HERSHEY_SIMPLEX, scale, _colour(rng), thick, cv2.LINE_AA)


def _lines(rng: np.random.Generator, image: F32, n: int) -> None:
    for _ in range(n):
        cv2.line(image, _place(rng), _place(rng), _colour(rng), int(rng.integers(1, 9)), cv2.LINE_AA)


def _turned(rng: np.random.Generator, image: F32, tilt: float = 2e-4) -> F32:
    """Return an image turned at random about its middle and seen a little aslant."""
    middle = (0.5 * WIDTH, 0.5 * HEIGHT)
    H = np.vstack([cv2.getRotationMatrix2D(middle, float(rng.uniform(0, 360)), float(rng.uniform(1.2, 1.9))), [0, 0, 1]])
    H[2, :2] = rng.normal(0.0, tilt, 2)
    return np.asarray(cv2.warpPerspective(image, H, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT), np.float32)


def _sea(rng: np.random.Generator) -> F32:
    base = _ground(rng, (float(rng.uniform(50, 140)), float(rng.uniform(50, 110)), float(rng.uniform(10, 70))), 0.03)
    waves = sum((_smooth(rng, s, 1.0, 3.0) for s in (3.0, 8.0, 25.0)), np.zeros((HEIGHT, WIDTH), np.float32))
    base = base * (1.0 + 0.12 * waves)[..., None]
    glint = np.clip(waves - float(rng.uniform(2.0, 4.5)), 0.0, 1.0)
    return _turned(rng, np.asarray(base + 255.0 * glint[..., None], np.float32))


def _deck(rng: np.random.Generator) -> F32:
    image = _ground(rng, _colour(rng), 0.05)
    for at in range(0, WIDTH, int(rng.uniform(40, 160))):
        cv2.line(image, (at, 0), (at, HEIGHT), _colour(rng), int(rng.integers(1, 4)))
    for _ in range(int(rng.integers(2, 8))):
        rng.choice([_box, _round, _written, _outline])(rng, image)
    _lines(rng, image, int(rng.integers(0, 4)))
    return _turned(rng, image)


def _grass(rng: np.random.Generator) -> F32:
    dry = float(rng.uniform(0.0, 1.0))
    image = _ground(rng, (45.0, 90.0 + 20.0 * dry, 50.0 + 90.0 * dry), 0.2)
    length = _size(rng, 4.0, 40.0)
    for _ in range(int(rng.integers(400, 1000))):
        x, y = _place(rng)
        turn, shade = float(rng.uniform(0.0, math.tau)), float(rng.uniform(0.2, 1.9))
        colour = (40.0 * shade, (95.0 + 15.0 * dry) * shade, (60.0 + 80.0 * dry) * shade)
        cv2.line(image, (x, y), (int(x + length * math.cos(turn)), int(y + length * math.sin(turn))), colour, int(rng.integers(1, 3)))
    for _ in range(int(rng.integers(0, 12))):
        cv2.circle(image, _place(rng), int(rng.integers(2, 12)), _colour(rng), -1)
    return image


def _asphalt(rng: np.random.Generator) -> F32:
    image = _ground(rng, (90.0, 92.0, 95.0), 0.12)
    for _ in range(int(rng.integers(200, 800))):
        shade = float(rng.uniform(20.0, 190.0))
        axes = (float(rng.uniform(2, 14)), float(rng.uniform(2, 10)))
        cv2.ellipse(image, (_place(rng), axes, float(rng.uniform(0, 180))), (shade, shade, shade * float(rng.uniform(0.9, 1.1))), -1)
    for _ in range(int(rng.integers(0, 4))):
        rng.choice([_written, _box, _outline])(rng, image)
    return image


def _roofs(rng: np.random.Generator) -> F32:
    image = _ground(rng, _colour(rng), 0.08)
    for _ in range(int(rng.integers(4, 14))):
        _box(rng, image)
    for _ in range(int(rng.integers(1, 5))):
        (x, y), step = _place(rng), int(rng.uniform(6, 30))
        for i in range(int(rng.integers(2, 9))):
            for j in range(int(rng.integers(2, 9))):
                at = (x + step * i, y + step * j)
                cv2.rectangle(image, at, (at[0] + step // 2, at[1] + step // 2), _colour(rng) if i == j == 0 else (40.0, 45.0, 50.0), -1)
    return _turned(rng, image)


def _room(rng: np.random.Generator) -> F32:
    image = _ground(rng, (float(rng.uniform(90, 200)), float(rng.uniform(100, 210)), float(rng.uniform(110, 220))), 0.02)
    step = int(rng.uniform(40, 200))
    for at in range(0, WIDTH, step):
        cv2.line(image, (at, 0), (at, HEIGHT), (70.0, 75.0, 80.0), 1)
        cv2.line(image, (0, at), (WIDTH, at), (70.0, 75.0, 80.0), 1)
    for _ in range(int(rng.integers(2, 9))):
        rng.choice([_box, _round, _box, _outline])(rng, image)
    image *= np.clip(1.0 + 0.5 * _smooth(rng, 60.0, 0.6), 0.3, 2.0)[..., None]
    return _turned(rng, image)


def _marks(rng: np.random.Generator) -> F32:
    image = _ground(rng, _colour(rng), 0.04)
    for _ in range(int(rng.integers(5, 16))):
        rng.choice([_round, _outline, _written, _round, _box])(rng, image)
    return _turned(rng, image)


_KINDS: tuple[Callable[[np.random.Generator], F32], ...] = (_sea, _deck, _grass, _asphalt, _roofs, _room, _marks)
