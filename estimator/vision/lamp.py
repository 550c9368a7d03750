"""A pad's lamps as data, and the rules that they keep so that a dark frame tells where the pad is and how it is turned."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64

FEWEST, MOST = 5, 40
"""Numbers of lamps of a pad that has any: with four in view nothing would tell a pad from four other lights."""
_WIDTH_LEAST = 0.2
"""Least extent of the lamps across their longest line, as a part of that: of a row of lamps the far side is not told apart."""
_ALIKE = 0.25
"""Part of the distance between two lamps by which a turned pattern must miss a lamp, or the pattern looks the same."""


class Lamp(Struct, frozen=True, forbid_unknown_fields=True):
    """A lamp that shines upwards from the pad."""

    at_m: tuple[float, float]
    """Its place: along the arrow and to starboard, from the pad's centre."""
    radius_m: Annotated[float, Meta(ge=0.001, le=0.2)] = 0.012
    """Radius of what shines."""


def places_of(lamps: Sequence[Lamp]) -> F64:
    """Return the places of lamps, (N, 2) m."""
    return np.array([lamp.at_m for lamp in lamps], dtype=float).reshape(-1, 2)


def points_of(lamps: Sequence[Lamp]) -> F64:
    """Return the places of lamps as points of the pad's plane, (N, 3) m."""
    return np.pad(places_of(lamps), ((0, 0), (0, 1)))


def check_lamps(lamps: Sequence[Lamp], where: str) -> None:
    """Check that lamps make a pattern that can be told apart from any other heading of it.

    Raises:
        BadInput: too few, two in one place, all in a line, or a pattern that looks the same after a turn.
    """
    if not lamps:
        return
    if len(lamps) < FEWEST:
        raise BadInput(f"{where}: lamps has {len(lamps)}: fewer than {FEWEST} are taken for any lights on a deck: add some")
    for (i, a), (j, b) in combinations(enumerate(lamps), 2):
        if math.dist(a.at_m, b.at_m) < a.radius_m + b.radius_m:
            raise BadInput(f"{where}: lamps[{j}] at {list(b.at_m)} touches lamps[{i}] at {list(a.at_m)}: take one out")
    places = places_of(lamps)
    long, wide = np.linalg.svd(places - places.mean(axis=0), compute_uv=False).tolist()
    if wide < _WIDTH_LEAST * long:
        raise BadInput(f"{where}: the lamps lie in a line: place some of them beside it")
    for n in range(2, len(lamps) + 1):
        if _looks_alike(places, math.tau / n):
            raise BadInput(
                f"{where}: the lamps look the same after a turn by {360 / n:g} degrees: leave one out, or move one, so that "
                "their heading can be told"
            )


def _looks_alike(places: F64, angle_rad: float) -> bool:
    """Return whether each lamp lies near another one's place after a turn about the pad's centre."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    turned = places @ np.array([[c, s], [-s, c]])
    off = np.linalg.norm(turned[:, None] - places[None], axis=2).min(axis=1)
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    nearest = float(apart[~np.eye(len(places), dtype=bool)].min())
    return bool(np.all(off < _ALIKE * nearest))
