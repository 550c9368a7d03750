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

import dataclasses
from types import MappingProxyType

import numpy as np
from msgspec import structs

from estimator.contracts.estimates import CENTRE, Feature, Method, RelativeState, Sighting
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation
from estimator.vision.deck.memory import DeckMemory
from estimator.vision.detect.acquire import FRESH_SEARCH
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detect.template import fade
from estimator.vision.detection import Detection, PadCheck, covered, fuse
from estimator.vision.pad.information import alike_headings
from estimator.vision.register.tone import with_tone
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.expected import ExpectedPlace
from estimator.vision.track.memory import Now, Registered, TrackerMemory
from estimator.vision.track.read_deck import COVER_NS, shows_deck
from estimator.vision.track.register import by_thesis, rays_of, register, verify_cues

_NEAR_DRAWN_M, _SQUARE = 0.4, 0.5 * np.array([(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0)])
"""Width of the outline of something about the pad, whose own is not known; an outline of one metre."""


def by_paint(
    tracker: TrackerConfig, memory: TrackerMemory, frame: Frame, attitude: Attitude | None, belief: RelativeState | None
) -> tuple[Detection, TrackerMemory]:
    """Return the detection of the painted pad, and the new memory, in which the rest of the frame is unread."""
    if memory.tone.steps:
        tracker = dataclasses.replace(tracker, camera=with_tone(tracker.camera, memory.tone.steps))
    place = ExpectedPlace.of(belief, frame, tracker, memory.alike_yaw_rad)
    orientation = Orientation.of(attitude, tracker.options.deck_tilt_sigma_rad)
    now = Now(tracker, frame, FrameView(Pyramid(frame.px), tracker.camera, tracker.pad), attitude, orientation, memory)
    registered, left = register(now, belief, place)
    thesis = None
    if tracker.options.method != "registration":
        thesis, registered = verify_cues(now, by_thesis(tracker, frame, attitude), registered, place)
    settled, at = registered.settled(), frame.stamp.measured_at
    best, elsewhere = settled.tracked, None if settled.elsewhere is None else settled.elsewhere.sighting
    is_sure, deck = best is not None and best.is_sure, memory.deck if tracker.watches else DeckMemory()
    check = deck.check(at)
    found = None if best is None else _add_outlines(best, check, tracker.camera)
    opinions = None if best is None else best.opinions
    methods: dict[Method, Sighting | None] = {**({} if thesis is None else thesis.methods), "registration": found}
    selected, chosen = found, None if found is None else found.method
    if thesis is not None:
        selected = fuse(cue for cue in methods.values() if cue is not None and not place.excludes(cue))
        chosen = None if selected is None else selected.method
    selected, elsewhere, unfinished = covered(selected), covered(elsewhere), left is not FRESH_SEARCH
    seen = Detection(selected, chosen, MappingProxyType(methods), opinions, elsewhere, check, unfinished=unfinished)
    alike = best is not None and is_sure and best.sighting.yaw_ambiguous and alike_headings(tracker.pad) > 1
    yaw_rad = best.sighting.yaw_rad if best is not None and alike else None
    paint = fade(memory.paint) if best is None else best.paint
    tone, back = memory.tone, (memory.tone.steps < 0) - (memory.tone.steps > 0)
    tone = tone if is_sure or not back else dataclasses.replace(tone, steps=tone.steps + back)
    pose = best.found.pose if best is not None and is_sure and shows_deck(now, best, belief) else None
    due = (tracker.watches and deck.is_due(at, now.view, pose)) or (best is not None and is_sure and tone.is_due(best.found, at))
    unread, cover = (now, best, belief) if due else None, None
    if best is not None and is_sure and best.cut is not None:
        is_known = memory.cover is not None and 0 <= at - memory.cover[1] < COVER_NS
        cover = memory.cover if is_known else (rays_of(best.found.pose).T @ best.cut, at)
    return seen, TrackerMemory(paint, left, yaw_rad, deck=deck, tone=tone, cover=cover, unread=unread)


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
