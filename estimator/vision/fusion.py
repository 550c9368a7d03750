"""Several methods looked at one frame: which of them agree, and what they say together.

Agreement: each cue in turn is taken for true and the others are held against it; the cue with the most confidence behind it wins
and those it does not agree with are outliers (RANSAC with every hypothesis tried, Fischler & Bolles 1981).

Fusion: all cues come from the same pixels and the same attitude, so their errors are correlated in ways nobody knows. Covariance
intersection (Julier & Uhlmann, A non-divergent estimation algorithm in the presence of unknown correlations, ACC 1997) is
consistent whatever the correlation; the weights are Niehsen's (Information fusion based on fast covariance intersection, 2002),
taken on the information so that a cue that comes or goes moves the result no further than its own share.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Sighting
from estimator.contracts.geometry import F64, wrap_pi

_AGREE_XYZ = 16.27
"""Chi-square, 3 degrees of freedom, 99.9 %."""
_AGREE_YAW = 10.83
"""Chi-square, 1 degree of freedom, 99.9 %."""
_COARSE = 0.003
"""Of the distance: one standard deviation of what worn paint, shade and a deck not quite level do to the thesis' methods beyond
what they say. Less than a few of it is no reason to doubt the pad."""


@dataclass(frozen=True, slots=True, eq=False)
class Fused:
    """What the cues say together."""

    sighting: Sighting
    """`method` is "fused"; `pose6` is that of the most certain cue that has one."""
    agreeing: tuple[str, ...]
    """Methods that took part."""
    outliers: tuple[str, ...]
    """Methods that disagreed and were left out."""


def fuse(cues: Iterable[Sighting]) -> Fused | None:
    """One sighting from those of one frame; None from none.

    The confidence is that of the most confident cue that took part, times the share of all confidence that agreed.
    """
    seen = [cue for cue in cues if cue.confidence > 0.0]
    if not seen:
        return None
    votes = [sum(other.confidence for other in seen if agree(cue, other)) for cue in seen]
    best = max(range(len(seen)), key=lambda i: (round(votes[i], 9), -_size(seen[i])))
    inliers = [cue for cue in seen if cue is seen[best] or agree(seen[best], cue)]
    inliers.sort(key=_size)
    share = sum(cue.confidence for cue in inliers) / sum(cue.confidence for cue in seen)
    confidence = max(cue.confidence for cue in inliers) * share
    return Fused(
        _intersected(inliers, confidence),
        tuple(cue.method for cue in inliers),
        tuple(cue.method for cue in seen if cue not in inliers),
    )


def agree(a: Sighting, b: Sighting) -> bool:
    """Whether two cues can both be right, as far as their covariances say."""
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
    """Of its uncertainty in place, m."""
    return math.sqrt(float(np.trace(cue.cov[:3, :3])))


def _intersected(cues: list[Sighting], confidence: float) -> Sighting:
    """Covariance intersection of cues that agree, the most certain first."""
    first = cues[0]
    sure = next((cue for cue in cues if cue.yaw_rad is not None and not cue.yaw_ambiguous), None)
    source = sure or next((cue for cue in cues if cue.yaw_rad is not None), None)
    reference = 0.0 if source is None or source.yaw_rad is None else source.yaw_rad
    informations = [_information(cue) for cue in cues]
    sizes = np.array([1.0 / np.trace(cue.cov[:3, :3]) for cue in cues])
    weights = sizes / sizes.sum()
    total = sum((w * info for w, info in zip(weights, informations, strict=True)), np.zeros((4, 4)))
    vector = np.zeros(4)
    for w, info, cue in zip(weights, informations, cues, strict=True):
        vector += w * info @ np.append(cue.d_body_pad_level, _turn_from(cue, reference))
    cov = np.linalg.inv(total)
    fused = cov @ vector
    yaw = None if source is None else wrap_pi(reference + float(fused[3]))
    if yaw is None:
        cov = _with_unknown_yaw(cov)
    return replace(
        first,
        method="fused",
        d_body_pad_level=fused[:3],
        yaw_rad=yaw,
        yaw_ambiguous=yaw is not None and sure is None,
        cov=0.5 * (cov + cov.T),
        confidence=min(1.0, confidence),
        pose6=next((cue.pose6 for cue in cues if cue.pose6 is not None), None),
        features=tuple(feature for cue in cues for feature in cue.features),
    )


def _information(cue: Sighting) -> F64:
    """(4, 4) inverse covariance; next to nothing about a heading it does not tell."""
    return np.asarray(np.linalg.inv(cue.cov if cue.yaw_rad is not None else _with_unknown_yaw(cue.cov)))


def _with_unknown_yaw(cov: F64) -> F64:
    out = cov.copy()
    out[3, :] = out[:, 3] = 0.0
    out[3, 3] = UNKNOWN_YAW_VAR
    return out


def _turn_from(cue: Sighting, reference_rad: float) -> float:
    """The cue's heading less the reference, on the branch nearest to it where the cue leaves the branch open."""
    if cue.yaw_rad is None:
        return 0.0
    turned = wrap_pi(cue.yaw_rad - reference_rad)
    return math.remainder(turned, math.pi) if cue.yaw_ambiguous else turned
