"""Learning the paints from the samples themselves."""

from __future__ import annotations

import numpy as np

from estimator.vision.detect.alignment import FLOOR
from estimator.vision.detect.paint import PaintMemory
from tests.estimator.vision.oracle.alignment import Aligned

RATE = 0.05
_PURE, _ENOUGH = 0.85, 6
_FARTHEST = 3.0


def shown(memory: PaintMemory, aligned: Aligned) -> PaintMemory:
    """Return what is known of the paints after a frame in which the drawing was aligned."""
    light = np.log1p(np.maximum(aligned.light, 0.0) / FLOOR)
    mean, var = memory.mean.copy(), memory.var.copy()
    first = memory.trust == 0.0
    for k in range(4):
        pure = (aligned.coverage[:, k] > _PURE) & (aligned.weight > 0.5)
        if np.count_nonzero(pure) < _ENOUGH:
            continue
        seen, scatter = light[pure].mean(axis=0), light[pure].var(axis=0) + 0.03**2
        if first:
            mean[k], var[k] = seen, scatter
            continue
        reach = _FARTHEST * np.sqrt(var[k])
        step = np.clip(seen - mean[k], -reach, reach)
        mean[k] += RATE * step
        var[k] += RATE * (scatter + step**2 - var[k])
    return PaintMemory(mean, var, memory.trust + RATE * (1.0 - memory.trust))
