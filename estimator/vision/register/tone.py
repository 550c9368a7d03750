"""Learn a camera's tone curve by looks, on the edges of a pad that is tracked: one number, step by step.

Across a blurred edge light is symmetric, and values are not. What the tone is off leaves near edges that no pose and no blur
explains, and displaces all of them towards the darker paint: that is a wrong range. From time to time a near registration is made
again one step beside, and the step is kept if the rest explains more. Noise alone has no edges, and clipped light no tone:
neither is learnt from.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from estimator.contracts.time import MonoNs
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation
from estimator.vision.detect.pyramid import U8, FrameView
from estimator.vision.register.registration import Registration, RegistrationOptions, look

STEP = 0.1
"""A step of the tone."""
_LOWEST = -10  # Steps to values that are linear light
_HIGHEST = 4  # Steps to a gamma of 2.7
_UNEXPLAINED_PX = 0.03
"""Displacement of edges from which something is learnt: of right tones 0.02 and less, one step beside 0.04, two 0.07."""
_FAR_OFF_PX = 0.12  # Displacement from which it is learnt by several steps at once
_STRIDE = 3  # Number of these steps
_LESS = 0.97  # Factor on what is left over contrast below which a step is kept
_EVERY_NS = 300_000_000  # Time between two trials
_RESTS_NS = 3_000_000_000  # Time after neither side was better
_AGREES = 0.8  # Least share of the edges that agree
_CLIPPED = 253  # Value from which light is clipped
_CLIPPED_SHARE = 0.01  # Largest share of the pad's box that may be

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

    def relaxed(self) -> ToneMemory:
        """Return the memory one step nearer to sRGB."""
        back = (self.steps < 0) - (self.steps > 0)
        return replace(self, steps=self.steps + back) if back else self

    def is_due(self, found: Registration, at: MonoNs) -> bool:
        """Return whether something may be learnt from a registration."""
        return at >= self.next_at and not found.dense and found.edge_rms_px >= _UNEXPLAINED_PX and found.inliers >= _AGREES


SRGB = ToneMemory()


@lru_cache(maxsize=8)
def with_tone(camera: Camera, steps: int) -> Camera:
    """Return a camera with the tone of so many steps from sRGB."""
    return replace(camera, tone=1.0 + STEP * steps)


def learn_tone(memory: ToneMemory, view: FrameView, found: Registration, orientation: Orientation, at: MonoNs) -> ToneMemory:
    """Return the tone after one more frame in which the pad is sure, found by that of the memory; most change nothing."""
    if not memory.is_due(found, at):
        return memory
    if _is_clipped(view.pyramid[0], found):
        return replace(memory, next_at=MonoNs(at + _EVERY_NS))
    steps = memory.steps + memory.way * (_STRIDE if found.edge_rms_px > _FAR_OFF_PX else 1)
    if not _LOWEST <= steps <= _HIGHEST:
        return replace(memory, way=-memory.way)
    tried = view._replace(camera=with_tone(view.camera, steps)).as_seen()
    other = look(tried, found.pose, orientation, RegistrationOptions(coarse=False), tracked=True)
    if other is not None and _left(other) < _LESS * _left(found):
        return ToneMemory(steps, memory.way, 0, MonoNs(at + _EVERY_NS))
    rests = _RESTS_NS if memory.failed else _EVERY_NS
    return ToneMemory(memory.steps, -memory.way, (memory.failed + 1) % 2, MonoNs(at + rests))


def _left(found: Registration) -> float:
    """Return what is left of the light along the edges, over their contrast."""
    contrast = float(np.linalg.norm([edge.contrast_bgr for edge in found.edges.values()]))
    return found.noise_light / max(contrast, 1e-9)


def _is_clipped(px: U8, found: Registration) -> bool:
    points = found.outline[np.isfinite(found.outline).all(axis=1)]
    if not len(points):
        return True
    height, width = px.shape[:2]
    (left, top), (right, bottom) = (
        np.clip(limit, 0, (width - 1, height - 1)).astype(int) for limit in (points.min(0), points.max(0))
    )
    part = px[top : bottom + 1 : 4, left : right + 1 : 4]
    return bool((part >= _CLIPPED).any(axis=2).mean() > _CLIPPED_SHARE)
