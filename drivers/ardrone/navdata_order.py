"""The order of navdata datagrams, by their sequence numbers."""

from enum import Enum

_REORDER = 64
"""A datagram this far behind the newest was not overtaken on its way: the drone has restarted."""


class SequencePlace(Enum):
    """The place of a datagram in its stream."""

    NEXT = "next"
    """It is newer than all before it."""
    OLD = "old"
    """It was overtaken, or arrived a second time."""
    RESTARTED = "restarted"
    """It is the first one of a drone that has restarted."""


class NavdataOrder:
    """Tells where each datagram belongs; only `OLD` ones are to be left out."""

    def __init__(self) -> None:
        self._newest: int | None = None
        self._expected: int | None = None

    def place(self, sequence: int) -> tuple[SequencePlace, int]:
        """Return the place of a datagram that has arrived, and how many are missing just before it."""
        newest, expected = self._newest, self._expected
        place, missing = SequencePlace.NEXT, 0
        if newest is not None and sequence < newest:
            if sequence != 1 and expected is not None and newest - sequence < _REORDER:
                return SequencePlace.OLD, 0
            place = SequencePlace.RESTARTED
        elif expected is not None:
            if sequence < expected:
                return SequencePlace.OLD, 0
            missing = sequence - expected
        self._newest, self._expected = sequence, sequence + 1
        return place, missing

    def silence(self) -> None:
        """Count no gap to the datagram before: the stream was silent and has been requested again."""
        self._expected = None
