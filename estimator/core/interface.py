"""Places of the members of structures that are still packed by index, in words of eight bytes."""

from __future__ import annotations

from estimator.core.library import CORE, Door


def size_of(kind: str, door: Door = CORE) -> int:
    """Return the size of a structure."""
    return door.dtype(kind).itemsize // 8


def places_of(kind: str, door: Door = CORE) -> dict[str, slice]:
    """Return where the members of a structure lie."""
    members = (door.dtype(kind).fields or {}).items()
    return {name: slice(member[1] // 8, (member[1] + member[0].itemsize) // 8) for name, member in members}
