"""Read the deck where a frame shows the pad: what lies on it, what is about it, and the camera's tone."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from msgspec import structs

from estimator.contracts.estimates import RelativeState
from estimator.vision.camera.pose import PadPose
from estimator.vision.deck.around import watch_around
from estimator.vision.deck.clear_deck import check_surface
from estimator.vision.deck.memory import DeckMemory
from estimator.vision.deck.passing import watch_passing
from estimator.vision.detection import Detection
from estimator.vision.pad.information import alike_headings
from estimator.vision.register.registration import Registration
from estimator.vision.register.tone import learn_tone
from estimator.vision.track.expected import EXPECTED_SIGMAS, expected, sigma_of
from estimator.vision.track.memory import Now, Registered, TrackerMemory

_SHOWS = 0.5  # Least share of the edges that agree with a registration at which the deck is read
_PLACE_RADII = 0.08
"""Largest standard deviation, in radii of the disc, of a predicted place at which it is read without a registration."""
_TURNED_RAD = 0.1  # Largest difference of a heading from the belief's
_UNSEEN_BLUR_PX = 1.0  # Blur that is assumed without a registration


def read_deck(seen: Detection, memory: TrackerMemory) -> tuple[Detection, TrackerMemory]:
    """Return a detection with what its frame shows on the pad and about it, and the memory, which learns the tone, too.

    A frame in which something about the pad is read has cost enough: the tone is learnt in the next ones.
    """
    if memory.unread is None:
        return seen, memory
    (now, best, belief), deck, tone = memory.unread, memory.deck, memory.tone
    if now.tracker.watches:
        deck = _watch_deck(now, deck, best, belief)
    if best is not None and best.is_sure and deck.around is memory.deck.around and deck.passing is memory.deck.passing:
        tone = learn_tone(tone, now.view, best.found, now.orientation, now.at)
    seen = seen if seen.chosen == "lamps" else structs.replace(seen, on_pad=deck.check(now.at))
    return seen, dataclasses.replace(memory, deck=deck, tone=tone, unread=None)


def _watch_deck(now: Now, memory: DeckMemory, best: Registered | None, belief: RelativeState | None) -> DeckMemory:
    """Return the memory of things on the pad and about it, with what the frame shows of one of them.

    A frame in which one of them is read has cost enough: the others follow in the next ones.
    """
    at = now.at
    shows = best is not None and shows_deck(now, best, belief)
    where = _surface_of(now, best.found if best is not None and shows else None, best is not None and best.is_sure, belief)
    if where is not None:
        surface = check_surface(memory.surface, now.view, where[0], at, *where[1:])
        if surface is not memory.surface:
            return dataclasses.replace(memory, surface=surface)
    if best is None or not (shows and best.is_sure):
        return memory
    around = watch_around(memory.around, now.view, best.found.pose, at)
    if around is not memory.around:
        return dataclasses.replace(memory, around=around)
    return dataclasses.replace(memory, passing=watch_passing(memory.passing, now.view, best.found.pose, at))


def _surface_of(
    now: Now, found: Registration | None, sure: bool, belief: RelativeState | None
) -> tuple[PadPose, float, float] | None:
    """Return the pose at which the pad's surface is read, and the sigmas of its blur, px, and of its place, m; None if unknown.

    The pad is where it is registered. What lies on it may hide most of the drawing: then it is where the rest is registered close
    to where the pad is believed, else where it is believed.

    Args:
        found: a registration at which the deck can be read.
    """
    registered = None
    if found is not None:
        registered = found.pose, found.blur_px, math.sqrt(max(0.0, float(found.cov.diagonal()[:2].max())))
    if registered is not None and sure:
        return registered
    if belief is None or now.attitude is None or not belief.consistent:
        return None
    sigma_m = math.hypot(sigma_of(belief), belief.height_m * math.sqrt(float(now.orientation.cov_tilt.diagonal().max())))
    if sigma_m > _PLACE_RADII * now.tracker.pad.disc_radius_m:
        return None
    start = expected(belief, now.attitude, now.tracker.camera, now.memory.alike_yaw_rad)
    if start is None or start.t_cam_pad[2] < 0.05:
        return None
    if registered is not None and float(np.linalg.norm(registered[0].t_cam_pad - start.t_cam_pad)) < EXPECTED_SIGMAS * sigma_m:
        return registered
    return start, _UNSEEN_BLUR_PX, sigma_m


def shows_deck(now: Now, best: Registered, belief: RelativeState | None) -> bool:
    """Return whether the deck can be read where a registration puts it: all that is painted moves against a wrong heading."""
    yaw_rad, known_rad = best.sighting.yaw_rad, None if belief is None else belief.yaw_rad
    if yaw_rad is None or known_rad is None or alike_headings(now.tracker.pad) > 1:
        return best.agreement >= _SHOWS
    return best.agreement >= _SHOWS and abs(math.remainder(yaw_rad - known_rad, math.pi)) < _TURNED_RAD
