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
import math
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from msgspec import Struct, structs

from estimator.contracts.estimates import CENTRE, Feature, IntegrityAlert, Method, RelativeState, Sighting
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs
from estimator.integrity.guard import excludes
from estimator.integrity.options import IntegrityOptions
from estimator.vision.about_pad import DeckMemory, watch_around, watch_passing
from estimator.vision.camera import Camera
from estimator.vision.clear_deck import check_surface
from estimator.vision.detect import verification
from estimator.vision.detect.acquire import FRESH_SEARCH, PadCandidate, SearchMemory, align_at, search
from estimator.vision.detect.guesses import Plane, heading, pose_about
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detect.template import FRESH, LEARNED_AT, PaintMemory, fade
from estimator.vision.detect.verification import calibrate
from estimator.vision.detection import Detection, Opinions, PadCheck, agree, covered, fuse
from estimator.vision.learned.second_opinion import WORTH_ASKING
from estimator.vision.pad import Pad
from estimator.vision.pad_information import alike_headings
from estimator.vision.pose import Orientation, PadPose
from estimator.vision.register.registration import (
    SRGB,
    Registration,
    RegistrationOptions,
    ToneMemory,
    learn_tone,
    nearest_of_four,
    sighting_of_look,
    with_tone,
)
from estimator.vision.thesis.detection import detect
from estimator.vision.thesis.segmentation import COLOUR_SETS
from estimator.vision.tracker_config import TrackerConfig
from estimator.vision.verified import CLOSE, CODED_PX, ROUGH, SURE, Verified, verify

_FRESH_S = 1.0
"""Age of the newest fused sighting up to which a belief excludes places."""
_REACH_OF_DISC, _REACH_OF_HEIGHT = 0.6, 0.04
"""Reach of tracking, as fractions of the disc's radius and of the height. Tracking is tried if two standard deviations of
the expected position lie within the sum.

Much of the belief's uncertainty comes from the attitude and does not show in the frame. A start that is too far off only costs a
search.
"""


class ExpectedPlace(Struct, frozen=True, eq=False):
    """Expected and excluded places of the pad in the frame, by the filter's estimate."""

    state: RelativeState | None
    """None if it is not fresh, not consistent or not sharp: then it excludes no place."""
    integrity: IntegrityOptions

    @staticmethod
    def of(belief: RelativeState | None, frame: Frame, tracker: TrackerConfig, alike_yaw_rad: float | None) -> ExpectedPlace:
        """Return what a belief says. That a pad is seen elsewhere makes it no less consistent here.

        Args:
            alike_yaw_rad: the heading if the belief has none.
        """
        if belief is not None:
            consistent = belief.consistent or belief.alerts == (IntegrityAlert.ELSEWHERE,)
            fresh = belief.age_s(frame.stamp.measured_at) <= _FRESH_S
            if consistent and fresh and near_enough(belief, sigma_of(belief), tracker.pad, alike_yaw_rad):
                return ExpectedPlace(belief, tracker.integrity)
        return ExpectedPlace(None, tracker.integrity)

    def excludes(self, seen: Sighting) -> bool:
        """Return whether a pad in that place is not the tracked one."""
        return self.state is not None and excludes(self.state, seen, self.integrity)


def expected(belief: RelativeState, attitude: Attitude, camera: Camera, alike_yaw_rad: float | None = None) -> PadPose | None:
    """Return the pose in camera coordinates that the belief predicts for a level deck; None without a heading.

    Args:
        alike_yaw_rad: the heading if the belief has none.
    """
    yaw_rad = alike_yaw_rad if belief.yaw_rad is None else belief.yaw_rad
    if yaw_rad is None:
        return None
    return in_camera(belief.d_body_pad_level, yaw_rad, attitude.R_ned_body.without_heading(), camera)


def in_camera(d_body_pad_level: F64, yaw_rad: float, R_level_body: Rotation, camera: Camera) -> PadPose:
    """Return the pose in camera coordinates of a pad on a level deck."""
    R_cam_body = camera.T_body_cam.R.inv
    R_cam_level = R_cam_body @ R_level_body.inv
    t = R_cam_level @ d_body_pad_level - R_cam_body @ camera.T_body_cam.t
    return PadPose(R_cam_level @ Rotation.from_rpy(0.0, 0.0, -yaw_rad), t)


def near_enough(belief: RelativeState, sigma_m: float, pad: Pad, alike_yaw_rad: float | None) -> bool:
    """Return whether the belief is certain enough to start tracking from."""
    remembered = belief.yaw_rad is None and alike_yaw_rad is not None
    sigma_yaw = 0.0 if remembered else math.sqrt(float(belief.cov[6, 6]))
    reach_m = _REACH_OF_DISC * pad.disc_radius_m + _REACH_OF_HEIGHT * belief.height_m
    return 2.0 * sigma_m < reach_m and sigma_yaw < 0.3


def sigma_of(belief: RelativeState) -> float:
    """Return the standard deviation of the pad's position along its worst direction, metres."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = belief.cov[:3, :3].tolist()
    mean, off2 = (xx + yy + zz) / 3.0, xy * xy + xz * xz + yz * yz
    x, y, z = xx - mean, yy - mean, zz - mean
    # The largest eigenvalue in closed form (Smith, Comm. ACM 4(4), 1961): LAPACK's takes ten times as long between two frames.
    spread = math.sqrt((x * x + y * y + z * z + 2.0 * off2) / 6.0)
    half = (x * (y * z - yz * yz) - xy * (xy * z - yz * xz) + xz * (xy * yz - y * xz)) / max(2.0 * spread**3, 1e-300)
    return math.sqrt(mean + 2.0 * spread * math.cos(math.acos(max(-1.0, min(1.0, half))) / 3.0))


@dataclass(frozen=True, slots=True, eq=False)
class TrackerMemory:
    """The state that vision keeps from frame to frame."""

    paint: PaintMemory = FRESH
    search: SearchMemory = FRESH_SEARCH
    alike_yaw_rad: float | None = None
    """The heading at which a pad that looks the same from several was last registered: the belief does not take it."""
    lit: bool = False
    """True if the pad was last seen by its lamps."""
    reversed: bool = False
    """True if the light of the pad was last seen reversed; only of pads whose files allow that."""
    deck: DeckMemory = field(default_factory=DeckMemory)
    """Things that were seen on the pad and about it."""
    tone: ToneMemory = SRGB
    """The camera's tone curve as far as it was learnt."""
    cover: tuple[F64, MonoNs] | None = None
    """The line on the pad beyond which something covers it, (3,) as `alignment.UNCUT`, and when it was found."""
    unread: tuple[_Now, _Registered | None, RelativeState | None] | None = None
    """The newest frame, the pad that it shows, and the belief about it, if it is left to `read_deck`."""


_CLOSE_PX = 1.0
"""Largest standard deviation of the expected position in the frame at which registration starts directly from it."""
_SEARCHED = 0.75
"""Share of a frame's work at which a search ends: the rest is for the registration of a candidate."""
_CANDIDATES = 2
"""Number of candidates of acquisition that are registered, those after the first while the frame's work lasts."""
WORTH_A_TRY = 0.03
"""Score of a candidate of acquisition, or of a drawing at a method's pose, below which it is not registered."""
_AGREES, _WORTH_ANOTHER, _BETTER = 0.6, 0.85, 0.15
"""Share of a near pad's visible edges that agree with a registration: below the first the belief's place is searched for again,
below the second another start is tried, and the third is the difference by which the other one is better. Edges repeat on a near
pad, and a registration from a start one edge off holds 0.06 to 0.66 of them at any confidence, from the right one 0.99 and more.
"""
_EXPECTED_SIGMAS = 3.0
"""Standard deviations of the expected position within which a candidate of acquisition counts as expected."""
_COVER_NS, _COVER_SURE = 250_000_000, 0.9
"""Time for which a cover is taken to lie where it was found, and the least confidence and agreement of what is seen beside it."""
_SUPPORTED = 0.2
"""Confidence from which what is found at the expected place is the tracked pad although something else is surer."""
_NEAR_DRAWN_M, _SQUARE = 0.4, 0.5 * np.array([(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0)])
"""Width of the outline of something about the pad, whose own is not known; an outline of one metre."""
_SHOWS, _PLACE_M, _TURNED_RAD = 0.5, 0.08, 0.1
"""Limits for reading the pad's surface. First: share of the edges that agree with a registration. Second, without a
registration: standard deviation of the predicted place, in radii of the disc. Third: how far a heading is off the belief's."""
_SMALL_PX, _LEAST_ABOUT = 15.0, 0.12
"""Radius of the disc, px, below which a pad that the estimate did not lead to is searched some pixels about its place.

The least fraction of the variance that the drawing must explain there: of pads in glare or half covered it is 0.16 or more.
"""


@dataclass(frozen=True, slots=True, eq=False)
class _Now:
    """Inputs of one frame's tracking."""

    tracker: TrackerConfig
    frame: Frame
    view: FrameView
    attitude: Attitude | None
    orientation: Orientation
    """The attitude at the exposure and the deck's expected tilt."""
    memory: TrackerMemory


@dataclass(frozen=True, slots=True, eq=False)
class _Registered:
    sighting: Sighting
    paint: PaintMemory
    found: Registration
    opinions: Opinions | None = None
    cut: F64 | None = None
    """The line in the frame beyond which something covers the pad; see `alignment.UNCUT`."""

    @property
    def agreement(self) -> float:
        """Share of a near pad's visible edges that agree with it; 1 of a distant pad, which has no edges of its own."""
        return 1.0 if self.found.dense else self.found.inliers

    @property
    def is_sure(self) -> bool:
        return self.sighting.confidence >= SURE


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """The best registrations of one frame."""

    tracked: _Registered | None = None
    """The surest one that may be the tracked pad."""
    elsewhere: _Registered | None = None
    """The surest one in a place that the belief excludes."""

    def having(self, of: _Registered | None, belief: ExpectedPlace) -> _Seen:
        """Return the best with one more registration; of two that are equally sure the first stays."""
        if of is None:
            return self
        if belief.excludes(of.sighting):
            return self if _stays(self.elsewhere, of) else dataclasses.replace(self, elsewhere=of)
        best = self.tracked if self.tracked is not None and _stays(self.tracked, of) else of
        return dataclasses.replace(self, tracked=_spread(best, self.tracked, of))

    @property
    def is_sure(self) -> bool:
        return self.tracked is not None and self.tracked.is_sure

    @property
    def agrees(self) -> bool:
        """True if the tracked pad's edges are at its place, and not on other edges that look alike."""
        return self.tracked is not None and self.tracked.agreement >= _AGREES

    def settled(self) -> _Seen:
        """Return the tracked pad with what is surer elsewhere; without it if the frame hardly supports it beside that."""
        if self.elsewhere is None or _surer(self.tracked, self.elsewhere):
            return _Seen(self.tracked)
        supported = self.tracked is not None and self.tracked.sighting.confidence >= _SUPPORTED
        return self if supported else _Seen(None, self.elsewhere)


def by_paint(
    tracker: TrackerConfig, memory: TrackerMemory, frame: Frame, attitude: Attitude | None, belief: RelativeState | None
) -> tuple[Detection, TrackerMemory]:
    """Return the detection of the painted pad, and the new memory, in which the rest of the frame is unread."""
    if memory.tone.steps:
        tracker = dataclasses.replace(tracker, camera=with_tone(tracker.camera, memory.tone.steps))
    place = ExpectedPlace.of(belief, frame, tracker, memory.alike_yaw_rad)
    orientation = Orientation.of(attitude, tracker.options.deck_tilt_sigma_rad)
    now = _Now(tracker, frame, FrameView(Pyramid(frame.px), tracker.camera, tracker.pad), attitude, orientation, memory)
    registered, left = _register(now, belief, place)
    thesis = None
    if tracker.options.method != "registration":
        thesis, registered = _verify_cues(now, by_thesis(tracker, frame, attitude), registered, place)
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
    pose = best.found.pose if best is not None and is_sure and _shows(now, best, belief) else None
    due = (tracker.watches and deck.is_due(at, now.view, pose)) or (best is not None and is_sure and tone.is_due(best.found, at))
    unread, cover = (now, best, belief) if due else None, None
    if best is not None and is_sure and best.cut is not None:
        is_known = memory.cover is not None and 0 <= at - memory.cover[1] < _COVER_NS
        cover = memory.cover if is_known else (_rays_of(best.found.pose).T @ best.cut, at)
    return seen, TrackerMemory(paint, left, yaw_rad, deck=deck, tone=tone, cover=cover, unread=unread)


def _rays_of(pose: PadPose) -> F64:
    """Return the matrix, (3, 3), that takes a place on the pad, x, y and 1, to its ray, times its depth."""
    return np.column_stack([pose.R_cam_pad.matrix[:, :2], pose.t_cam_pad])


def read_deck(seen: Detection, memory: TrackerMemory) -> tuple[Detection, TrackerMemory]:
    """Return a detection with what its frame shows on the pad and about it, and the memory, which learns the tone, too.

    A frame in which something about the pad is read has cost enough: the tone is learnt in the next ones.
    """
    if memory.unread is None:
        return seen, memory
    (now, best, belief), deck, tone = memory.unread, memory.deck, memory.tone
    at = now.frame.stamp.measured_at
    if now.tracker.watches:
        deck = _watch_deck(now, deck, best, belief)
    if best is not None and best.is_sure and deck.around is memory.deck.around and deck.passing is memory.deck.passing:
        tone = learn_tone(tone, now.view, best.found, now.orientation, at)
    seen = seen if seen.chosen == "lamps" else structs.replace(seen, on_pad=deck.check(at))
    return seen, dataclasses.replace(memory, deck=deck, tone=tone, unread=None)


def _add_outlines(best: _Registered, check: PadCheck | None, camera: Camera) -> Sighting:
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


def _watch_deck(now: _Now, memory: DeckMemory, best: _Registered | None, belief: RelativeState | None) -> DeckMemory:
    """Return the memory of things on the pad and about it, with what the frame shows of one of them.

    A frame in which one of them is read has cost enough: the others follow in the next ones.
    """
    at = now.frame.stamp.measured_at
    shows = best is not None and _shows(now, best, belief)
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
    now: _Now, found: Registration | None, sure: bool, belief: RelativeState | None
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
    if sigma_m > _PLACE_M * now.tracker.pad.disc_radius_m:
        return None
    start = expected(belief, now.attitude, now.tracker.camera, now.memory.alike_yaw_rad)
    if start is None or start.t_cam_pad[2] < 0.05:
        return None
    if registered is not None and float(np.linalg.norm(registered[0].t_cam_pad - start.t_cam_pad)) < _EXPECTED_SIGMAS * sigma_m:
        return registered
    return start, 1.0, sigma_m


def _shows(now: _Now, best: _Registered, belief: RelativeState | None) -> bool:
    """Return whether the deck can be read where a registration puts it: all that is painted moves against a wrong heading."""
    yaw_rad, known_rad = best.sighting.yaw_rad, None if belief is None else belief.yaw_rad
    if yaw_rad is None or known_rad is None or alike_headings(now.tracker.pad) > 1:
        return best.agreement >= _SHOWS
    return best.agreement >= _SHOWS and abs(math.remainder(yaw_rad - known_rad, math.pi)) < _TURNED_RAD


def by_thesis(tracker: TrackerConfig, frame: Frame, attitude: Attitude | None) -> Detection:
    """Return what the thesis' methods detect."""
    o = tracker.options
    return detect(frame, attitude, tracker.camera, tracker.pad, COLOUR_SETS[o.colours], sigma_deck_rad=o.deck_tilt_sigma_rad)


def _register(now: _Now, belief: RelativeState | None, place: ExpectedPlace) -> tuple[_Seen, SearchMemory]:
    """Register where the belief expects the pad, else where a search finds it; return the best, and what the search leaves."""
    camera, pad, attitude, alike_yaw_rad = now.tracker.camera, now.tracker.pad, now.attitude, now.memory.alike_yaw_rad
    left, best, suspect = FRESH_SEARCH, _Seen(), False
    start: PadPose | None = None
    sigma_m = math.inf if belief is None else sigma_of(belief)
    if belief is not None and attitude is not None and near_enough(belief, sigma_m, pad, alike_yaw_rad):
        start = expected(belief, attitude, camera, alike_yaw_rad)
        if start is not None and start.t_cam_pad[2] > 0.05:
            options = CLOSE if sigma_m * camera.fx < _CLOSE_PX * start.t_cam_pad[2] else ROUGH
            tracked = verification.TRACKED_LOG_ODDS
            cover, beside = now.memory.cover, None
            if cover is not None and 0 <= now.frame.stamp.measured_at - cover[1] < _COVER_NS:
                cut = np.asarray(np.linalg.solve(_rays_of(start).T, cover[0]))
                beside = _register_from(now, start, CLOSE, tracked, cut, searched=False)
            if beside is None or min(beside.sighting.confidence, beside.agreement) < _COVER_SURE:
                beside = _register_from(now, start, options, tracked, searched=False)
            best = best.having(beside, place)
            suspect = options is ROUGH and best.tracked is not None and best.tracked.agreement < _WORTH_ANOTHER
            if suspect:
                # The whole drawing, blurred, draws from farther away than edges do.
                aligned = align_at(start, now.orientation.measured, now.view)
                if aligned is not None and aligned.score >= WORTH_A_TRY:
                    best = best.having(_register_from(now, aligned.pose, CLOSE, tracked, searched=False), place)
            by_parts = pad.markings.is_searched_by_parts and not pad.markings.is_letter_alone
            if not best.is_sure and by_parts and start.disc_px(camera, pad) < _SMALL_PX:
                plane = Plane.of(camera, attitude.R_ned_body.without_heading())
                about = pose_about(now.view.as_seen(), plane, start)
                if about is not None and about[1] >= _LEAST_ABOUT:
                    best = best.having(_register_from(now, about[0], CLOSE, tracked, searched=False), place)
    if not best.is_sure or (suspect and not best.agrees):
        R_level_body = None if attitude is None else attitude.R_ned_body.without_heading()
        found = search(now.view, R_level_body, now.memory.paint, now.memory.search, budget=_SEARCHED * now.tracker.search_work)
        left = found.memory
        for number, candidate in enumerate(found.candidates[:_CANDIDATES]):
            # One that is none of the pad takes ten floors and more to be refused, beside what covers it, too.
            if candidate.score < WORTH_A_TRY or (number > 0 and now.view.pyramid.work > now.tracker.search_work):
                break
            off_m = math.inf if start is None else float(np.linalg.norm(candidate.pose.t_cam_pad - start.t_cam_pad))
            prior = verification.TRACKED_LOG_ODDS if off_m < _EXPECTED_SIGMAS * sigma_m else 0.0
            pose = candidate.pose
            if pad.markings.is_letter_alone and alike_headings(pad) == 4:
                R_level_cam = now.orientation.R_level_body.matrix @ camera.T_body_cam.R.matrix
                pose = nearest_of_four(pose, R_level_cam, alike_yaw_rad or 0.0)
            best = best.having(_register_from(now, pose, CLOSE, prior, candidate.cut), place)
            if best.is_sure and (best.agrees or not suspect):
                break
    return best, left


def _verify_cues(now: _Now, thesis: Detection, best: _Seen, place: ExpectedPlace) -> tuple[Detection, _Seen]:
    """Verify the cues of the thesis' methods, and return them with the best registrations.

    A cue's confidence is limited to that of the drawing registered at the cue's pose, unless it agrees with a confident
    registration. The returned registrations are the best of the given ones and those started from cues.
    """
    sure = best.tracked.sighting if best.tracked is not None and best.is_sure else None
    methods: dict[Method, Sighting | None] = dict(thesis.methods)
    for method, cue in thesis.methods.items():
        if cue is None or (sure is not None and agree(cue, sure)):
            continue
        candidate = _align_cue(now.view, cue, now.orientation)
        aligned = None
        if candidate is not None and candidate.score >= WORTH_A_TRY:
            aligned = _register_from(now, candidate.pose, CLOSE)
        methods[method] = structs.replace(
            cue, confidence=0.0 if aligned is None else min(cue.confidence, aligned.sighting.confidence)
        )
        best = best.having(aligned, place)
    return structs.replace(thesis, methods=MappingProxyType(methods)), best


def _align_cue(view: FrameView, cue: Sighting, orientation: Orientation) -> PadCandidate | None:
    """Align the drawing at a cue's pose. A cue without a heading is aligned at the heading that fits best."""
    flat = in_camera(cue.d_body_pad_level, cue.yaw_rad or 0.0, orientation.R_level_body, view.camera)
    if flat.t_cam_pad[2] < 0.05:
        return None
    if cue.yaw_rad is None:
        found = heading(view, flat)
        if found is None:
            return None
        flat = flat.turned(found.turn_rad)
    return align_at(flat, orientation.measured, view)


def _spread(best: _Registered, a: _Registered | None, b: _Registered) -> _Registered:
    """Return the better of two registrations with their difference in its covariance, where neither is better than the other.

    The edge of a shade across the pad holds a part of the drawing's edges off, and another part from each start.
    """
    if a is None or min(a.sighting.confidence, b.sighting.confidence) < SURE:
        return best
    if abs(a.agreement - b.agreement) > _BETTER or max(a.agreement, b.agreement) >= _WORTH_ANOTHER:
        return best
    one, other = a.sighting, b.sighting
    turn = 0.0 if one.yaw_rad is None or other.yaw_rad is None else math.remainder(one.yaw_rad - other.yaw_rad, math.tau)
    # Opposite headings say nothing of how far the pad is turned.
    apart = np.append(one.d_body_pad_level - other.d_body_pad_level, turn if abs(turn) < 0.5 * math.pi else 0.0)
    return dataclasses.replace(best, sighting=structs.replace(best.sighting, cov=best.sighting.cov + np.outer(apart, apart)))


def _stays(a: _Registered | None, b: _Registered) -> bool:
    """Return whether the first of two registrations in the same place is kept: the surer one, or the one whose edges agree."""
    if a is None:
        return False
    both = min(a.sighting.confidence, b.sighting.confidence) >= SURE
    return a.agreement >= b.agreement if both and abs(a.agreement - b.agreement) > _BETTER else _surer(a, b)


def _surer(a: _Registered | None, b: _Registered) -> bool:
    """Return whether the first of two registrations is as sure as the second, or surer."""
    return a is not None and a.sighting.confidence >= b.sighting.confidence


def _register_from(
    now: _Now,
    start: PadPose,
    options: RegistrationOptions,
    prior_log_odds: float = 0.0,
    cut: F64 | None = None,
    *,
    searched: bool = True,
) -> _Registered | None:
    """Register from a start pose and verify the drawing at the result; arguments as for `verify`.

    Args:
        searched: whether the start comes from a search or a cue and not from the belief: then the second opinion is used.
    """
    if now.frame.coded:
        options = dataclasses.replace(options, coded_px=CODED_PX)
    paint = now.memory.paint
    of = verify(now.view, start, now.orientation, options, prior_log_odds, cut, paint)
    if of is None:
        return None
    opinions = _second_opinion(now, of) if searched else None
    # The network can only lower a confidence.
    sure = of.confidence if opinions is None else min(of.confidence, opinions.learned)
    learned = fade(paint) if sure < SURE else of.found.paint() if sure >= LEARNED_AT else paint
    # A letter alone tells too little to be surer than its bound.
    said = sure if now.tracker.pad.markings.is_letter_alone else calibrate(sure)
    return _Registered(sighting_of_look(now.frame, of.found, said), learned, of.found, opinions, of.cut)


def _second_opinion(now: _Now, of: Verified) -> Opinions | None:
    """Return both opinions on a registration; None if the second opinion is not used or sees too little of the pad."""
    network = now.tracker.second_opinion
    if network is None or of.confidence < WORTH_ASKING:
        return None
    log_odds = network.log_odds(*now.view, of.found.pose, of.cut)
    return None if log_odds is None else Opinions(of.confidence, verification.confidence(log_odds))
