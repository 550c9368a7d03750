"""Which pad a sighting is about: the one that is followed, or another one.

A sighting belongs to the track when motion explains its place: it lies where the belief expects the pad (the IMU at full rate is
in that), or right beside the sighting before it. Anything else is a candidate with its own short history. The track is never
moved to a candidate: after `adopt_s` in which one candidate alone was seen the track ends, and a new one with a higher number
begins. Who steers sees the number change.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from estimator.integrity.options import IntegrityOptions

_BESIDE_S = 0.1
"""How old the sighting before may be for its neighbourhood to explain the next one."""
_SPEED_M_S, _ACCELERATION_M_S2 = 1.0, 6.0
"""By how much two sightings of one pad may differ a second besides: velocity and tilt of the vehicle against the deck."""
_BELIEF_SIGMAS, _BELIEF_MAX_M = 3.0, 1.5
_ALIVE_S = 1.0
_MOST = 4
_SEEN_AT_LEAST = 3
_ESTABLISHED = 8


class Place(NamedTuple):
    """Where a pad was seen from the body, in axes of fixed heading."""

    t: int
    """ns."""
    d: tuple[float, float, float]
    """m; down is third."""
    sigma_m: float
    """Of one component."""


class Candidate(NamedTuple):
    """Another place in which a pad is seen."""

    first: int
    """ns."""
    n: int
    last: Place


class Tracks(NamedTuple):
    """The track and its rivals."""

    number: int = 0
    """0 before the first sighting."""
    n: int = 0
    """Sightings of this track."""
    last: Place | None = None
    candidates: tuple[Candidate, ...] = ()

    def disputed(self, now: int) -> bool:
        """Whether a pad was seen elsewhere more than by accident within the last second."""
        return any(c.n >= _SEEN_AT_LEAST and now - c.last.t <= _ALIVE_S * 1e9 for c in self.candidates)


def judge(tracks: Tracks, seen: Place, expected: Place | None, o: IntegrityOptions) -> tuple[Tracks, bool]:
    """Take one sighting.

    Args:
        expected: the belief's place at that instant with its uncertainty; None without one.

    Returns:
        The new tracks, and whether the sighting is about the track. `fused` says later whether the estimator took it.
    """
    last = tracks.last
    if last is None:
        return Tracks(1, 0, seen), True
    near_last = abs(seen.t - last.t) <= _BESIDE_S * 1e9 and _beside(last, seen, o)
    if near_last or (expected is not None and _as_expected(expected, seen, o)):
        return tracks, True
    candidates = _with(tracks.candidates, seen, o)
    chosen = next(c for c in candidates if c.last is seen)
    if tracks.n < _ESTABLISHED:
        # Nobody has flown by the track yet; whichever is seen more is the pad.
        if chosen.n > max(tracks.n, _SEEN_AT_LEAST):
            return Tracks(tracks.number, chosen.n, seen), True
    elif _adopted(tracks, chosen, candidates, o):
        return Tracks(tracks.number + 1, chosen.n, seen), True
    return tracks._replace(candidates=candidates), False


def fused(tracks: Tracks, seen: Place) -> Tracks:
    """The estimator took the sighting: the next one is compared with it."""
    last = tracks.last if tracks.last is not None and tracks.last.t > seen.t else seen
    alive = tuple(c for c in tracks.candidates if seen.t - c.last.t <= 2.0 * _ALIVE_S * 1e9)
    return tracks._replace(n=tracks.n + 1, last=last, candidates=alive)


def _adopted(tracks: Tracks, chosen: Candidate, candidates: tuple[Candidate, ...], o: IntegrityOptions) -> bool:
    seen = chosen.last.t
    alone = all(c is chosen or c.n < _SEEN_AT_LEAST or seen - c.last.t > _ALIVE_S * 1e9 for c in candidates)
    unseen = tracks.last is None or tracks.last.t < chosen.first
    return alone and unseen and chosen.n >= _ESTABLISHED and seen - chosen.first >= o.adopt_s * 1e9


def _with(candidates: tuple[Candidate, ...], seen: Place, o: IntegrityOptions) -> tuple[Candidate, ...]:
    """The candidates with one more look: it joins the one that it lies beside, or begins another."""
    out, joined = [], False
    for c in candidates:
        age = seen.t - c.last.t
        if not joined and abs(age) <= _ALIVE_S * 1e9 and _beside(c.last, seen, o):
            out.append(Candidate(c.first, c.n + 1, seen))
            joined = True
        elif age <= 2.0 * _ALIVE_S * 1e9:
            out.append(c)
    if not joined:
        out.append(Candidate(seen.t, 1, seen))
    return tuple(sorted(out, key=lambda c: c.last.t)[-_MOST:])


def _base_m(seen: Place, o: IntegrityOptions) -> float:
    return o.place_step_m + o.place_step_share * abs(seen.d[2])


def _beside(last: Place, seen: Place, o: IntegrityOptions) -> bool:
    dt = abs(seen.t - last.t) * 1e-9
    moved = _SPEED_M_S * dt + 0.5 * _ACCELERATION_M_S2 * dt * dt
    return math.dist(last.d, seen.d) <= _base_m(seen, o) + 4.0 * math.hypot(last.sigma_m, seen.sigma_m) + moved


def _as_expected(expected: Place, seen: Place, o: IntegrityOptions) -> bool:
    doubt = min(_BELIEF_SIGMAS * expected.sigma_m, _BELIEF_MAX_M) + 4.0 * seen.sigma_m
    return math.dist(expected.d, seen.d) <= _base_m(seen, o) + doubt
