"""The AT command channel: passes the streamer's commands to the sender process, and starts another sender when that is lost.

`SenderClient` is the service's end of its sender: it starts the process, sends it commands, and notices when it is gone.
"""

import asyncio
import socket
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Self

import msgspec

import drivers
from drivers.ardrone.arbiter import HOVER, STAY_UP, TimedCommand
from drivers.ardrone.at import AtCommand, encode
from drivers.ardrone.counters import Counters
from drivers.ardrone.custody import CommandStreamer
from drivers.ardrone.navdata_channel import NavdataChannel
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.sender_lock import mark
from drivers.ardrone.sender_wire import BUSY, READ_MAX, SenderOptions, SenderOrder, as_text, pack
from estimator.contracts.errors import Recoverable
from estimator.contracts.time import Clock, MonoNs, after, seconds_between

_COMMANDS_S = 0.5
"""Further commands, those passed to `SenderClient.send`, are dropped when they have waited this long."""
_READY_S = 5.0  # a new sender that has not sent its first status for this long is replaced
_SILENT_S = 0.1
"""A sender answers each command with its status; if none arrives for this long, hover is sent to the drone directly."""
_SILENT_PERIODS = 3.5
"""Longest silence of the sender in command periods, for commands that are sent more slowly."""
_STUCK_S = 0.5
"""A sender that has not sent its status for this long is replaced."""
_END_S = 2.0  # time that a sender gets to end by itself before it is killed
_GONE_S = 0.02
"""A process whose socket has closed needs this long to end."""
_BURST = 3  # number of datagrams that repeat a hover sent directly, as one may be lost
_LEFT: list[subprocess.Popen[bytes]] = []
"""The senders that were left to a successor and may have ended since."""
_START = "import sys; sys.path += sys.argv[1:3]; from drivers.ardrone.sender import main; sys.exit(main(sys.argv[3:]))"
"""The program of the sender, which starts without site-packages: they come after the standard library, for msgspec alone."""


class SenderClient:
    """One running sender process.

    Args:
        on_up: is called when the sender has reported for the first time that it runs.
        program: the process, and the socket to it; see `start`.
    """

    def __init__(
        self,
        options: SenderOptions,
        clock: Clock,
        on_up: Callable[[], None],
        program: tuple[subprocess.Popen[bytes], socket.socket],
    ) -> None:
        self._o = options
        self._clock = clock
        self._on_up = on_up
        self._silent_s = max(_SILENT_S, _SILENT_PERIODS * options.period_s)
        self._received_at: MonoNs | None = None
        self._began = clock.now()
        self._latest: TimedCommand | None = None
        self._closed = False
        self.busy = False
        """True if the sender has ended because another service, which is alive, flies this drone."""
        self._process, self._socket = program
        self._lost: str | None = None
        asyncio.get_running_loop().add_reader(self._socket.fileno(), self._read)

    @classmethod
    async def start(cls, options: SenderOptions, clock: Clock, on_up: Callable[[], None]) -> Self:
        """Start a sender on a thread, because a new process may wait for a processor, and return the client.

        Raises:
            Recoverable: the process cannot be started.
        """
        _LEFT[:] = [left for left in _LEFT if left.poll() is None]
        starting = asyncio.get_running_loop().run_in_executor(None, _spawn, options)
        try:
            return cls(options, clock, on_up, await asyncio.shield(starting))
        except asyncio.CancelledError:
            starting.add_done_callback(_abandon)
            raise

    @property
    def pid(self) -> int:
        """The process id of the sender."""
        return self._process.pid

    @property
    def up(self) -> bool:
        """True if the sender has reported that it runs."""
        return self._received_at is not None

    @property
    def _flew(self) -> bool:
        """True if the drone was flown by this sender or by one that it replaces; otherwise another service may be flying it."""
        return self.up or self._o.replaces

    def update(self, command: TimedCommand) -> None:
        """Send the newest command; never blocks.

        While the sender is silent, or takes long to replace another, each call sends hover to the drone directly.

        Raises:
            Recoverable: the sender is gone or stuck.
        """
        self._latest = command
        self._look()
        heard_at = self._began if self._received_at is None else self._received_at
        if self._flew and seconds_between(heard_at, self._clock.now()) > self._silent_s:
            self._hover()
        self._write(SenderOrder(latest=command))

    def send(self, commands: Sequence[AtCommand]) -> None:
        """Send further commands, all in one datagram, in order; they are dropped while the sender is not up yet.

        Raises:
            Recoverable: the sender is gone or stuck.
        """
        self._look()
        if not self.up:
            return  # dropped as a datagram may be: important ones are repeated, and must not pile up
        self._write(SenderOrder(commands=as_text(commands), until=after(self._clock.now(), _COMMANDS_S)))

    def reopen(self) -> None:
        """Open the AT socket again; the new one takes this host's present address.

        Raises:
            Recoverable: the sender is gone or stuck.
        """
        self._look()
        self._write(SenderOrder(reopen=True))

    def end(self, command: TimedCommand) -> None:
        """Let the sender send this command and end: the service ends on purpose."""
        with suppress(Recoverable):
            self._write(SenderOrder(end=command))
        self._close()
        self._kill(_END_S)

    def let_go(self) -> None:
        """Leave the sender running, so that it holds a flying drone until a successor takes over: the service ends otherwise."""
        self._close()
        _LEFT.append(self._process)

    def _look(self) -> None:
        if self._lost is not None:
            raise Recoverable(self._lost)
        self._read()  # after this process stood still, the sender's status lies here unread
        if self._lost is not None:
            raise Recoverable(self._lost)
        since, timeout_s = (self._began, _READY_S) if self._received_at is None else (self._received_at, _STUCK_S)
        if seconds_between(since, self._clock.now()) > timeout_s:
            self._lose(f"the sender of AT commands says nothing for {timeout_s} s")
            raise Recoverable(self._lost or "")

    def _write(self, order: SenderOrder) -> None:
        line = pack(order)
        try:
            if self._socket.send(line) != len(line):
                self._lose("the sender of AT commands is stuck")
        except BlockingIOError:
            self._lose("the sender of AT commands is stuck")
        except OSError:
            self._lose("the sender of AT commands is gone")
        if self._lost is not None:
            raise Recoverable(self._lost)

    def _read(self) -> None:
        try:
            output = self._socket.recv(READ_MAX)
        except BlockingIOError:
            return
        except OSError:
            output = b""
        if not output:
            self._lose("the sender of AT commands is gone")
            return
        first, self._received_at = self._received_at is None, self._clock.now()
        if BUSY in output:
            self.busy = True
            self._lose("another service, which is alive, flies this drone")
        elif first:
            self._on_up()

    def _lose(self, why: str) -> None:
        """Make sure that an unreliable sender is gone, and let the drone hover until there is another."""
        if self._lost is not None:
            return
        self._lost = why
        self._close()
        self._kill(_GONE_S)
        if not self.busy and self._latest is not None and self._flew:
            self._hover()

    def _kill(self, timeout_s: float) -> None:
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _hover(self) -> None:
        """Send hover to the drone directly: without a sender it would fly on by the last command that it received.

        Sequence number 1 makes the drone accept this datagram. It also accepts those of a sender that was only slow and continues
        with its own numbers, which are higher. A landing that the firmware began meanwhile is called off.
        """
        newest = self._latest
        stays_up = newest is not None and newest.ref == STAY_UP
        commands = replace(newest, sticks=HOVER, ref=STAY_UP if stays_up else None).commands() if newest else [HOVER]
        data = b"".join(encode(number, command) for number, command in enumerate(commands, 1))
        try:
            # A name would have to be resolved, which blocks.
            family, kind, _, _, address = socket.getaddrinfo(
                self._o.host, self._o.at_port, type=socket.SOCK_DGRAM, flags=socket.AI_NUMERICHOST
            )[0]
            with socket.socket(family, kind) as direct:
                direct.setblocking(False)
                for _ in range(_BURST):
                    direct.sendto(data, address)
        except OSError:
            return  # a name instead of an address, or no network: the next sender will report it

    def _close(self) -> None:
        if not self._closed:
            self._closed = True
            asyncio.get_running_loop().remove_reader(self._socket.fileno())
            self._socket.close()


def _spawn(options: SenderOptions) -> tuple[subprocess.Popen[bytes], socket.socket]:
    ours, theirs = socket.socketpair()
    try:
        roots = [str(Path(next(iter(package.__path__))).parent) for package in (drivers, msgspec)]
        process = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", _START, *roots, str(theirs.fileno()), msgspec.json.encode(options).decode()],
            pass_fds=(theirs.fileno(),),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            start_new_session=True,
        )
    except OSError as why:
        ours.close()
        raise Recoverable(f"the sender of AT commands cannot be started: {why}") from why
    finally:
        theirs.close()
    ours.setblocking(False)
    return process, ours


def _abandon(starting: asyncio.Future[tuple[subprocess.Popen[bytes], socket.socket]]) -> None:
    """Leave a sender alone that is no longer waited for: without a service it ends by itself."""
    if not starting.cancelled() and starting.exception() is None:
        process, ours = starting.result()
        ours.close()
        _LEFT.append(process)


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
        """True if commands reach the drone's port now."""
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
            self._sender = await SenderClient.start(self._options(), self._clock, self._on_up)
            self._counters.at_senders += 1
        else:
            self._sender.reopen()
        opened = due = self._clock.now()
        try:
            while True:
                self._navdata.take_waiting()
                now = self._clock.now()
                self._sender.update(self._streamer.command(now))
                if seconds_between(max(opened, self._navdata.received_at or opened), now) > self._o.reopen_after_s:
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
            o.host, o.at_port, o.navdata_port, o.command_period_s, o.hold_s, o.vz_max_m_s,
            as_text(o.timeouts(o.hold_com_watchdog_s)), as_text(o.timeouts(o.com_watchdog_s)), self._flew,
        )  # fmt: skip

    def _unmark(self) -> None:
        if self._mark is not None:
            self._mark.close()
            self._mark = None

    def _on_up(self) -> None:
        self._mark = self._mark or mark(self._options().marked)
        self._flew = True
