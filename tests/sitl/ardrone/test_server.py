"""The simulated drone over real sockets and as a process: what a client sees on each of the four ports."""

import asyncio
import json
import logging
import random
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import AbstractAsyncContextManager, AbstractContextManager, ExitStack, asynccontextmanager
from pathlib import Path
from typing import Any, cast

import av
import msgspec
import numpy as np
import pytest

from drivers.ardrone import at, pave
from drivers.ardrone.link import ArDrone, open_ardrone
from drivers.ardrone.navdata import LAYOUTS, ControlState, NavdataState
from drivers.ardrone.options import ArDroneOptions, ardrone_options
from drivers.clock import SystemClock
from estimator.contracts.commands import Land
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import Rotation
from estimator.contracts.pictures import CodedPicture
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Frame, Imu, Range, VehicleStatus
from estimator.contracts.time import NS_PER_S, MonoNs, seconds_between
from estimator.uvlc import UvlcDecoder
from sitl.ardrone.state import FIRST
from sitl.ardrone.uvlc import ArrivingFrames
from sitl.emulators.ardrone import serve, truth_log
from sitl.emulators.ardrone.serve import fly_repeatedly
from sitl.emulators.ardrone.server import ArDroneServer, Habits, Ports
from sitl.emulators.ardrone.wire_pictures import Shot, UvlcPictures
from sitl.faults.kinds import FrameStream, LinkLost
from sitl.flight.one_flight import fly
from sitl.perception.levels import perceive, represents
from sitl.perception.port import Perception
from sitl.scenario.scenario import Start
from sitl.scenario.scenario import load as load_scenario
from sitl.scenario.settings import settings_for
from sitl.scenario.with_fault import faulty, real_time
from sitl.world.truth import RenderedFrame
from sitl.world.world import World
from tests.sitl.ardrone.point_mass import Peer, PointMass, Watcher, options_for
from tests.support.clocks import PatientClock
from tests.support.processes import started
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
    assert full.vy_mm_s > 0
    assert 800 < full.altitude_mm < 1500
    assert full.altitude_raw_mm == pytest.approx(full.altitude_mm / np.cos(np.radians(0.25 * tilt_deg)), abs=10)
    assert full.battery_percent == 50
    assert (full.wx_deg_s, full.wy_deg_s, full.wz_deg_s) == pytest.approx(np.degrees([0.01, -0.02, 0.03]))
    ahead_mg = 1e3 * np.sin(np.radians(full.theta_mdeg / 1e3))
    assert (full.ax_mg, full.ay_mg, full.az_mg) == pytest.approx([ahead_mg, -53.0, -990.0], abs=12), "forward-right-down"
    assert full.temperature_dc == 435
    assert 101_305 <= full.pressure_pa <= 101_318
    assert full.sum_echo > 10
    flown_us = (world.now - world.started) // 1000
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
    assert all(began <= r.at <= ended for r in records)
    assert np.median(np.diff([r.at for r in records])) == pytest.approx(10e6, rel=0.01)
    with path.open("a") as f:
        f.write('{"at": 1, "cut')
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


async def test_wrong_stamps_late_frames_and_a_lost_link_reach_the_wire(server, world, peer, stack):
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
    world.failing.set = [FrameStream(at_s=0.0, delay_s=0.4)]
    async with asyncio.timeout(60):
        while (frame := (await watcher.frame()).header).timestamp_ms >= ahead_ms - 1000 or frame.timestamp_ms < true_ms:
            pass
    while server._drone_clock.milliseconds(server._clock.now()) - (await watcher.frame()).header.timestamp_ms < 400:
        pass
    numbers = [(await watcher.frame()).header.frame_number for _ in range(4)]
    world.failing.set = []
    numbers += [(await watcher.frame()).header.frame_number for _ in range(12)]
    assert numbers == sorted(numbers), "what follows a late frame waits behind it"
    world.failing.set = [LinkLost(at_s=0.0)]
    await asyncio.sleep(0.1)
    measured_at, sent = server.drone.state.counters["at_taken"], server.counters["navdata_sent"]
    peer.say(FLY)
    await asyncio.sleep(0.2)
    assert (server.drone.state.counters["at_taken"], server.counters["navdata_sent"]) == (measured_at, sent)
    world.failing.set = []
    peer.ask()  # on a busy machine its lease has run out meanwhile
    peer.say(FLY)
    await peer.until(lambda n: n.control_state is ControlState.HOVERING)


ANY_PORTS = ("--navdata-port", "0", "--video-port", "0", "--at-port", "0", "--control-port", "0")


def start(*arguments: str, **options: Any) -> AbstractContextManager[subprocess.Popen[str]]:
    return started([sys.executable, "-m", "sitl.emulators.ardrone.serve", *arguments], stderr=subprocess.PIPE, **options)


@pytest.mark.parametrize("how", ["stdin closes", "SIGTERM"])
def test_it_ends_when_ordered_and_leaves_the_whole_truth(how: str, tmp_path: Path) -> None:
    truth = tmp_path / "truth.jsonl"
    with start("calm", "--truth", str(truth), *ANY_PORTS, stdin=subprocess.PIPE) as process:
        ready = json.loads(process.stdout.readline())
        assert ready["event"] == "ready"
        assert len(set(ready["ports"].values())) == 4
        assert all(1024 < port < 65536 for port in ready["ports"].values())
        process.stdout.flush()
        if how == "SIGTERM":
            process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    ended = json.loads(out)
    assert ended["event"] == "ended"
    assert ended["phase"] == "hovering"
    assert ended["stood_still_s"] >= 0.0
    records = truth_log.read(truth)
    assert all(r.at >= ready["started_ns"] for r in records)


@pytest.mark.parametrize(
    ("arguments", "code", "what"),
    [
        (("nowhere",), 2, "there is no file 'nowhere' and no shipped one"),
        (("calm", "--seed", "-1"), 2, "--seed must be 0 or more"),
        (("calm", "--truth", "/nowhere/at/all", *ANY_PORTS), 2, "truth log /nowhere/at/all: No such file"),
    ],
)
def test_wrong_use_is_one_line(arguments: tuple[str, ...], code: int, what: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert serve.main(list(arguments)) == code
    output = capsys.readouterr()
    assert output.out == ""
    assert what in output.err
    assert output.err.count("\n") == 1


async def test_its_stamps_of_frames_agree_with_when_they_were_exposed() -> None:
    clock = SystemClock()
    world = PointMass(clock.now(), height_m=1.5)
    exposed: list[MonoNs] = []
    lags_ms: list[float] = []
    expose = world.expose

    def recorded() -> object:
        exposed.append(world.now)
        lags_ms.append((clock.now() - world.now) * 1e-6)
        return expose()

    world.expose = recorded  # type: ignore[assignment, method-assign]
    async with ArDroneServer(cast(World, world), HOST, Ports(0, 0, 0, 0), clock) as server:
        exposed.clear()  # the frame made before flight is no frame
        async with open_ardrone(options_for(server.ports), clock) as drone:
            await until(lambda: drone.ready)
            off_ms = []
            for _ in range(28):
                frame = await drone.frames.get()
                assert frame.px.shape == (360, 640, 3)
                off_ms.append((frame.stamp.measured_at - exposed[frame.seq - 1]) * 1e-6)
            # The drone of a busy machine lags behind its own clock, which no stamp can know. Late is one side: the quarter that
            # was least so is what the stamps are judged by.
            low, middle = np.percentile(off_ms[10:], [25, 50])
            assert abs(low) < 8.0 + 2.0 * np.median(lags_ms)
            assert middle - low < 5.0 + 2.0 * np.median(lags_ms)


CLOCK = SystemClock()
NEAR = msgspec.structs.replace(load_scenario("calm"), start=Start(height_m=0.8, pad_right_m=0.1, pad_forward_m=0.1))


async def test_each_flight_ends_and_another_begins_in_the_air_under_the_same_client() -> None:
    reported: list[dict[str, Any]] = []
    too_short = msgspec.structs.replace(NEAR, duration_limit_s=2.5)
    patient = PatientClock()
    async with ArDroneServer(World(too_short, 1, patient.now()), ports=Ports(0, 0, 0, 0), clock=patient) as server:
        first, done, changes = server.world, asyncio.Event(), [False]

        def tell(**what: Any) -> None:
            reported.append(what)
            if len(reported) == 3:
                done.set()

        # A driver that sets the drone up again misses what happens meanwhile: on a busy machine an answer may take its time.
        async with (
            asyncio.timeout(60),
            open_ardrone(options_for(server.ports, config_timeout_s=30.0), CLOCK) as drone,
            asyncio.TaskGroup() as group,
        ):
            flying_since: MonoNs | None = None

            async def fly() -> None:
                """Half a second in the air, then land; the first is let run out of time."""
                nonlocal flying_since
                async for sample in drone.samples:
                    if not isinstance(sample, VehicleStatus) or sample.flying is None:
                        continue
                    if sample.flying != changes[-1]:
                        changes.append(sample.flying)
                        flying_since = CLOCK.now() if sample.flying else None
                    if reported and flying_since is not None and seconds_between(flying_since, CLOCK.now()) > 0.5:
                        drone.command(Land())

            pilot = group.create_task(fly())
            flights = group.create_task(fly_repeatedly(server, NEAR, 1, patient, tell, landed_s=0.3, silent_s=1.5))
            await done.wait()
            while len(changes) < 7:  # noqa: ASYNC110 - the third landing is still on its way to the driver
                await asyncio.sleep(0.01)
            pilot.cancel()
            flights.cancel()
    assert [flight["seed"] for flight in reported] == [1, 2, 3]
    assert [flight["ended"] for flight in reported] == ["time is up", "landed", "landed"]
    assert all(flight["surface"] in ("pad", "deck") and flight["on_pad"] for flight in reported[1:])
    assert changes == [False, True, False, True, False, True, False], "on the ground between two flights, and never in between"
    assert server.world is not first


def test_faults_are_the_seeds_own_and_fit_the_flight() -> None:
    high = msgspec.structs.replace(NEAR, start=Start(height_m=4.0))
    drawn = [faulty(high, seed) for seed in range(80)]
    assert drawn == [faulty(high, seed) for seed in range(80)]
    assert len({scenario.title for scenario in drawn}) >= 20
    assert all(scenario.faults and scenario.because for scenario in drawn)
    assert all(real_time(scenario) for scenario in drawn)
    every = [faulty(high, seed, possible=lambda _: True) for seed in range(300)]
    assert not all(real_time(scenario) for scenario in every)
    assert not {"ship_speed", "ship_turn", "vessel_reports"} & {fault.kind for one in every for fault in one.faults}, "at anchor"
    low = [fault for seed in range(40) for fault in faulty(NEAR, seed).faults]
    assert all(fault.below_height_m is None or fault.below_height_m <= NEAR.start.height_m for fault in low)


def test_a_seed_selects_only_faults_that_the_level_of_perception_represents() -> None:
    """WHY: a soak of modelled perception ended at the first seed whose fault only rendered frames show."""
    seen = {level: kinds_of(perceive(level)) for level in ("pixels", "model", "truth")}
    assert "other_pad" in seen["pixels"]
    assert "other_pad" not in seen["model"] | seen["truth"]
    assert len(seen["truth"]) >= 10
    assert seen["truth"] < seen["model"] < seen["pixels"]


def kinds_of(level: Perception) -> set[str]:
    return {
        fault.kind
        for seed in range(200)
        for fault in faulty(load_scenario("demo"), seed, possible=lambda s: represents(level, s.faults)).faults
    }


@asynccontextmanager
async def first_drone() -> AsyncIterator[ArDroneServer]:
    clock = SystemClock()
    world = PointMass(clock.now(), height_m=1.5, size=(176, 144))
    async with ArDroneServer(cast(World, world), HOST, Ports(0, 0, 0, 0), clock, habits=Habits(FIRST)) as server:
        yield server


def linked(server: ArDroneServer) -> AbstractAsyncContextManager[ArDrone]:
    return open_ardrone(options_for(server.ports, model="1.0"), SystemClock(), decoder=UvlcDecoder())


async def frames(drone: ArDrone, count: int) -> list[Frame]:
    async with asyncio.timeout(PATIENCE_S):
        return [await drone.frames.get() for _ in range(count)]


async def until_down(drone: ArDrone, channel: str) -> str:
    await until(lambda: channel in drone.down)
    return drone.down[channel]


async def test_its_frames_and_samples_arrive() -> None:
    async with first_drone() as server, linked(server) as drone:
        got = await frames(drone, 8)
        config = server.drone.state.config
        assert (config["video:video_codec"], config["video:video_channel"]) == ("32", "1")
        assert all(frame.px.shape == (144, 176, 3) for frame in got)
        numbers = [frame.seq for frame in got]
        assert numbers == sorted(set(numbers))
        assert {frame.stamp.source for frame in got} == {"arrival"}
        assert np.abs(got[0].px.mean() - 120) < 10, "the grey texture, not the sea of the front camera"
        assert drone.counters.frames_before_setup > 0, "until it is configured it sends P264"
        assert drone.counters.video_refused.total() == 0
        kinds = {type(await drone.samples.get()) for _ in range(len(drone.samples))}
        assert kinds >= {Imu, Attitude, BodyVelocity, Range, VehicleStatus}
        assert Baro not in kinds
        assert drone.counters.model_mismatches == 0
        assert drone.counters.config_mismatches == 0


async def test_p264_is_refused_with_the_setting_that_helps() -> None:
    async with first_drone() as server, linked(server) as drone:
        await frames(drone, 2)
        ids = server.drone.state.config.ids
        server.drone.state.config.set("video:video_codec", "64", ids)
        output = await until_down(drone, "video")
        assert "P264" in output
        assert "video:video_codec to 32 (UVLC)" in output
        assert drone.counters.video_refused["inter_picture"] >= 1
        server.drone.state.config.set("video:video_codec", "32", ids)
        assert (await frames(drone, 3))[-1].px.shape == (144, 176, 3), "it goes on by itself"


def test_a_setting_that_requests_p264_is_refused() -> None:
    with pytest.raises(ValueError, match=r"video:video_codec=64 is not decoded \(64 is P264\): leave it out, or use 32"):
        ArDroneOptions(model="1.0", further_configuration="video:video_codec=64")


async def test_the_other_generation_is_named_with_the_setting_that_helps(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    async with first_drone() as server, open_ardrone(options_for(server.ports, model="2.0"), SystemClock()) as drone:
        await until(lambda: drone.counters.model_mismatches > 0)
        await until_down(drone, "video")
    output = [record.getMessage() for record in caplog.records if "firmware" in record.getMessage()]
    assert 'firmware 1.7.4, that of an AR.Drone 1.0, and vehicle.model is "2.0": set vehicle.model = "1.0"' in output[0]


def test_pictures_scatter_in_their_arrival_and_never_overtake_one_another() -> None:
    """WHY: they are stamped by their arrival, and datagrams of one link that are not lost keep their order."""

    def at(seconds: float) -> MonoNs:
        return MonoNs(round(NS_PER_S * seconds))

    options, period_s = ArDroneOptions(model="1.0", arrival_sigma_s=0.02), 1.0 / 30.0
    arriving = ArrivingFrames(FIRST, options, np.random.SeedSequence(7), rendered=False)
    exposed_s = period_s * np.arange(3000)
    px = np.zeros((144, 176, 3), np.uint8)
    frames = [arriving.frame(n, RenderedFrame(px, at(s), 0.01), at(s + 0.15)) for n, s in enumerate(exposed_s.tolist())]
    stamped_s = 1e-9 * np.array([frame.stamp.measured_at for frame in frames])
    assert np.diff(stamped_s).min() > 0.0005
    late_s = stamped_s - exposed_s
    assert 0.015 < late_s.std() < 0.022
    assert all(frame.stamp.measured_at <= frame.stamp.received_at for frame in frames)


@pytest.mark.parametrize(
    ("channel", "shape", "inset"),
    [("0", (240, 320), None), ("1", (144, 176), None), ("2", (240, 320), (72, 88)), ("3", (144, 176), (42, 56))],
)
def test_the_views_of_its_channels(channel: str, shape: tuple[int, int], inset: tuple[int, int] | None) -> None:
    keys = {"video:video_codec": "32", "video:video_channel": channel}
    shot = Shot(np.full((144, 176, 3), 120, np.uint8), Rotation.identity(), 1, 33, 15.0, keys)
    data = UvlcPictures().make(shot).data
    header = UvlcDecoder().header(data)
    assert isinstance(header, CodedPicture)
    px = UvlcDecoder().decode(data, header)
    assert px.shape[:2] == shape
    grey = np.ptp(px[-60:, -60:].reshape(-1, 3).mean(axis=0)) < 10
    assert grey == (channel in "13"), "the bottom's picture is grey, sky and sea are not"
    if inset is not None:
        part = px[2 : inset[0] - 2, 2 : inset[1] - 2].reshape(-1, 3).mean(axis=0)
        assert (np.ptp(part) < 10) == (channel == "2")


def test_it_lands_in_virtual_time_by_decoded_pictures() -> None:
    scenario = load_scenario("ardrone1")
    settings = settings_for(scenario, None)
    assert ardrone_options(settings.vehicle).model == "1.0"
    ending = fly("ardrone1", scenario, 1, settings).as_json()
    assert ending["landed_on_pad"]
    assert ending["touchdown"]["lateral_m"] < 0.2
