"""`simulate --autopilot` from start to landing on a stand-in program, and on a real one where the environment names it."""

import asyncio
import itertools
import json
import os
import signal
import stat
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest
from msgspec.structs import replace

from companion.base.mission import FlightOutcome
from companion.cli.main import main
from companion.facts.records import TruthRecord
from companion.recording.reading import open_recording
from drivers.endpoint import parse_endpoint
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import LinkOptions, Links, open_links
from sitl.emulators.autopilots.flight import AutopilotFlight, AutopilotProgram
from sitl.emulators.autopilots.programs import px4
from sitl.emulators.autopilots.stand_in.px4 import Px4StandIn
from sitl.perception.levels import perceive
from sitl.scenario.scenario import load
from sitl.scenario.settings import settings_for
from tests.fly import NEAR, land
from tests.support.processes import gone, started
from tests.support.waiting import wait_until

ROOT = Path(__file__).parents[3]
STAND_IN = f'PYTHONPATH={ROOT} exec {sys.executable} -m tests.sitl.autopilots.stand_in "$@"'
REAL = os.environ.get("DECKLANDER_ARDUCOPTER", "")


def program(folder: Path, body: str) -> str:
    """Return a program that can be run, as a shell script."""
    path = folder / "arducopter"
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


@pytest.fixture
def near(tmp_path: Path) -> str:
    path = tmp_path / "near.toml"
    path.write_text(NEAR)
    return str(path)


def simulate(*words: str) -> int:
    return main(["simulate", *words, "--autopilot", "arducopter"])


@pytest.mark.timeout(400)
def test_a_stand_in_arms_takes_off_and_is_landed_on_the_pad_and_its_recording_replays_to_the_bit(tmp_path, near, capsys):
    kept, record, page = tmp_path / "kept", str(tmp_path / "flight.mcap"), tmp_path / "report"
    words = ["--keep", str(kept), "--param", "LAND_SPEED=40", "--perception", "model", "--record", record, "--report", str(page)]
    code = simulate(near, "--seed", "2", "--binary", program(tmp_path, STAND_IN), "--json", *words)
    reported = json.loads(capsys.readouterr().out)
    assert code == 0, (reported["because"], reported["unsafe"], (kept / "texts.txt").read_text()[-500:])
    assert reported["landed_on_pad"]
    assert reported["outcome"] == "landed"
    assert reported.keys() >= land(load(near), level="truth").as_json().keys(), "judged as every flight is"
    assert (reported["grade"], reported["unsafe"], reported["standing"]["on_pad"]) == ("on pad", [], True)
    assert reported["referee"]["into_deck_m_s"][0] > 0.0
    assert reported["touchdown"]["lateral_m"] < 0.15
    assert reported["touchdown"]["vertical_speed_m_s"] < 0.8
    assert reported["frames"]["fused"] > 100
    assert reported["touchdown"]["yaw_deg"] == pytest.approx(0.0, abs=5.0), "along the arrow, from 20 degrees off"
    texts = (kept / "texts.txt").read_text()
    assert "Arm: Need Position Estimate" in texts, "asked again until it armed"
    assert "Decklander: down" in texts
    asked = (kept / "decklander.parm").read_text()
    assert "PLND_LAG 0.05\n" in asked
    assert "LAND_SPEED 40\n" in asked
    truths = [event for event in open_recording([Path(record)]).events() if isinstance(event, TruthRecord)]
    assert max(b.at_ns - a.at_ns for a, b in itertools.pairwise(truths)) <= 24_000_000
    contact = truths[-1].touchdown
    assert contact.lateral_m == pytest.approx(reported["touchdown"]["lateral_m"], abs=1e-4)
    assert truths[-1].phase == "landed"
    assert main(["replay", record, "--json"]) == 0
    (ekf,) = (row for row in json.loads(capsys.readouterr().out)["against"]["the recording"] if row["path"] == "ekf")
    assert ekf["both"] > 300
    assert ekf["identical"] == ekf["both"]
    assert "Touchdown and trajectory" in (page / "index.html").read_text()


@pytest.mark.skipif(not REAL, reason="DECKLANDER_ARDUCOPTER does not name an ArduCopter program")
@pytest.mark.timeout(600)
@pytest.mark.parametrize("physics", ["ours", "own"])
def test_a_real_program_is_landed_on_the_pad(near: str, physics: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert simulate(near, "--binary", REAL, "--physics", physics, "--json") == 0
    assert json.loads(capsys.readouterr().out)["touchdown"]["lateral_m"] < 0.15


@pytest.mark.timeout(400)
def test_a_vehicle_of_the_programs_own_meets_our_deck_on_a_ship_under_way(tmp_path, near, capsys):
    words = ["--binary", program(tmp_path, STAND_IN), "--physics", "own", "--perception", "model", "--json"]
    assert simulate(near, "--seed", "2", "--set", "vessel.moored=false", "--set", "vessel.speed_m_s=0.8", *words) == 0
    reported = json.loads(capsys.readouterr().out)
    (contact,) = reported["contacts"]
    assert 0.0 < reported["tracking_m"] < 0.2
    assert contact["lateral_m"] < 0.15
    assert contact["vertical_speed_m_s"] == pytest.approx(0.4, abs=0.25)
    assert contact["phase"] in ("commit", "press")


def test_a_program_that_never_steps_leaves_no_recording(tmp_path: Path, near: str, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "flight.mcap"
    for before in (None, b"an older one"):
        if before is not None:
            kept.write_bytes(before)
        assert simulate(near, "--binary", program(tmp_path, "exit 1"), "--record", str(kept), "--force") == 1
        assert "ended with code 1" in capsys.readouterr().err
        assert (kept.read_bytes() if kept.exists() else None) == before


def test_sigterm_leaves_neither_program_nor_folder(tmp_path: Path, near: str) -> None:
    begun, folders = tmp_path / "begun", tmp_path / "folders"
    folders.mkdir()
    binary = program(tmp_path, f"echo $$ > {begun}.new; mv {begun}.new {begun}; exec sleep 60")
    words = [sys.executable, "-m", "companion.cli.main", "simulate", near, "--autopilot", "arducopter", "--binary", binary]
    with started(words, env=os.environ | {"TMPDIR": str(folders)}) as process:
        wait_until(begun.exists)
        assert list(folders.iterdir())
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 143
        assert gone(int(begun.read_text()))
    assert list(folders.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--physics", "own"], "go with --binary PATH, a program"),
        (["--vehicle", "octa"], "--vehicle: there is no file 'octa'"),
        (["--vehicle", "hexa_7kg", "--set", "vehicle.file=hexa_7kg"], "give one of them"),
        (["--vehicle", "hexa_7kg", "--binary", "/bin/sh"], "--binary flies four rotors in an X"),
        (["--binary", __file__], "is no program that can be run"),
        (["--binary", "/bin/sh", "--record", "/dev/null"], "--record /dev/null: the name of a recording must end in .mcap"),
        (["--binary", "/bin/sh", "--follow", "udpin://127.0.0.1:0"], "does not go with"),
        (["--binary", "/bin/sh", "--keep", "/dev/null"], "--keep /dev/null: Not a directory"),
        (["--binary", "/bin/sh", "--param", "PLND_LAG=nan"], "--param PLND_LAG needs a number"),
        (["--binary", "/bin/sh", "--autopilot", "px4"], "rcS"),
    ],
)
def test_wrong_use_is_one_line(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "calm", "--autopilot", "arducopter", *words]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1


HOST = "127.0.0.1"
REAL_PX4 = os.environ.get("DECKLANDER_PX4", "")


class Px4(Px4StandIn):
    """The stand-in behind PX4's simulator interface."""

    def __init__(self, flight: AutopilotFlight) -> None:
        super().__init__(flight.clock, dict(flight.autopilot.parameters))
        self._flight = flight

    def controls(self) -> Message:
        """Return the motors for the state as it is."""
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
        scenario, 1, settings_for(scenario, None, by_autopilot=True), autopilot, folder, perception=perceive("model")
    )
    async with asyncio.timeout(380), asyncio.TaskGroup() as group:
        standin = group.create_task(pretend(flight))
        end = await flight.flown()
        await standin
    assert end.failure == ""
    assert end.ending.outcome is FlightOutcome.LANDED
    assert end.ending.contact.on_pad
    assert end.ending.contact.vertical_speed_m_s < 0.8
    assert any("Decklander: down" in text for _, _, text in end.texts)
    environment = (folder / "environment").read_text()
    assert "PX4_SIM_HOSTNAME=127.0.0.1" in environment
    assert "PX4_PARAM_MPC_XY_VEL_MAX=3" in environment
    assert "PX4_PARAM_MIS_TAKEOFF_ALT=2" in environment
    assert str(tmp_path / "etc") in (folder / "arguments").read_text()


@pytest.mark.skipif(not REAL_PX4, reason="DECKLANDER_PX4 does not name a PX4 program")
@pytest.mark.timeout(600)
async def test_a_real_program_is_landed_on_the_pad_of_a_ship_under_way(tmp_path: Path) -> None:
    scenario = load("moderate")
    autopilot = AutopilotProgram("px4", Path(REAL_PX4))
    flight = AutopilotFlight(
        scenario, 21, settings_for(scenario, None, by_autopilot=True), autopilot, tmp_path, perception=perceive("pixels")
    )
    end = await flight.flown()
    assert end.failure == ""
    assert end.ending.outcome is FlightOutcome.LANDED
    assert end.ending.contact.on_pad
    assert end.failsafes == ()
