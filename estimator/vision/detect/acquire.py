"""Find the pad in a whole frame without a prior: hypotheses, best first, each verified with the whole drawing.

Hypotheses come from the fiducials of a pad that has some, from circles of edges in luminance, at several sizes of the frame, from
the outlines of small areas that stand out, from the strokes of the H, and from circles in the measure of the disc's colour where
there is colour. A pad that has fiducials and not
disc, ring and lettering besides is searched by its fiducials alone, as nothing else distinguishes it from other markings.

A frame may have a budget of work, which all that is done in it counts against; what is left of a search goes on with the next
frame. The core counts work and not time (`native.work_done`), so that the same frames give the same results.

To be verified, the whole drawing is aligned with the frame: pose and paints are estimated together, by Gauss-Newton on the pixels
(dense alignment). The frame near the pad is modelled as a mixture of four paints (H, orange, disc, surroundings). The drawing
gives the coverage of each paint in every pixel. Light is additive, so for a given pose the paints follow by linear least squares
under any illumination. The pose then follows the model's gradient (Lucas and Kanade 1981, as compositional alignment with the
drawing as template, and with Cauchy weights against occlusion and glare). The result is near enough for edge-based registration
to start, and it holds the inputs of the confidence classifier.

Where something covers a part of a pad, a towel, a hatch or a vehicle beside it, that is one region with a border. About the pad
this border is taken for straight, and what lies beyond it counts as little as what lies beyond the frame's edge: neither
alignment nor registration nor verification sees it. Nothing is then assumed of the hidden part, and the rest has to fit as well
as a pad at the frame's edge has to.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.core.library import CORE
from estimator.vision.camera import Camera
from estimator.vision.detect.guesses import Guess, Plane
from estimator.vision.detect.hypotheses import FULL_PIXELS, WORK_COARSE, Kind, kinds
from estimator.vision.detect.pyramid import FrameView
from estimator.vision.detect.template import FRESH, PaintMemory
from estimator.vision.detect.verification import ALONE_LOG_ODDS, alone, confidence, log_odds
from estimator.vision.fiducial import PaintedFiducial, cells_apart, dictionary_of
from estimator.vision.native import checked, count_work, native_pose, pose_of, tracker_of
from estimator.vision.pad import Pad
from estimator.vision.pose import PadPose

U8 = NDArray[np.uint8]

WINDOWS_PX = (5, 13, 23)
"""Sides of the neighbourhood whose mean divides light from dark, in the order in which they are tried: the least one is quickest
and reads the smallest cells, larger ones stand more blur and noise.
"""
WORK_FIDUCIALS = 3.0
"""Work of reading the fiducials of one dictionary with one window; see `hypotheses.Kind`."""
_POSES = 3
"""Largest number of poses of one frame: two pads in view, or a pose and its mirror image."""
_CORNER_PX = 0.7
"""Standard deviation of a corner's place as the detector finds it."""
_TILT_RAD = math.radians(4.0)
"""Standard deviation of the tilt between the deck and a vehicle of known attitude."""
_SAME_SIDES = 0.25
"""Largest distance of a fiducial's corners from their place by another fiducial's pose, in its sides in the frame."""
_MIRRORED = 6.0
"""Difference of two squared errors, in variances, below which a pose and its mirror image are both tried."""
_UNIT = np.eye(3)


class _Read(Struct, frozen=True, eq=False):
    """A fiducial as read in a frame."""

    p_pad: F64
    """Its corners on the pad, (4, 3) m."""
    uv_px: F64
    """Its corners in the frame, (4, 2) px."""

    @property
    def side_px(self) -> float:
        return float(np.linalg.norm(self.uv_px - np.roll(self.uv_px, 1, axis=0), axis=1).min())


class FiducialPose(NamedTuple):
    """A pose from fiducials."""

    pose: PadPose
    off_px: float
    """Largest error of the pad's farthest visible edge by errors of the corners alone, px."""


def fiducial_poses(grey: U8, camera: Camera, pad: Pad, plane: Plane, window_px: int) -> list[FiducialPose]:
    """Return poses of a pad from its fiducials, best supported first; empty if none is read.

    Args:
        grey: (H, W) luminance.
        plane: the plane that the pad is taken to lie in.
        window_px: one of `WINDOWS_PX`.
    """
    left = sorted(_read(grey, pad, window_px), key=lambda read: -read.side_px)
    found: list[tuple[int, list[FiducialPose]]] = []
    while left and len(found) < _POSES:
        agreeing = left[:1]
        poses = _solved(agreeing, camera, plane)
        if poses:
            agreeing += [read for read in left[1:] if any(_agrees(read, pose, camera) for pose in poses)]
            poses = _solved(agreeing, camera, plane) or poses
            found.append((len(agreeing), [FiducialPose(pose, _off_px(agreeing, pose, camera, pad)) for pose in poses]))
        left = [read for read in left if not any(read is other for other in agreeing)]
    found.sort(key=lambda of: -of[0])
    return [pose for _, poses in found for pose in poses][:_POSES]


def _read(grey: U8, pad: Pad, window_px: int) -> list[_Read]:
    """Return the pad's fiducials that the detector reads."""
    found = []
    for detector, fiducials in _detectors(pad.markings.fiducials, window_px):
        corners, numbers, _ = detector.detectMarkers(grey)
        for uv, number in zip(corners, [] if numbers is None else np.ravel(numbers), strict=True):
            p_pad = np.pad(fiducials[int(number)].corners_read(), ((0, 0), (0, 1)))
            found.append(_Read(p_pad, np.asarray(uv, float).reshape(4, 2)))
    return found


@lru_cache(maxsize=16)
def _detectors(
    fiducials: tuple[PaintedFiducial, ...], window_px: int
) -> list[tuple[cv2.aruco.ArucoDetector, list[PaintedFiducial]]]:
    """Return a detector for each dictionary, which knows these fiducials alone, and the fiducials by the number that it gives."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.errorCorrectionRate = 1.0
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = window_px
    out = []
    for name in dict.fromkeys(f.dictionary for f in fiducials):
        of, own = dictionary_of(name), [f for f in fiducials if f.dictionary == name]
        known = cv2.aruco.Dictionary(of.bytesList[[f.id for f in own]], of.markerSize, _correctable(own))
        out.append((cv2.aruco.ArucoDetector(known, parameters), own))
    return out


def _correctable(fiducials: list[PaintedFiducial]) -> int:
    """Return how many wrong cells leave each of a pad's own markers the nearest one.

    That is more than the dictionary allows, whose other markers are not there. What is read wrongly is refused by the drawing.
    """
    cells = [fiducial.cells() for fiducial in fiducials]
    turned_itself = [cells_apart(own, own, (1, 2, 3)) for own in cells]
    return (min([*turned_itself, *(cells_apart(a, b) for a, b in combinations(cells, 2))]) - 1) // 2


def _off_px(reads: list[_Read], pose: PadPose, camera: Camera, pad: Pad) -> float:
    """Return what the farthest edge in view may be off by: the corners' error times the pad's size over that of what is read."""
    uv = np.concatenate([read.uv_px for read in reads])
    radius_px = float(np.linalg.norm(uv - uv.mean(axis=0), axis=1).max())
    pad_px = pose.disc_px(camera, pad)
    return _CORNER_PX * min(pad_px, 0.5 * math.hypot(camera.width, camera.height)) / max(radius_px, 1.0)


def _agrees(read: _Read, pose: PadPose, camera: Camera) -> bool:
    p_cam = pose.points(read.p_pad)
    if float(p_cam[:, 2].min()) < 0.01:
        return False
    off = np.linalg.norm(camera.project(p_cam) - read.uv_px, axis=1)
    return bool(off.max() < _SAME_SIDES * read.side_px)


def _solved(reads: list[_Read], camera: Camera, plane: Plane) -> list[PadPose]:
    """Return the likeliest pose, and its mirror image if that is about as likely."""
    p_pad, uv = (np.concatenate(all_of) for all_of in ([r.p_pad for r in reads], [r.uv_px for r in reads]))
    rays = camera.rays(uv)
    if not np.isfinite(rays).all():
        return []
    _, turns, places, errors = cv2.solvePnPGeneric(p_pad, rays, _UNIT, np.zeros(5), flags=cv2.SOLVEPNP_IPPE)
    rated: list[tuple[float, PadPose]] = []
    for turn, place, error in zip(turns, places, np.ravel(errors).tolist(), strict=True):
        R, t = np.asarray(cv2.Rodrigues(turn)[0], float), np.asarray(place, float)[:, 0]
        if not (np.isfinite(R).all() and np.isfinite(t).all() and t[2] > 0.0 and R[2, 2] > 0.0):
            continue
        # The error is the root mean square over both coordinates of all corners.
        off = 2.0 * len(uv) * (error * camera.fx / _CORNER_PX) ** 2
        if plane.known:
            off += (math.acos(min(1.0, float(R[:, 2] @ plane.R_cam_plane[:, 2]))) / _TILT_RAD) ** 2
        rated.append((off, PadPose(Rotation(R), t)))
    rated.sort(key=lambda of: of[0])
    return [pose for off, pose in rated if off < rated[0][0] + _MIRRORED]


UNCUT = np.zeros(3)
"""The cut that hides nothing. A cut (3,) is a line across the frame: rays (x, y) with `a x + b y + c < 0` do not count."""
UNCUT.setflags(write=False)

SIGMA_TILT_RAD = math.radians(3.0)
"""Standard deviation of the tilt between the deck and a vehicle of measured attitude."""
SIGMA_TILT_FREE_RAD = math.radians(15.0)
"""Standard deviation of the tilt if neither attitude is known."""


class ArrowPlace(NamedTuple):
    """The measurements at one of the two places where an arrowhead may be."""

    found: float
    """Strength of the arrowhead there times the fraction of the variation it explains, 0..1."""
    seen: float
    """Fraction of the place inside the frame; 0 if the pixels are too coarse."""
    clear: float
    """Confidence, 0..1, that only disc, ring and perhaps an arrowhead are there."""


class AlignedTemplate(Struct, frozen=True, eq=False):
    """The drawing as aligned with one frame."""

    pose: PadPose
    paints: F64
    """Linear light of H, orange, disc and surroundings, (4, 3), 0..1, in blue, green, red."""
    in_view: float
    """Fraction of the disc's area inside the frame."""
    arrow: tuple[ArrowPlace, ArrowPlace]
    """Support for the arrowhead at its place, and at the place where it would be with the drawing turned by 180 degrees."""
    features: F64
    """Inputs of the confidence classifier, in the order of `verification.FEATURES`."""

    @property
    def arrow_support(self) -> float:
        """Support for the heading, -1..1: 1 for an orange arrowhead at its place, -1 for one at the opposite place.

        The value is 0 if neither, both or nothing of the kind is in view.
        """
        fore, aft = self.arrow
        return fore.found * fore.seen - aft.found * aft.seen


def align(
    view: FrameView,
    pose: PadPose,
    sigma_tilt_rad: float,
    steps: int = 4,
    *,
    local: bool = False,
    side: F64 | None = None,
    cut: F64 = UNCUT,
) -> AlignedTemplate | None:
    """Align the drawing with the frame from a rough pose.

    Args:
        sigma_tilt_rad: standard deviation of the tilt of the start pose's normal.
        steps: number of Gauss-Newton steps; the first half uses a drawing blurred twice as much. With 0 the pose is unchanged.
        local: use the light minus its mean in the neighbourhood, against glare and shadows; the reach is a little shorter.
        side: (2,) unit direction in x and y of the pad: use only the half of the disc on this side, because the other is covered.
        cut: the line beyond which something covers the pad, (3,); see `UNCUT`.

    Returns:
        The aligned template; None if too little of the pad is in view, or if the pose diverges.
    """
    at, out = native_pose(pose), np.zeros((), CORE.dtype("dl_aligned_pad"))
    how = CORE.ffi.new("dl_alignment *", {
        "steps": steps, "local": local, "one_side": side is not None, "sigma_tilt_rad": sigma_tilt_rad, "cut": cut.tolist(),
        "side": (0.0, 0.0) if side is None else side.tolist(),
    })  # fmt: skip
    pyramid, camera, pad = view
    if not checked(CORE.lib.dl_align(tracker_of(camera, pad), pyramid.native, how, at, CORE.array("dl_aligned_pad", out))):
        return None
    found, arrow = pose_of(at) if steps > 0 else pose, out["arrow"].tolist()
    places = ArrowPlace(*arrow[:3]), ArrowPlace(*arrow[3:])
    return AlignedTemplate(found, out["paints"].reshape(4, 3), out["in_view"].item(), places, out["features"])


COVERED_LOG_ODDS = -1.0
"""Prior of a partly covered drawing, for `verification.confidence`: the line is chosen so that the
rest fits best.
"""
_TURNS = 6
"""Headings in half a turn that a covered pad may have; alignment reaches half of the way to the next."""
_LEAST_GAIN, _MOST_LEFT = 0.7, 0.6
"""Least gain of a cover, and the largest share of the light's variation beside it that the drawing may leave. At the true poses
of 90 half-covered pads at 5 to 15 m the gain was 1.0 and more, and 0.56 was left at most.
"""


def cut_at(view: FrameView, pose: PadPose) -> F64 | None:
    """Return the cut beyond which something covers the pad that lies about at a pose; None if nothing seems to.

    A cut is a line across the frame; see `alignment.UNCUT`. There is always a best one unless too little of the pad is in view;
    its gain, the mean fall of the logarithm of the residuals' variance, and what the drawing leaves say what it is worth.
    """
    pyramid, camera, pad = view
    how, out = CORE.ffi.new("dl_alignment *", {"cover": 1}), CORE.ffi.new("dl_aligned_pad *")
    if not checked(CORE.lib.dl_align(tracker_of(camera, pad), pyramid.native, how, native_pose(pose), out)):
        return None
    line = out.cover
    return None if line.gain < _LEAST_GAIN or line.left > _MOST_LEFT else np.array(list(line.cut))


def align_uncovered(view: FrameView, pose: PadPose, sigma_tilt_rad: float, steps: int) -> tuple[AlignedTemplate, F64] | None:
    """Align the drawing with what nothing covers, from a rough pose; return it with the cut, None if nothing seems to be covered.

    Args:
        sigma_tilt_rad, steps: as for `alignment.align`.
    """
    cut = cut_at(view, pose)
    if cut is None:
        return None
    aligned = align(view, pose, sigma_tilt_rad, steps, local=True, cut=cut)
    if aligned is None:
        return None
    again = cut_at(view, aligned.pose)
    if again is None:
        return None
    better = align(view, aligned.pose, sigma_tilt_rad, 0, cut=again)
    return None if better is None else (better, again)


def turned_uncovered(view: FrameView, at: AlignedTemplate, cut: F64, sigma_tilt_rad: float, steps: int) -> AlignedTemplate | None:
    """Return the drawing aligned from the heading that fits best to what nothing covers; None if that is the one it has.

    What covers a half of a distant pad has more pixels than its H, and turns the heading that a guess has.
    """
    turned = [align(view, at.pose.turned(k * math.pi / _TURNS), sigma_tilt_rad, 0, cut=cut) for k in range(1, _TURNS)]
    best = max((one for one in turned if one is not None), key=lambda one: log_odds(one.features), default=None)
    if best is None or log_odds(best.features) < log_odds(at.features):
        return None
    return align(view, best.pose, sigma_tilt_rad, steps, local=True, cut=cut)


SURE, ENOUGH = 0.9, 0.5
"""Confidence at which no further hypotheses are tried, and confidence at which no further kinds of hypotheses are tried."""
_CLOSE_PX = 2.0
"""Largest error of the farthest edge in view at which registration may start from fiducials directly."""
_MOST_ALIGNED = 24
"""Largest number of hypotheses of one frame that the drawing is aligned at before the search is given up."""
_ALIGNED = 3
"""Number of the best hypotheses of one kind that the drawing is aligned at."""
_TRIES = 2
"""Guesses tried for each candidate that may be kept. Most false candidates are refused at the first step and cost little."""
_STEPS, _STEPS_FREE = 4, 8
"""Gauss-Newton steps of alignment, with the tilt known and unknown."""
_ARROW_SEEN = 0.3
"""Support of the arrowhead at which the heading is unambiguous."""
_ARROW_MISSING = 0.5
"""Margin by which it must be surer that no arrowhead is at its place than that there is none half a turn away."""
_WORK_ALIGN, _WORK_TURNED = 0.8, 1.2
"""Work that an alignment usually takes, and that of other headings beside what covers a part."""
_SMALL_PX = 30.0
"""Radius of the disc, px, up to which what covers a part of it may turn a guess."""
_SAME_PX, _SAME_RADII, _SAME_FAR = 4.0, 0.5, 0.15
"""Largest differences of one place between two frames: px, radii of the disc, and the logarithm of the distance."""
_REMEMBERED = 24
"""Most places of refused hypotheses that are remembered."""
_BETTER = 0.05
"""Further share of the variance that another guess in the place of a refused one must explain not to come last."""
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
        budget: work in the frame, whatever did it, at which the search goes on with the next one, as `tracker_config.FRAME_WORK`.
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
        guesses = self.guesses.get(kind.guesses)
        if guesses is None:
            if self.guesses and self.left < kind.work:
                return None
            guesses = self.guesses[kind.guesses] = kind.guesses()
        aligned = kept = 0
        drawn = [guess for guess in guesses if kind.is_drawn(guess) and id(guess) not in self.tried]
        for guess in sorted(drawn, key=lambda g: (self._is_refused(g), -g.score)):
            # Guesses are not tried beside any candidate, and exact ones not beside confident ones.
            if any(_near(guess.t_cam_pad, c.pose) for c in self.found if c.score >= ENOUGH or not kind.exact):
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
        # What covers a part, and the heading beside it, were chosen to fit: that alone is not enough.
        enough = self.sure <= 1.0 and any(c.score >= min(self.sure, ENOUGH if c.cut is None else SURE) for c in self.found)
        return enough or len(self.found) >= _MOST_ALIGNED

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
        is_small = aligned.pose.disc_px(self.view.camera, self.view.pad) < _SMALL_PX
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
