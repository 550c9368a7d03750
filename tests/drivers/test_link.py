"""The link against a drone in miniature, over real sockets on loopback."""

import asyncio
import re
import socket
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from typing import Any

import numpy as np
import pytest

from drivers.ardrone import at, command_channel
from drivers.ardrone import navdata as nd
from drivers.ardrone.link import ArDrone, open_ardrone
from drivers.ardrone.options import ArDroneOptions
from drivers.clock import SystemClock
from drivers.datagrams import WaitingDatagrams
from estimator.contracts.commands import TakeOff, Velocity
from estimator.contracts.errors import Recoverable
from estimator.contracts.time import MonoNs
from tests.drivers.test_video import clip
from tests.support.fake_ardrone import FakeArDrone
from tests.support.waiting import until

FORWARD = Velocity(np.array([0.4, 0.0, 0.0]), 0.0)


def video() -> list[bytes]:
    return [u.header.pack() + u.payload for u in clip()[0]]


PATIENT = {"navdata_silence_s": 3.0, "reopen_after_s": 30.0, "config_timeout_s": 30.0}
"""Options of a link whose other channels are not to be lost on a busy machine."""


@asynccontextmanager
async def linked(fake: FakeArDrone, **options: Any) -> AsyncIterator[ArDrone]:
    async with fake.on_loopback(**options) as chosen, open_ardrone(chosen, SystemClock()) as drone:
        yield drone


async def steer(drone: ArDrone, fake: FakeArDrone) -> None:
    """Command a velocity until the drone is flown by its sticks."""

    def steered() -> bool:
        drone.command(FORWARD)
        return bool(fake.of(at.Pcmd)[-1].flags == at.PCMD_PROGRESSIVE)

    await until(steered)


@pytest.fixture(autouse=True)
def _patience(monkeypatch: pytest.MonkeyPatch) -> None:
    be_patient(monkeypatch)


def be_patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine the service would take a sender that waits for the processor for a silent one, and send hover itself."""
    for limit in ("_SILENT_S", "_STUCK_S", "_READY_S"):
        monkeypatch.setattr(command_channel, limit, 60.0)


async def test_setup_brings_the_drone_out_of_bootstrap_key_by_key() -> None:
    fake = FakeArDrone()
    async with linked(fake, further_configuration="general:ardrone_name=test", config_timeout_s=30.0) as drone:
        await until(lambda: drone.ready)
        await until(lambda: bool(drone.configuration))
        assert fake.configured_in_order == [*ArDroneOptions(further_configuration="general:ardrone_name=test").configuration()]
        assert fake.configuration["general:navdata_demo"] == "FALSE"
        assert fake.configuration["video:video_channel"] == "1"
        assert drone.configuration == fake.configuration
        first_ids = [ids is not None for ids in fake.ids_before_config]
        assert first_ids == [False] * 4 + [True] * (len(first_ids) - 4), "ids directly before every key once they are in use"
        assert not fake.state & nd.NavdataState.COMMAND_ACK
        assert drone.counters.config_acknowledged == len(first_ids)
        assert drone.counters.config_timeouts == drone.counters.config_mismatches == 0
        assert not fake.refused
        await until(lambda: not fake.state & nd.NavdataState.COM_WATCHDOG)
    numbers = [n for n, _ in fake.commands]
    assert numbers[0] == 1
    assert 1 <= numbers.count(1) <= 8, "the first datagrams make the drone count anew, lest one lost datagram deafens it"
    grown = [n for n in numbers if n != 1]
    assert grown == list(range(2, len(grown) + 2)), "one sequence for all commands"


async def test_frames_of_the_bottom_camera_only_and_newest_only() -> None:
    fake = FakeArDrone()
    fake.clips = video() * 8
    async with linked(fake) as drone:
        await until(lambda: drone.counters.frames > 20)
        frame = await drone.frames.get()
        assert frame.px.shape == (360, 640, 3)
        counters = drone.counters
        assert counters.frames_before_setup > 0, "what came before the bottom camera was selected is not handed on"
        assert counters.frames_replaced >= counters.frames - 2


async def test_a_frame_is_received_with_its_first_byte() -> None:
    unit = video()[0]
    fake = FakeArDrone()
    async with linked(fake, video_silence_s=30.0) as drone:
        await until(lambda: drone.ready and fake.video_writers)
        fake.video_writers[-1].write(unit[:900])
        await until(lambda: drone.counters.video_bytes == 900)
        began = SystemClock().now()
        fake.video_writers[-1].write(unit[900:])
        frame = await drone.frames.get()
        assert frame.stamp.received_at <= began
        assert frame.coded


@pytest.mark.parametrize("how", ["leave", "error", "cancel"])
async def test_leaving_in_flight_leaves_the_drone_in_hover(how: str) -> None:
    fake = FakeArDrone()
    async with fake.on_loopback() as options:
        flying = asyncio.Event()

        async def fly() -> None:
            async with open_ardrone(options, SystemClock()) as drone:
                await until(lambda: drone.ready)
                drone.command(TakeOff())
                await until(lambda: bool(fake.state & nd.NavdataState.FLYING))
                await until(lambda: bool(drone.navdata and drone.navdata.state & nd.NavdataState.FLYING))
                await steer(drone, fake)
                flying.set()
                if how == "error":
                    raise LookupError("ours")
                if how == "cancel":
                    await asyncio.sleep(60)

        task = asyncio.create_task(fly())
        await asyncio.wait([task, waiting := asyncio.create_task(flying.wait())], return_when=asyncio.FIRST_COMPLETED)
        waiting.cancel()
        if how == "cancel":
            task.cancel()
        (result,) = await asyncio.gather(task, return_exceptions=True)
        assert type(result) is {"leave": type(None), "error": LookupError, "cancel": asyncio.CancelledError}[how]
        await until(lambda: fake.of(at.Pcmd)[-3:] == [at.Pcmd(0, 0.0, 0.0, 0.0, 0.0)] * 3)
        assert fake.of(at.Ref)[-3:] == [at.Ref(at.REF_BASE | at.REF_TAKE_OFF)] * 3
        assert fake.state & nd.NavdataState.FLYING


@pytest.mark.parametrize("channel", ["video", "control"])
async def test_a_connection_is_lost_and_found_again_alone(channel: str) -> None:
    fake = FakeArDrone()
    fake.clips = video()
    async with linked(fake, **PATIENT) as drone:
        await until(lambda: drone.counters.control_reads == 1)
        frames = drone.counters.frames
        (fake.drop_video if channel == "video" else fake.text.drop)()
        found = {"video": lambda: drone.counters.frames > frames, "control": lambda: drone.counters.control_reads == 2}
        await until(found[channel])
        assert drone.counters.restarts[channel] >= 1
        assert not any(drone.counters.restarts[other] for other in ("navdata", "at", "setup"))


async def test_a_key_that_reads_back_wrongly_is_requested_again() -> None:
    fake = FakeArDrone()
    async with linked(fake) as drone:
        await until(lambda: drone.counters.control_reads == 1)
        fake.configuration["video:video_channel"] = "0"
        fake.text.drop()
        await until(lambda: drone.counters.config_mismatches == 1)
        await until(lambda: drone.counters.control_reads >= 3)
        assert fake.configuration["video:video_channel"] == "1"
        assert drone.ready


async def test_silent_navdata_is_requested_again_and_commands_go_on() -> None:
    fake = FakeArDrone()
    async with linked(fake) as drone:
        await until(lambda: drone.ready)
        asked, sent = fake.counters["navdata_request"], len(fake.commands)
        fake.silent = True
        await until(lambda: fake.counters["navdata_request"] > asked)
        await until(lambda: drone.counters.restarts["navdata"] >= 1)
        assert drone.counters.navdata_silences >= 2
        received = drone.counters.samples
        await until(lambda: len(fake.commands) > sent + 20)
        assert drone.counters.samples == received, "the keep-alive does not wait for navdata"
        fake.silent = False
        await until(lambda: drone.counters.samples > received)


async def test_navdata_of_which_none_is_whole_are_named_with_their_reason_and_number() -> None:
    fake = FakeArDrone()
    whole = fake.datagram
    fake.datagram = lambda: whole()[:-1] + bytes([whole()[-1] ^ 1])  # type: ignore[method-assign]
    async with linked(fake) as drone:
        await until(lambda: "navdata" in drone.down)
        said = re.fullmatch(r"no navdata for .* s: (\d+) datagrams are refused: their checksum is wrong", drone.down["navdata"])
        assert said is not None, drone.down
        assert 0 < int(said[1]) <= drone.counters.navdata_refused["bad_checksum"]
        fake.datagram = whole  # type: ignore[method-assign]
        await until(lambda: drone.counters.samples > 0)


async def test_a_drone_that_begins_again_is_configured_again() -> None:
    fake = FakeArDrone()
    async with linked(fake) as drone:
        await until(lambda: drone.ready)
        await until(lambda: drone.counters.samples > 500)
        fake.forget()
        await until(lambda: not drone.ready)
        await until(lambda: drone.ready)
        assert drone.counters.navdata_restarts == 1
        assert "video:video_channel" in fake.configured_in_order
        assert not fake.state & (nd.NavdataState.NAVDATA_BOOTSTRAP | nd.NavdataState.COM_WATCHDOG)


async def test_a_key_that_is_not_acknowledged_is_tried_again_later() -> None:
    fake = FakeArDrone()
    fake.deaf_to_config = True
    async with linked(fake, config_timeout_s=0.15) as drone:
        await until(lambda: drone.counters.config_timeouts >= 2)
        assert "general:navdata_demo" in drone.down.get("setup", "general:navdata_demo")
        assert not drone.ready
        fake.deaf_to_config = False
        await until(lambda: drone.ready)


class Ends:
    """A waiting socket and its peer."""

    def __init__(self) -> None:
        self.peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.peer.bind(("127.0.0.1", 0))
        self.own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.own.setblocking(False)
        self.own.connect(self.peer.getsockname())
        self.taken: list[tuple[bytes, MonoNs]] = []
        self.waiting = WaitingDatagrams(self.own, SystemClock(), lambda data, at, sender: self.taken.append((data, at)))
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
