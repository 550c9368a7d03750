"""The sender's process on real sockets: what the drone is told when the service is killed, stopped, stuck, or comes back."""

import asyncio
import os
import pickle
import signal
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest

from drivers.ardrone import at, sender_lock
from drivers.ardrone import navdata as nd
from drivers.ardrone.arbiter import HOVER, STAY_UP, TimedCommand
from drivers.ardrone.command_channel import SenderClient
from drivers.ardrone.counters import Refusal
from drivers.ardrone.link import open_ardrone
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.sender_wire import SenderOptions, SenderOrder, as_text, order_of, pack
from drivers.clock import SystemClock
from estimator.contracts.commands import TakeOff
from estimator.contracts.time import MonoNs, after
from tests.drivers.test_link import be_patient, steer
from tests.support.clocks import SteppedClock
from tests.support.fake_ardrone import HOST, FakeArDrone
from tests.support.waiting import until

CLOCK = SystemClock()
ROOT = Path(__file__).parents[2]
AHEAD = at.Pcmd(at.PCMD_PROGRESSIVE, 0.0, -0.5, 0.0, 0.0)
SERVICE = f"""
import asyncio, pickle, sys
import numpy as np
from drivers.ardrone.link import open_ardrone
from drivers.clock import SystemClock
from estimator.contracts.commands import TakeOff, Velocity

async def main():
    options = pickle.loads(bytes.fromhex(sys.argv[1]))
    async with open_ardrone(options, SystemClock()) as drone:
        drone.command(TakeOff())
        while not (drone.navdata and drone.navdata.state & 1 and drone.ready):
            await asyncio.sleep(0.01)
        print(drone.sender_pid, flush=True)
        while True:
            drone.command(Velocity(np.array([0.4, 0.0, 0.0]), 0.0))
            await asyncio.sleep(0.02)

sys.path.insert(0, {str(ROOT)!r})
asyncio.run(main())
"""


def received_commands(datagram: bytes) -> list[tuple[int, at.AtCommand]]:
    """Return the commands of a datagram; one that cannot be read fails the test."""
    decoded = list(at.decode(datagram))
    assert not any(isinstance(item, Refusal) for item in decoded)
    return [item for item in decoded if not isinstance(item, Refusal)]


def moving_command(fake: FakeArDrone) -> bool:
    return bool(fake.of(at.Pcmd)[-1].flags)


def alive(pid: int) -> bool:
    """Return whether the process runs; one that has ended and is not waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2][0] != "Z"
    except FileNotFoundError:
        return False


def stopped(pid: int) -> bool:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2][0] == "T"


@asynccontextmanager
async def service(options: ArDroneOptions, fake: FakeArDrone) -> AsyncIterator[tuple[subprocess.Popen[bytes], int]]:
    """Yield a service that flies the drone ahead from a process of its own, and its sender's process."""
    words = [sys.executable, "-c", SERVICE, pickle.dumps(options).hex()]
    child = await asyncio.to_thread(subprocess.Popen, words, stdout=subprocess.PIPE, cwd=ROOT)
    sender = 0
    try:
        sender = int(await asyncio.to_thread(child.stdout.readline))
        fake.vx_mm_s = 100.0
        await until(lambda: moving_command(fake))
        yield child, sender
    finally:
        child.kill()
        child.wait()
        child.stdout.close()
        if sender and alive(sender):
            os.kill(sender, signal.SIGKILL)


def test_it_is_small() -> None:
    """No large package is imported: it starts in a tenth of a second, and stays in memory when the service does not."""
    code = "import sys, drivers.ardrone.sender; print(sorted({'numpy', 'cv2', 'asyncio', 'av', 'logging'} & set(sys.modules)))"
    output = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert output.stdout.strip() == "[]"


def test_what_the_two_say_to_each_other_comes_out_as_it_went_in() -> None:
    word = TimedCommand(MonoNs(12345), AHEAD, at.REF_BASE, True, True, at.Pcmd(at.PCMD_PROGRESSIVE, 0.1, 0.2, 1.0, 0.0))
    text = as_text([at.Config("a:b", "c d"), at.Ctrl(5)])
    assert text == (("CONFIG", ',"a:b","c d"'), ("CTRL", ",5,0"))
    for order in (
        SenderOrder(word),
        SenderOrder(commands=text, until=MonoNs(7)),
        SenderOrder(reopen=True),
        SenderOrder(end=word),
    ):
        assert order_of(pack(order)) == order


@pytest.mark.hazard("H5")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
async def test_a_service_that_is_killed_or_stopped_leaves_a_climb_and_hover_and_the_drone_in_the_air(how: signal.Signals) -> None:
    fake = FakeArDrone()
    async with fake.on_loopback(hold_s=2.5) as options, service(options, fake) as (child, sender):
        child.send_signal(how)
        before = len(fake.of(at.Pcmd))
        await until(lambda: fake.of(at.Pcmd)[-1].gaz == 1.0)
        old = sum(p.flags and p.gaz < 1.0 for p in fake.of(at.Pcmd)[before:])
        assert old <= 30, "120 ms at 10 ms each, and what was on its way"
        fake.altitude_mm = 2100
        await until(lambda: not moving_command(fake))
        count = len(fake.of(at.Pcmd))
        fake.state |= nd.NavdataState.COM_WATCHDOG
        await until(lambda: len(fake.of(at.Pcmd)) > count + 30)
        assert all(p.flags == 0 for p in fake.of(at.Pcmd)[count:])
        assert fake.state & nd.NavdataState.FLYING, "never told to land"
        await until(lambda: not fake.state & nd.NavdataState.COM_WATCHDOG)
        await until(lambda: fake.configuration["general:com_watchdog"] == str(options.hold_com_watchdog_s))
        fake.state &= ~nd.NavdataState.COMMAND_ACK
        if how is signal.SIGSTOP:
            # What it had in hand when it was stopped is old; it flies on only by what guidance says now.
            child.send_signal(signal.SIGCONT)
            await until(lambda: moving_command(fake))
            await until(lambda: fake.configuration["general:com_watchdog"] == "2")
        else:
            await until(lambda: not alive(sender))
            assert fake.state & nd.NavdataState.FLYING, "given up after hold_s, to the drone's own rules"


async def test_a_new_service_takes_over_from_the_sender_that_holds_the_drone(monkeypatch: pytest.MonkeyPatch) -> None:
    be_patient(monkeypatch)
    fake = FakeArDrone()
    async with fake.on_loopback() as options, service(options, fake) as (child, orphan):
        child.kill()
        child.wait()
        fake.altitude_mm = 2100
        await until(lambda: not moving_command(fake))
        seen = len(fake.commands)
        async with open_ardrone(options, CLOCK) as drone:
            await until(lambda: drone.ready)
            await steer(drone, fake)
            assert drone.sender_pid not in (None, orphan)
            await until(lambda: not alive(orphan))
            numbers = [n for n, _ in fake.commands[seen:]]
            assert numbers == sorted(numbers), "it goes on counting, and the two are never both heard"
            assert fake.configuration["general:com_watchdog"] == "2"
        assert fake.state & nd.NavdataState.FLYING
        assert not any(c.emergency for c in fake.of(at.Ref))


async def test_a_drone_that_a_living_service_flies_is_not_taken() -> None:
    fake = FakeArDrone()
    async with fake.on_loopback() as options, service(options, fake), open_ardrone(options, CLOCK) as other:
        await until(lambda: "another service" in other.down.get("at", ""))
        await until(lambda: moving_command(fake))


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
async def test_a_sender_that_is_killed_or_stuck_is_replaced_and_the_drone_hovers_meanwhile(how: signal.Signals) -> None:
    fake = FakeArDrone()
    async with fake.on_loopback() as options, open_ardrone(options, CLOCK) as drone:
        await until(lambda: drone.ready)
        drone.command(TakeOff())
        await until(lambda: bool(fake.state & nd.NavdataState.FLYING))
        fake.vx_mm_s = 100.0
        await steer(drone, fake)
        first = drone.sender_pid
        os.kill(first, how)
        await until(lambda: not moving_command(fake))
        await until(lambda: drone.counters.at_senders == 2 and drone.sender_pid not in (None, first))
        await steer(drone, fake)
        assert fake.state & nd.NavdataState.FLYING
        assert not alive(first)


class Heard:
    """A socket in a drone's place, and a client whose sender speaks to it."""

    def __init__(self, drone: socket.socket, client: SenderClient, clock: SteppedClock) -> None:
        self.drone, self.client, self.clock = drone, client, clock

    def flies(self, until_s: float = 60.0, ref: int | None = None, *, watchdog: bool = False) -> None:
        self.client.update(TimedCommand(after(CLOCK.now(), until_s), AHEAD, ref, watchdog=watchdog))

    def waiting(self) -> list[tuple[int, at.AtCommand]]:
        """Return the commands that have arrived, at once."""
        self.drone.setblocking(False)
        out = []
        with suppress(BlockingIOError):
            while True:
                out += received_commands(self.drone.recv(2048))
        self.drone.settimeout(60.0)
        return out

    def next(self) -> list[tuple[int, at.AtCommand]]:
        return received_commands(self.drone.recv(2048))


@asynccontextmanager
async def listening(period_s: float = 0.03, *, replaces: bool = False) -> AsyncIterator[Heard]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as drone:
        drone.bind((HOST, 0))
        drone.settimeout(60.0)
        port, clock = drone.getsockname()[1], SteppedClock()
        options = SenderOptions(HOST, port, port, period_s, 60.0, 2.0, replaces=replaces)
        client = await SenderClient.start(options, clock, lambda: None)
        try:
            yield Heard(drone, client, clock)
        finally:
            with suppress(ProcessLookupError):
                os.kill(client.pid, signal.SIGCONT)
            client.end(TimedCommand(CLOCK.now(), HOVER))


async def test_a_sender_that_pauses_is_spoken_past_and_then_received_again() -> None:
    """Long before it is replaced; one that was only slow is the same process afterwards, and the drone still receives it."""
    async with listening() as heard:
        heard.flies()
        await until(lambda: heard.client.up)
        assert heard.next()[-1][1] == AHEAD
        os.kill(heard.client.pid, signal.SIGSTOP)
        await until(lambda: stopped(heard.client.pid))
        heard.flies()  # what it had said before it stopped is read now
        heard.clock.advance(0.09)
        heard.flies()
        assert not [number for number, _ in heard.waiting() if number == 1]
        heard.clock.advance(0.03)
        heard.flies()
        assert heard.waiting() == [(1, at.Pcmd(0, 0.0, 0.0, 0.0, 0.0))] * 3
        os.kill(heard.client.pid, signal.SIGCONT)
        heard.flies()
        gate = at.SequenceGate()
        while (received := heard.next())[-1][1] != AHEAD:
            assert all(gate.accepts(number) for number, _ in received)
        assert all(gate.accepts(number) for number, _ in received)


@pytest.mark.parametrize("replaces", [True, False])
async def test_while_a_replacement_starts_slowly_the_drone_is_spoken_to(replaces: bool) -> None:
    """A drone without commands would land by itself, on water too; a drone of another service is left alone."""
    async with listening(replaces=replaces) as heard:
        os.kill(heard.client.pid, signal.SIGSTOP)
        for dt_s in (0.09, 0.03):
            assert not heard.waiting()
            heard.clock.advance(dt_s)
            heard.flies(ref=STAY_UP, watchdog=True)
        hover = at.Pcmd(0, 0.0, 0.0, 0.0, 0.0)
        said = [(1, at.ComWdg()), (2, at.Ref(STAY_UP)), (3, hover)]
        assert heard.waiting()[:3] == (said if replaces else [])


async def test_a_sender_that_was_stopped_flies_nothing_that_waited_for_it() -> None:
    async with listening(0.01) as heard:
        heard.client.update(TimedCommand(after(CLOCK.now(), 5.0), HOVER))
        assert isinstance(heard.next()[-1][1], at.Pcmd)
        os.kill(heard.client.pid, signal.SIGSTOP)
        heard.client._write(SenderOrder(TimedCommand(after(CLOCK.now(), 0.1), AHEAD, at.REF_BASE)))
        heard.client._write(SenderOrder(commands=as_text([at.Ftrim()]), until=after(CLOCK.now(), 0.1)))
        await asyncio.sleep(0.2)
        heard.waiting()
        os.kill(heard.client.pid, signal.SIGCONT)
        later = [command for _ in range(10) for _, command in heard.next()]
        assert not any(isinstance(c, at.Ftrim | at.Ref) or (isinstance(c, at.Pcmd) and c.flags) for c in later)


@pytest.mark.hazard("H5")
async def test_a_blocked_event_loop_means_hover() -> None:
    fake = FakeArDrone()
    async with fake.on_loopback() as options, open_ardrone(options, CLOCK) as drone:
        await until(lambda: drone.ready)
        drone.command(TakeOff())
        await until(lambda: bool(fake.state & nd.NavdataState.FLYING))
        fake.vx_mm_s = 100.0
        await steer(drone, fake)
        seen = len(fake.of(at.Pcmd))
        time.sleep(0.5)  # noqa: ASYNC251 - the fault itself; what the drone was sent meanwhile waits in its socket
        await until(lambda: len(fake.of(at.Pcmd)) > seen + 20)
        flags = [p.flags for p in fake.of(at.Pcmd)[seen:]]
        assert 0 in flags[:30]
        assert not any(flags[flags.index(0) :]), "and guidance has said nothing since"
        assert drone.sender_pid is not None
        assert fake.state & nd.NavdataState.FLYING


def test_only_the_same_user_takes_over(monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"\0decklander-test/{os.getpid()}"
    claimed = sender_lock.claim(name, f"{name}/mark", replaces=False)
    listener, sequence = claimed
    assert sequence == 0
    with listener, socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as stranger:
        stranger.connect(name)
        stranger.sendall(b"yield\n")
        monkeypatch.setattr(sender_lock, "_peer", lambda end: (1234, os.getuid() + 1))
        assert not sender_lock.yield_to(listener, 7)
        with pytest.raises(ConnectionResetError):
            stranger.recv(32)


async def test_a_service_that_has_lost_its_sender_gets_the_drone_back_before_a_newcomer() -> None:
    """The name of a sender is free until the next one runs; on a busy machine a sender may be replaced."""
    name = f"\0decklander-test/{os.getpid()}/lost"
    with sender_lock.mark(f"{name}/mark") or socket.socket() as mark:
        assert mark.getsockname(), "the drone is marked"
        assert sender_lock.mark(f"{name}/mark") is None, "by one service only"
        newcomer = asyncio.create_task(asyncio.to_thread(sender_lock.claim, name, f"{name}/mark", replaces=False))
        await asyncio.sleep(0.1)
        assert not newcomer.done()
        claimed = sender_lock.claim(name, f"{name}/mark", replaces=True)
        listener, _ = claimed
        with listener:
            await until(lambda: newcomer.done() or sender_lock.yield_to(listener, None))
            assert await newcomer is None
