"""Say which parts of a pad's file a person's own pictures show, and which they do not.

The pad is searched in each picture as `decklander detect` does it. Unless all of it shows, it is searched in reversed light and
without one part of it after another, too. By the pose of each of these, every border of the file is drawn over the picture, and
the light on both sides of it is compared with what the file says. The pose by which the most borders show counts. A border that
does not show there is tried at other sizes about the pad's centre.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from msgspec import Struct, structs

from companion.tools.pad_price import registered
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.detect.pyramid import U8, FrameView, Pyramid
from estimator.vision.detect.template import F32
from estimator.vision.pad.geometry import covers
from estimator.vision.pad.information import paint_at
from estimator.vision.pad.pad import Pad
from estimator.vision.pad.rules import check_regions
from estimator.vision.pad.shapes import PaintedDisc, PaintedRing, borders_of, part_of
from estimator.vision.register.verified import SURE
from estimator.vision.srgb import LINEAR_LIGHT
from estimator.vision.track.config import IMAGE_WORK
from estimator.vision.track.register import WORTH_A_TRY

_POINTS = 240  # points on a border
_ACROSS_PX = 1.5  # distance from it at which light is compared
_APART_PX = 4.0  # least distance from the next border at other sizes
_AGREES = 0.3  # least step of light at a point, in what the file and the picture's light make of it
_BARE_AGREES = 0.06  # the same against an unknown ground, in parts of white
_SHOWN = 0.6  # share of a border's points that have it where the border shows
_FEWEST = 40  # least number of points to say so
_SIZES = np.exp(np.linspace(math.log(0.6), math.log(1.7), 71)).tolist()
_NEAR = 0.025  # difference from the file's size that counts as the file's
_DOUBTED = 0.15  # difference from it at which a border is looked for that shows at the file's
_BETTER = 1.15  # factor by which a border has to follow the pictures more at another size
_TURNS = 72  # headings that are tried
_FAINTEST = 0.02  # least light of a picture over that of the file


class Border(Struct, frozen=True, eq=False):
    """One line of a disc or a ring, or all lines of another region."""

    region: int
    key: str
    """The key of its size; empty where a region has several."""
    size_m: float
    """The value of that key; of others the largest distance from the centre."""
    at: F64
    """Points on it, (N, 2) m."""
    normal: F64
    """Unit normals that point out of the region, (N, 2)."""


class Found(Struct, frozen=True, eq=False):
    """The pad, or that of it which was found, in one picture."""

    lacks: tuple[str, ...]
    """The parts that were left out of the search."""
    confidence: float
    pose: PadPose
    camera: Camera
    light: F32
    """Linear blue, green, red of the picture, (H, W, 3)."""
    sampled: tuple[tuple[F64, F64], ...] = ()
    """Points inside and outside of each border, (2, N, 2) m, and the file's steps of light between them.

    Steps are (N, 3) blue, green, red; nan where the outer side is not known."""
    gain: float = 1.0
    """The picture's light over the file's, by the borders that show it best."""

    def points(self, at: F64) -> F64:
        """Return the pixels (N, 2) of points (N, 2) m of the pad."""
        return self.camera.project(self.pose.points(np.column_stack([at, np.zeros(len(at))])))

    def at(self, at: F64) -> list[list[float]]:
        """Return the same as lists, for JSON."""
        out: list[list[float]] = np.round(self.points(at), 2).tolist()
        return out

    def lay(self, pad: Pad, borders: Sequence[Border]) -> Found:
        """Return the same with the pad's borders over it."""
        ground, sampled = LINEAR_LIGHT[list(dict(pad.paints)[pad.ground])] if pad.ground else np.full(3, np.nan), []
        for border in borders:
            px_per_m = np.linalg.norm(self.points(border.at + 1e-3 * border.normal) - self.points(border.at), axis=1) / 1e-3
            off = (_ACROSS_PX / np.maximum(px_per_m, 1e-3))[:, None] * border.normal
            sides = np.stack([border.at - off, border.at + off])
            drawn_step = np.subtract(*(paint_at(pad, side, ground) for side in sides))[:, ::-1]
            # Where the file has one paint on both sides there is no border to be seen.
            kept = ~(np.abs(drawn_step).max(axis=1) < 1e-6)
            sampled.append((sides[:, kept], drawn_step[kept]))
        out = structs.replace(self, sampled=tuple(sampled))
        each = [_share(*out.steps(k)) for k in range(len(borders))]
        medians = [abs(float(np.median(one[np.isfinite(one)]))) for one in each if np.isfinite(one).sum() >= _FEWEST]
        return structs.replace(out, gain=max(_FAINTEST, *medians) if medians else 1.0)

    def steps(self, k: int, size: float = 1.0, turn: float = 0.0) -> tuple[F64, F64]:
        """Return the file's and the picture's steps of light across a border at a size and a turn, where it is in view."""
        (sides, drawn_step), c, s = self.sampled[k], math.cos(turn), math.sin(turn)
        uv = self.points((sides @ (size * np.array([[c, s], [-s, c]]))).reshape(-1, 2)).reshape(sides.shape)
        h, w = self.light.shape[:2]
        kept = np.all((uv > 1.0) & (uv < (w - 2.0, h - 2.0)), axis=(0, 2))
        if not kept.any():
            return np.empty((0, 3)), np.empty((0, 3))
        light = cv2.remap(self.light, uv[:, kept].astype(np.float32), None, cv2.INTER_LINEAR)  # type: ignore[call-overload]
        return drawn_step[kept], np.asarray(light[0] - light[1], float)

    def follows(self, k: int, size: float = 1.0, turn: float = 0.0) -> F64:
        """Return for each point of a border in view by how much the picture's step is the file's: 1 all, negative if reversed."""
        drawn_step, seen = self.steps(k, size, turn)
        if not len(seen):
            return np.empty(0)
        share, common = _share(drawn_step, seen), seen.mean(axis=0)
        bare = seen @ common / max(float(np.linalg.norm(common)), 1e-9) * (_AGREES / _BARE_AGREES)
        return np.clip(np.where(np.isfinite(share), share, bare) / self.gain, -1.0, 1.0)

    def shows(self, k: int, size: float = 1.0) -> float | None:
        """Return the share of a border's points that show it, less that of reversed ones; None where too few are in view."""
        follows = self.follows(k, size)
        return float(np.mean(np.sign(follows) * (np.abs(follows) > _AGREES))) if len(follows) >= _FEWEST else None

    def turned(self) -> Found:
        """Return the same at the heading at which the most points follow the file."""

        def follows(turn: float) -> float:
            return abs(float(sum(self.follows(k, turn=turn).sum() for k in range(len(self.sampled)))))

        best = max((math.tau * k / _TURNS for k in range(_TURNS)), key=follows)
        if follows(best) <= 1.1 * follows(0.0) + _FEWEST:
            return self
        return structs.replace(self, pose=self.pose.turned(max(best + np.radians(np.arange(-3.0, 3.5, 0.5)), key=follows)))


def _share(drawn_step: F64, seen: F64) -> F64:
    """Return the picture's steps in those of the file; nan where these are not known."""
    return np.asarray(np.sum(drawn_step * seen, axis=1) / np.sum(drawn_step * drawn_step, axis=1))


def check_pictures(
    pad: Pad, pictures: Mapping[str, tuple[U8, Camera]], progress: Callable[[int, int], None] = lambda done, of: None
) -> dict[str, Any]:
    """Return what is found of a pad in each picture by its name, and what all of them show of each of its borders, as JSON.

    Raises:
        ValueError: a picture is not of its camera's size.
    """
    # A sheet below all else is a region whose border may show, and not one that is searched.
    drawn = pad if pad.sheet is None else replace(pad, regions=(pad.sheet, *pad.regions), ground="")
    borders, found = list(borders_of_pad(drawn)), dict[str, Found | None]()
    for name, (px, camera) in pictures.items():
        found[name] = _find(pad, drawn, camera, px)
        progress(len(found), len(pictures))
    shown = [_shown(drawn, borders, k, [of for of in found.values() if of is not None]) for k in range(len(borders))]
    per_picture: list[dict[str, Any]] = []
    for name, of in found.items():
        if of is None:
            per_picture.append({"picture": name, "found": False})
            continue
        centre, outlines = of.at(np.zeros((1, 2)))[0], [of.at(border.at) for border in borders]
        seen = {"without": of.lacks, "confidence": round(of.confidence, 4), "centre_px": centre, "outlines_px": outlines}
        per_picture.append({"picture": name, "found": True, **seen})
    return {"pad": pad.name, "all_shown": all(one["is_shown"] for one in shown), "pictures": per_picture, "borders": shown}


def reduced(pad: Pad) -> Iterator[tuple[tuple[str, ...], Pad]]:
    """Yield the parts that are left out, and the rest as a pad: the whole pad, the same in any light, then ever less of it."""
    parts = list(dict.fromkeys(part_of(region) for region in pad.regions))
    whole = replace(pad, lamps=(), calibration=None, reversible=True)
    yield (), pad
    yield (), whole
    for names in [*([p for p in parts if p != one] for one in parts), *([one] for one in parts if len(parts) > 2)]:
        regions = tuple(region for region in pad.regions if part_of(region) in names)
        under = next((region.paint for region in pad.regions if part_of(region) in ("disc", "panel")), pad.ground)
        try:
            check_regions(regions, dict(pad.paints), "")
        except BadInput:
            continue
        ground = pad.ground if {"disc", "panel"} & set(names) else under
        yield tuple(p for p in parts if p not in names), replace(whole, regions=regions, ground=ground)


def _find(pad: Pad, drawn: Pad, camera: Camera, px: U8) -> Found | None:
    """Return what is found of a pad in a picture: the whole pad if all of it shows, else that of it by which the most shows.

    The person says that the pad is there: what is not sure counts beside nothing if all of its own borders show.
    """
    borders, light = list(borders_of_pad(drawn)), LINEAR_LIGHT[px].astype(np.float32)
    best, most = None, (False, 0)
    for lacks, one in reduced(pad):
        for seen in (px, cv2.bitwise_not(px)) if one.reversible else (px,):
            view = FrameView(Pyramid(np.asarray(seen, np.uint8)), camera, one)
            find = max(registered(view, None, IMAGE_WORK), key=lambda of: of.confidence, default=None)
            if find is None:
                continue
            found = Found(lacks, find.confidence, find.found.pose, camera, light).lay(drawn, borders).turned()
            shows: dict[int, bool] = {}
            for k, border in enumerate(borders):
                if (share := found.shows(k)) is not None:
                    shows[border.region] = shows.get(border.region, True) and abs(share) >= _SHOWN
            own = [is_shown for i, is_shown in shows.items() if part_of(drawn.regions[i]) not in lacks]
            score = find.confidence >= SURE, sum(shows.values())
            if (score[0] or (find.confidence >= WORTH_A_TRY and len(own) > 1 and all(own))) and score > most:
                best, most = found, score
                if score[0] and all(shows.values()):
                    return best
    return best


def borders_of_pad(pad: Pad) -> Iterator[Border]:
    """Yield the borders of a pad's regions: of discs and rings one for each radius."""
    for i, region in enumerate(pad.regions):
        lines = borders_of(region, _POINTS)
        match region:
            case PaintedDisc():
                named = [("radius_m", lines)]
            case PaintedRing():
                named = [("outer_m", lines[:1]), ("inner_m", lines[1:])]
            case _:
                named = [("", lines)]
        for key, own in named:
            at, normal = (np.concatenate(each) for each in zip(*map(_sampled, own), strict=True))
            inward = covers(region, at + 1e-4 * normal)
            size_m = max(float(np.hypot(*line.T).max()) for line in own)
            yield Border(i, key, size_m, at, np.where(inward[:, None], -normal, normal))


def _sampled(line: F64) -> tuple[F64, F64]:
    """Return points along a closed line at equal distances, and unit normals, (N, 2) each."""
    way = np.roll(line, -1, axis=0) - line
    length = np.hypot(*way.T)
    each = np.maximum(1, np.rint(_POINTS * length / length.sum())).astype(int)
    which = np.repeat(np.arange(len(line)), each)
    along = (np.arange(len(which)) - np.repeat(np.cumsum(each) - each, each) + 0.5) / each[which]
    unit = way[which] / length[which, None]
    return line[which] + along[:, None] * way[which], np.stack([unit[:, 1], -unit[:, 0]], axis=1)


def _shown(pad: Pad, borders: Sequence[Border], k: int, found: Sequence[Found]) -> dict[str, Any]:
    """Return what pictures show of a border: in how many it is as in the file, reversed, judged; elsewhere; and what to do."""
    border, region = borders[k], pad.regions[borders[k].region]
    shown, against, of = _counted(found, k)
    found_at, has_edge = _found_at(borders, k, found)
    if has_edge and found_at is None and 2 * shown <= of:
        shown = of
    is_shown = 2 * shown > of
    advice = ""
    if not of:
        advice = "not seen or too thin: nothing is known; take a picture from nearer that shows all of the pad"
    elif 2 * against > of:
        advice = f'light and dark are the other way round: change paint "{region.paint}", or the paint that it lies on'
    elif found_at is not None:
        keys = f"write {border.key} = {found_at * border.size_m:.3f}" if border.key else f"multiply its lengths by {found_at:.2f}"
        where = "fits better" if is_shown else "no edge at that size; one is"
        advice = f"{where} at {found_at * border.size_m:.3f} m, if the rest is right: measure it, or {keys}"
    elif not is_shown:
        advice = f"no edge at that size, nor from {_SIZES[0]:.1f} to {_SIZES[-1]:.1f} times that: measure it, or take it out"
        if region is pad.sheet:
            advice += f'; the rest is found without it: ground = "{region.paint}" above [paints] says enough'
        elif part_of(region) in ("disc", "panel"):
            advice += f'; if the sheet or deck around has its paint, write ground = "{region.paint}" above [paints]'
    shown_at_m = None if found_at is None else round(found_at * border.size_m, 4)
    return {
        "region": border.region, "part": part_of(region), "key": border.key, "size_m": round(border.size_m, 4), "shown": shown,
        "reversed": against, "of": of, "is_shown": is_shown, "shown_at_m": shown_at_m, "advice": advice,
    }  # fmt: skip


def _counted(found: Sequence[Found], k: int) -> tuple[int, int, int]:
    """Return in how many pictures a border is as in the file, in how many reversed, and how many were judged."""
    shares = [share for one in found if (share := one.shows(k)) is not None]
    return sum(share >= _SHOWN for share in shares), sum(share <= -_SHOWN for share in shares), len(shares)


def _judging(found: Sequence[Found], k: int) -> list[Found]:
    return [one for one in found if one.shows(k) is not None]


def _follows(judged: Sequence[Found], k: int, size: float) -> float:
    """Return how well pictures that judge a border follow it at a factor of its size; 0 if most show no edge there."""
    shares = [share for one in judged if (share := one.shows(k, size)) is not None]
    is_there = 2 * len(shares) > len(judged) and np.median(shares) >= _SHOWN
    return float(np.median([one.follows(k, size).mean() for one in judged])) if is_there else 0.0


def _found_at(borders: Sequence[Border], k: int, found: Sequence[Found]) -> tuple[float | None, bool]:
    """Return the factor of a border's size at which pictures show it better, and whether they show it at any size."""
    border, judged = borders[k], _judging(found, k)
    shown, against, of = _counted(found, k)
    if not judged or 2 * against > of:
        return None, False
    # What is seen at the size of another border that shows is that border.
    others = [i for i, one in enumerate(borders) if border.key and one.key and i != k and 2 * _counted(found, i)[0] > of]
    apart_m = max(_APART_PX * one.pose.range_m / one.camera.fx for one in judged)
    most = _DOUBTED if 2 * shown > of else math.inf
    near = [s for s in _SIZES if abs(math.log(s)) < most]
    tried = [1.0, *(s for s in near if all(abs(s * border.size_m - borders[i].size_m) > apart_m for i in others))]
    by_size = [_follows(judged, k, size) for size in tried]
    best = int(np.argmax(by_size))
    is_elsewhere = by_size[best] > _BETTER * by_size[0] and abs(tried[best] - 1.0) > _NEAR
    return tried[best] if is_elsewhere else None, by_size[best] > 0.0


def lines(checked: Mapping[str, Any]) -> Iterator[str]:
    """Yield what `check_pictures` returns as text."""
    for of in checked["pictures"]:
        without = f" without its {', '.join(of['without'])}" if of.get("without") else ""
        where = f"found{without} at {of['centre_px']} px, confidence {of['confidence']:.2f}" if of["found"] else "not found"
        yield f"{of['picture']}: {where}"
    if not any(of["found"] for of in checked["pictures"]):
        yield (
            "no part of the pad is found, in no light: is it this pad, seen by the camera of --camera, 20 px across or more, and "
            "wholly in view?"
        )
        return
    if all(2 * one["reversed"] > one["of"] for one in checked["borders"] if one["of"]):
        yield 'all of it is in reversed light: swap the light and the dark paint, or write polarity = "any" for a thermal camera'
    for one in checked["borders"]:
        what = f"regions[{one['region']}] ({one['part']}) {one['key'] or 'to'} {one['size_m']:.3f} m"
        yield f"{what:<44} shown in {one['shown']} of {one['of']}" + (f": {one['advice']}" if one["advice"] else "")
