"""Datagrams that wait in the kernel keep the instants at which they were received, whenever somebody takes them."""

import socket
import time
from collections.abc import Iterator

import pytest

from drivers.ardrone.datagrams import WaitingDatagrams
from drivers.clock import SystemClock
from estimator.contracts.errors import Recoverable
from estimator.contracts.time import MonoNs

Taken = list[tuple[bytes, MonoNs]]


class Ends:
    """A waiting socket and its peer."""

    def __init__(self) -> None:
        self.peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.peer.bind(("127.0.0.1", 0))
        self.own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.own.setblocking(False)
        self.own.connect(self.peer.getsockname())
        self.taken: Taken = []
        self.waiting = WaitingDatagrams(self.own, SystemClock(), lambda data, at: self.taken.append((data, at)))
        self.waiting.take()

    def sent(self, *data: bytes) -> None:
        for one in data:
            self.peer.sendto(one, self.own.getsockname())


@pytest.fixture
def ends() -> Iterator[Ends]:
    both = Ends()
    with both.peer, both.own:
        yield both


def test_what_waits_is_taken_in_order_with_the_instant_of_its_reception(ends: Ends) -> None:
    # The two clocks are read one after the other, so an instant may come out late by as long as this thread stood still.
    for _ in range(5):
        ends.taken.clear()
        before = time.monotonic_ns()
        ends.sent(b"a", b"b")
        after = time.monotonic_ns()
        time.sleep(0.05)
        ends.sent(b"c")
        ends.waiting.take()
        assert [data for data, _ in ends.taken] == [b"a", b"b", b"c"]
        (_, a), (_, b), (_, c) = ends.taken
        assert before - 1_000_000 <= min(a, b)
        assert after <= c <= time.monotonic_ns()
        if c - b >= 40_000_000:
            return
    raise AssertionError("the third was received later, though all were taken at once")


def test_a_wall_clock_that_was_set_meanwhile_moves_no_reception(ends: Ends, monkeypatch: pytest.MonkeyPatch) -> None:
    ends.sent(b"a")
    taken_from = time.monotonic_ns()
    wall_ns = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: wall_ns() + 3_600_000_000_000)
    ends.waiting.take()
    assert [data for data, _ in ends.taken] == [b"a"]
    assert taken_from <= ends.taken[0][1] <= time.monotonic_ns()


def test_a_flood_is_taken_in_parts_and_loses_nothing(ends: Ends) -> None:
    ends.sent(*[b"%d" % i for i in range(100)])
    ends.waiting.take()
    assert 0 < len(ends.taken) < 100
    ends.waiting.take()
    assert [data for data, _ in ends.taken] == [b"%d" % i for i in range(100)]


def test_a_peer_that_refuses_breaks_nothing(ends: Ends) -> None:
    port = ends.peer.getsockname()[1]
    ends.peer.close()
    for _ in range(3):
        ends.waiting.send(b"hello")
        ends.waiting.take()
        ends.waiting.check()
    assert ends.waiting.errors > 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", port))
        again.sendto(b"here", ends.own.getsockname())
        ends.waiting.take()
        ends.waiting.take()
    assert [data for data, _ in ends.taken] == [b"here"]


def test_a_broken_socket_is_reported_by_check_and_not_by_take(ends: Ends) -> None:
    ends.own.close()
    ends.waiting.take()
    with pytest.raises(Recoverable):
        ends.waiting.check()
    with pytest.raises(Recoverable):
        ends.waiting.send(b"hello")
