"""Colour classes that learn: what the pad's paints look like under the light of the day.

The drawing, laid on a frame and believed, says of every pixel which paint it shows. Memory goes in and memory comes out; it
moves slowly, fades when the pad is not found, and below a certain trust it is as if nothing had been learned. Acquisition takes
from it where to part disc from surroundings; without it, it tries several places.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.detect.alignment import AlignedTemplate
from estimator.vision.detect.template import AROUND, DISC
from estimator.vision.pad import Pad

LEARNED_AT = 0.9
"""Confidence a frame needs to teach anything."""
RATE = 0.05
"""Of one frame in the memory: half of what is known is newer than 14 frames."""
FADING = 0.08
"""Of the trust lost with each frame without the pad: from full trust to none in 28 frames."""
TRUSTED = 0.10
"""Trust from which on the memory is used: three confident frames."""
_FLOOR = 0.01
"""Of full scale: light below it is noise."""
_BROAD = 1.0
"""Variance, in natural logarithms squared, of a paint that nothing is known of: a factor e either way."""
_PURE, _ENOUGH = 0.85, 6
_FARTHEST = 3.0
"""Standard deviations a paint may move in one frame's opinion; more is taken for that much."""


@dataclass(frozen=True, slots=True, eq=False)
class PaintMemory:
    """Mean and variance of the logarithm of each paint's light, and how far to trust them."""

    mean: F64
    """(4, 3) of H, orange, disc, surroundings in blue, green, red: log1p(light / floor)."""
    var: F64
    """(4, 3)."""
    trust: float
    """0..1."""

    @property
    def trusted(self) -> bool:
        return self.trust >= TRUSTED

    def dominance(self, pad: Pad) -> tuple[float, float] | None:
        """By how much the disc's dominant channel exceeds the others on the disc and around it, in natural logarithms.

        None while the memory is not trusted, or where the two are not apart by two standard deviations.
        """
        if not self.trusted:
            return None
        main = 2 - int(np.argmax(pad.colours.disc))
        others = [(main + 1) % 3, (main + 2) % 3]
        disc, around = (float(self.mean[k, main] - self.mean[k, others].max()) for k in (DISC, AROUND))
        spread = float(np.sqrt(self.var[[DISC, AROUND]].mean()))
        return (disc, around) if disc - around > 2.0 * spread else None


FRESH = PaintMemory(np.zeros((4, 3)), np.full((4, 3), _BROAD), 0.0)
"""Nothing learned."""


def learn(memory: PaintMemory, aligned: AlignedTemplate, confidence: float) -> PaintMemory:
    """The memory after a frame in which the drawing was laid with this confidence; unchanged by a doubtful one."""
    if confidence < LEARNED_AT:
        return memory
    light = np.log1p(np.maximum(aligned.light, 0.0) / _FLOOR)
    mean, var = memory.mean.copy(), memory.var.copy()
    first = memory.trust == 0.0
    for k in range(4):
        pure = (aligned.share[:, k] > _PURE) & (aligned.weight > 0.5)
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


def missed(memory: PaintMemory) -> PaintMemory:
    """The memory after a frame without the pad: less trusted, broader, at last as fresh as before all learning."""
    trust = memory.trust * (1.0 - FADING)
    if trust < 0.5 * TRUSTED:
        return FRESH
    return PaintMemory(memory.mean, memory.var + FADING * (_BROAD - memory.var), trust)
