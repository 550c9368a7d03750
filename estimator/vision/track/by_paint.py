"""See the pad by its paint: follow it where the filter expects it, else search the whole frame.

Tracking starts `registration` from the filter's belief at the exposure. If there is no belief, or the drawing does not fit there,
acquisition searches the whole frame and registration refines its candidates. In both cases the classifier of `verification`
scores the whole drawing and the agreement of its edges at the registered pose, and that score is the sighting's confidence. If
one of the thesis' methods reports a pose on its own, the drawing is verified there too, because a green disc is not yet a pad; if
it fits, registration starts from it.

A fresh belief weighs in. What is found in a place that it excludes does not take the tracked pad's place, however sure it is: it
is reported beside it (`Detection.elsewhere`), because a belief can be wrong, and the guard judges it.
"""

from __future__ import annotations

from types import MappingProxyType

import numpy as np
from msgspec import structs

from estimator.contracts.estimates import CENTRE, Feature, Method, RelativeState, Sighting
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.tables import imported
from estimator.vision.camera.camera import Camera
from estimator.vision.detect.acquire import FRESH_SEARCH, SearchMemory
from estimator.vision.detect.template import fade
from estimator.vision.detection import Detection, PadCheck, covered, fuse
from estimator.vision.pad.information import alike_headings
from estimator.vision.track.config import THESIS, TrackerConfig
from estimator.vision.track.expected import ExpectedPlace
from estimator.vision.track.memory import Now, Registered, Seen, TrackerMemory
from estimator.vision.track.read_deck import shows_deck
from estimator.vision.track.register import register

_NEAR_DRAWN_M = 0.4  # Width of the outline of something about the pad, whose own is not known
_SQUARE = 0.5 * np.array([(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0)])  # An outline of one metre


def by_paint(
    tracker: TrackerConfig, memory: TrackerMemory, frame: Frame, attitude: Attitude | None, belief: RelativeState | None
) -> tuple[Detection, TrackerMemory]:
    """Return the detection of the painted pad, and the new memory, in which the rest of the frame is unread."""
    now = Now.of(tracker, memory, frame, attitude)
    place = ExpectedPlace.of(belief, frame, now.tracker, memory.alike_yaw_rad)
    registered, left = register(now, belief, place)
    thesis = None
    if tracker.options.method != "registration":
        by_thesis = imported(THESIS)
        thesis, registered = by_thesis.verify_cues(now, by_thesis.by_thesis(now.tracker, frame, attitude), registered, place)
    settled = registered.settled()
    seen = _detection(now, settled, thesis, place)
    return structs.replace(seen, unfinished=left is not FRESH_SEARCH), _remembered(now, settled.tracked, left, belief)


def _detection(now: Now, settled: Seen, thesis: Detection | None, place: ExpectedPlace) -> Detection:
    """Return a frame's detection: the best registration, or all methods fused if the thesis' are among them."""
    best, check = settled.tracked, now.deck.check(now.at)
    selected = found = None if best is None else _add_outlines(best, check, now.tracker.camera)
    methods: dict[Method, Sighting | None] = {"registration": found}
    if thesis is not None:
        methods = {**thesis.methods, "registration": found}
        selected = fuse(cue for cue in methods.values() if cue is not None and not place.excludes(cue))
    return Detection(
        covered(selected),
        None if selected is None else selected.method,
        MappingProxyType(methods),
        None if best is None else best.opinions,
        covered(None if settled.elsewhere is None else settled.elsewhere.sighting),
        check,
    )


def _remembered(now: Now, best: Registered | None, left: SearchMemory, belief: RelativeState | None) -> TrackerMemory:
    """Return the memory after a frame: what a sure registration teaches, and what is left to read.

    Args:
        best: the tracked pad.
        left: what the search leaves.
    """
    sure, memory = best if best is not None and best.is_sure else None, now.memory
    paint = fade(memory.paint) if best is None else best.paint
    if sure is None:
        due = now.tracker.watches and now.deck.is_due(now.at, now.view, None)
        unread = (now, best, belief) if due else None
        return TrackerMemory(paint, left, deck=now.deck, tone=memory.tone.relaxed(), unread=unread)
    pose, alike = sure.found.pose, sure.sighting.yaw_ambiguous and alike_headings(now.tracker.pad) > 1
    due = now.tracker.watches and now.deck.is_due(now.at, now.view, pose if shows_deck(now, sure, belief) else None)
    due = due or memory.tone.is_due(sure.found, now.at)
    cover = None if sure.cut is None else memory.cover_at(now.at) or (pose.rays().T @ sure.cut, now.at)
    return TrackerMemory(
        paint,
        left,
        sure.sighting.yaw_rad if alike else None,
        deck=now.deck,
        tone=memory.tone,
        cover=cover,
        unread=(now, best, belief) if due else None,
    )


def _add_outlines(best: Registered, check: PadCheck | None, camera: Camera) -> Sighting:
    """Return a registration's sighting with the pad's centre, what lies on the pad and what is about it among its features."""
    features = [*best.sighting.features, Feature("point", CENTRE, camera.project(best.found.pose.t_cam_pad[None]))]
    thing, near = (None, None) if check is None else (check.thing, check.near)
    places = [] if thing is None else [(thing.width_m, thing.forward_m, thing.right_m)]
    places += [] if near is None else [(_NEAR_DRAWN_M, near.forward_m, near.right_m)]
    for width_m, forward_m, right_m in places:
        points = best.found.pose.points(width_m * _SQUARE + np.array([forward_m, right_m, 0.0]))
        if points[:, 2].min() > 0.05:
            features.append(Feature("outline", "thing", camera.project(points)))
    return structs.replace(best.sighting, features=tuple(features))
