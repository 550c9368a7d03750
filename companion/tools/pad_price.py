"""Price a pad by clutter: how often a search takes something else for it, from what size on it is found, and what decides that.

The pad is searched for in views without one (`clutter`), and in views that it is planted in (`planted`). The support
that clutter gives has an exponential tail, as every likelihood ratio has. From it follow the chance of a false pad in a frame,
and the support that makes it rare.

The views without a pad are drawn at random: textures by filtered noise, things by their outlines, then the light, the blur and
the noise of a camera. No view is a photograph. A view is a function of its number alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import count
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation, Transform
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.detect.acquire import search
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detect.verification import support_log_odds
from estimator.vision.pad.file import Calibration
from estimator.vision.pad.geometry import covers
from estimator.vision.pad.information import paint_at
from estimator.vision.pad.pad import RARE, SUPPORT, Pad
from estimator.vision.register.verified import Verified, verify
from estimator.vision.srgb import linear_light
from estimator.vision.track.config import FRAME_WORK
from estimator.vision.track.register import WORTH_A_TRY

WIDTH = 320
"""Width of a view, px."""
HEIGHT = 180
"""Height of a view, px."""
VIEWS = 504
"""Number of views that a pad is priced by."""
_LETTERS = "HXTLIAVENPRO8305"
_FINE = 512
"""Points along a side of the drawing."""
_SHEET = 1.35
"""Half of the side of a sheet of the ground's paint, in radii of the pad."""
_TILT_RAD = math.radians(20.0)  # largest tilt of a view
FRAMES = 4.0
"""Factor from places in one view to places in a frame of 640x360; twice that for a pad whose light may be reversed."""
_EACH = 6
"""Views that the pad is planted in at each size."""
_FOUND = 0.8
"""Share of those in which it has to be found."""
_ALL = 1e-6
"""Least support of a drawing if all finds count."""
_TOP = 0.06  # share of the views whose log-odds show how fast they fall
_LEAST_SCALE = 0.7  # the least fall: so few views do not show less
_BY_COUNT = 0.01
"""Least share of the views that may be the pad, over that which was counted: the fall is not followed farther."""
_DOUBTED = -1.0
"""Log-odds of a find's edges and light from which it counts as one that might be the pad."""
_CLEAR_PX = 28.0  # radius of a pad that is seen clearly
_MISSED = 0.2  # share of such pads whose supports are below that from which the required one follows
_BELOW = 0.6  # largest required support, as a share of that one
_CANDIDATES = 2  # candidates of a view that are verified
_DECK_RAD = math.radians(2.0)  # standard deviation of the deck's tilt


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
    cv2.polylines(image, [box], True, _colour(rng), int(rng.integers(1, 5))) if not fill else cv2.fillPoly(
        image, [box], _colour(rng)
    )


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


def _one_of(rng: np.random.Generator, image: F32, *makers: Callable[[np.random.Generator, F32], None]) -> None:
    makers[int(rng.integers(0, len(makers)))](rng, image)


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
        _one_of(rng, image, _box, _round, _written, _outline)
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
        cv2.line(
            image, (x, y), (int(x + length * math.cos(turn)), int(y + length * math.sin(turn))), colour, int(rng.integers(1, 3))
        )
    for _ in range(int(rng.integers(0, 12))):
        cv2.circle(image, _place(rng), int(rng.integers(2, 12)), _colour(rng), -1)
    return image


def _asphalt(rng: np.random.Generator) -> F32:
    image = _ground(rng, (90.0, 92.0, 95.0), 0.12)
    for _ in range(int(rng.integers(200, 800))):
        shade = float(rng.uniform(20.0, 190.0))
        axes = (float(rng.uniform(2, 14)), float(rng.uniform(2, 10)))
        cv2.ellipse(
            image, (_place(rng), axes, float(rng.uniform(0, 180))), (shade, shade, shade * float(rng.uniform(0.9, 1.1))), -1
        )
    for _ in range(int(rng.integers(0, 4))):
        _one_of(rng, image, _written, _box, _outline)
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
                cv2.rectangle(
                    image, at, (at[0] + step // 2, at[1] + step // 2), _colour(rng) if i == j == 0 else (40.0, 45.0, 50.0), -1
                )
    return _turned(rng, image)


def _room(rng: np.random.Generator) -> F32:
    image = _ground(rng, (float(rng.uniform(90, 200)), float(rng.uniform(100, 210)), float(rng.uniform(110, 220))), 0.02)
    step = int(rng.uniform(40, 200))
    for at in range(0, WIDTH, step):
        cv2.line(image, (at, 0), (at, HEIGHT), (70.0, 75.0, 80.0), 1)
        cv2.line(image, (0, at), (WIDTH, at), (70.0, 75.0, 80.0), 1)
    for _ in range(int(rng.integers(2, 9))):
        _one_of(rng, image, _box, _round, _box, _outline)
    image *= np.clip(1.0 + 0.5 * _smooth(rng, 60.0, 0.6), 0.3, 2.0)[..., None]
    return _turned(rng, image)


def _marks(rng: np.random.Generator) -> F32:
    image = _ground(rng, _colour(rng), 0.04)
    for _ in range(int(rng.integers(5, 16))):
        _one_of(rng, image, _round, _outline, _written, _round, _box)
    return _turned(rng, image)


_KINDS: tuple[Callable[[np.random.Generator], F32], ...] = (_sea, _deck, _grass, _asphalt, _roofs, _room, _marks)


U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]


@lru_cache(maxsize=4)
def _drawing(pad: Pad) -> tuple[F32, float]:
    """Return the pad's linear blue, green, red and share of each point, (n, n, 4), row by x, column by y; and points per m."""
    half = _SHEET * pad.disc_radius_m
    axis = (np.arange(_FINE) - 0.5 * (_FINE - 1)) * 2.0 * half / _FINE
    gx, gy = np.meshgrid(axis, axis, indexing="ij")
    at = np.stack([gx.ravel(), gy.ravel()], axis=1)
    ground = linear_light(dict(pad.paints)[pad.ground]) if pad.ground else np.zeros(3)
    share = np.ones(len(at), bool) if pad.ground else np.any([covers(region, at) for region in pad.regions], axis=0)
    light = paint_at(pad, at, ground)[:, ::-1] * share[:, None]
    return np.asarray(np.c_[light, share].reshape(_FINE, _FINE, 4), np.float32), _FINE / (2.0 * half)


def random_pose(rng: np.random.Generator, camera: Camera, pad: Pad, radius_px: float) -> PadPose:
    """Return a pose with a radius in the frame, the pad's centre in view, and its plane within 20 degrees of the camera's."""
    depth = camera.fx * pad.disc_radius_m / radius_px
    aside = np.clip(np.array([0.5 * camera.width - radius_px, 0.5 * camera.height - radius_px]), 10.0, None)
    middle = np.array([camera.cx, camera.cy]) + rng.uniform(-1.0, 1.0, 2) * aside
    ray = np.append(camera.rays(middle[None])[0], 1.0)
    axis = rng.uniform(0.0, math.tau)
    tilt = Rotation.from_rotvec(float(rng.uniform(0.0, _TILT_RAD)) * np.array([math.cos(axis), math.sin(axis), 0.0]))
    return PadPose(tilt @ Rotation.from_rpy(0.0, 0.0, float(rng.uniform(-math.pi, math.pi))), ray * depth)


def planted(px: U8, camera: Camera, pad: Pad, pose: PadPose, rng: np.random.Generator) -> U8:
    """Return a view, (H, W, 3) BGR, with the pad in it."""
    drawing, per_m = _drawing(pad)
    # From the drawing's points to the frame's: x runs along rows of the drawing, y along its columns.
    to_pad = np.array([[0.0, 1.0 / per_m, 0.0], [1.0 / per_m, 0.0, 0.0], [0.0, 0.0, 1.0]])
    to_pad[:2, 2] = -0.5 * (_FINE - 1) / per_m
    K = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    H = K @ np.column_stack([pose.R_cam_pad.matrix[:, :2], pose.t_cam_pad]) @ to_pad
    fine = 2
    S = np.array([[fine, 0.0, 0.5 * (fine - 1)], [0.0, fine, 0.5 * (fine - 1)], [0.0, 0.0, 1.0]])
    shrunk = max(1.0, 0.5 * _FINE / max(1.0, fine * 1.4 * pose.px_of(pad.disc_radius_m, camera)))
    source = cv2.GaussianBlur(drawing, (0, 0), 0.5 * shrunk) if shrunk > 1.0 else drawing
    size = fine * camera.width, fine * camera.height
    seen = cv2.warpPerspective(source, S @ H, size, flags=cv2.INTER_LINEAR)
    seen = cv2.GaussianBlur(
        cv2.resize(seen, (camera.width, camera.height), interpolation=cv2.INTER_AREA), (0, 0), float(rng.uniform(0.5, 1.1))
    )
    under = (px.astype(np.float32) / 255.0) ** 2.2
    light = float(np.exp(rng.uniform(math.log(0.25), math.log(1.1))))
    out = under * (1.0 - seen[..., 3:]) + light * seen[..., :3]
    noise = float(rng.uniform(0.5, 4.0)) * rng.standard_normal(px.shape, np.float32)
    return np.asarray(np.clip(255.0 * np.clip(out, 0.0, 1.0) ** (1.0 / 2.2) + noise, 0, 255), np.uint8)


MOUNT = Transform(Rotation.from_rpy(0.0, 0.0, 0.5 * math.pi), np.zeros(3))
CAMERA = Camera(WIDTH, HEIGHT, 0.8 * WIDTH, 0.8 * WIDTH, 0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1), np.zeros(5), MOUNT)
_STAMP = Stamp(MonoNs(0), MonoNs(0), 0.001, "sim")
_RADII_PX = (5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0, 60.0)
_TAKEN_PX = (24.0, 48.0)
"""Radii of other pads that the pad is looked for in."""


class Price(Struct, frozen=True):
    """Cost of a pad in clutter: how often a search finds it where it is not."""

    views: int
    per_1000: tuple[float, float]
    """False pads that are expected in 1,000 frames of 640x360 at confidence 0.5 and 0.9, with the calibration."""
    found: Mapping[float, float]
    """Share of the planted pads that is found by radius, px."""
    taken_for: tuple[str, ...]
    """Names of other pads that are taken for it."""
    calibration: Calibration


def price(
    pad: Pad, others: Mapping[str, Pad], views: int = VIEWS, progress: Callable[[int, int], None] = lambda done, of: None
) -> Price:
    """Search for a pad in clutter, in views with the pad and in views with others, and return its price.

    Args:
        others: pads that it may be taken for, by name; itself among them does not count.
        progress: takes how many views are done, of how many.
    """
    bare = replace(pad, calibration=Calibration(least_support=_ALL, chance=0.0))
    counted = count(1)
    whole = views + len(_RADII_PX) * _EACH + len(others) * len(_TAKEN_PX)

    def seen_in(finds: list[_Find]) -> list[_Find]:
        progress(next(counted), whole)
        return finds

    clutter = [seen_in(_finds(bare, view(k), k % 2 == 0)) for k in range(views)]
    fewest = replace(pad, calibration=None).least_support
    tail = _Tail.of(clutter, pad.markings.is_searched_by_parts, 0.5 * fewest)
    shown = {r: [seen_in(_planted_finds(bare, bare, r, 100 * i + k)) for k in range(_EACH)] for i, r in enumerate(_RADII_PX)}
    clear = [max(find.support for find in finds) for r in _RADII_PX if r >= _CLEAR_PX for finds in shown[r] if finds]
    most = max(SUPPORT, _BELOW * float(np.quantile(clear or [0.0], _MISSED)))
    places = 2.0 * FRAMES if pad.reversible else FRAMES
    least = float(np.clip(tail.exceeded(RARE / places), fewest, max(fewest, most)))
    sure = {r: float(np.mean(_surest(finds, least) >= 0.0)) for r, finds in shown.items()}
    least_px = next((r for r in _RADII_PX if all(sure[s] >= _FOUND for s in _RADII_PX if s >= r)), 0.0)
    taken = []
    for name, other in others.items():
        seen = [seen_in(_planted_finds(bare, other, radius_px, 900 + k)) for k, radius_px in enumerate(_TAKEN_PX)]
        if other.regions != pad.regions and np.any(_surest(seen, least) >= 0.0):
            taken.append(name)
    chance, nine = (min(1.0, places * tail.chance(least * (1.0 + odds / support_log_odds(2.0)))) for odds in (0.0, math.log(9.0)))
    calibration = Calibration(round(least, 2), float(f"{chance:.2g}"), least_px, pad.fingerprint)
    return Price(views, (1000.0 * chance, 1000.0 * nine), sure, tuple(taken), calibration)


class _Find(NamedTuple):
    log_odds: float
    """Log-odds of the find's edges and its light alone."""
    support: float
    """Support that the drawing gives there, times the share that follows it."""


def registered(view_of: FrameView, attitude: Attitude | None, budget: float) -> list[Verified]:
    """Return what a search of one frame registers, as far as it is worth a try."""
    body, out = None if attitude is None else attitude.R_ned_body.without_heading(), []
    for candidate in search(view_of, body, budget=budget).candidates[:_CANDIDATES]:
        if candidate.score >= WORTH_A_TRY:
            found = verify(view_of, candidate.pose, Orientation.of(attitude, _DECK_RAD), cut=candidate.cut)
            out += [] if found is None else [found]
    return out


def _finds(pad: Pad, px: U8, level: bool) -> list[_Find]:
    """Return what a search of one frame of a flight registers; the vehicle is level if it says how it lies."""
    attitude = Attitude(_STAMP, Rotation.identity(), np.eye(3) * math.radians(1.0) ** 2) if level else None
    out = []
    for found in registered(FrameView(Pyramid(px), CAMERA, pad), attitude, FRAME_WORK):
        support, sure = found.found.record["aligned"]["support"], min(max(found.confidence, 1e-13), 1.0 - 1e-13)
        out.append(_Find(math.log(sure / (1.0 - sure)), float(support["support"]) * float(support["share"])))
    return out


def _planted_finds(pad: Pad, shown: Pad, radius_px: float, number: int) -> list[_Find]:
    rng = np.random.default_rng([0x9AD, number])
    pose = random_pose(rng, CAMERA, shown, radius_px)
    return _finds(pad, planted(view(10_000 + number), CAMERA, shown, pose, rng), False)


def _surest(views: Sequence[Sequence[_Find]], least_support: float) -> F64:
    """Return the log-odds of the surest find of each view, -30 for none."""
    return np.array(
        [max([min(f.log_odds, support_log_odds(f.support / least_support)) for f in finds], default=-30.0) for finds in views]
    )


class _Tail(Struct, frozen=True):
    """Clutter whose edges and light alone would make it a pad: the number of views, and the average support."""

    share: float
    mean: float

    @staticmethod
    def of(views: Sequence[Sequence[_Find]], by_parts: bool, presumed: float) -> _Tail:
        """Return the tail of the finds of some views, with one more find than was seen.

        Args:
            by_parts: whether the log-odds are of a pad whose parts verification was fitted to.
            presumed: the support of that one more find.
        """
        support = [
            max(f.support for f in finds if f.log_odds > _DOUBTED) for finds in views if any(f.log_odds > _DOUBTED for f in finds)
        ]
        counted = (len(support) + 1.0) / (len(views) + 1.0)
        # If none is likely, the fall of the largest log-odds is a better bound than a count of zero.
        likely = np.sort([max((f.log_odds for f in finds), default=-30.0) for finds in views])[::-1]
        n = max(4, round(_TOP * len(views)))
        start, scale = float(likely[n]), max(_LEAST_SCALE, float(likely[:n].mean()) - float(likely[n]))
        falls = n / len(views) * math.exp(min(0.0, start / scale)) if start < 0.0 else 1.0
        return _Tail(
            min(counted, max(falls, _BY_COUNT * counted)) if by_parts else counted,
            (sum(support) + presumed) / (len(support) + 1.0),
        )

    def chance(self, support: float) -> float:
        """Return the chance that a view gives this support."""
        return min(1.0, self.share * math.exp(-support / self.mean))

    def exceeded(self, chance: float) -> float:
        """Return the support that a view exceeds with a small chance."""
        return max(0.0, self.mean * math.log(self.share / chance))
