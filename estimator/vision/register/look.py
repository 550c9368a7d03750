"""Look at where the pad may lie: register the drawing from a start pose, verify it there, and bring it to level.

The native core does all of it in one call (`estimator/core/vision/look/look.c`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.core.library import CORE
from estimator.vision.detect.alignment import UNCUT
from estimator.vision.detect.paint import FRESH, PaintMemory
from estimator.vision.detect.pyramid import FrameView
from estimator.vision.drawing import EdgeKind
from estimator.vision.native import edge_points
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.registration import (
    EdgeSupport,
    Registration,
    RegistrationOptions,
    is_ambiguous,
    looked_at,
    native_start,
    registration_of,
    supports,
)


@dataclass(frozen=True, slots=True, eq=False)
class Looked:
    """Result of a look: a registration, the evidence that it is the pad, and its sighting in level."""

    record: NDArray[Any]
    """The core's `dl_registered_pad`."""
    outline: F64
    """Pixels of the outline's points, (N, 2)."""
    pad: Pad
    orientation: Orientation

    @property
    def log_odds(self) -> float:
        """Log-odds that this is the pad, from the frame alone."""
        return float(self.record["log_odds"])

    @property
    def evidence(self) -> F64:
        """The inputs of the verification, in the order of `look_evidence` in the core's header."""
        return np.asarray(self.record["evidence"])

    @property
    def pose(self) -> PadPose:
        """The pad's pose in `cam`."""
        found = self.record["found"]
        return PadPose(Rotation(found["R"].reshape(3, 3)), found["t"])

    @property
    def range_m(self) -> float:
        """Distance from the lens to the pad's centre, m."""
        return math.hypot(*self.record["found"]["t"].tolist())

    @property
    def in_level(self) -> NDArray[Any]:
        """The core's `dl_level_sighting`."""
        return np.asarray(self.record["seen"])

    @property
    def edges(self) -> Mapping[EdgeKind, EdgeSupport]:
        """The support of the frame for each kind of edge."""
        return supports(self.record["found"])

    @property
    def yaw_ambiguous(self) -> bool:
        """True if neither an arrowhead nor a fiducial resolved the headings."""
        return is_ambiguous(self.record["found"], self.pad)

    @property
    def outlines(self) -> tuple[F64, ...]:
        """The outline by kind of edge, (N, 2) px each, of the points that the lens projects."""
        each = tuple(self.outline[part] for part in edge_points(self.pad).shown)
        ok = np.isfinite(self.outline)
        return each if ok.all() else tuple(uv[np.isfinite(uv).all(axis=1)] for uv in each)

    def paint(self) -> PaintMemory:
        """Return what is known of the paints if this is the pad."""
        paint = self.record["paint"]
        return PaintMemory(paint["mean"].reshape(4, 3), paint["var"].reshape(4, 3), float(paint["trust"]))

    def registration(self) -> Registration:
        """Return the registration."""
        return registration_of(self.record["found"], self.pad, self.orientation)


def look(
    view: FrameView,
    start: PadPose,
    orientation: Orientation,
    options: RegistrationOptions,
    *,
    tracked: bool = False,
    cut: F64 = UNCUT,
    paint: PaintMemory = FRESH,
) -> Looked | None:
    """Register the drawing from a start pose and verify it there; return None if nothing of it is found.

    Args:
        view: the pad as the camera sees it, see `FrameView.as_seen`.
        start: as for `registration.register`.
        orientation: the attitude at the exposure and the deck's expected tilt.
        tracked: whether a track has confirmed the pad there before.
        cut: the line beyond which something covers the pad, (3,); see `alignment.UNCUT`.
        paint: what is known of the paints.

    Raises:
        ValueError: the frame is not of the camera's size.
    """
    given, out = native_start(start, orientation, options, cut, paint), np.zeros((), CORE.dtype("dl_registered_pad"))
    given.tracked = tracked
    outline = looked_at(view, given, out)
    if outline is None:
        return None
    out.setflags(write=False)
    outline.setflags(write=False)
    return Looked(out, outline, view.pad, orientation)
