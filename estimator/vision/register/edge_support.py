"""Measure the support of the frame for each kind of edge at the registered pose."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.drawing import EdgeKind
from estimator.vision.pad import Pad
from estimator.vision.register import profiles as profiles_
from estimator.vision.register.sampling import Profiles
from estimator.vision.register.state import light_table

_SNR_SEEN = 5.0
_LIKENESS_SEEN = 0.4
"""Limit on the likeness: with the white balance off by 20 % and light of 3000 K, white against green and orange against green
stay above 0.8.
"""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeSupport:
    """The support of the frame for one kind of edge."""

    contrast_bgr: F64
    """Linear light inside minus outside, (3,) BGR."""
    snr: float
    """Contrast over its standard deviation, for the best channel mix."""
    in_view: float
    """Fraction of these edges within the frame, 0..1."""
    inliers: float
    """Fraction of those in view that agree with the drawing, 0..1."""
    likeness: float = 1.0
    """Cosine between the contrast and that of the pad file's paints; 1 for the disc, whose surroundings are unknown."""

    @property
    def seen(self) -> bool:
        return self.snr > _SNR_SEEN and self.inliers > 0.5 and self.in_view > 0.0 and self.likeness > _LIKENESS_SEEN

    def beside(self, kind: EdgeKind, pad: Pad) -> EdgeSupport:
        """Return a copy with the likeness to the paints of the pad file."""
        nominal = _contrasts(pad).get(kind)
        size = math.sqrt(float(self.contrast_bgr @ self.contrast_bgr))
        like = 1.0 if nominal is None or size < 1e-6 else float(nominal @ self.contrast_bgr) / size
        return EdgeSupport(self.contrast_bgr, self.snr, self.in_view, self.inliers, like)


def profile_support(
    fit: profiles_.ProfileFit, measured_at: Profiles, mix: profiles_.Channels, noise: F64
) -> tuple[dict[EdgeKind, EdgeSupport], float]:
    """Return the support of every kind of edge from profiles, and the fraction of all pixels that agree."""
    out: dict[EdgeKind, EdgeSupport] = {}
    pixels, agree = np.add.reduceat(np.stack([measured_at.usable, fit.weight]), measured_at.starts, axis=1)
    enough = pixels > 8
    # The mean of Tukey's weights under Gaussian noise is 0.9.
    counted, agreed = (np.stack([pixels * enough, agree * enough]) @ measured_at.of_kind).tolist()
    for kind, var in zip(EdgeKind, noise.mean(axis=1).tolist(), strict=True):
        in_view = float(measured_at.in_view[kind])
        if not counted[kind]:
            out[kind] = EdgeSupport(np.zeros(3), 0.0, in_view, 0.0)
            continue
        contrast = profiles_.median(fit.contrast[enough & (measured_at.group_kind == kind)])
        snr = contrast / math.sqrt(var) if var < 0.5 else 0.0
        out[kind] = EdgeSupport(mix.contrast[kind] * contrast, snr, in_view, min(1.0, agreed[kind] / (0.9 * counted[kind])))
    return out, min(1.0, float(agree.sum()) / max(1.0, 0.9 * float(pixels.sum())))


def arrow_support(amplitude: float, sigma: float, contrast: F64, in_view: float) -> EdgeSupport:
    """Return the support of an arrowhead with this amplitude; 1 is nominal."""
    agree = min(1.0, max(0.0, 1.0 - abs(amplitude - 1.0)))
    return EdgeSupport(contrast * amplitude, max(0.0, amplitude) / max(sigma, 1e-6), in_view, agree)


@lru_cache(maxsize=8)
def _contrasts(pad: Pad) -> Mapping[EdgeKind, F64]:
    """Return the (3,) BGR unit vectors from the disc's paint to the others of the pad file."""
    table, paints = light_table(True), pad.colours
    ways = {kind: table[list(rgb[::-1])] - table[list(paints.disc[::-1])] for kind, rgb in (
        (EdgeKind.RING, paints.ring), (EdgeKind.ARROW, paints.ring), (EdgeKind.H, paints.h),
    )}  # fmt: skip
    return MappingProxyType({kind: way / max(float(np.linalg.norm(way)), 1e-6) for kind, way in ways.items()})
