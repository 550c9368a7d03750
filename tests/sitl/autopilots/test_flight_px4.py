"""`--autopilot px4` from start to landing.

The program is a stand-in in this process that speaks PX4's simulator interface and its MAVLink, but looks up the state in the
physics instead of estimating it; the child that is started only keeps its place.
"""

import asyncio
import os
import stat
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest
from msgspec.structs import replace

from companion.base.mission import FlightOutcome
from companion.settings.load import load as load_settings
from drivers.endpoint import parse_endpoint
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import LinkOptions, Links, open_links
from sitl.emulators.autopilots import px4
from sitl.emulators.autopilots.flight import AutopilotFlight, AutopilotProgram
from sitl.emulators.autopilots.stand_in.px4 import Px4StandIn
from sitl.flight.one_flight import settings_for
from sitl.perception.levels import perceive
from sitl.scenario.scenario import load

HOST = "127.0.0.1"
REAL = os.environ.get("DECKLANDER_PX4", "")


class Px4(Px4StandIn):
    """The stand-in behind PX4's simulator interface."""

    def __init__(self, flight: AutopilotFlight) -> None:
        super().__init__(flight.clock, dict(flight.autopilot.parameters))
        self._flight = flight

    def controls(self) -> Message:
        """Return the motors for the state as it is."""
        assert self._flight.body is not None
        motors = self.step(self._flight.body.state())
        return mav.MAVLink_hil_actuator_controls_message(0, [*motors, *[0.0] * 12], 129 if self.armed else 1, 0)

    @asynccontextmanager
    async def on_both(self) -> AsyncIterator[Links]:
        options = [LinkOptions(parse_endpoint(f"udpout://{HOST}:{port}")) for port in px4.MAVLINK_PORTS]
        async with open_links(options, self.clock, (1, 1)) as self.links, asyncio.TaskGroup() as group:
            tasks = [group.create_task(self._live()), group.create_task(self._read(self.links))]
            try:
                yield self.links
            finally:
                for task in tasks:
                    task.cancel()


async def until_closed(reader: asyncio.StreamReader) -> AsyncIterator[bytes]:
    """Yield the messages of the physics. A stream that closes before its answer arrives ends in a reset."""
    with suppress(ConnectionResetError):
        while data := await reader.read(4096):
            yield data


async def pretend(flight: AutopilotFlight) -> None:
    """PX4's side of the lock step, until the physics closes."""
    for _ in range(500):
        try:
            reader, writer = await asyncio.open_connection(HOST, px4.PHYSICS_PORT)
            break
        except OSError:
            await asyncio.sleep(0.02)
    codec, program = Codec(1, 1), Px4(flight)
    async with program.on_both():
        async for data in until_closed(reader):
            for message in codec.feed(data):
                if message.get_type() == "HIL_SENSOR":
                    await flight.clock.settle()
                    writer.write(codec.pack(program.controls()))
    writer.close()


def build(folder: Path) -> Path:
    """Return a folder as a PX4 build leaves it."""
    binary = folder / "bin" / "px4"
    binary.parent.mkdir()
    binary.write_text('#!/bin/sh\nprintenv > environment; echo "$@" > arguments; exec sleep 600\n')
    binary.chmod(binary.stat().st_mode | stat.S_IXUSR)
    (folder / "etc" / "init.d-posix").mkdir(parents=True)
    (folder / "etc" / "init.d-posix" / "rcS").write_text("")
    return binary


@pytest.mark.timeout(400)
async def test_armed_taken_off_and_landed_on_the_pad_by_offboard_velocities(tmp_path: Path) -> None:
    scenario = load("calm")
    scenario = replace(scenario, start=replace(scenario.start, height_m=2.0), duration_limit_s=40.0)
    folder = tmp_path / "flight"
    folder.mkdir()
    autopilot = AutopilotProgram("px4", build(tmp_path), parameters=(("MPC_XY_VEL_MAX", 3.0),))
    flight = AutopilotFlight(
        scenario, 1, load_settings("sim", by_autopilot=True), autopilot, folder, perception=perceive("model")
    )
    async with asyncio.timeout(380), asyncio.TaskGroup() as group:
        standin = group.create_task(pretend(flight))
        end = await flight.fly()
        await standin
    assert end.failure == ""
    assert end.outcome is FlightOutcome.LANDED
    assert end.landing is not None
    assert end.landing.on_pad
    assert end.landing.vertical_speed_m_s < 0.8
    assert any("Decklander: down" in text for _, _, text in end.texts)
    environment = (folder / "environment").read_text()
    assert "PX4_SIM_HOSTNAME=127.0.0.1" in environment
    assert "PX4_PARAM_MPC_XY_VEL_MAX=3" in environment
    assert "PX4_PARAM_MIS_TAKEOFF_ALT=2" in environment
    assert str(tmp_path / "etc") in (folder / "arguments").read_text()


@pytest.mark.skipif(not REAL, reason="DECKLANDER_PX4 does not name a PX4 program")
@pytest.mark.timeout(600)
async def test_a_real_program_is_landed_on_the_pad_of_a_ship_under_way(tmp_path: Path) -> None:
    scenario = load("moderate")
    autopilot = AutopilotProgram("px4", Path(REAL))
    flight = AutopilotFlight(
        scenario, 21, settings_for(scenario, None, by_autopilot=True), autopilot, tmp_path, perception=perceive("pixels")
    )
    end = await flight.fly()
    assert end.failure == ""
    assert end.outcome is FlightOutcome.LANDED
    assert end.landing is not None
    assert end.landing.on_pad
    assert end.failsafes == ()
