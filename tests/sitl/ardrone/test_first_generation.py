"""The simulated AR.Drone 1.0 over real sockets: what our driver makes of it, and what it says of another codec or setting."""

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import cast

import numpy as np
import pytest

from companion.settings.model import ardrone_options
from drivers.ardrone.link import ArDrone, open_ardrone
from drivers.ardrone.options import ArDroneOptions
from drivers.clock import SystemClock
from estimator.contracts.geometry import Rotation
from estimator.contracts.pictures import CodedPicture
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Frame, Imu, Range, VehicleStatus
from estimator.contracts.time import NS_PER_S, MonoNs
from estimator.uvlc import UvlcDecoder
from sitl.ardrone.generations import FIRST
from sitl.ardrone.uvlc import ArrivingFrames
from sitl.emulators.ardrone.server import ArDroneServer, Habits, Ports
from sitl.emulators.ardrone.wire_pictures import Shot, UvlcPictures
from sitl.flight.one_flight import fly, settings_for
from sitl.scenario.scenario import load as load_scenario
from sitl.world.truth import RenderedFrame
from sitl.world.world import World
from tests.sitl.ardrone.peer import options_for
from tests.sitl.ardrone.point_mass import PointMass
from tests.support.waiting import PATIENCE_S, until

HOST = "127.0.0.1"


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
    async with (
        first_drone() as server,
        linked(server) as drone,
    ):
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
    async with (
        first_drone() as server,
        linked(server) as drone,
    ):
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
    assert output
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
    assert isinstance(px, np.ndarray)
    assert px.shape[:2] == shape
    grey = np.ptp(px[-60:, -60:].reshape(-1, 3).mean(axis=0)) < 10
    assert grey == (channel in "13"), "the bottom's picture is grey, sky and sea are not"
    if inset is not None:
        part = px[2 : inset[0] - 2, 2 : inset[1] - 2].reshape(-1, 3).mean(axis=0)
        assert (np.ptp(part) < 10) == (channel == "2")


def test_it_lands_in_virtual_time_by_decoded_pictures() -> None:
    scenario = load_scenario("ardrone1")
    settings = settings_for(scenario, None)
    assert ardrone_options(settings).model == "1.0"
    ending = fly("ardrone1", scenario, 1, settings).as_json()
    assert ending["landed_on_pad"]
    assert ending["touchdown"]["lateral_m"] < 0.2
