"""Find the pad in a whole frame without a prior: hypotheses, best first, each verified with the whole drawing.

Hypotheses come from the fiducials of a pad that has some, from circles of edges in luminance, at several sizes of the frame, from
the outlines of small areas that stand out, from the strokes of the H, and from circles in the measure of the disc's colour where
there is colour. A pad that has fiducials and not disc, ring and lettering besides is searched by its fiducials alone, as nothing
else distinguishes it from other markings.

A frame may have a budget of work, which all that is done in it counts against; what is left of a search goes on with the next
frame. The core counts work and not time (`native.work_done`), so that the same frames give the same results.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct, field

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.detect.alignment import (
    SIGMA_TILT_FREE_RAD,
    SIGMA_TILT_RAD,
    AlignedTemplate,
    align,
    align_uncovered,
    turned_uncovered,
)
from estimator.vision.detect.fiducials import WINDOWS_PX, WORK_FIDUCIALS, fiducial_poses
from estimator.vision.detect.guesses import Guess, Plane
from estimator.vision.detect.hypotheses import FULL_PIXELS, WORK_COARSE, Kind, kinds
from estimator.vision.detect.pyramid import FrameView
from estimator.vision.detect.template import FRESH, PaintMemory
from estimator.vision.detect.verification import ALONE_LOG_ODDS, alone, confidence, log_odds
from estimator.vision.native import count_work

SURE = 0.9
"""Confidence at which no further hypotheses are tried."""
ENOUGH = 0.5
"""Confidence at which no further kinds of hypotheses are tried."""
_CLOSE_PX = 2.0  # Largest error of the farthest edge in view at which registration may start from fiducials directly
_MOST_ALIGNED = 24  # Largest number of hypotheses of one frame that the drawing is aligned at before the search is given up
_ALIGNED = 3  # Number of the best hypotheses of one kind that the drawing is aligned at
_TRIES = 2
"""Guesses tried for each candidate that may be kept. Most false candidates are refused at the first step and cost little."""
_STEPS, _STEPS_FREE = 4, 8
"""Gauss-Newton steps of alignment, with the tilt known and unknown."""
_ARROW_SEEN = 0.3  # Support of the arrowhead at which the heading is unambiguous
_ARROW_MISSING = 0.5
"""Margin by which it must be surer that no arrowhead is at its place than that there is none half a turn away."""
_WORK_ALIGN, _WORK_TURNED = 0.8, 1.2
"""Work that an alignment usually takes, and that of other headings beside what covers a part."""
_SMALL_PX = 30.0  # Radius of the disc, px, up to which what covers a part of it may turn a guess
_SAME_PX, _SAME_RADII, _SAME_FAR = 4.0, 0.5, 0.15
"""Largest differences of one place between two frames: px, radii of the disc, and the logarithm of the distance."""
_REMEMBERED = 24  # Most places of refused hypotheses that are remembered
_BETTER = 0.05  # Further share of the variance that another guess in the place of a refused one must explain not to come last
Place = tuple[float, float, float, float]
"""The pad's centre, px from the lens' axis, the logarithm of its distance, and the fraction of the variance that is explained."""


class PadCandidate(Struct, frozen=True, eq=False):
    """A hypothesis for the pad's pose, aligned and verified."""

    pose: PadPose
    score: float
    """Calibrated probability, 0..1, that this is the pad and that `pose` is good enough to start registration."""
    yaw_ambiguous: bool
    """True if the arrowhead does not show: the heading may be 180 degrees off."""
    aligned: AlignedTemplate
    cut: F64 | None = None
    """The line beyond which something covers the pad, (3,); see `alignment.UNCUT`."""


class SearchMemory(Struct, frozen=True):
    """Memory of a search from frame to frame."""

    first: int = 0
    """The kind of hypotheses to begin with."""
    refused: tuple[Place, ...] = ()
    """Places whose hypotheses were refused since all kinds were tried last. Hypotheses there come last."""


FRESH_SEARCH = SearchMemory()


class Found(NamedTuple):
    """The result of a search in one frame: candidates, best first, and empty if nothing resembles the pad; and its memory."""

    candidates: list[PadCandidate]
    memory: SearchMemory


def search(
    view: FrameView,
    R_level_body: Rotation | None = None,
    paint: PaintMemory = FRESH,
    memory: SearchMemory = FRESH_SEARCH,
    *,
    sure: float = SURE,
    budget: float = math.inf,
) -> Found:
    """Search a frame for the pad.

    Args:
        R_level_body: roll and pitch of the body at the exposure. None if the vehicle does not report them, which costs time
            and some range.
        paint: learned paints. They only order the search: where the disc stood out by its colour, colour comes first.
        memory: what the search left in the frame before.
        sure: confidence at which no further hypotheses are tried; a value over 1 gives all candidates.
        budget: work in the frame, whatever did it, at which the search goes on with the next one, as `track.config.FRAME_WORK`.
            The first kind that is looked for is, whatever is left.

    Raises:
        ValueError: the frame is not of the camera's size.
    """
    camera, (height, width) = view.camera, view.pyramid[0].shape[:2]
    if (height, width) != (camera.height, camera.width):
        raise ValueError(f"the frame is {width}x{height} px, the camera's are {camera.width}x{camera.height}")
    task = _Search(view.as_seen(), Plane.of(camera, R_level_body), sure, budget, memory.refused, refused=list(memory.refused))
    # A marker that is blurred, cut or half covered is not read, and its drawing is found as any other is.
    if view.pad.markings.fiducials and task.try_fiducials():
        return Found(_distinct(task.found), FRESH_SEARCH)
    of_all, began = kinds(task.view, task.plane, paint), view.pyramid.work
    for k in ((memory.first + i) % len(of_all) for i in range(len(of_all))):
        whole = k == memory.first or view.pyramid.work - began <= WORK_COARSE * camera.width * camera.height / FULL_PIXELS
        enough = task.try_kind(of_all[k])
        if enough is None:
            # A kind may have more guesses than a frame has work and the memory places: a search that stayed would never leave it.
            after = (k + 1) % len(of_all) if whole else k
            return Found(_distinct(task.found), SearchMemory(after, tuple(task.refused[-_REMEMBERED:])))
        if enough:
            break
    return Found(_distinct(task.found), FRESH_SEARCH)


def align_at(pose: PadPose, tilt_known: bool, view: FrameView) -> PadCandidate | None:
    """Align the drawing from one rough pose and verify it; return None if it does not fit at all."""
    return _Search(view).align_at(pose, tilt_known)


class _Search(Struct, eq=False):
    """A search in one frame: its inputs and its progress."""

    view: FrameView
    plane: Plane = field(default_factory=lambda: Plane(np.eye(3), False))
    sure: float = SURE
    budget: float = math.inf
    refused_before: tuple[Place, ...] = ()
    found: list[PadCandidate] = field(default_factory=list)
    refused: list[Place] = field(default_factory=list)
    guesses: dict[Callable[[], list[Guess]], list[Guess]] = field(default_factory=dict)
    """Guesses of the kinds that were looked for, by what made them: two kinds may share them."""
    tried: set[int] = field(default_factory=set)
    """Identities of the guesses that the drawing was aligned at."""

    @property
    def left(self) -> float:
        """Work that is left of the frame's budget."""
        return self.budget - self.view.pyramid.work

    def try_fiducials(self) -> bool:
        """Read the pad's fiducials and verify the drawing there; return whether that is enough.

        Where a small fiducial leaves the rest of the pad uncertain, or the drawing does not fit, it is aligned from there.
        """
        pyramid, camera, pad = self.view
        dictionaries = len({fiducial.dictionary for fiducial in pad.markings.fiducials})
        grey = np.asarray(cv2.cvtColor(pyramid[0], cv2.COLOR_BGR2GRAY), np.uint8)
        for window_px in WINDOWS_PX:
            count_work(round(1e6 * WORK_FIDUCIALS * dictionaries * camera.width * camera.height / FULL_PIXELS))
            for pose, off_px in fiducial_poses(grey, camera, pad, self.plane, window_px):
                candidate = _candidate(align(self.view, pose, SIGMA_TILT_RAD, 0))
                if candidate is None or candidate.score < self.sure or off_px > _CLOSE_PX:
                    moved = align_at(pose, self.plane.known, self.view)
                    if moved is not None and (candidate is None or moved.score > min(candidate.score, ENOUGH)):
                        candidate = moved
                if candidate is not None:
                    self.found.append(candidate)
                    if candidate.score >= self.sure:
                        return True
            if self.sure <= 1.0 and any(c.score >= ENOUGH for c in self.found):
                return True
        return False

    def try_kind(self, kind: Kind) -> bool | None:
        """Align the drawing at the best guesses of a kind. Return whether that is enough, or None if the budget ends before."""
        if kind.guesses not in self.guesses:
            if self.guesses and self.left < kind.work:
                return None
            self.guesses[kind.guesses] = kind.guesses()
        aligned = kept = 0
        for guess in self._untried(kind):
            if self._is_beside_found(guess, kind):
                continue
            if aligned == _TRIES * _ALIGNED or kept == _ALIGNED:
                break
            if self.left < _WORK_ALIGN and aligned > 0:
                return None
            candidate = self.align_at(guess.pose, guess.tilt_known, guess.side, kind.covered)
            self.tried.add(id(guess))
            aligned += 1
            if candidate is not None:
                kept += 1
                self.found.append(candidate)
                if candidate.score >= self.sure:
                    return True
            if candidate is None or candidate.score < ENOUGH:
                self.refused.append(_place(guess, self.view.camera))
        return self._has_enough() or len(self.found) >= _MOST_ALIGNED

    def _untried(self, kind: Kind) -> list[Guess]:
        """Return the guesses of a kind that explain enough and were not tried, those in refused places last."""
        drawn = [guess for guess in self.guesses[kind.guesses] if kind.is_drawn(guess) and id(guess) not in self.tried]
        return sorted(drawn, key=lambda g: (self._is_refused(g), -g.score))

    def _is_beside_found(self, guess: Guess, kind: Kind) -> bool:
        """Return whether a guess need not be tried: none is beside any candidate, and an exact one not beside a confident one."""
        return any(_near(guess.t_cam_pad, c.pose) for c in self.found if c.score >= ENOUGH or not kind.exact)

    def _has_enough(self) -> bool:
        """Return whether a candidate is confident. What covers a part was chosen to fit: that alone is not enough."""
        return self.sure <= 1.0 and any(c.score >= min(self.sure, ENOUGH if c.cut is None else SURE) for c in self.found)

    def align_at(self, pose: PadPose, tilt_known: bool, side: F64 | None = None, covered: bool = False) -> PadCandidate | None:
        """Align the drawing from one rough pose and verify it; return None if it does not fit at all.

        Args:
            side: as for `align`.
            covered: where the whole drawing does not fit at all, look for what covers a part of it, too.
        """
        sigma, steps = (SIGMA_TILT_RAD, _STEPS) if tilt_known else (SIGMA_TILT_FREE_RAD, _STEPS_FREE)
        aligned = align(self.view, pose, sigma, steps, local=True, side=side)
        found = None if aligned is None else self._with_arrow(aligned, sigma, side)
        enough = not covered if found is None else found.score >= ENOUGH
        if not enough and self.view.pad.markings.is_searched_by_parts:
            found = _better(found, self._uncovered_at(pose if found is None else found.pose, sigma, steps))
        return found

    def _uncovered_at(self, pose: PadPose, sigma_tilt_rad: float, steps: int) -> PadCandidate | None:
        """Align the drawing with what nothing covers, and verify it; return None if nothing seems to be covered.

        Other headings beside a cover are tried if so much work is left, and if half of the disc has so few pixels that what
        covers the rest may turn it.
        """
        uncovered = align_uncovered(self.view, pose, sigma_tilt_rad, steps)
        if uncovered is None:
            return None
        aligned, cut = uncovered
        found = _candidate(aligned, aligned.arrow_support < _ARROW_SEEN, cut)
        is_small = aligned.pose.px_of(self.view.pad.disc_radius_m, self.view.camera) < _SMALL_PX
        if found is not None and (found.score >= ENOUGH or self.left < _WORK_TURNED or not is_small):
            return found
        turned = turned_uncovered(self.view, aligned, cut, sigma_tilt_rad, steps)
        other = None if turned is None else _candidate(turned, turned.arrow_support < _ARROW_SEEN, cut)
        return _better(found, other)

    def _with_arrow(self, aligned: AlignedTemplate, sigma_tilt_rad: float, side: F64 | None) -> PadCandidate | None:
        """Return an aligned drawing as a candidate, turned by half a turn if its arrowhead can only be there."""
        arrow, (fore, aft) = aligned.arrow_support, aligned.arrow
        missing = fore.seen * (1.0 - fore.found) - aft.seen * (1.0 - aft.found)
        if arrow < -0.5 * _ARROW_SEEN or missing > _ARROW_MISSING:
            side = None if side is None else -side
            turned = align(self.view, aligned.pose.turned(math.pi), sigma_tilt_rad, 2, local=True, side=side)
            if turned is not None:
                aligned, arrow = turned, turned.arrow_support
        return _candidate(aligned, ambiguous=arrow < _ARROW_SEEN and not self.view.pad.markings.fiducials)

    def _is_refused(self, guess: Guess) -> bool:
        """Return whether a hypothesis near this one that explained about as much, or more, was refused in a frame before."""
        if not self.refused_before:
            return False
        u, v, far, drawing = _place(guess, self.view.camera)
        reach = _SAME_PX + _SAME_RADII * self.view.camera.fx * self.view.pad.disc_radius_m * math.exp(-far)
        return any(
            drawing < d + _BETTER and abs(far - c) < _SAME_FAR and math.hypot(u - a, v - b) < reach
            for a, b, c, d in self.refused_before
        )


def _better(found: PadCandidate | None, other: PadCandidate | None) -> PadCandidate | None:
    return other if found is None or (other is not None and other.score > found.score) else found


def _candidate(aligned: AlignedTemplate | None, ambiguous: bool = False, cut: F64 | None = None) -> PadCandidate | None:
    """Return an aligned drawing as a candidate."""
    if aligned is None:
        return None
    sure = confidence(log_odds(aligned.features) + ALONE_LOG_ODDS * alone(aligned.features))
    return PadCandidate(aligned.pose, sure, ambiguous, aligned, cut)


def _place(guess: Guess, camera: Camera) -> Place:
    x, y, z = guess.t_cam_pad
    return camera.fx * x / z, camera.fy * y / z, math.log(z), guess.drawing


def _near(a_m: Sequence[float], b: PadPose) -> bool:
    """Return whether two centres of the pad are the same place to within a fifth of a disc."""
    b_m: list[float] = b.t_cam_pad.tolist()
    apart = math.hypot(a_m[0] / a_m[2] - b_m[0] / b_m[2], a_m[1] / a_m[2] - b_m[1] / b_m[2])
    return math.dist(a_m, b_m) < 0.05 * b_m[2] and apart * b_m[2] < 0.03


def _distinct(candidates: list[PadCandidate]) -> list[PadCandidate]:
    out: list[PadCandidate] = []
    for c in sorted(candidates, key=lambda c: -c.score):
        if not any(_near(c.pose.t_cam_pad.tolist(), k.pose) for k in out):
            out.append(c)
    return out
