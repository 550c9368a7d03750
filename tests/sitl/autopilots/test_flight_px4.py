"""`--autopilot px4` from start to landing.

The program is a stand-in in this process that speaks PX4's simulator interface and its MAVLink, but looks up the state in the
physics instead of estimating it; the child that is started only keeps its place.
"""

from __future__ import annotations

import asyncio
import stat
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from companion.config.settings import load as load_settings
from companion.runtime.pilot import FlightOutcome
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.endpoint import parse_endpoint
from drivers.mavlink.links import LinkOptions, Links, ReceivedMessage, open_links
from drivers.mavlink.vehicle import Stack
from estimator.contracts.errors import BadInput
from sitl.airframe import Airframe
from sitl.autopilots import px4
from sitl.autopilots.body import Body
from sitl.autopilots.flight import AutopilotFlight, AutopilotProgram
from sitl.scenario import load
from sitl.testing.fake_autopilot import FakeAutopilot
from tests.sitl.autopilots.pilot import Cascade

HOST = "127.0.0.1"


class Px4(FakeAutopilot):
    """Flies the body of the physics: AUTO.TAKEOFF and OFFBOARD velocities."""

    def __init__(self, flight: AutopilotFlight) -> None:
        super().__init__(Stack.PX4, system=1, mode="auto.loiter", armed=False, landed_state=1, clock=flight.clock)
        self._flight = flight
        self._cascade = Cascade(Airframe(), 0.0, px4.STEP_S, most_m_s2=1.5)
        self._hold: Any = None
        self._wanted = np.zeros(3)
        self._home: Any = None
        self.rpy = lambda t: self._body.state().R_ned_body.rpy_rad

    @property
    def _body(self) -> Body:
        assert self._flight.body is not None
        return self._flight.body

    def _on_message(self, received: ReceivedMessage) -> None:
        """What is meant for another component goes on to the other link, as PX4 forwards it."""
        assert self.links is not None
        m = received.message
        if getattr(m, "target_component", 0) != 1 and m.get_type() != "TIMESYNC":
            wire = self.links.all[1 - received.link]._wire
            if wire is not None:
                wire.send(bytes(m.get_msgbuf()), None)
        super()._on_message(received)

    def _on_set_position_target_local_ned(self, m: Message, received: ReceivedMessage) -> None:
        super()._on_set_position_target_local_ned(m, received)
        if self.mode == "offboard":
            self._wanted = np.array([m.vx, m.vy, m.vz])

    def _streams(self, t: float) -> list[Message]:
        s = self._body.state()
        self._home = s.p_ned if self._home is None else self._home
        self.p_ned, self.v_ned = s.p_ned - self._home, s.v_ned
        out = [m for m in super()._streams(t) if m.get_type() != "HIGHRES_IMU"]
        if t >= self._next.get(-1, 0.0):
            self._next[-1] = t + 0.01
            readings = (*map(float, s.f_body), *map(float, s.w_body), 0, 0, 0, 1000.0, 0, 0, 20.0, 0b111111)
            out.append(mav.MAVLink_highres_imu_message(self.boot_ns // 1000, *readings))
        return out

    def controls(self) -> Message:
        """The motors for the state as it is."""
        s = self._body.state()
        if self._body.landing() is not None and self.landed_state == 2:
            self.landed_state, self.armed = 1, False
        if self.mode == "offboard" and self.now_s - self.setpoints[-1][0] > px4.PARAMETERS["COM_OF_LOSS_T"]:
            self.set_mode("auto.loiter")  # COM_OBL_RC_ACT 5: hold
            self._wanted = np.zeros(3)
        motors = (0.0, 0.0, 0.0, 0.0)
        if self.armed and self.landed_state == 2:
            wanted = self._wanted
            if self.mode == "auto.takeoff":
                wanted = np.array([0.0, 0.0, max(-1.0, -(2.0 + self.p_ned[2]))])
            hold = s.p_ned if self._hold is None else self._hold
            self._hold = s.p_ned + np.clip(hold + wanted * px4.STEP_S - s.p_ned, -0.2, 0.2)
            motors = self._cascade.motors(s.p_ned, s.v_ned, s.R_ned_body, s.w_body, self._hold, wanted)
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
    """What the physics sends; closed while an answer is still on its way, the stream ends in a reset."""
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
    """A folder as a PX4 build leaves it."""
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
    flight = AutopilotFlight(scenario, 1, load_settings("sim"), autopilot, folder)
    async with asyncio.timeout(380), asyncio.TaskGroup() as group:
        standin = group.create_task(pretend(flight))
        end = await flight.fly()
        await standin
    assert end.failure == ""
    assert end.outcome is FlightOutcome.LANDED
    assert end.landing is not None
    assert end.landing.on_pad
    assert end.landing.speed_m_s < 0.8
    assert any("Decklander: down" in text for _, _, text in end.texts)
    environment = (folder / "environment").read_text()
    assert "PX4_SIM_HOSTNAME=127.0.0.1" in environment
    assert "PX4_PARAM_MPC_XY_VEL_MAX=3" in environment
    assert "PX4_PARAM_MIS_TAKEOFF_ALT=2" in environment
    assert str(tmp_path / "etc") in (folder / "arguments").read_text()


def test_a_build_without_its_start_up_files_is_refused(tmp_path: Path) -> None:
    binary = build(tmp_path)
    (tmp_path / "etc" / "init.d-posix" / "rcS").unlink()
    with pytest.raises(BadInput, match="rcS"):
        px4.start(binary, height_m=2.0)
