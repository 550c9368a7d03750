"""The inputs of a frame, its best registrations, and the memory of vision from frame to frame."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field

import numpy as np
from msgspec import structs

from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs
from estimator.vision.camera.pose import Orientation
from estimator.vision.deck.memory import DeckMemory
from estimator.vision.detect.acquire import FRESH_SEARCH, SearchMemory
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detect.template import FRESH, PaintMemory
from estimator.vision.detection import Opinions
from estimator.vision.register.registration import Registration
from estimator.vision.register.tone import SRGB, ToneMemory, with_tone
from estimator.vision.register.verified import SURE
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.expected import ExpectedPlace

_AGREES = 0.6
"""Share of a near pad's visible edges that agree, below which the belief's place is searched again.

Edges repeat on a near pad, and a registration from a start one edge off holds 0.06 to 0.66 of them at any confidence, from the
right one 0.99 and more.
"""
WORTH_ANOTHER = 0.85
"""Share below which another start is tried."""
_BETTER = 0.15  # Difference in that share by which one registration is better than another
_SUPPORTED = 0.2  # Confidence from which what is found at the expected place is the tracked pad although something else is surer
_COVER_NS = 250_000_000  # Time for which a cover is taken to lie where it was found


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
    unread: tuple[Now, Registered | None, RelativeState | None] | None = None
    """The newest frame, the pad that it shows, and the belief about it, if it is left to `read_deck`."""

    def cover_at(self, at: MonoNs) -> tuple[F64, MonoNs] | None:
        """Return the cover if it is still taken to lie where it was found."""
        return self.cover if self.cover is not None and 0 <= at - self.cover[1] < _COVER_NS else None


@dataclass(frozen=True, slots=True, eq=False)
class Now:
    """Inputs of one frame's tracking."""

    tracker: TrackerConfig
    frame: Frame
    view: FrameView
    attitude: Attitude | None
    orientation: Orientation
    """The attitude at the exposure and the deck's expected tilt."""
    memory: TrackerMemory

    @staticmethod
    def of(tracker: TrackerConfig, memory: TrackerMemory, frame: Frame, attitude: Attitude | None) -> Now:
        """Return a frame's inputs, by the camera's tone as it was learnt."""
        if memory.tone.steps:
            tracker = dataclasses.replace(tracker, camera=with_tone(tracker.camera, memory.tone.steps))
        orientation = Orientation.of(attitude, tracker.options.deck_tilt_sigma_rad)
        return Now(tracker, frame, FrameView(Pyramid(frame.px), tracker.camera, tracker.pad), attitude, orientation, memory)

    @property
    def at(self) -> MonoNs:
        """The exposure."""
        return self.frame.stamp.measured_at

    @property
    def deck(self) -> DeckMemory:
        """The memory of things on the pad and about it; an empty one if they are not looked for."""
        return self.memory.deck if self.tracker.watches else DeckMemory()


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """The pad as registered in one frame, and what that says of it."""

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
class Seen:
    """The best registrations of one frame."""

    tracked: Registered | None = None
    """The surest one that may be the tracked pad."""
    elsewhere: Registered | None = None
    """The surest one in a place that the belief excludes."""

    def having(self, of: Registered | None, belief: ExpectedPlace) -> Seen:
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

    def settled(self) -> Seen:
        """Return the tracked pad with what is surer elsewhere; without it if the frame hardly supports it beside that."""
        if self.elsewhere is None or _surer(self.tracked, self.elsewhere):
            return Seen(self.tracked)
        supported = self.tracked is not None and self.tracked.sighting.confidence >= _SUPPORTED
        return self if supported else Seen(None, self.elsewhere)


def _spread(best: Registered, a: Registered | None, b: Registered) -> Registered:
    """Return the better of two registrations with their difference in its covariance, where neither is better than the other.

    The edge of a shade across the pad holds a part of the drawing's edges off, and another part from each start.
    """
    if a is None or min(a.sighting.confidence, b.sighting.confidence) < SURE:
        return best
    if abs(a.agreement - b.agreement) > _BETTER or max(a.agreement, b.agreement) >= WORTH_ANOTHER:
        return best
    one, other = a.sighting, b.sighting
    turn = 0.0 if one.yaw_rad is None or other.yaw_rad is None else math.remainder(one.yaw_rad - other.yaw_rad, math.tau)
    # Opposite headings say nothing of how far the pad is turned.
    apart = np.append(one.d_body_pad_level - other.d_body_pad_level, turn if abs(turn) < 0.5 * math.pi else 0.0)
    return dataclasses.replace(best, sighting=structs.replace(best.sighting, cov=best.sighting.cov + np.outer(apart, apart)))


def _stays(a: Registered | None, b: Registered) -> bool:
    """Return whether the first of two registrations in the same place is kept: the surer one, or the one whose edges agree."""
    if a is None:
        return False
    both = min(a.sighting.confidence, b.sighting.confidence) >= SURE
    return a.agreement >= b.agreement if both and abs(a.agreement - b.agreement) > _BETTER else _surer(a, b)


def _surer(a: Registered | None, b: Registered) -> bool:
    """Return whether the first of two registrations is as sure as the second, or surer."""
    return a is not None and a.sighting.confidence >= b.sighting.confidence
