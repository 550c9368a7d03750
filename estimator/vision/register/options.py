"""Options of registration."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RegistrationOptions:
    """Options that trade accuracy against time.

    The defaults are for 640x360 frames on one thread.
    """

    coarse: bool = True
    """Approach from the start on a reduced frame first; False for a start good to 1.5 px."""
    max_profiles: int = 120
    dense_pixels: int = 1700
    """Largest number of pixels in the disc's image at which it is registered as a whole."""
    blur_px: float = 0.6
    """Initial sigma of the lens' point spread; it is estimated."""
    edge_sigma_px: float = 0.004
    """Smallest sigma of an edge's place in the frame as predicted by drawing, lens and blur model."""
    dense_edge_sigma_px: float = 0.004
    """The same where edges merge."""
    coded_px: float = 0.0
    """Sigma of the place of a patch of the frame that a video codec has moved; 0 of a frame that no codec has predicted."""
    gamma: bool = True
    """True if pixel values are sRGB; False if they are linear light."""
