"""The detection of the pad in one frame, as a value, and the fusion of several methods, without those that disagree.

Recorders and pages read it without the rest of vision, which takes long to load.

Agreement: each cue in turn is the hypothesis, and the other cues vote for it with their confidence if they agree with it. The
hypothesis with the most votes wins, and the cues that disagree with it are outliers (RANSAC with every hypothesis tried, Fischler
& Bolles 1981).

Fusion: all cues come from the same pixels and the same attitude, so their errors have an unknown correlation. Covariance
intersection (Julier & Uhlmann, A non-divergent estimation algorithm in the presence of unknown correlations, ACC 1997) is
consistent for any correlation. The weights are Niehsen's (Information fusion based on fast covariance intersection, 2002). They
apply to the information, so that a cue that appears or vanishes moves the result by its own weight at most.
"""

import math
from collections.abc import Iterable, Mapping

import numpy as np
from msgspec import Struct, structs

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, UNSURE, Method, Sighting
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import MonoNs

_AGREE_XYZ = 16.27  # Chi-square limit, 3 degrees of freedom, 99.9 %
_AGREE_YAW = 10.83  # Chi-square limit, 1 degree of freedom, 99.9 %
_COARSE = 0.003
"""Error that worn paint, shade and a tilted deck add to the thesis' methods, one standard deviation, in parts of the distance.

Their own covariance does not contain it. A disagreement of a few of these is no reason to reject a cue.
"""

_FAR_M = 10.0  # Distance that a pad may at least have which something else is taken for


def covered(seen: Sighting | None) -> Sighting | None:
    """Return a sighting as it is, or one that is hardly the pad with a covariance that covers the pad elsewhere in view.

    It then stands for a mixture: the pad where it seems to be by its confidence, else as far from there as the sighting is away,
    or as a pad is usually seen from. Its full pose, whose covariance says nothing of this, is left out.
    """
    if seen is None or seen.confidence >= UNSURE:
        return seen
    away = max(_FAR_M, float(np.linalg.norm(seen.d_body_pad_level))) ** 2
    cov = seen.cov + (1.0 - seen.confidence) * np.diag([away, away, away, 0.0 if seen.yaw_rad is None else UNKNOWN_YAW_VAR])
    return structs.replace(seen, cov=cov, pose6=None)


def fuse(cues: Iterable[Sighting]) -> Sighting | None:
    """Fuse the sightings of one frame into one of method "fused"; return None if there are none with a positive confidence.

    Its `pose6` comes from the most certain cue that has one. Cues that disagree are left out.
    The confidence is that of the most confident cue that took part, times the fraction of all confidence that agreed.
    """
    seen = [cue for cue in cues if cue.confidence > 0.0]
    if not seen:
        return None
    votes = [sum(other.confidence for other in seen if agree(cue, other)) for cue in seen]
    best = max(range(len(seen)), key=lambda i: (round(votes[i], 9), -_size(seen[i])))
    inliers = [cue for cue in seen if cue is seen[best] or agree(seen[best], cue)]
    inliers.sort(key=_size)
    fraction = sum(cue.confidence for cue in inliers) / sum(cue.confidence for cue in seen)
    confidence = max(cue.confidence for cue in inliers) * fraction
    return _intersected(inliers, confidence)


def agree(a: Sighting, b: Sighting) -> bool:
    """Return whether two cues can both be right according to their covariances."""
    if a is b:
        return True
    apart = a.d_body_pad_level - b.d_body_pad_level
    away_m = float(np.linalg.norm(a.d_body_pad_level))
    S = a.cov[:3, :3] + b.cov[:3, :3] + np.eye(3) * (_COARSE * away_m) ** 2
    if not float(apart @ np.linalg.solve(S, apart)) <= _AGREE_XYZ:
        return False
    if a.yaw_rad is None or b.yaw_rad is None:
        return True
    turned = wrap_pi(a.yaw_rad - b.yaw_rad)
    if a.yaw_ambiguous or b.yaw_ambiguous:
        turned = math.remainder(turned, math.pi)
    return turned**2 <= _AGREE_YAW * float(a.cov[3, 3] + b.cov[3, 3])


def _size(cue: Sighting) -> float:
    """Return the standard deviation of the cue's position, m: the root of the trace of its covariance."""
    return math.sqrt(float(np.trace(cue.cov[:3, :3])))


def _intersected(cues: list[Sighting], confidence: float) -> Sighting:
    """Return the covariance intersection of cues that agree; the most certain cue comes first."""
    headings = [(cue.yaw_ambiguous, cue.yaw_rad) for cue in cues if cue.yaw_rad is not None]
    # The first heading that is not ambiguous, else the first one.
    ambiguous, reference = min(headings, key=lambda of: of[0], default=(False, None))
    # There is almost no information about a heading that a cue does not give.
    covs = [cue.cov if cue.yaw_rad is not None else _with_unknown_yaw(cue.cov) for cue in cues]
    informations = [np.asarray(np.linalg.inv(cov)) for cov in covs]
    sizes = np.array([1.0 / np.trace(cue.cov[:3, :3]) for cue in cues])
    weights = sizes / sizes.sum()
    total, vector = np.zeros((4, 4)), np.zeros(4)
    for w, info, cue in zip(weights, informations, cues, strict=True):
        total += w * info
        vector += w * info @ np.append(cue.d_body_pad_level, _turn_from(cue, reference or 0.0))
    cov: F64 = np.asarray(np.linalg.inv(total))
    fused = cov @ vector
    yaw = None if reference is None else wrap_pi(reference + float(fused[3]))
    if yaw is None:
        cov = _with_unknown_yaw(cov)
    return structs.replace(
        cues[0],
        method="fused",
        d_body_pad_level=fused[:3],
        yaw_rad=yaw,
        yaw_ambiguous=ambiguous,
        cov=0.5 * (cov + cov.T),
        confidence=min(1.0, confidence),
        pose6=next((cue.pose6 for cue in cues if cue.pose6 is not None), None),
        features=tuple(feature for cue in cues for feature in cue.features),
    )


def _with_unknown_yaw(cov: F64) -> F64:
    out = cov.copy()
    out[3, :] = out[:, 3] = 0.0
    out[3, 3] = UNKNOWN_YAW_VAR
    return out


def _turn_from(cue: Sighting, reference_rad: float) -> float:
    """Return the cue's heading minus the reference, rad.

    For a cue that is ambiguous by 180 degrees this takes the branch nearest to the reference.
    """
    if cue.yaw_rad is None:
        return 0.0
    turned = wrap_pi(cue.yaw_rad - reference_rad)
    return math.remainder(turned, math.pi) if cue.yaw_ambiguous else turned


class Opinions(Struct, frozen=True):
    """Opinions on the candidate of a detection, if a second opinion was requested."""

    verified: float
    """Confidence of the verification alone, 0..1."""
    learned: float
    """Confidence of the trained network, 0..1; it can lower the other one."""


class PadThing(Struct, frozen=True):
    """Something that lies on the pad."""

    width_m: float
    """Its larger extent along one of the pad's axes."""
    forward_m: float
    """Place of its middle from the pad's centre, along the arrow."""
    right_m: float
    """The same to starboard of the arrow."""

    @property
    def from_centre_m(self) -> float:
        """Distance of its middle from the pad's centre, m."""
        return math.hypot(self.forward_m, self.right_m)


class NearThing(Struct, frozen=True):
    """Something that stands out of the deck about the pad, or moves against it."""

    forward_m: float
    """Its place from the pad's centre, along the arrow; of what moves, where it is seen against the deck."""
    right_m: float
    """The same to starboard of the arrow."""
    height_m: float
    """Height that it stands out of the deck; 0 for what moves, whose height is not known."""

    @property
    def from_centre_m(self) -> float:
        """Distance from the pad's centre, m."""
        return math.hypot(self.forward_m, self.right_m)


class PadCheck(Struct, frozen=True):
    """State of the pad's surface, and of what is about it, at an instant."""

    at: MonoNs
    """Exposure of the newest frame that was read."""
    seen: float
    """Share, 0..1, of the cells that the drawing knows which were read often enough within the time for which they count."""
    thing: PadThing | None = None
    """The largest thing; None if nothing is seen."""
    near: NearThing | None = None
    """The nearest thing about the pad; None if nothing is seen."""
    glare: float = 0.0
    """Share of the pad's ground, 0..1, that is in glare where this may hide something of 15 cm; 0 otherwise."""


class Detection(Struct, frozen=True, eq=False):
    """The detection of the pad in one frame."""

    selected: Sighting | None
    """The chosen method's sighting with `method` "selected"; None if there is none. If both show, the arrow resolves an ambiguous
    heading. A fresh belief does not exclude its place.
    """
    chosen: Method | None
    methods: Mapping[Method, Sighting | None]
    """The sighting of every method that was tried."""
    opinions: Opinions | None = None
    """The two opinions on the best registration; None without a second opinion."""
    elsewhere: Sighting | None = None
    """Sighting that is surer than `selected`, or the only one, at a place that a fresh estimate excludes.

    It is another pad, or the tracked one if the estimate is wrong; the guard decides.
    """
    on_pad: PadCheck | None = None
    """Known things that lie on the pad; None before its surface was read."""
    alone_in: F64 | None = None
    """Corners, (4, 2) m in `level`, of the deck that the frame shows with no second pad.

    Empty if a second one is there; None if that is in doubt or was not looked for.
    """
    unfinished: bool = False
    """True if the frame's budget of work ended its search, which goes on with the next frame."""

    def _repr_html_(self) -> str:
        """Return the detection as a notebook shows it: its sighting, and what each method saw."""
        seen = "no pad" if self.selected is None else self.selected._repr_html_()
        tried = ", ".join(f"{name} {'-' if one is None else f'{one.confidence:.2f}'}" for name, one in self.methods.items())
        return f"{seen}<p>confidence by method: {tried}</p>"
