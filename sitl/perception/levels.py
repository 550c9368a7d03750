"""Make the perception of a level."""

from __future__ import annotations

from collections.abc import Sequence

from estimator.contracts.errors import BadInput
from sitl.faults.fault import Fault
from sitl.perception.model import Model
from sitl.perception.pixels import Pixels
from sitl.perception.port import LEVELS, Level, Perception
from sitl.perception.truth import TruthLevel


def perceive(level: Level, model: str | None = None) -> Perception:
    """Return a perception of this level, for one flight.

    Args:
        model: the error model's file, or the name of a shipped one; None for the one of the settings' vision.

    Raises:
        BadInput: the level is not known, or the error model's file is missing or has a fault.
    """
    if level == "model":
        return Model(model)
    if level == "truth":
        return TruthLevel(model)
    if level == "pixels":
        return Pixels()
    raise BadInput(f"there is no perception {level!r}; known are {', '.join(LEVELS)}")


def represents(level: Perception, faults: Sequence[Fault]) -> bool:
    """Return whether a level of perception represents all of these faults."""
    try:
        level.refuse(faults)
    except BadInput:
        return False
    return True
