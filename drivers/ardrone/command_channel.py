"""The AT command channel: passes the streamer's commands to the sender process, and starts another sender when that is lost."""

from __future__ import annotations

import socket
from collections.abc import Sequence

from drivers.ardrone.at import AtCommand
from drivers.ardrone.command_streamer import CommandStreamer
from drivers.ardrone.counters import Counters
from drivers.ardrone.navdata_channel import NavdataChannel
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.sender_client import SenderClient
from drivers.ardrone.sender_lock import mark
from drivers.ardrone.sender_wire import SenderOptions, SenderStatus, as_text
from estimator.contracts.errors import Recoverable
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, after, seconds_between


class CommandChannel:
    """Sends the streamer's command every period, and the commands of the other channels. The sender outlives a broken run."""

    def __init__(
        self, options: ArDroneOptions, clock: Clock, counters: Counters, streamer: CommandStreamer, navdata: NavdataChannel
    ) -> None:
        self._o = options
        self._clock = clock
        self._counters = counters
        self._streamer = streamer
        self._navdata = navdata
        self._sender: SenderClient | None = None
        self._flew = False
        """A sender of this service has run, and none was refused since, so no other service flies this drone."""
        self._mark: socket.socket | None = None
        """Tells other services on this machine that the drone is flown by this one."""

    @property
    def sender_pid(self) -> int | None:
        """The process id of the sender, None while there is none."""
        return None if self._sender is None else self._sender.pid

    @property
    def up(self) -> bool:
        """Whether commands reach the drone's port now."""
        return self._sender is not None and self._sender.up

    def send(self, commands: Sequence[AtCommand]) -> None:
        """Send the commands in one datagram, in order.

        Raises:
            Recoverable: there is no sender.
        """
        if self._sender is None:
            raise Recoverable("the sender of AT commands is not running")
        self._sender.send(commands)

    async def run(self) -> None:
        """Send a command every period until the sender is lost or the drone has been silent for `reopen_after_s`.

        Raises:
            Recoverable: one of the two happened; the next run has a new sender, or a new socket with this host's present address.
        """
        if self._sender is None:
            self._sender = SenderClient(self._options(), self._clock, self._on_status, self._hovered)
            self._counters.at_senders += 1
        else:
            self._sender.reopen()
        opened = due = self._clock.now()
        try:
            while True:
                self._navdata.take_waiting()
                now = self._clock.now()
                self._sender.update(self._streamer.command(now))
                if seconds_between(self._last_sign(opened), now) > self._o.reopen_after_s:
                    break
                due = max(after(due, self._o.command_period_s), now)
                await self._clock.sleep(max(0.0, seconds_between(self._clock.now(), due)))
        except Recoverable:
            if self._sender.busy:
                self._flew = False
                self._unmark()
            self._sender = None
            raise
        raise Recoverable(f"no sign of the drone for {self._o.reopen_after_s} s")

    def close(self, *, hold: bool) -> None:
        """End the sender with the final command; with `hold`, leave it running to hold the drone until a successor takes over."""
        self._unmark()
        if self._sender is None:
            return
        if hold:
            self._sender.let_go()
        else:
            self._sender.end(self._streamer.leave(self._clock.now()))
        self._sender = None

    def _options(self) -> SenderOptions:
        o = self._o
        return SenderOptions(
            o.host, o.at_port, o.navdata_port, o.command_period_s, o.hold_s,
            as_text(o.timeouts(o.hold_com_watchdog_s)), as_text(o.timeouts(o.com_watchdog_s)), self._flew,
        )  # fmt: skip

    def _unmark(self) -> None:
        if self._mark is not None:
            self._mark.close()
            self._mark = None

    def _on_status(self, before: SenderStatus, now: SenderStatus) -> None:
        if self._mark is None and not before.datagrams:
            self._mark = mark(self._options().marked)
        self._flew = True
        self._counters.at_datagrams += now.datagrams - before.datagrams
        self._counters.at_commands += max(0, now.sequence - before.sequence)
        self._counters.at_errors += now.errors - before.errors
        self._counters.at_late_hovers += now.late_hovers - before.late_hovers

    def _hovered(self) -> None:
        self._counters.at_hovers_past_sender += 1

    def _last_sign(self, opened: MonoNs) -> MonoNs:
        received_at = self._navdata.received_at
        return opened if received_at is None else max(opened, received_at)
