"""Open ways for bytes and slots for what they bring: nothing old on a slow line, another address, a peer that is silent."""

import asyncio
import logging
import os
import socket
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import wires
from drivers.endpoint import Address, Endpoint
from drivers.mailbox import Latest, Line
from drivers.reconnect import BackOff, reconnect
from drivers.wires import QUEUE_S, SendQueue, WireCounts, open_wire, resolve
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.time import MonoNs
from tests.make import ns
from tests.support.clocks import SleepingClock, SteppedClock
from tests.support.waiting import until

HOST = "127.0.0.1"


def nobody(data: bytes, received_at: MonoNs, sender: Address | None) -> None:
    """Take what nobody waits for."""


@given(st.lists(st.tuples(st.sampled_from(["", "", "velocity", "target"]), st.floats(0.0, 0.1), st.booleans()), max_size=60))
def test_a_line_gets_the_newest_setpoint_first_and_nothing_old(steps: list[tuple[str, float, bool]]) -> None:
    counts, now, put, got = WireCounts(), 0.0, list[tuple[str, float]](), list[tuple[str, float]]()
    queue = SendQueue(counts)
    for kind, wait_s, takes in steps:
        now += wait_s
        queue.put(partial(str.encode, f"{kind} {len(put)}"), kind, ns(now))
        put.append((kind, now))
        if takes and (data := queue.take(ns(now))):
            kind, _, number = data.decode().rpartition(" ")
            got.append((kind, put[int(number)][1]))
            assert now - got[-1][1] <= QUEUE_S + 1e-6
            newest = [t for k, t in put if k == kind]
            assert not kind or got[-1][1] == newest[-1], "the newest of its kind"
    while queue.take(ns(now)):
        got.append(("", now))
    assert len(got) + counts.late == len(put), "what does not go is counted"
    ordinary = [t for kind, t in got if not kind]
    assert ordinary == sorted(ordinary)


async def test_a_serial_line_that_stood_still_carries_nothing_old(monkeypatch: pytest.MonkeyPatch) -> None:
    far, near = os.openpty()
    tty.setraw(far)
    os.set_blocking(far, False)
    clock, counts, gone, kept = SteppedClock(), WireCounts(), [0], bytearray()

    def empty(fd: int, which: int) -> None:
        while _read(far):
            pass
        gone[0] = wire._total  # type: ignore[attr-defined]

    def message() -> bytes:
        return b"%012d" % round(clock.now() / 1e6) + 88 * b"."  # the instant at which it is packed, ms

    async with open_wire(Endpoint("serial", os.ttyname(near), 57600), clock, nobody, counts) as wire:
        # A pseudo terminal neither tells what waits in it nor forgets it, as a serial port does.
        monkeypatch.setattr(wires, "_in_kernel", lambda fd: wire._total - gone[0])  # type: ignore[attr-defined]
        monkeypatch.setattr(termios, "tcflush", empty)
        for n in range(1200):  # 12 s of 100 messages a second
            clock.advance(0.01)
            assert wire.send(message, None, "velocity" if n % 4 == 0 else "")
        assert counts.late > 1100
        goes_on_ms = round(clock.now() / 1e6)
        for _ in range(20):
            kept += _read(far)
            gone[0] = wire._total  # type: ignore[attr-defined]
            clock.advance(0.01)
            wire.send(message, None)
        kept += _read(far)
    times_ms = [int(kept[i - 12 : i]) for i in range(12, len(kept)) if kept[i : i + 88] == 88 * b"." and kept[i - 1 : i] != b"."]
    assert len(times_ms) >= 20
    assert min(times_ms) >= goes_on_ms - 500
    os.close(far)
    os.close(near)


def _read(fd: int) -> bytes:
    try:
        return os.read(fd, 65536)
    except BlockingIOError:
        return b""


@contextmanager
def served() -> Iterator[tuple[Endpoint, Callable[[], socket.socket]]]:
    """Yield a server, and what accepts its next connection."""
    with ExitStack() as stack, socket.create_server((HOST, 0)) as server:

        def accept() -> socket.socket:
            peer = stack.enter_context(server.accept()[0])
            peer.setblocking(False)
            return peer

        yield Endpoint("tcp", HOST, server.getsockname()[1]), accept


async def test_a_tcp_peer_that_does_not_read_is_given_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, counts, got = SteppedClock(), WireCounts(), bytearray()
    with served() as (endpoint, accept):
        async with open_wire(endpoint, clock, nobody, counts) as wire:
            peer = accept()
            monkeypatch.setattr(wires, "_in_kernel", lambda fd: wire._total - len(got))  # type: ignore[attr-defined]
            for _ in range(1200):
                clock.advance(0.01)
                wire.send(lambda: 100 * b".", None)
            before = wire._total  # type: ignore[attr-defined]
            assert before < 60 * 100, "half a second of 100 messages a second, and some more"
            assert counts.late > 1100
            await until(lambda: _into(got, peer) == before)
            wire.send(lambda: b"new", None)
            await until(lambda: bool(_into(got, peer)) and got.endswith(b"new"))
            assert len(got) <= before + 3 + 21 * 100, "what waited is no older than the queue allows"


def _into(got: bytearray, peer: socket.socket) -> int:
    """Add what arrived; return the number of bytes so far."""
    with suppress(BlockingIOError):
        got.extend(peer.recv(65536))
    return len(got)


@pytest.fixture
def names(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, list[str]]]:
    """Yield a resolver of our own: the addresses of each name."""
    table: dict[str, list[str]] = {}
    threads: set[int] = set()

    def getaddrinfo(host: str, port: int, **options: Any) -> list[Any]:
        threads.add(threading.get_ident())
        if host not in table:
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return [(socket.AF_INET, options["type"], 0, "", (address, port)) for address in table[host]]

    monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)
    yield table
    assert threading.get_ident() not in threads, "no look-up on the loop's thread"


def udp(address: str, port: int = 0) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind((address, port))
    made.setblocking(False)
    return made


def heard(sock: socket.socket) -> bool:
    try:
        return bool(sock.recv(100))
    except BlockingIOError:
        return False


async def test_a_host_that_moved_is_found_again(names: dict[str, list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wires, "_WATCH_S", 0.01)
    clock, counts = SteppedClock(), WireCounts()
    old = udp(HOST)
    port = old.getsockname()[1]
    with udp("127.0.0.2", port) as new:
        names["autopilot.local"] = [HOST]
        endpoint = Endpoint("udpout", "autopilot.local", port)
        async with open_wire(endpoint, clock, nobody, counts) as wire:
            wire.send(lambda: b"one", None)
            await until(lambda: heard(old))
            old.close()
            names["autopilot.local"] = ["127.0.0.2"]
            broken = asyncio.ensure_future(wire.broken())
            for _ in range(20):
                wire.send(lambda: b"two", None)
                await asyncio.sleep(0.002)
            assert counts.refused > 0
            clock.advance(3.0)
            with pytest.raises(Recoverable, match=r"127\.0\.0\.1 refuses.*autopilot\.local is 127\.0\.0\.2 now"):
                await broken
        async with open_wire(endpoint, clock, nobody, counts) as wire:
            wire.send(lambda: b"three", None)
            await until(lambda: heard(new))


async def test_each_address_of_a_name_is_tried_in_turn(names: dict[str, list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wires, "_WATCH_S", 0.01)
    clock, counts, used = SteppedClock(), WireCounts(), list[str]()
    with udp("127.0.0.3") as third:
        port = third.getsockname()[1]
        names["ship"] = ["127.0.0.1", "127.0.0.2", "127.0.0.3"]
        for _ in range(4):
            async with open_wire(Endpoint("udpout", "ship", port), clock, nobody, counts) as wire:
                used.append(wire._own.getpeername()[0])  # type: ignore[attr-defined]
                await asyncio.sleep(0.01)  # the watch begins
                clock.advance(11.0)
                with pytest.raises(Recoverable, match="not a byte"):
                    await wire.broken()
        assert used == ["127.0.0.1", "127.0.0.2", "127.0.0.3", "127.0.0.1"]
        got: list[bytes] = []
        async with open_wire(Endpoint("udpout", "ship", port), clock, lambda data, when, who: got.append(data), counts) as wire:
            assert wire._own.getpeername()[0] == "127.0.0.2"  # type: ignore[attr-defined]
        async with open_wire(Endpoint("udpout", "ship", port), clock, lambda data, when, who: got.append(data), counts) as wire:
            wire.send(lambda: b"hello", None)
            await until(lambda: heard(third))
            third.sendto(b"here", wire.local)
            await until(lambda: got == [b"here"])
        assert not counts.tried, "the one that answers is tried first again"
        names.clear()
        with pytest.raises(Recoverable, match=r"ship:.*no host of that name"):
            async with open_wire(Endpoint("udpout", "ship", port), clock, nobody, counts):
                pass


async def test_a_silent_udp_peer_with_one_address_is_kept(names: dict[str, list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wires, "_WATCH_S", 0.01)
    clock = SteppedClock()
    async with open_wire(Endpoint("udpout", HOST, 9), clock, nobody) as wire:
        broken = asyncio.ensure_future(wire.broken())
        for _ in range(3):
            clock.advance(11.0)
            await asyncio.sleep(0.05)
        assert not broken.done(), "it may come, and a router knows it by its port"
        broken.cancel()


async def test_a_tcp_server_that_forgot_us_is_connected_to_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wires, "_WATCH_S", 0.01)
    clock, got = SteppedClock(), list[bytes]()
    with served() as (endpoint, accept):
        async with open_wire(endpoint, clock, lambda data, when, who: got.append(data)) as wire:
            accept().send(b"hello")
            await until(lambda: got)
            clock.advance(9.9)
            broken = asyncio.ensure_future(wire.broken())
            await asyncio.sleep(0.05)
            assert not broken.done()
            clock.advance(0.2)
            with pytest.raises(Recoverable, match=r"not a byte of 127\.0\.0\.1 for 10 s"):
                await broken


async def test_a_resolver_that_hangs_holds_up_nobody_and_is_queried_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, go_on = [0], threading.Event()

    def getaddrinfo(host: str, port: int, **options: Any) -> list[Any]:
        asked[0] += 1
        go_on.wait(20)
        return [(socket.AF_INET, options["type"], 0, "", (HOST, port))]

    monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)
    for _ in range(3):
        with pytest.raises(Recoverable, match="no answer from the resolver"):
            await resolve("slow", 1, 0.02)
    waiting = [asyncio.ensure_future(resolve("slow", 1, 5.0)) for _ in range(2)]
    await asyncio.sleep(0)
    go_on.set()
    assert [(await one)[0][4] for one in waiting] == [(HOST, 1)] * 2
    assert asked == [1]
    assert (await resolve("::1", 7, 0.1))[0][4][:2] == ("::1", 7)


BOXES = [Latest, lambda: Line(4)]


async def test_what_waits_in_a_line_is_read_together_and_then_its_error():
    line, read = Line[int](3), list[list[int]]()
    for i in range(5):
        line.offer(i)

    async def reading() -> None:
        async for items in line.together():
            read.append(items)

    reader = asyncio.create_task(reading())
    await asyncio.sleep(0)
    line.offer(5)
    await asyncio.sleep(0)
    line.offer(6)
    line.fail(Recoverable("gone"))
    with pytest.raises(Recoverable):
        await asyncio.wait_for(reader, 60)
    assert read == [[2, 3, 4], [5], [6]]
    assert (line.offered, line.dropped, len(line)) == (7, 2, 0)


@pytest.mark.parametrize("make", BOXES)
@pytest.mark.parametrize("turns", range(6))
async def test_cancelling_a_reader_at_any_turn_of_the_loop_loses_nothing(make, turns):
    box, got = make(), []

    async def read():
        async for item in box:
            got.append(item)

    reader = asyncio.create_task(read())
    await asyncio.sleep(0)
    box.offer("a")
    for _ in range(turns):
        await asyncio.sleep(0)
    reader.cancel()
    await asyncio.gather(reader, return_exceptions=True)
    if not got:
        got.append(await asyncio.wait_for(box.get(), 60))
    assert got == ["a"]


@pytest.mark.parametrize("make", BOXES)
async def test_a_failure_reaches_the_reader_after_what_was_left(make):
    box, got = make(), []
    box.offer("last")
    box.fail(Recoverable("unplugged"))

    async def read():
        async for item in box:
            got.append(item)

    with pytest.raises(Recoverable, match="unplugged"):
        await asyncio.wait_for(read(), 60)
    assert got == ["last"]
    with pytest.raises(Recoverable):
        await box.get()


@settings(max_examples=60)
@given(st.lists(st.sampled_from(["offer", "get", "cancelled get", "turn"]), max_size=40), st.integers(1, 5))
def test_every_item_is_read_dropped_or_still_there(script, capacity):
    async def play():
        latest, line = Latest[int](), Line[int](capacity)
        read: dict[object, list[Any]] = {latest: [], line: []}
        for i, what in enumerate(script):
            for box in (latest, line):
                if what == "offer":
                    box.offer(i)
                elif what == "turn":
                    await asyncio.sleep(0)
                else:
                    task = asyncio.create_task(box.get())
                    if what == "get":
                        await asyncio.sleep(0)
                        await asyncio.sleep(0)
                    if not task.done():
                        task.cancel()
                    result = (await asyncio.gather(task, return_exceptions=True))[0]
                    if not isinstance(result, BaseException):
                        read[box].append(result)
        assert all(items == sorted(set(items)) for items in read.values())
        left = 1 if latest._item is not None else 0
        assert latest.offered == len(read[latest]) + latest.replaced + left
        assert line.offered == len(read[line]) + line.dropped + len(line)
        assert len(line) <= capacity

    asyncio.run(play())


def test_what_waits_or_has_come_elsewhere_is_taken_in_order_and_then_the_error():
    socket = [4]

    def fetch() -> None:
        while socket:
            line.offer(socket.pop())

    line = Line[int](3, fetch)
    for i in range(4):
        line.offer(i)
    line.check()
    assert line.waiting() == [2, 3, 4]
    line.fail(Recoverable("gone"))
    assert line.waiting() == []
    with pytest.raises(Recoverable, match="gone"):
        line.check()


class Body:
    """Fails as the list says: an error, or a number of seconds to be up before it fails. It returns when the list is over."""

    def __init__(self, clock: SleepingClock, runs: list[BaseException | float]) -> None:
        self.clock, self.runs = clock, runs

    async def __call__(self) -> None:
        if not self.runs:
            return
        run = self.runs.pop(0)
        if isinstance(run, BaseException):
            raise run
        self.clock.advance(run)
        raise OSError("unplugged")


BACK_OFF = BackOff(0.5, 4.0, healthy_after_s=10.0)


async def test_rests_grow_to_the_cap_and_begin_again_after_a_healthy_run() -> None:
    clock, failures = SleepingClock(), list[Any]()
    body = Body(clock, [*[Recoverable("absent")] * 6, 9.9, 10.0, Recoverable("absent")])
    await reconnect("camera", body, BACK_OFF, clock, failures.append)
    assert clock.slept == [0.5, 1.0, 2.0, 4.0, 4.0, 4.0, 4.0, 0.5, 1.0]
    assert len(failures) == 9


async def test_an_absent_device_is_logged_twice_in_an_hour_and_once_when_it_is_back(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "drivers.reconnect")
    clock = SleepingClock()
    await reconnect("camera", Body(clock, [*[Recoverable("absent")] * 900, 11.0]), BACK_OFF, clock)
    assert clock.t > 3600e9 - 4e9
    assert caplog.messages == [
        "camera: absent; trying again",
        "camera: still absent; trying every 4 s until it comes back",
        "camera: up again after 900 failed attempts",
        "camera: unplugged; trying again",
    ]


BUG_IN_GROUP = ExceptionGroup("both", [Recoverable("absent"), ValueError("a bug")])


@pytest.mark.parametrize("error", [BadInput("no such size"), ValueError("a bug"), BUG_IN_GROUP, asyncio.CancelledError()])
async def test_any_other_error_passes_through_as_it_is(error: BaseException) -> None:
    with pytest.raises(type(error)) as raised:
        await reconnect("camera", Body(SleepingClock(), [Recoverable("absent"), error]), BACK_OFF, SleepingClock())
    if isinstance(raised.value, ExceptionGroup):
        assert [type(e) for e in raised.value.exceptions] == [ValueError]
    else:
        assert raised.value is error or isinstance(error, asyncio.CancelledError)


async def test_jitter_shortens_each_rest_by_at_most_its_part() -> None:
    clock = SleepingClock()
    await reconnect("broker", Body(clock, [Recoverable("refused")] * 50), BackOff(1.0, 1.0, 10.0, jitter=0.5), clock)
    assert all(0.5 <= s <= 1.0 for s in clock.slept)
    assert len({round(s, 6) for s in clock.slept}) > 25
