"""Our driver on one end, the simulated drone on the other, sockets between them."""

import asyncio
from typing import cast

import numpy as np
import pytest

from drivers.ardrone.link import ArDrone, open_ardrone
from drivers.ardrone.options import ArDroneOptions
from drivers.clock import SystemClock
from estimator.contracts.commands import Land, TakeOff, Velocity
from estimator.contracts.samples import Attitude, BodyVelocity, Imu, Range, VehicleStatus
from estimator.contracts.time import MonoNs, seconds_between
from sitl.emulators.ardrone.server import ArDroneServer, Ports
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.world import World
from tests.sitl.ardrone.point_mass import PointMass
from tests.support.waiting import until

HOST = "127.0.0.1"


def options_for(server: ArDroneServer) -> ArDroneOptions:
    p = server.ports
    return ArDroneOptions(host=HOST, navdata_port=p.navdata, video_port=p.video, at_port=p.at, control_port=p.control)


async def reach(world: PointMass, phase: VehiclePhase) -> None:
    await until(lambda: world.phase is phase)


async def ready(drone: ArDrone) -> None:
    await until(lambda: drone.ready)


async def test_it_configures_flies_and_lands_the_drone() -> None:
    clock = SystemClock()
    begun = clock.now()
    world = PointMass(begun)
    async with ArDroneServer(cast(World, world), HOST, Ports(0, 0, 0, 0), clock) as server:
        options = options_for(server)
        async with open_ardrone(options, clock) as drone:
            await ready(drone)
            config = server.drone.state.config
            assert (config.ids.session, config.ids.user, config.ids.application) == options.ids
            assert config["video:video_channel"] == "1"
            assert not config.flag("general:navdata_demo")
            assert world.limits.euler_angle_max_rad == pytest.approx(options.euler_angle_max_rad, abs=1e-6)
            drone.command(TakeOff())
            await reach(world, VehiclePhase.HOVERING)
            for _ in range(3000):  # as long as a busy machine takes; it comes nowhere near without a loop that closes
                drone.command(Velocity(np.array([0.5, 0.0, 0.0]), 0.0))
                await asyncio.sleep(0.02)
                if world.v[0] > 0.35:
                    break
            assert world.v[0] > 0.35
            assert abs(world.v[1]) < 0.05
            kinds = {type(await drone.samples.get()) for _ in range(len(drone.samples))}
            assert kinds >= {Imu, Attitude, BodyVelocity, Range, VehicleStatus}
            drone.command(Land())
            await reach(world, VehiclePhase.LANDED)
        reported = server.drone.state.counters
        assert {name for name in reported if name.startswith("config_")} <= {"config_set", "config_during_ack"}
        # A key whose acknowledgement a busy machine brings late is sent again, and meets it.
        assert reported["config_during_ack"] <= reported["config_set"] - drone.counters.config_acknowledged
        # 50 ms without a command, as a busy machine may have it; a stream that is too slow has it some ten times a second.
        assert reported["com_watchdog"] <= 3 + 2.0 * seconds_between(begun, clock.now())


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
        async with open_ardrone(options_for(server), clock) as drone:
            await ready(drone)
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
