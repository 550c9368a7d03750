"""Look at where the pad may lie: register the drawing from a start pose, verify it there, and bring it to level.

The native core does all of it in one call (`estimator/core/vision/look/look.c`).

A camera's tone curve is learnt by looks, on the edges of a pad that is tracked: one number, step by step. Across a blurred edge
light is symmetric, and values are not. What the tone is off leaves near edges that no pose and no blur explains, and displaces
all of them towards the darker paint: that is a wrong range. From time to time a near registration is made again one step beside,
and the step is kept if the rest explains more. Noise alone has no edges, and clipped light no tone: neither is learnt from.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.time import MonoNs
from estimator.core.library import CORE
from estimator.vision.camera import Camera
from estimator.vision.detect.alignment import UNCUT
from estimator.vision.detect.paint import FRESH, PaintMemory
from estimator.vision.detect.pyramid import U8, FrameView
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


STEP, _LOWEST, _HIGHEST = 0.1, -10, 4
"""A step of the tone, and the range in steps: from values that are linear light to a gamma of 2.7."""
_UNEXPLAINED_PX, _FAR_OFF_PX, _STRIDE = 0.03, 0.12, 3
"""Displacement of edges from which something is learnt, and from which by so many steps at once: of right tones it is 0.02 and
less, of one step beside 0.04, of two 0.07."""
_LESS = 0.97
"""Factor on what is left over contrast below which a step is kept."""
_EVERY_NS, _RESTS_NS = 300_000_000, 3_000_000_000
"""Time between two trials, and after neither side was better."""
_AGREES, _CLIPPED, _CLIPPED_SHARE = 0.8, 253, 0.01
"""Least share of the edges that agree; value from which light is clipped, and the share of the pad's box that may be."""

_AT_ONCE = MonoNs(0)


@dataclass(frozen=True, slots=True)
class ToneMemory:
    """The tone that was learnt, in steps, and the next trial."""

    steps: int = 0
    way: int = -1
    """The side that is tried next, 1 or -1."""
    failed: int = 0
    """Trials since a step was kept."""
    next_at: MonoNs = _AT_ONCE


SRGB = ToneMemory()


@lru_cache(maxsize=8)
def with_tone(camera: Camera, steps: int) -> Camera:
    """Return a camera with the tone of so many steps from sRGB."""
    return replace(camera, tone=1.0 + STEP * steps) if steps else camera


def learn_tone(
    memory: ToneMemory, camera: Camera, view: FrameView, found: Looked, orientation: Orientation, at: MonoNs
) -> ToneMemory:
    """Return the tone after one more frame in which the pad is sure; most frames change nothing.

    Args:
        camera: as its file has it, without a tone.
        found: the pad in this frame, by the tone of the memory.
    """
    record = found.record["found"]
    if at < memory.next_at or record["dense"] or record["edge_rms_px"] < _UNEXPLAINED_PX or record["inliers"] < _AGREES:
        return memory
    if _is_clipped(view.pyramid[0], found):
        return replace(memory, next_at=MonoNs(at + _EVERY_NS))
    steps = memory.steps + memory.way * (_STRIDE if record["edge_rms_px"] > _FAR_OFF_PX else 1)
    if not _LOWEST <= steps <= _HIGHEST:
        return replace(memory, way=-memory.way)
    tried = view._replace(camera=with_tone(camera, steps)).as_seen()
    other = look(tried, found.pose, orientation, RegistrationOptions(coarse=False), tracked=True)
    if other is not None and _left(other) < _LESS * _left(found):
        return ToneMemory(steps, memory.way, 0, MonoNs(at + _EVERY_NS))
    rests = _RESTS_NS if memory.failed else _EVERY_NS
    return ToneMemory(memory.steps, -memory.way, (memory.failed + 1) % 2, MonoNs(at + rests))


def fade_tone(memory: ToneMemory) -> ToneMemory:
    """Return the tone one step nearer to sRGB, after a frame in which no pad is sure."""
    return replace(memory, steps=memory.steps - (memory.steps > 0) + (memory.steps < 0)) if memory.steps else memory


def _left(found: Looked) -> float:
    """Return what is left of the light along the edges, over their contrast."""
    record = found.record["found"]
    contrast = float(np.linalg.norm(record["edges"]["contrast_bgr"]))
    return float(record["noise_light"]) / max(contrast, 1e-9)


def _is_clipped(px: U8, found: Looked) -> bool:
    points = found.outline[np.isfinite(found.outline).all(axis=1)]
    if not len(points):
        return True
    height, width = px.shape[:2]
    (left, top), (right, bottom) = (
        np.clip(limit, 0, (width - 1, height - 1)).astype(int) for limit in (points.min(0), points.max(0))
    )
    part = px[top : bottom + 1 : 4, left : right + 1 : 4]
    return bool((part >= _CLIPPED).any(axis=2).mean() > _CLIPPED_SHARE)
