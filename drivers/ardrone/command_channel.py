"""The AT command socket: one sequence for everything sent, and the period that keeps the drone's watchdog content."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.ardrone.at import AtCommand, encode
from drivers.ardrone.counters import Counters
from drivers.ardrone.datagrams import Datagrams, open_datagrams
from drivers.ardrone.helm import Helm
from drivers.ardrone.navdata_channel import NavdataChannel
from drivers.ardrone.options import ArDroneOptions
from estimator.contracts.errors import Recoverable
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, after, seconds_between

_PARTING = 5
"""Datagrams of the last word: any one of them is enough."""


class CommandChannel:
    """Sends the helm's commands every period, whatever else happens, and whatever the other channels want sent."""

    def __init__(self, options: ArDroneOptions, clock: Clock, counters: Counters, helm: Helm, navdata: NavdataChannel) -> None:
        self._o = options
        self._clock = clock
        self._counters = counters
        self._helm = helm
        self._navdata = navdata
        self._socket: Datagrams | None = None
        self._sequence = 0

    def send(self, commands: Sequence[AtCommand]) -> None:
        """All in one datagram, in order.

        Raises:
            Recoverable: the socket is not open or broken.
        """
        if self._socket is None:
            raise Recoverable("the command socket is not open")
        words = []
        for command in commands:
            self._sequence += 1
            words.append(encode(self._sequence, command))
        self._socket.send(b"".join(words))
        self._counters.at_datagrams += 1
        self._counters.at_commands += len(words)

    async def run(self) -> None:
        """Period after period, until the socket breaks or the drone has been silent for `reopen_after_s`.

        Raises:
            Recoverable: as said; a new socket takes this host's present address.
        """
        async with open_datagrams(self._o.host, self._o.at_port, self._clock, lambda data, heard: None) as socket:
            self._socket = socket
            opened = due = self._clock.now()
            counted = 0
            try:
                while True:
                    now = self._clock.now()
                    self.send(self._helm.period(now))
                    self._counters.at_errors += socket.errors - counted
                    counted = socket.errors
                    if seconds_between(self._last_sign(opened), now) > self._o.reopen_after_s:
                        raise Recoverable(f"no sign of the drone for {self._o.reopen_after_s} s")
                    due = max(after(due, self._o.command_period_s), now)
                    await self._clock.sleep(max(0.0, seconds_between(self._clock.now(), due)))
            finally:
                self._part(socket)
                self._socket = None

    def _last_sign(self, opened: MonoNs) -> MonoNs:
        heard = self._navdata.heard
        return opened if heard is None else max(opened, heard)

    def _part(self, socket: Datagrams) -> None:
        """However this socket ends, its last word leaves the drone holding its place."""
        try:
            for _ in range(_PARTING):
                self.send(self._helm.leave(self._clock.now()))
        except Recoverable:
            self._counters.at_errors += 1
