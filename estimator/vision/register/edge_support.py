"""The support of the frame for each kind of edge at the registered pose."""

from __future__ import annotations

from dataclasses import dataclass

from estimator.contracts.geometry import F64

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
