"""Faults of the streams between vehicle and service as data: one kind a stream, with what becomes of its packets.

A packet may be dropped, doubled, overtaken by the one after it, or late; several of these go together.
"""

from __future__ import annotations

from typing import Annotated, Literal

from estimator.contracts.keys import number
from sitl.faults.fault import Fault

Stream = Literal["frames", "navdata", "commands"]
STREAMS: tuple[Stream, ...] = ("frames", "navdata", "commands")


class StreamFault(Fault, frozen=True):
    """A fault of one stream."""

    delay_s: Annotated[float, number("delay in addition to the usual one; stamps stay true", "s", 0.0, 10.0)] = 0.0
    dropped_fraction: Annotated[float, number("fraction of the packets that are lost, drawn by the seed", "1", 0.0, 1.0)] = 0.0
    duplicated_fraction: Annotated[
        float, number("fraction of the packets that arrive twice, drawn by the seed", "1", 0.0, 1.0)
    ] = 0.0
    reordered_fraction: Annotated[
        float, number("fraction of the packets that the next one overtakes, drawn by the seed", "1", 0.0, 1.0)
    ] = 0.0

    def check(self) -> None:
        """Refuse a fault without an effect, or with effects that exclude each other; raises ValueError."""
        if not any((self.delay_s, self.dropped_fraction, self.duplicated_fraction, self.reordered_fraction)):
            raise ValueError(
                "nothing says what is wrong with the stream: give delay_s, dropped_fraction, duplicated_fraction or "
                "reordered_fraction"
            )
        if self.dropped_fraction == 1.0 and (self.delay_s or self.duplicated_fraction or self.reordered_fraction):
            raise ValueError("dropped_fraction is 1: no packet is left for another effect; give only dropped_fraction")

    @property
    def silent(self) -> bool:
        """Whether nothing passes."""
        return self.dropped_fraction >= 1.0


class FrameStream(StreamFault, frozen=True, tag="frames"):
    """The camera's frames on their way to the service."""


class NavdataStream(StreamFault, frozen=True, tag="navdata"):
    """The vehicle's samples on their way to the service."""


class CommandStream(StreamFault, frozen=True, tag="commands"):
    """The service's commands on their way to the vehicle."""


KIND_OF_STREAM: dict[Stream, type[StreamFault]] = {"frames": FrameStream, "navdata": NavdataStream, "commands": CommandStream}
