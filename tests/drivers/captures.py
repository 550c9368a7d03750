"""Real captures of the drone, which lie beside the repository and are not part of it."""

from pathlib import Path

import pytest

from drivers.ardrone.pave import PaveFrame, PaveParser

CAPTURES = Path(__file__).parents[2] / "../shared/data/ardrone"
needs_captures = pytest.mark.skipif(
    not CAPTURES.is_dir(), reason="the captures in ../shared/data/ardrone are not on this machine"
)


def frames_of(name: str) -> list[PaveFrame]:
    """Return every frame of a capture."""
    return PaveParser().feed((CAPTURES / name).read_bytes())
