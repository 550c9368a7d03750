"""The effect of faults on the streams between vehicle and service.

The same packets, faults and seed give the same result.
"""

from bisect import insort
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from estimator.contracts.time import MonoNs, after
from sitl.faults.acts import STREAMS, Passage, Stream
from sitl.faults.corrupted import Corruptions
from sitl.faults.fault import Fault, FaultTimer

_T = TypeVar("_T")
LAG_S = 0.015
"""Time after which a doubled packet arrives again, and an overtaken one after the other: by then the service has finished with
the first."""


class Fate(NamedTuple):
    """Fate of one packet."""

    copies: int
    """Number of arrivals, 0 to 2."""
    overtaken: bool = False
    """True if the next one overtakes it."""


_ARRIVES = Fate(1)
_SURELY = (0.5, 0.5, 0.5)
"""Numbers in place of those that are drawn, of what happens to every packet or to none."""


class FaultyStream:
    """Fate of the packets of one stream.

    Args:
        faults: which faults are active.
        stream: which stream this is.
        seed: seed of what is lost, doubled or overtaken.
    """

    def __init__(self, faults: FaultTimer, stream: Stream, seed: int) -> None:
        self._faults, self._stream = faults, stream
        self._rng = np.random.default_rng([seed, 0x57EA, STREAMS.index(stream)])

    @property
    def clear(self) -> bool:
        """True if every packet passes, at its time and in its order."""
        return not self._faults.now

    @property
    def silent(self) -> bool:
        """True if nothing passes."""
        return any(passage.lost >= 1.0 for passage in self._passages())

    @property
    def delay_s(self) -> float:
        """Delay of a packet that is sent now, in addition to the usual one, s."""
        return sum(passage.delay_s for passage in self._passages())

    def fate(self) -> Fate:
        """Return what becomes of the packet that is sent now; every call is another packet."""
        passages = self._passages()
        if not passages:
            return _ARRIVES
        if any(passage.lost >= 1.0 and not passage.by_chance for passage in passages):
            return Fate(0)
        copies, overtaken = 1, False
        for passage in passages:
            lost, twice, late = self._rng.random(3) if passage.by_chance else _SURELY
            if lost < passage.lost:
                copies = 0
            elif twice < passage.doubled:
                copies = min(2, 2 * copies)
            overtaken = overtaken or late < passage.overtaken
        return Fate(copies, overtaken)

    def _passages(self) -> list[Passage]:
        """Return how the active faults let a packet pass."""
        return [passage for fault, _ in self._faults.now if (passage := fault.on_stream(self._stream)) is not None]


class VehicleStreams:
    """The three streams of one vehicle."""

    def __init__(self, faults: FaultTimer, seed: int) -> None:
        self.frames, self.navdata, self.commands = (FaultyStream(faults, stream, seed) for stream in STREAMS)


class FlightFaults(FaultTimer):
    """The faults of one flight, with its streams and signals."""

    def __init__(self, faults: tuple[Fault, ...], seed: int = 0) -> None:
        super().__init__(faults, seed)
        self.streams = VehicleStreams(self, seed)
        """Fate of samples, frames and commands, for the code that carries them."""
        self.corruptions = Corruptions(self, seed)
        """Corrupted values of signals."""


class InTransit(Generic[_T]):
    """Packets of one stream under way, each with the instant of its arrival.

    A stream keeps its order: what follows a late packet waits behind it. Only a packet that is overtaken
    arrives `LAG_S` after the one that overtook it, and a doubled one again `LAG_S` after the first.
    """

    def __init__(self, stream: FaultyStream) -> None:
        self._stream = stream
        self._under_way: list[tuple[MonoNs, _T]] = []
        self._held: list[tuple[_T, int]] = []
        self._due: MonoNs | None = None

    def send(self, make: Callable[[], _T], now: MonoNs, usual_s: float = 0.0) -> None:
        """Send a packet.

        Args:
            make: makes the packet; it is not called where the packet is lost.
            usual_s: time that the packet needs without a fault.
        """
        fate = self._stream.fate()
        if fate.copies:
            self.put(make(), fate, now, usual_s)

    def put(self, packet: _T, fate: Fate, now: MonoNs, usual_s: float = 0.0) -> MonoNs | None:
        """Send a packet of a known fate; return the instant of its arrival, None while that is not known."""
        if fate.overtaken:
            self._held.append((packet, fate.copies))
            return None
        late_s = usual_s + self._stream.delay_s
        due = after(now, late_s) if late_s else now
        if self._due is not None and self._due > due:
            due = self._due
        self._due = due
        if fate.copies == 1 and not self._held and (not self._under_way or self._under_way[-1][0] <= due):
            self._under_way.append((due, packet))
            return due
        later = after(due, LAG_S)
        again = [(due if n == 0 else later, packet) for n in range(fate.copies)]
        for each in [*again, *((later, held) for held, copies in self._held for _ in range(copies))]:
            insort(self._under_way, each, key=itemgetter(0))
        self._held.clear()
        return due

    def through(self, make: Callable[[], _T], now: MonoNs) -> Sequence[tuple[MonoNs, _T]]:
        """Send a packet that takes no time without a fault; return all that have arrived, each with its instant."""
        if self._stream.clear and not self._under_way and not self._held:
            return ((now, make()),)
        self.send(make, now)
        arrived = []
        while (packet := self.arrived(now)) is not None:
            arrived.append(packet)
        return arrived

    def arrived(self, now: MonoNs) -> tuple[MonoNs, _T] | None:
        """Return the next packet that has arrived, with the instant of its arrival, and forget it; None if there is none."""
        if not self._under_way or self._under_way[0][0] > now:
            return None
        return self._under_way.pop(0)

    def clear(self) -> None:
        """Forget all that is under way."""
        self._under_way.clear()
        self._held.clear()
        self._due = None
