"""The navdata channel requests the stream, keeps its order, maps its clock to ours and makes samples."""

from collections.abc import Callable
from enum import Enum

from drivers.ardrone.counters import Counters, Refusal
from drivers.ardrone.navdata import Navdata, decode
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.samples import NavdataSampler
from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.datagrams import WaitingDatagrams, open_waiting
from estimator.contracts.errors import Recoverable
from estimator.contracts.samples import Sample
from estimator.contracts.time import Clock, MonoNs, Stamp, after, seconds_between

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
        self._silent = False

    def place(self, sequence: int) -> SequencePlace:
        """Return the place of a datagram that has arrived."""
        newest, silent = self._newest, self._silent
        place = SequencePlace.NEXT
        if newest is not None and sequence < newest:
            if sequence != 1 and not silent and newest - sequence < _REORDER:
                return SequencePlace.OLD
            place = SequencePlace.RESTARTED
        elif sequence == newest and not silent:
            return SequencePlace.OLD
        self._newest, self._silent = sequence, False
        return place

    def silence(self) -> None:
        """Note that the stream was silent and has been requested again: nothing was overtaken by what comes next."""
        self._silent = True


OPENING = b"\x01\x00\x00\x00"
"""The datagram that requests the unicast stream."""
_LOOK_S = 0.05
_UNASKED_S = 0.04
"""Time after which the channel itself takes what nobody requested."""


class NavdataChannel:
    """One navdata stream.

    Args:
        received: is called with every datagram, in order, and the samples made from it.
        restarted: is called when the drone has restarted and has lost the configuration that it was sent.
    """

    def __init__(
        self,
        options: ArDroneOptions,
        clock: Clock,
        counters: Counters,
        received: Callable[[Navdata, list[Sample], MonoNs], None],
        restarted: Callable[[], None],
    ) -> None:
        self._o = options
        self._clock = clock
        self._counters = counters
        self._received = received
        self._restarted = restarted
        self._sampler = NavdataSampler(options)
        self._map = ClockMap(
            ClockMapOptions(
                wrap_ns=2048 * 1_000_000_000,
                floor_s=options.navdata_delay_s,
                floor_sigma_s=options.navdata_delay_sigma_s,
                name="the drone's navdata",
            )
        )
        self._order = NavdataOrder()
        self.received_at: MonoNs | None = None
        """The instant at which the newest good datagram was received; None before the first."""
        self._socket: WaitingDatagrams | None = None
        self.newest: Navdata | None = None

    def take_waiting(self) -> None:
        """Process the datagrams that wait in the socket. Guidance, vision and the commands request them just before they decide.

        Most of the time that a datagram takes by itself is spent on waking for it, 200 times a second. Never raises.
        """
        if self._socket is not None:
            self._socket.take()

    async def run(self) -> None:
        """Receive until the stream is silent for `reopen_after_s`.

        Raises:
            Recoverable: the stream is silent, or the socket is broken.
        """
        async with open_waiting(self._o.host, self._o.navdata_port, self._clock, self.take) as self._socket:
            try:
                await self._watch(self._socket)
            finally:
                self._socket = None

    async def _watch(self, socket: WaitingDatagrams) -> None:
        """Take what nobody requested, and request the stream again when it is silent; as `run`."""
        opened = asked = self._clock.now()
        socket.send(OPENING)
        while True:
            await self._clock.sleep(min(_LOOK_S, self._o.navdata_silence_s / 4))
            now = self._clock.now()
            if seconds_between(socket.taken_at, now) >= _UNASKED_S:
                socket.take()
            socket.check()
            received_at = max(opened, self.received_at or opened)
            if seconds_between(received_at, now) > self._o.reopen_after_s:
                raise Recoverable(f"no navdata for {self._o.reopen_after_s} s")
            if seconds_between(max(received_at, asked), now) > self._o.navdata_silence_s:
                self._counters.navdata_silences += 1
                self._order.silence()
                socket.send(OPENING)
                asked = now

    def take(self, datagram: bytes, received_at: MonoNs) -> None:
        """Process one received datagram. Never raises on any bytes."""
        navdata = decode(datagram)
        if isinstance(navdata, Refusal):
            self._counters.navdata_refused[navdata.value] += 1
            return
        if not self._in_order(navdata.sequence):
            return
        self.newest, self.received_at = navdata, received_at
        samples = self._sampler.samples(navdata, self._stamp(navdata, received_at)) if navdata.options else []
        self._counters.samples += len(samples)
        self._received(navdata, samples, received_at)

    def _in_order(self, sequence: int) -> bool:
        place = self._order.place(sequence)
        if place is SequencePlace.RESTARTED:
            self._counters.navdata_restarts += 1
            self._map.reset()
            self._restarted()
        return place is not SequencePlace.OLD

    def _stamp(self, navdata: Navdata, received_at: MonoNs) -> Stamp:
        drone_us = navdata.time_us
        if drone_us is not None:
            return self._map.stamp(drone_us * 1000, received_at)
        return Stamp(after(received_at, -self._o.navdata_delay_s), received_at, self._o.arrival_sigma_s, "arrival")
