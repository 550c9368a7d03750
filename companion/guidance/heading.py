"""The heading to the arrow: the nose follows it, and never through half a turn that the estimate made by itself."""

import math

from msgspec import Struct

from companion.base.reason import Reason, ReasonCause
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import wrap_pi

JUMP_RAD = math.radians(90.0)
"""Change of the estimated heading within one guidance cycle that no vehicle makes."""
SIGMA_MAX_RAD = math.radians(20.0)
"""Uncertainty of the heading beyond which nothing turns by it."""


class HeadingMemory(Struct, frozen=True):
    """The heading's memory."""

    last_rad: float | None = None
    """Heading against the arrow in the newest estimate that knew it."""


def watch(memory: HeadingMemory, estimate: RelativeState) -> tuple[HeadingMemory, Reason | None]:
    """Take the next estimate; return the reason if the arrow turned in it by more than any vehicle turns."""
    yaw, last = estimate.yaw_rad, memory.last_rad
    if yaw is None:
        return memory, None
    jump = abs(wrap_pi(yaw - (yaw if last is None else last)))
    memory = HeadingMemory(yaw)
    return memory, Reason(ReasonCause.HEADING_TURNED, math.degrees(jump), math.degrees(JUMP_RAD)) if jump > JUMP_RAD else None


def wanted_rad(estimate: RelativeState) -> float | None:
    """Return the heading to turn to, or None to keep the present one."""
    known = estimate.yaw_rad is not None and float(estimate.cov[6, 6]) <= SIGMA_MAX_RAD**2
    return 0.0 if known else None
