"""Learn the colours of the pad's paints under the present light.

An aligned and trusted drawing gives the paint of every pixel. The memory is an input and an output; it moves slowly,
fades while the pad is not found, and is ignored below a certain trust. Where the disc stands out by its
colour, a search begins with colour.
"""

import numpy as np
from msgspec import Struct

from estimator.contracts.geometry import F64
from estimator.vision.detect.template import AROUND, DISC
from estimator.vision.pad import Pad

LEARNED_AT = 0.9
"""Confidence that a frame needs to update the memory."""
FADING = 0.08
"""Fraction of the trust lost with each frame without the pad: full trust is lost in 28 frames."""
TRUSTED = 0.10
"""Trust above which the memory is used: three confident frames."""
_BROAD = 1.0
"""Variance, in natural logarithms squared, of a paint that nothing is known about: a factor e either way."""


class PaintMemory(Struct, frozen=True, eq=False):
    """Mean and variance of the logarithm of each paint's light, and their trust."""

    mean: F64
    """Mean of log1p(light / floor), (4, 3): of H, orange, disc, surroundings in blue, green, red."""
    var: F64
    """Variance of the same, (4, 3)."""
    trust: float
    """Trust in the memory, 0..1."""

    @property
    def trusted(self) -> bool:
        return self.trust >= TRUSTED

    def dominance(self, pad: Pad) -> tuple[float, float] | None:
        """Return the excess of the disc's dominant channel over the others, on the disc and around it, in natural logarithms.

        Return None if the memory is not trusted, or if the two values are not two standard deviations apart.
        """
        if not self.trusted:
            return None
        main = 2 - int(np.argmax(pad.markings.colours.disc))
        others = [(main + 1) % 3, (main + 2) % 3]
        disc, around = (float(self.mean[k, main] - self.mean[k, others].max()) for k in (DISC, AROUND))
        spread = float(np.sqrt(self.var[[DISC, AROUND]].mean()))
        return (disc, around) if disc - around > 2.0 * spread else None


FRESH = PaintMemory(np.zeros((4, 3)), np.full((4, 3), _BROAD), 0.0)
"""The memory before any learning."""


def fade(memory: PaintMemory) -> PaintMemory:
    """Return the memory after a frame without the pad: less trusted and broader, and in the end equal to `FRESH`."""
    trust = memory.trust * (1.0 - FADING)
    if trust < 0.5 * TRUSTED:
        return FRESH
    return PaintMemory(memory.mean, memory.var + FADING * (_BROAD - memory.var), trust)
