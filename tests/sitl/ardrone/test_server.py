"""The simulated drone over real sockets, around a point mass: what a client sees on each of the four ports."""

import asyncio
import random
import socket
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, cast

import av
import numpy as np
import pytest

from drivers.ardrone import at, pave
from drivers.ardrone.navdata import LAYOUTS, ControlState, NavdataState
from drivers.clock import SystemClock
from estimator.contracts.errors import BadInput
from sitl.emulators.ardrone import truth_log
from sitl.emulators.ardrone.server import ArDroneServer, Ports
from sitl.faults.kinds import FrameStream, LinkLost
from sitl.world.world import World
from tests.sitl.ardrone.peer import Peer, Watcher
from tests.sitl.ardrone.point_mass import PointMass
from tests.support.clocks import PatientClock
from tests.support.waiting import PATIENCE_S, until

HOST = "127.0.0.1"
ANY = Ports(0, 0, 0, 0)
FLY = at.Ref(at.REF_BASE | at.REF_TAKE_OFF)


def serving(world: PointMass, **options: Any) -> ArDroneServer:
    return ArDroneServer(cast(World, world), HOST, ANY, PatientClock(), **options)


@pytest.fixture
def world() -> PointMass:
    return PointMass(SystemClock().now())


@pytest.fixture
async def server(world: PointMass) -> AsyncIterator[ArDroneServer]:
    async with serving(world) as server:
        yield server


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def peer(server: ArDroneServer, stack: ExitStack) -> Peer:
    peer = Peer(HOST, server.ports)
    stack.callback(peer.close)
    return peer


async def test_bootstrap_reports_nothing_but_its_state_until_it_is_configured(peer: Peer) -> None:
    for request in (b"\x01", b"\x01\x00\x00\x00"):
        peer.ask(request)
    first = await peer.on_message()
    assert first.sequence == 1
    assert first.options == ()
    assert first.state & NavdataState.NAVDATA_BOOTSTRAP
    assert first.state & NavdataState.COM_WATCHDOG
    await peer.configure("general:navdata_demo", "TRUE")
    demo = await peer.on_message()
    assert demo.options == (0, 16), "65537: demo and vision_detect"
    assert demo.control_state is ControlState.LANDED
    peer.say(at.ComWdg())
    await peer.until(lambda n: not n.state & NavdataState.COM_WATCHDOG)


@pytest.mark.parametrize(("demo", "low_hz", "high_hz"), [("TRUE", 13.0, 18.0), ("FALSE", 170.0, 215.0)])
async def test_rates(server: ArDroneServer, peer: Peer, world: PointMass, demo: str, low_hz: float, high_hz: float) -> None:
    """Rates are in the drone's own time, which a busy machine does not stretch."""
    peer.ask()
    await peer.configure("general:navdata_demo", demo)
    first = (await peer.on_message()).sequence
    began, sent = world.now, server.counters["navdata_sent"]
    while world.now - began < 600_000_000:
        last = await peer.on_message()
    hz = (server.counters["navdata_sent"] - sent) / ((world.now - began) * 1e-9)
    assert low_hz < hz < high_hz
    assert last.sequence - first == pytest.approx(server.counters["navdata_sent"] - sent, abs=60), "they are heard too"


async def test_full_navdata_holds_what_the_sensors_read(server: ArDroneServer, peer: Peer, world: PointMass) -> None:
    peer.ask()
    await peer.configure("general:navdata_demo", "FALSE")
    async with peer.talking(FLY, at.Pcmd(1, 0.25, -0.5, 0.2, 0.3)):
        await peer.until(lambda n: n.control_state is ControlState.FLYING)
        full = await peer.until(lambda n: (n.vx_mm_s or 0.0) > 300 and (n.psi_mdeg or 0.0) > 0)
    assert (full.options, full.skipped) == (tuple(range(28)), ())
    tilt_deg = np.degrees(world.limits.euler_angle_max_rad)
    assert full.theta_mdeg == pytest.approx(-0.5 * tilt_deg * 1e3, rel=1e-4), "nose down to fly ahead"
    assert full.phi_mdeg == pytest.approx(0.25 * tilt_deg * 1e3, rel=1e-4)
    assert full.vy_mm_s is not None
    assert full.vy_mm_s > 0
    assert full.altitude_mm is not None
    assert 800 < full.altitude_mm < 1500
    assert full.altitude_raw_mm == pytest.approx(full.altitude_mm / np.cos(np.radians(0.25 * tilt_deg)), abs=10)
    assert full.battery_percent == 50
    assert (full.wx_deg_s, full.wy_deg_s, full.wz_deg_s) == pytest.approx(np.degrees([0.01, -0.02, 0.03]))
    ahead_mg = 1e3 * np.sin(np.radians(full.theta_mdeg / 1e3))
    assert (full.ax_mg, full.ay_mg, full.az_mg) == pytest.approx([ahead_mg, -53.0, -990.0], abs=12), "forward-right-down"
    assert full.temperature_dc == 435
    assert full.pressure_pa is not None
    assert 101_305 <= full.pressure_pa <= 101_318
    assert full.sum_echo is not None
    assert full.sum_echo > 10
    flown_us = (world.now - world.started) // 1000
    assert full.time_us is not None
    assert 89_000_000 < full.time_us - flown_us < 91_000_000, "the drone was switched on a minute and a half before"
    further = server.drone.further_fields()
    assert [further[f"magneto_raw_{axis}"] for axis in "xyz"] == pytest.approx((210.0, -15.0, 430.0))
    assert [further[f"motor_{n}"] for n in range(1, 5)] == [170, 171, 172, 173]
    assert set(further) <= {name for layout in LAYOUTS.values() for name in layout.fields}


async def test_video_is_pave_with_h264_of_what_the_camera_sees(server: ArDroneServer, peer: Peer, stack: ExitStack) -> None:
    peer.say(at.Config("video:video_channel", "1"))
    await until(lambda: server.drone.state.config["video:video_channel"] == "1")
    watcher = Watcher(HOST, server.ports)
    stack.callback(watcher.close)
    decoder = av.CodecContext.create("h264", "r")
    frames = [await watcher.frame() for _ in range(18)]
    headers = [f.header for f in frames]
    assert [h.frame_number for h in headers] == list(range(1, 19))
    assert [i for i, h in enumerate(headers) if h.frame_type == pave.FrameType.IDR] == [0, 15]
    assert {h.frame_type for h in headers} == {pave.FrameType.IDR, pave.FrameType.P}
    first = headers[0]
    assert (first.codec, first.header_size, first.version) == (pave.CODEC_H264, 68, 2)
    assert (first.encoded_width, first.encoded_height, first.display_width, first.display_height) == (640, 368, 640, 360)
    assert first.sps_size > 8
    assert first.pps_size > 4
    assert headers[1].stream_position == first.payload_size - first.sps_size - first.pps_size
    gaps_ms = np.diff([h.timestamp_ms for h in headers])
    assert np.median(gaps_ms) >= 25
    assert min(gaps_ms) <= 42, "a host that is too slow for it films fewer"
    assert not any(f.discontinuity for f in frames[1:])
    images = [decoder.decode(av.Packet(f.payload))[0].to_ndarray(format="bgr24") for f in frames]
    assert images[-1].shape == (360, 640, 3)
    assert 60 < images[-1].mean() < 180
    assert np.abs(images[-1].astype(int) - images[0]).mean() > 5, "the texture moves"


async def test_a_slow_client_loses_frames_not_freshness(server: ArDroneServer, peer: Peer, stack: ExitStack) -> None:
    peer.say(at.Config("video:video_channel", "1"))
    peer.say(at.Config("video:max_bitrate", "20000"))
    await until(lambda: server.drone.state.config["video:max_bitrate"] == "20000")
    slow = Watcher(HOST, server.ports, receive_buffer=4096)
    stack.callback(slow.close)
    await slow.frame()
    await until(lambda: server.counters["video_dropped"] >= 20)
    numbers = [(await slow.frame()).header.frame_number]
    while numbers[-1] - numbers[0] < 20:
        numbers.append((await slow.frame()).header.frame_number)
    assert max(np.diff(numbers)) > 5
    # Having read what was in the pipe, the client is at the present again.
    async with asyncio.timeout(60):
        while server.drone.shot.number - (await slow.frame()).header.frame_number >= 15:
            pass
    assert server.counters["navdata_dropped"] == 0


async def test_garbage_on_every_port_hurts_nobody(server: ArDroneServer, peer: Peer, stack: ExitStack) -> None:
    rng = random.Random(11)
    peer.ask()
    await peer.configure("general:navdata_demo", "FALSE")
    watcher = Watcher(HOST, server.ports)
    stack.callback(watcher.close)
    others = [socket.create_connection((HOST, server.ports.control)) for _ in range(3)]
    for other in others:
        stack.callback(other.close)
    for _ in range(100):
        garbage = rng.randbytes(rng.randrange(0, 1400))
        peer.commands.sendto(garbage, (HOST, server.ports.at))
        peer.commands.sendto(b"AT*" + garbage + b"\r", (HOST, server.ports.at))
        peer.navdata.sendto(garbage[:200], (HOST, server.ports.navdata))
        rng.choice(others).send(garbage)
        watcher.socket.send(garbage)
        await asyncio.sleep(0.001)
    peer.say(FLY)
    await peer.until(lambda n: n.control_state is ControlState.HOVERING)
    assert (await watcher.frame()).payload
    assert server.drone.state.counters["at_bad_magic"] > 10
    assert server.counters["navdata_request_refused"] > 60


async def test_the_truth_log_holds_each_hundredth_of_a_second_in_this_hosts_time(tmp_path: Path) -> None:
    world, path, began = PointMass(SystemClock().now(), height_m=2.0), tmp_path / "truth.jsonl", SystemClock().now()
    async with serving(world, truth_path=path):
        await until(lambda: world.now - began > 500_000_000)
    records, ended = truth_log.read(path), SystemClock().now()
    assert len(records) >= 40
    assert all(began <= r["at_ns"] <= ended for r in records)
    assert np.median(np.diff([r["at_ns"] for r in records])) == pytest.approx(10e6, rel=0.01)
    with path.open("a") as f:
        f.write('{"at_ns": 1, "cut')
    assert len(truth_log.read(path)) == len(records)
    with path.open("a") as f:
        f.write("\n")
    with pytest.raises(BadInput, match=f"line {len(records) + 1}"):
        truth_log.read(path)


async def test_a_bug_inside_takes_the_body_down(world: PointMass, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: object) -> None:
        raise ZeroDivisionError

    with pytest.RaisesGroup(ZeroDivisionError):
        async with serving(world):
            monkeypatch.setattr(world, "advance", broken)
            await asyncio.sleep(PATIENCE_S)


async def test_wrong_stamps_late_frames_and_a_lost_link_reach_the_wire(
    server: ArDroneServer, world: PointMass, peer: Peer, stack: ExitStack
) -> None:
    watcher = Watcher(HOST, server.ports)
    stack.callback(watcher.close)
    peer.ask()
    await peer.configure("general:navdata_demo", "FALSE")
    true_ms = (await watcher.frame()).header.timestamp_ms
    world.stamp_error_s = 5.0
    async with asyncio.timeout(60):
        while (ahead_ms := (await watcher.frame()).header.timestamp_ms) < true_ms + 4000:
            pass
    world.stamp_error_s = 0.0
    world.failing.now = [FrameStream(at_s=0.0, delay_s=0.4)]
    async with asyncio.timeout(60):
        while (frame := (await watcher.frame()).header).timestamp_ms >= ahead_ms - 1000 or frame.timestamp_ms < true_ms:
            pass
    while server._drone_clock.milliseconds(server._clock.now()) - (await watcher.frame()).header.timestamp_ms < 400:
        pass
    numbers = [(await watcher.frame()).header.frame_number for _ in range(4)]
    world.failing.now = []
    numbers += [(await watcher.frame()).header.frame_number for _ in range(12)]
    assert numbers == sorted(numbers), "what follows a late frame waits behind it"
    world.failing.now = [LinkLost(at_s=0.0)]
    await asyncio.sleep(0.1)
    measured_at, sent = server.drone.state.counters["at_taken"], server.counters["navdata_sent"]
    peer.say(FLY)
    await asyncio.sleep(0.2)
    assert (server.drone.state.counters["at_taken"], server.counters["navdata_sent"]) == (measured_at, sent)
    world.failing.now = []
    peer.ask()  # on a busy machine its lease has run out meanwhile
    peer.say(FLY)
    await peer.until(lambda n: n.control_state is ControlState.HOVERING)
