"""The guides as scripts: the commands of a page in its order, by the real command line, and flights in virtual time.

Orders reach a daemon with a simulated vehicle through the service's own socket; settings are checked by `run --check`. A command
that needs a device, a network or real time stands in `ELSEWHERE` with the test that runs it.
"""

import argparse
import asyncio
import importlib
import os
import re
import shlex
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, nullcontext
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from msgspec import Struct

from companion.base.containment import RESTART
from companion.cli.commands import COMMANDS
from companion.cli.main import main
from companion.parts.operator.client import socket_path
from companion.parts.operator.local_socket import OperatorSocket
from companion.service.daemon import Daemon, DaemonSetup
from companion.settings.load import from_mapping, load
from estimator.contracts.commands import Command, CutMotors, Land, Lean, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import Stamp, after
from estimator.vision.pad.pad import Pad
from tests.companion import calibration_flights
from tests.companion.virtual_flight import TICK_S, FakeFlight, SeeingPilot, VirtualClock, settled
from tests.support.processes import ran

ROOT = Path(__file__).parents[2]
ELSEWHERE = {
    "demo": "tests/companion/test_cli.py",
    "doctor": "tests/companion/doctor/test_gather.py",
    "fly": "tests/companion/operator/test_local_socket.py",
    "gamepad show": "tests/companion/operator/test_gamepad_part.py",
    "calibrate camera": "tests/companion/test_calibrate.py",
}
"""Beginnings of commands that are not run here, and the test that runs each."""
_BASE = '[vehicle]\nkind = "ardrone"\n[camera]\nfile = "ardrone2_bottom"\n[pad]\nfile = "thesis"\n'
_HOVER_M, _LIMIT_S = 2.5, 60.0


class Drone(FakeFlight):
    """A point mass that takes off, lands, and stands on the pad's surface."""

    def __init__(self, clock: VirtualClock) -> None:
        super().__init__(clock)
        self.p_level = np.array([-0.1, 0.1, 0.0])
        self.mode, self.cut, self._now = "landed", False, clock.now

    @property
    def flying(self) -> bool:
        return self.mode != "landed"

    def command(self, command: Command) -> None:
        super().command(command)
        match command:
            case TakeOff() if not self.flying and not self.cut:
                self.mode = "taking_off"
            case Land() if self.flying:
                self.mode = "landing"
            case CutMotors():
                self.mode, self.cut = "landed", True
            case LeaveEmergency():
                self.cut = False
            case Lean(v_level=v) | Velocity(v_level=v) if self.mode in ("flying", "hovering", "landing"):
                self.mode, self._v_level = "flying", np.asarray(v)
            case _ if self.mode in ("flying", "landing"):
                self.mode = "hovering"

    def tick(self, n: int) -> None:
        if self.mode == "taking_off":
            self._v_level = np.array([0.0, 0.0, -1.0])
            if self.p_level[2] < -_HOVER_M:
                self.mode, self._v_level = "hovering", np.zeros(3)
        elif self.mode == "landing":
            self._v_level = np.array([0.0, 0.0, 0.4])
        if not self.flying:
            self._v_level = np.zeros(3)
        super().tick(n)
        self.push_up_m_s2 /= 2.0
        if self.p_level[2] > 0.0:
            self.push_up_m_s2 += self._v_level[2] / TICK_S / 2.0
            self.p_level[2], self._v_level = 0.0, np.zeros(3)
            self.mode = "landed" if self.mode == "landing" else self.mode

    def status(self, stamp: Stamp) -> VehicleStatus:
        return VehicleStatus(stamp, self.flying, self.mode, 0.8, self.cut, True)


class Service:
    """The daemon of a page's settings around the drone; time passes while an order is under way, and until its effect."""

    def __init__(self, config: str) -> None:
        path = socket_path(load(config))
        assert path is not None
        self.clock = VirtualClock()
        self.drone = Drone(self.clock)
        pilot = SeeingPilot(self.drone)
        served = OperatorSocket(path, pilot, self.clock)
        setup = DaemonSetup(RESTART, 50.0)
        self.daemon = Daemon(self.drone.open, pilot, self.clock, setup, observers=[served], extras={"operator": served.run})
        self._ticks = 0

    async def tick(self) -> None:
        await self.clock.pass_to(after(self.clock.now(), TICK_S))
        self.drone.tick(self._ticks)
        self._ticks += 1
        await settled()
        while self.daemon.health.frames.total() < self.drone.frames.offered:  # noqa: ASYNC110 (the thread of vision)
            await asyncio.sleep(0)

    async def order(self, words: list[str]) -> int:
        """Return the exit code of the command line, which runs in a thread as in another terminal, a second after the last."""
        for _ in range(round(1.0 / TICK_S)):
            await self.tick()
        giving = asyncio.create_task(asyncio.to_thread(main, words))
        while not giving.done():
            await self.tick()
        return giving.result()

    async def until(self, flying: bool) -> None:
        for _ in range(round(_LIMIT_S / TICK_S)):
            if self.drone.flying is flying:
                return
            await self.tick()
        raise AssertionError(f"{self.drone.mode} after {_LIMIT_S} s, at {self.drone.p_level}")


@asynccontextmanager
async def serve_guide(config: str) -> AsyncIterator[Service]:
    service = Service(config)
    with patch("companion.service.daemon.no_full_collections", nullcontext):
        task = asyncio.create_task(service.daemon.run())
        for _ in range(50):
            await service.tick()
        yield service
        service.daemon.stop()
        while not task.done():
            await service.clock.pass_to(after(service.clock.now(), TICK_S))
            await asyncio.sleep(0.001)
        await task


def commands_of(page: str, begin: str = "", end: str = "\0") -> Iterator[list[str]]:
    """Yield the words of every command line of a page's part, in order."""
    text = (ROOT / f"docs/{page}.md").read_text().partition(begin)[2] if begin else (ROOT / f"docs/{page}.md").read_text()
    for line in text.partition(end)[0].splitlines():
        found = re.match(r"(?: {3,}|)decklander ([^#|>&;`]*)", line)
        if found is not None:
            yield shlex.split(re.split(r" {2,}", found[1])[0])


def elsewhere(words: list[str]) -> bool:
    line = " ".join(words)
    return any(line == known if known == "fly" else line.startswith(known) for known in ELSEWHERE)


@pytest.fixture
def reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield the folder of a reader who has copied the profiles, with sockets of its own."""
    for profile in ("sim", "ardrone2", "raspberry_ardupilot", "raspberry_px4"):
        (tmp_path / f"{profile}.toml").write_bytes((ROOT / f"configs/{profile}.toml").read_bytes())
    for copied in ("my-drone", "rig"):
        (tmp_path / f"{copied}.toml").write_bytes((ROOT / "configs/raspberry_ardupilot.toml").read_bytes())
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    with tempfile.TemporaryDirectory(prefix="fly") as sockets:
        monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
        monkeypatch.setenv("XDG_RUNTIME_DIR", sockets)
        monkeypatch.setattr(tempfile, "tempdir", sockets)
        yield tmp_path


@pytest.mark.parametrize(
    ("page", "end", "flown"),
    [
        ("ardupilot", "\0", [("begin", True), ("takeoff", False)]),
        ("px4", "\0", [("takeoff", False), ("begin", True)]),
        (
            "operator",
            "## Flying by the keyboard",
            [
                *(("takeoff", False), ("begin", False), ("stay", False), ("hold", False), ("abort", False)),
                *(("land", True), ("status", True), ("emergency", True), ("reset", True)),
            ],
        ),
    ],
)
async def test_the_orders_of_a_guide_fly_and_land(page: str, end: str, flown: list[tuple[str, bool]], reader: Path) -> None:
    """`flown`: the orders in the page's order, and whether the drone stands at the end of each."""
    todo = [words for words in commands_of(page, end=end) if not elsewhere(words)]
    orders = [words for words in todo if words[0] == "fly"]
    for words in todo:
        if words[0] != "fly" and words[-2:] != ["--config", "my-drone.toml"]:
            assert await asyncio.to_thread(main, words) == 0, words
    assert [words[1] for words in orders] == [order for order, _ in flown]
    async with serve_guide("my-drone.toml" if page == "ardupilot" else "raspberry_px4") as service:
        if flown[0][0] == "begin":
            await service.order(["fly", "takeoff", "--wait", "20"])  # by hand, as the page says
        for words, (order, stands) in zip(orders, flown, strict=True):
            assert await service.order(words) == 0, order
            if page != "operator" or order in ("takeoff", "land"):
                await service.until(not stands)
            assert service.drone.flying is not stands, order
            if order == "begin" and stands:
                assert np.hypot(*service.drone.p_level[:2]) < 0.1, "on the pad"


@pytest.mark.parametrize("page", ["page", "operator"])
def test_the_settings_of_a_guide_are_taken_with_the_files_that_it_makes(page: str, reader: Path) -> None:
    text = (ROOT / f"docs/{page}.md").read_text()
    for block in re.findall(r"(?:^    .+\n)+", text, re.MULTILINE):
        body = re.sub(r"^    ", "", block, flags=re.MULTILINE).strip()
        if body.startswith("["):
            (reader / "rig.toml").write_text(f"{_BASE}\n{body}\n")
            assert main(["run", "--config", "rig.toml", "--check"]) == 0, body
        elif body.startswith("openssl"):
            subprocess.run(["sh", "-ec", body], cwd=reader, check=True, capture_output=True)
        elif body.startswith("decklander keys"):
            assert main(shlex.split(body.partition("#")[0])[1:]) == 0
        elif body.startswith("decklander gamepad list"):
            assert main(["gamepad", "list"]) in (0, 1), "1: nothing is plugged in"


def test_the_calibrations_of_a_flight_run(reader: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = load("sim")
    (reader / "my_rig.toml").write_bytes((ROOT / "configs/sim.toml").read_bytes())
    flight = calibration_flights.flight(5, np.radians([1.5, -1.0, 2.0]), 0.03, seconds=40.0)
    calibration_flights.record(reader / "flight.mcap", flight, settings)
    todo = [words for words in commands_of("cameras", "## Print the board") if not elsewhere(words)]
    codes = {words[1] if words[0] == "calibrate" else words[0]: main(words) for words in todo}
    printed = capsys.readouterr().err
    assert codes == {"pad": 0, "mount": 0, "delay": 0, "readout": 2, "vehicle": 2}
    assert "images" in printed, "the page says that readout needs them"


PAGES = [*sorted(ROOT.glob("docs/**/*.md")), *(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY"))]


class Snippet(Struct, frozen=True):
    page: str
    line: int
    kind: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def snippets() -> list[Snippet]:
    found = []
    for page in PAGES:
        text = page.read_text()
        for block in re.finditer(r"^( *)```([^\n]*)\n(.*?)^\1```$", text, re.MULTILINE | re.DOTALL):
            indent = len(block[1])
            body = "".join(line[indent:] or "\n" for line in block[3].splitlines(keepends=True))
            found.append(Snippet(page.name, text.count("\n", 0, block.start()) + 1, block[2].strip(), body))
    return found


def of_kind(start: str) -> list[Snippet]:
    return [s for s in snippets() if s.kind.startswith(start)]


def command_lines() -> list[tuple[str, list[str]]]:
    """Return every line of any page that begins with the command, in a block or indented by four."""
    found = []
    for page in PAGES:
        for number, line in enumerate(page.read_text().splitlines(), 1):
            output = re.match(r"^(?: {3,}|)(?:\.venv/bin/)?(decklander [^|>&#;`]*)", line)
            if output is not None and "SOURCE..." not in line:
                typed = re.sub(r"\[[^\]]*\]", "", re.split(r" {2,}", output[1])[0]).strip(" \\")
                words = [word for word in shlex.split(typed)[1:] if word != "..."]
                if words:
                    found.append((f"{page.name}:{number}", words))
    return found


@pytest.mark.parametrize(("where", "words"), command_lines(), ids=lambda value: value if isinstance(value, str) else "")
def test_command_lines_parse(where: str, words: list[str]) -> None:
    assert words[0] in COMMANDS, where
    parser = argparse.ArgumentParser(prog="decklander", exit_on_error=False, allow_abbrev=False)
    importlib.import_module(COMMANDS[words[0]].module).add_arguments(parser)
    try:
        parser.parse_args(words[1:])
    except (SystemExit, argparse.ArgumentError) as why:
        pytest.fail(f"{where}: decklander {' '.join(words)}: {why}")


@pytest.mark.parametrize("snippet", of_kind("sh run"), ids=str)
def test_shell_snippets_run(snippet: Snippet, tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/decklander").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m companion.cli.main "$@"\n')
    (tmp_path / "bin/decklander").chmod(0o755)
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    path = f"{tmp_path / 'bin'}:{os.environ['PATH']}"
    done = ran("sh", "-e", "-c", snippet.text, cwd=tmp_path, PATH=path)
    wanted = re.search(r"exit=(\d+)", snippet.kind)
    assert done.returncode == (int(wanted[1]) if wanted else 0), done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("snippet", of_kind("python run"), ids=str)
def test_python_snippets_run(snippet: Snippet, tmp_path: Path) -> None:
    done = ran(sys.executable, "-W", "error", "-c", snippet.text, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("snippet", of_kind("toml"), ids=str)
def test_settings_in_the_docs_are_good(snippet: Snippet) -> None:
    data = tomllib.loads(snippet.text)
    if snippet.kind == "toml pad":
        assert Pad.from_mapping(data, str(snippet)).disc_radius_m > 0
    else:
        assert snippet.kind == "toml rig"
        from_mapping(data, str(snippet))


def test_there_is_something_to_run() -> None:
    assert len(of_kind("sh run")) >= 2
    assert len(of_kind("python run")) >= 1
    assert len(of_kind("toml")) >= 2
    assert len(command_lines()) >= 10
