"""The process that speaks to an AR.Drone's AT port: `python -m drivers.ardrone.sender FD OPTIONS`, started by the service.

It is a process of its own so that no command outlives the service that sent it. It owns the AT socket and its sequence, takes
commands with a deadline from the service over a stream socket (`FD`), and sends hover as soon as the newest command has
expired: the service may be killed, stopped, swapped out or stuck. When the service is gone it climbs out of the deck's reach
and holds the flying drone in hover for `hold_s`, receiving navdata itself, until a new service's sender requests the sequence
and takes over. It imports nothing large.
"""

import select
import signal
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import suppress

import msgspec

from drivers.ardrone.arbiter import HOVER, CommandArbiter
from drivers.ardrone.at import numbered
from drivers.ardrone.counters import Refusal
from drivers.ardrone.navdata import decode
from drivers.ardrone.sender_lock import claim, yield_to
from drivers.ardrone.sender_wire import BUSY, READ_MAX, UP, SenderOptions, SenderOrder, TextCommand, as_text, order_of
from estimator.contracts.time import MonoNs

PARTING = 5
"""The number of datagrams that carry the final command; any one of them is enough."""
_NAVDATA_OPENING = b"\x01\x00\x00\x00"
_OPENING_DATAGRAMS = 8
"""Number of datagrams that begin with sequence number 1, which resets the drone's counter; one of them may be lost."""
(_NOTHING,) = as_text([HOVER])
"""The command that carries that number. It must not reset the drone's watchdog, whose bit shows why a drone is landing."""
_ALONE_DATAGRAMS = 5
"""Number of datagrams that repeat the commands for a lost or returned service, as no acknowledgement is waited for then."""
_STATUS_S = 0.02
"""Least time between two statuses; shorter than the usual period, as the service expects a status for each command."""
_REQUEST_AGAIN_S = 0.5  # time between two requests for navdata, and between two refusals of one port that belong together
_REFUSED_S = 2.0
"""A port that refuses for so long belongs to a simulated drone that has ended: a real one out of reach does not answer."""
_NS = 1_000_000_000  # nanoseconds of a second


class Sender:
    """The loop of the process.

    Args:
        service: stream to the service that started it.
        listener: the socket on which a successor requests to take over; None if there is none.
        sequence: number of the last command that a predecessor sent to the drone; 0 if it is not known.
    """

    def __init__(self, options: SenderOptions, service: socket.socket, listener: socket.socket | None, sequence: int) -> None:
        self._o = options
        self._service: socket.socket | None = service
        self._listener = listener
        self._arbiter = CommandArbiter(options.hold_s, options.climb_m_s)
        self._sequence = sequence
        self._opening = 0 if sequence else _OPENING_DATAGRAMS
        self._at: socket.socket | None = None
        self._navdata: socket.socket | None = None
        self._asked = self._status_at = self._due = 0
        self._in_force: int | None = None
        """The deadline of the command that was sent to the drone last; None if that was hover."""
        self._buffer = b""
        self._refused: tuple[int, int] | None = None
        """The instants of the first and the newest refusal of a series; None if there is no series."""
        self._alone = False
        self._telling: list[tuple[TextCommand, ...]] = []
        self._over = False

    def run(self) -> None:
        """Run until the service ends it, a successor takes over, or there is nothing left to hold."""
        signal.signal(signal.SIGTERM, lambda *_: self._part())
        while True:
            now = time.monotonic_ns()
            due = self._due if self._in_force is None else min(self._due, self._in_force + 1)
            self._wait(max(0, due - now))
            if self._over:
                break
            now = time.monotonic_ns()
            if now >= self._due or (self._in_force is not None and now > self._in_force):
                self._transmit(now)
            self._consider(now)
        for end in (self._service, self._listener, self._at, self._navdata):
            if end is not None:
                end.close()

    def _wait(self, wait_ns: int) -> None:
        readers = [end for end in (self._service, self._listener, self._navdata) if end is not None]
        ready, _, _ = select.select(readers, [], [], wait_ns / _NS)
        if self._listener in ready and self._listener is not None:
            silent = self._service is None or self._arbiter.gone(MonoNs(time.monotonic_ns()))
            self._over = yield_to(self._listener, self._sequence if silent else None) or self._over
        if self._navdata in ready:
            self._on_message()
        if self._service in ready:
            self._take()

    def _take(self) -> None:
        """Read the service's lines; only its newest command counts, and an expired one is not flown."""
        assert self._service is not None
        try:
            output = self._service.recv(READ_MAX)
        except OSError:
            output = b""
        if not output:
            self._service.close()
            self._service = None
            self._buffer = b""
            self._arbiter.lost(MonoNs(time.monotonic_ns()))
            self._due = 0
            return
        *lines, self._buffer = (self._buffer + output).split(b"\n")
        before = self._arbiter.latest
        for line in lines:
            try:
                order = order_of(line)
            except msgspec.DecodeError:
                continue
            self._obey(order)
            if self._over:
                return
        if self._arbiter.latest is not before:
            self._transmit(time.monotonic_ns())

    def _obey(self, order: SenderOrder) -> None:
        if order.latest is not None:
            self._arbiter.take(order.latest)
        elif order.end is not None:
            self._arbiter.take(order.end)
            self._part()
        elif order.until is not None:
            if time.monotonic_ns() <= order.until:
                self._send(order.commands)
        elif order.reopen and self._at is not None:
            self._at.close()
            self._at = None

    def _part(self) -> None:
        for _ in range(PARTING):
            self._transmit(time.monotonic_ns())
        self._over = True

    def _transmit(self, now: int) -> None:
        instant = MonoNs(now)
        fresh = self._arbiter.fresh(instant)
        commands = as_text(self._arbiter.commands(instant))
        queued = self._telling.pop(0) if self._telling else ()
        if commands or queued:
            self._send((*queued, *commands))
        latest = self._arbiter.latest
        self._in_force = latest.until if fresh and latest is not None else None
        # While commands arrive once a period there is no need to repeat one just before the next.
        self._due = now + round((4 / 3 if fresh else 1.0) * self._o.period_s * _NS)

    def _send(self, commands: Sequence[TextCommand]) -> None:
        parts = []
        if self._opening:
            self._opening -= 1
            parts.append(numbered(1, *_NOTHING))
            self._sequence = max(self._sequence, 1)
        for name, rest in commands:
            self._sequence += 1
            parts.append(numbered(self._sequence, name, rest))
        try:
            if self._at is None:
                self._at = _connect(self._o.host, self._o.at_port)
            self._at.send(b"".join(parts))
        except ConnectionRefusedError:
            now = time.monotonic_ns()
            if self._refused is None or now - self._refused[1] > _REQUEST_AGAIN_S * _NS:
                self._refused = (now, now)
            self._refused = (self._refused[0], now)
        except BlockingIOError:
            return
        except OSError:
            if self._at is not None:
                self._at.close()
            self._at = None

    def _consider(self, now: int) -> None:
        """Check whether the service is present, and receive navdata while it is not."""
        instant = MonoNs(now)
        alone = self._service is None or self._arbiter.gone(instant)
        if alone != self._alone:
            self._alone = alone
            if self._arbiter.latest is not None:
                self._telling = [self._o.on_service_lost if alone else self._o.on_service_back] * _ALONE_DATAGRAMS
        if alone:
            self._listen(now)
        elif self._navdata is not None:
            self._navdata.close()
            self._navdata = None
        if self._service is not None:
            self._report(now)
            return
        refused = self._refused is not None and self._refused[1] - self._refused[0] > _REFUSED_S * _NS
        if self._arbiter.latest is None or refused or self._arbiter.silent_s(instant) > self._o.hold_s:
            self._over = True
        elif self._arbiter.on_ground(instant):
            self._send(self._o.on_service_back)
            self._over = True

    def _report(self, now: int) -> None:
        if now - self._status_at < _STATUS_S * _NS or self._service is None:
            return
        self._status_at = now
        # A service that does not read gets a later status; the next read shows whether it is gone.
        with suppress(OSError):
            self._service.send(UP + b"\n", socket.MSG_DONTWAIT)

    def _listen(self, now: int) -> None:
        """Receive navdata in this process, and request it again if it does not arrive."""
        try:
            if self._navdata is None:
                self._navdata = _connect(self._o.host, self._o.navdata_port)
                self._asked = 0
            if now - self._asked > _REQUEST_AGAIN_S * _NS:
                self._asked = now
                self._navdata.send(_NAVDATA_OPENING)
        except OSError:
            if self._navdata is not None:
                self._navdata.close()
            self._navdata = None

    def _on_message(self) -> None:
        assert self._navdata is not None
        newest = b""
        with suppress(OSError):  # BlockingIOError after the last one, or a port that refuses
            while True:
                newest = self._navdata.recv(4096)
        navdata = decode(newest)
        if not isinstance(navdata, Refusal):
            self._asked = time.monotonic_ns()
            self._arbiter.on_report(navdata, MonoNs(self._asked))


def _connect(host: str, port: int) -> socket.socket:
    """Open a UDP socket that talks to one peer only and never blocks."""
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    end = socket.socket(family, kind, protocol)
    try:
        end.connect(address)
        end.setblocking(False)
    except OSError:
        end.close()
        raise
    return end


def _stay_in_memory() -> None:
    """Ask the system not to swap this process out; if that is not allowed, go on without."""
    try:
        import ctypes

        ctypes.CDLL(None).mlockall(1)
    except (ImportError, OSError, AttributeError, MemoryError):
        return


def main(argv: Sequence[str]) -> int:
    """Run the sender on the stream socket with descriptor `argv[0]`; returns the exit code."""
    # Ctrl-C and a closed terminal are meant for the service, which ends its sender in its own time.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    options = msgspec.json.decode(argv[1], type=SenderOptions)
    service = socket.socket(fileno=int(argv[0]))
    claimed = claim(options.name, options.marked, replaces=options.replaces)
    if claimed is None:
        with suppress(OSError):
            service.sendall(BUSY + b"\n")
        service.close()
        return 1
    listener, sequence = claimed
    _stay_in_memory()
    sender = Sender(options, service, listener, sequence)
    sender.run()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
