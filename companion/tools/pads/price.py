"""Price a pad by clutter: how often a search takes something else for it, from what size on it is found, and what decides that.

The pad is searched for in views without one (`clutter`), and in views that it is planted in (`planted`). The support
that clutter gives has an exponential tail, as every likelihood ratio has. From it follow the chance of a false pad in a frame,
and the support that makes it rare.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import NamedTuple

import numpy as np

from companion.tools.pads.clutter import HEIGHT, VIEWS, WIDTH, view
from companion.tools.pads.planted import U8, planted, random_pose
from estimator.contracts.geometry import F64, Rotation, Transform
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.by_paint import WORTH_A_TRY
from estimator.vision.camera import Camera
from estimator.vision.detect.acquire import search
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.pad import RARE, TOLD, Calibration, Pad
from estimator.vision.pose import Orientation
from estimator.vision.register.fit_verification import support_log_odds
from estimator.vision.tracker_config import FRAME_WORK
from estimator.vision.verified import verify

FRAMES = 4.0
"""Factor from places in one view to places in a frame of 640x360; twice that for a pad whose light may be reversed."""
_MOUNT = Transform(Rotation.from_rpy(0.0, 0.0, 0.5 * math.pi), np.zeros(3))
CAMERA = Camera(WIDTH, HEIGHT, 0.8 * WIDTH, 0.8 * WIDTH, 0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1), np.zeros(5), _MOUNT)
_STAMP = Stamp(MonoNs(0), MonoNs(0), 0.001, "sim")
_RADII_PX = (5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0, 60.0)
_EACH = 6
"""Views that the pad is planted in at each size."""
_FOUND = 0.8
"""Share of those in which it has to be found."""
_ALL = 1e-6
"""Least support of a drawing if all finds count."""
_TOP, _LEAST_SCALE = 0.06, 0.7
"""Share of the views whose log-odds show how fast they fall, and the least of that: so few views do not show less."""
_BY_COUNT = 0.01
"""Least share of the views that may be the pad, over that which was counted: the fall is not followed farther."""
_DOUBTED = -1.0
"""Log-odds of a find's edges and light from which it counts as one that might be the pad."""
_CLEAR_PX, _MISSED, _BELOW = 28.0, 0.2, 0.6
"""Radius of a pad that is seen clearly, and the largest required share of the weakest support among them."""
_CANDIDATES, _DECK_RAD = 2, math.radians(2.0)
_TAKEN_PX = (24.0, 48.0)
"""Radii of other pads that the pad is looked for in."""


@dataclass(frozen=True, slots=True)
class Price:
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
    most = max(TOLD, _BELOW * float(np.quantile(clear or [0.0], _MISSED)))
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


def _finds(pad: Pad, px: U8, level: bool) -> list[_Find]:
    """Return what a search of one frame of a flight registers; the vehicle is level if it says how it lies."""
    attitude = Attitude(_STAMP, Rotation.identity(), np.eye(3) * math.radians(1.0) ** 2) if level else None
    view_of, body = FrameView(Pyramid(px), CAMERA, pad), None if attitude is None else attitude.R_ned_body.without_heading()
    out = []
    for candidate in search(view_of, body, budget=FRAME_WORK).candidates[:_CANDIDATES]:
        if candidate.score >= WORTH_A_TRY:
            found = verify(view_of, candidate.pose, Orientation.of(attitude, _DECK_RAD), cut=candidate.cut)
            if found is not None:
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


@dataclass(frozen=True, slots=True)
class _Tail:
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
