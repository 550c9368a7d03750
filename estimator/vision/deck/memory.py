"""The memory of things on the pad and about it."""

from dataclasses import dataclass

from msgspec import structs

from estimator.contracts.time import MonoNs, seconds_between
from estimator.vision.camera.pose import PadPose
from estimator.vision.deck.around import AroundMemory, shows_ring
from estimator.vision.deck.clear_deck import LASTS_S, PERIOD_S, SurfaceMemory, is_near
from estimator.vision.deck.passing import LOW_M, LOW_PERIOD_S, PASS_PERIOD_S, PassMemory
from estimator.vision.detect.pyramid import FrameView
from estimator.vision.detection import PadCheck


@dataclass(frozen=True, slots=True, eq=False)
class DeckMemory:
    """Memory of things on the pad and about it; a part is None before it was read."""

    surface: SurfaceMemory | None = None
    around: AroundMemory | None = None
    passing: PassMemory | None = None

    def is_due(self, at: MonoNs, view: FrameView, pose: PadPose | None) -> bool:
        """Return whether something may be read in a frame exposed then: at a sure pose, or without one the surface elsewhere."""
        each = (
            (self.surface, PERIOD_S, pose is None or is_near(view, pose)),
            (self.around, PERIOD_S, pose is not None and (self.around is None or shows_ring(view, pose))),
            (self.passing, LOW_PERIOD_S if pose is not None and pose.range_m < LOW_M else PASS_PERIOD_S, pose is not None),
        )
        return any(may and (of is None or not 0.0 <= seconds_between(of.at, at) < over_s) for of, over_s, may in each)

    def check(self, at: MonoNs) -> PadCheck | None:
        """Return what was lately seen on the pad and about it, what moves first; None if nothing was read or is there."""
        surface = None if self.surface is None or seconds_between(self.surface.at, at) > LASTS_S else self.surface.check
        there = [(near, each.at) for each in (self.around, self.passing) if each is not None and (near := each.finding.near(at))]
        if not there:
            return surface
        near, read = min(there, key=lambda of: (of[0].height_m > 0.0, of[0].from_centre_m))
        if surface is None:
            return PadCheck(read, 0.0, None, near)
        return structs.replace(surface, at=max(surface.at, read), near=near)
