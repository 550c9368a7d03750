"""The command line: exit codes, one line on stderr, nothing imported that was not requested; and the first settings by start."""

import argparse
import asyncio
import errno
import importlib
import logging
import os
import re
import shlex
import socket
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from importlib import import_module, metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import pytest
from msgspec.structs import replace

from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.cli import main as cli
from companion.cli import run as run_command
from companion.cli.commands import COMMANDS
from companion.guidance.pilot import Pilot, make_pilot
from companion.service import assemble as service
from companion.service.assemble import Proven
from companion.service.daemon import Daemon, DaemonSetup
from companion.settings.capabilities import Command
from companion.settings.guidance import GuidanceOptions
from companion.settings.load import load
from decklander.place import PACKAGES
from drivers.reconnect import BackOff
from estimator.contracts.errors import BadInput, Recoverable, SetupImpossible
from estimator.contracts.time import MonoNs
from estimator.options import EstimatorOptions
from estimator.vision.detection import Detection, PadCheck
from tests.companion.test_daemon import CLOCK, EYES, FakeVehicle
from tests.fly import NEAR
from tests.support.waiting import until

ROOT = Path(__file__).parents[2]


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Return a subcommand `probe` whose `run` a test sets."""
    module = SimpleNamespace(DESCRIPTION="Probe.", add_arguments=lambda parser: None, run=lambda args: 0)
    monkeypatch.setitem(COMMANDS, "probe", Command("study", "probe", "a probe"))
    monkeypatch.setattr(importlib, "import_module", {"probe": module}.__getitem__)
    return module


def raising(error: BaseException) -> object:
    def run(_: argparse.Namespace) -> int:
        raise error

    return run


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_has_a_parser_and_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert callable(import_module(COMMANDS[name].module).run)
    with pytest.raises(SystemExit) as ended:
        cli.main([name, "--help"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: decklander {name}")


def test_help_lists_the_commands_without_importing_any_of_them() -> None:
    probe = (
        "import sys\nfrom companion.cli.main import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit as ended:\n    assert ended.code == 0\n"
        "print(sorted({'numpy', 'cv2', 'av', 'msgspec', 'asyncio', 'matplotlib'} & set(sys.modules)))\n"
        "print([m for m in sys.modules if m.startswith('companion.cli.') and m[14:] not in ('main', 'commands')])"
    )
    done = subprocess.run([sys.executable, "-c", probe], cwd=ROOT, capture_output=True, text=True, timeout=240, check=True)
    assert all(name in done.stdout for name in COMMANDS)
    assert done.stdout.splitlines()[-2:] == ["[]", "[]"]


def test_settings_are_checked_without_the_libraries_of_images_and_links() -> None:
    probe = (
        "import sys\nfrom companion.cli.main import main\nassert main(['config', 'check', 'raspberry_px4', 'sim']) == 0\n"
        "heavy = {'asyncio', 'cv2', 'av', 'matplotlib', 'pymavlink', 'mcap', 'aiohttp', 'drivers.mavlink.dialect'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", probe], cwd=ROOT, capture_output=True, text=True, timeout=240, check=True)
    assert {"raspberry_px4: good", "sim: good"} <= {*done.stdout.splitlines()[:-1]}
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (BadInput("rig.toml: vision.threads\nmust be more"), 2, "decklander: rig.toml: vision.threads must be more\n"),
        (SetupImpossible("no such device class"), 1, "decklander: no such device class\n"),
        (Recoverable("the drone is gone"), 1, "decklander: the drone is gone\n"),
        (ExceptionGroup("parts", [ExceptionGroup("inner", [BadInput("bad key")])]), 2, "decklander: bad key\n"),
        (KeyboardInterrupt(), 130, ""),
        (BaseExceptionGroup("parts", [KeyboardInterrupt(), ValueError("on the way out")]), 130, ""),
    ],
)
def test_what_went_wrong_is_one_line_and_a_code(command, capsys, error, code, said):
    command.run = raising(error)
    assert cli.main(["probe"]) == code
    assert capsys.readouterr().err == said


def test_a_bug_of_ours_is_not_hidden(command: SimpleNamespace) -> None:
    command.run = raising(ZeroDivisionError("ours"))
    with pytest.raises(ZeroDivisionError):
        cli.main(["probe"])
    command.run = raising(ExceptionGroup("parts", [BadInput("x"), ZeroDivisionError("ours")]))
    with pytest.raises(ExceptionGroup):
        cli.main(["probe"])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["demi"], "did you mean 'demo'?"),
        (["zzz"], "known are demo, detect"),
        (["--nonsense"], "--nonsense"),
        (["config", "chekc", "x"], "chekc"),
        (["simulate", "calm", "--recrod", "x"], "did you mean '--record'? (see decklander simulate --help)"),
        (["report", "x.mcap", "--report", "x"], "unrecognized arguments: --report x (see decklander report --help)"),
    ],
)
def test_wrong_use_ends_with_two_and_one_line(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(words)
    err = capsys.readouterr().err
    assert ended.value.code == 2
    assert err.count("\n") == 1
    assert err.startswith("decklander")
    assert said in err


def test_config_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["config", "show", "sim"]) == 0
    shown = tmp_path / "shown.toml"
    shown.write_text(capsys.readouterr().out)
    assert cli.main(["config", "check", "ardrone2", str(shown)]) == 0
    assert capsys.readouterr().out == f"ardrone2: good\n{shown}: good\n"
    assert cli.main(["config", "schema"]) == 0
    assert capsys.readouterr().out.startswith("{")
    shown.write_text(shown.read_text().replace("threads = 1", "threads = 1000"))
    assert cli.main(["config", "check", "nix", str(shown), "ardrone2"]) == 2
    out, err = capsys.readouterr()
    assert (out, "no file 'nix'" in err) == ("ardrone2: good\n", True)
    assert err.endswith(f"decklander: {shown}: vision.threads must be a whole number from 1 to 64 threads, found 1000\n")


MINIMAL = '[vehicle]\nkind = "ardrone"\n[camera]\nfile = "sim"\n[pad]\nfile = "thesis"\n'
SECRETS = tomllib.loads(Path(__file__).with_name("refused_settings.toml").read_text())["absent"]
"""Tables that each name an absent file, by the key that does."""


@pytest.mark.parametrize("key", SECRETS)
def test_a_missing_secret_file_fails_the_check(key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(f"{MINIMAL}{SECRETS[key]}")
    for words in (["config", "check", str(rig)], ["run", "--check", "--config", str(rig)]):
        assert cli.main(words) == 2
        err = capsys.readouterr().err
        assert key in err
        assert re.search(r"absent.?: No such file", err)
        assert err.count("\n") == 1


def test_credentials_are_checked_inside_the_systemd_unit_alone(tmp_path, capsys, monkeypatch):
    rig = tmp_path / "rig.toml"
    rig.write_text(MINIMAL + '[mqtt]\ntransport = "tls"\nuser = "deck"\npassword_file = "credential:password"\n')
    monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)
    assert cli.main(["config", "check", str(rig)]) == 0
    assert "mqtt.password_file: credentials of the systemd unit, not checked here" in capsys.readouterr().out
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    assert cli.main(["config", "check", str(rig)]) == 2
    (tmp_path / "password").write_text("secret\n")
    assert cli.main(["config", "check", str(rig)]) == 0


def test_a_32_bit_python_is_refused_with_a_word(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """numpy, OpenCV and PyAV ship no packages for it: what came instead was whichever of their errors was met first."""
    monkeypatch.setattr(sys, "maxsize", 2**31 - 1)
    assert cli.main(["config", "check", "sim"]) == 1
    assert capsys.readouterr().err.startswith("decklander: this is a 32-bit Python; decklander needs a 64-bit operating system")


@pytest.mark.parametrize("command", ["demo", "simulate", "replay"])
def test_a_report_that_cannot_be_written_is_refused_before_the_flight(command, tmp_path, capsys):
    """A folder below a file cannot be made, not even by root."""
    (tmp_path / "file").write_text("")
    what = {"demo": [], "simulate": ["calm"], "replay": [str(ROOT / "tests/golden/approach.mcap")]}[command]
    began_s = time.process_time()
    assert cli.main([command, *what, "--report", str(tmp_path / "file/report")]) == 2
    printed = capsys.readouterr()
    assert printed.err == f"decklander: --report {tmp_path / 'file/report'}: Not a directory\n"
    assert printed.out == ""
    assert time.process_time() - began_s < 10.0, "less than a flight"


def test_a_reader_that_went_away_is_no_traceback() -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "companion.cli.main", "config", "schema"], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(60) == 141


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("pad list > /dev/full", 1, b"decklander: cannot write the output: No space left on device\n"),
        ("config schema > /dev/full", 1, b"decklander: cannot write the output: No space left on device\n"),
        ("--help > /dev/full", 1, b"decklander: cannot write the output: No space left on device\n"),
        ("pad list <&- >&-", 0, b""),
    ],
    ids=["a full disk", "a full disk before the end", "a help", "closed streams"],
)
def test_standard_streams_that_cannot_be_used_are_no_traceback(words: str, code: int, said: bytes) -> None:
    shell = ["sh", "-c", f'exec "$0" -m companion.cli.main {words}', sys.executable]
    ended = subprocess.run(shell, cwd=ROOT, capture_output=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr) == (code, said)


def test_the_version_is_the_project_s() -> None:
    if not list(metadata.Distribution.discover(name="decklander")):
        pytest.skip("the project is not installed here; make test installs it")
    command = [sys.executable, "-m", "companion.cli.main", "--version"]
    assert subprocess.check_output(command, cwd=ROOT, text=True) == f"decklander {metadata.version('decklander')}\n"


WRONG = tomllib.loads(Path(__file__).with_name("wrong_use.toml").read_text(encoding="utf-8"))
"""Command lines that cannot be carried out, and what the one line says that each ends with; and the files beside pad.jpg."""


@pytest.mark.parametrize("line", WRONG["lines"])
def test_what_cannot_be_done_is_one_line_and_writes_nothing(line, flight_file, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    for name, text in WRONG["files"].items():
        Path(name).write_text(text)
        Path(name).chmod(0o600)
    Path("pad.jpg").write_bytes((ROOT / "configs/examples/pad.jpg").read_bytes())
    before = sorted(tmp_path.rglob("*"))
    assert cli.main(shlex.split(line.format(flown=flight_file, link="--link udpin://127.0.0.1:0"))) == 2
    err = capsys.readouterr().err
    assert err.startswith("decklander: ")
    assert WRONG["lines"][line] in err
    assert err.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


WORLD = [errno.EIO, errno.EROFS, errno.ENOSPC, errno.EMFILE, errno.ENOMEM, errno.ENODEV, errno.ESTALE, errno.EADDRINUSE]
SETTINGS = [errno.ENOENT, errno.EISDIR, errno.ENOTDIR, errno.EACCES, errno.ENAMETOOLONG, errno.ELOOP]


@pytest.fixture
def lives(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """`run` with a flight that ends as the test says; no flight at all, an error."""
    lives = SimpleNamespace(error=None, observers=())

    async def live(*_: Any, **__: Any) -> None:
        for observer in lives.observers:
            observer.on_frame(None)
        if lives.error is not None:
            raise lives.error

    def make_daemon(*_: Any, observers: Any, **__: Any) -> None:
        lives.observers = observers if lives.sees else ()

    lives.sees = False
    monkeypatch.setattr(run_command, "live", live)
    monkeypatch.setattr(run_command, "make_daemon", make_daemon)
    monkeypatch.setattr(run_command, "sole_service", lambda *_: nullcontext())  # a test beside this one may have the vehicle
    return lives


@pytest.fixture(autouse=True)
def loggers() -> Iterator[None]:
    """`run` sets the root logger up for itself."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:], root.level = handlers, level


@pytest.mark.parametrize(("number", "code"), [*((n, 1) for n in WORLD), *((n, 2) for n in SETTINGS)])
def test_a_settings_file_that_cannot_be_read(number, code, tmp_path, monkeypatch, capsys):
    file = tmp_path / "rig.toml"
    file.write_text("")

    def broken(path: Path, flags: int, mode: int = 0o777, *, opens: Callable[..., int] = os.open, **more: Any) -> int:
        if path == file:
            raise OSError(number, os.strerror(number))
        return opens(path, flags, mode, **more)

    monkeypatch.setattr(os, "open", broken)
    assert cli.main(["run", "--config", str(file)]) == code
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("wrapped", [False, True])
def test_settings_that_gave_a_frame_are_no_longer_wrong_in_this_life_and_the_next(lives, wrapped, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    wrong = BadInput("camera /dev/video0: control 'gain' was set to 3 but holds 1")
    lives.error = ExceptionGroup("parts", [wrong]) if wrapped else wrong
    assert cli.main(["run", "--config", "sim"]) == 2
    lives.sees = True
    assert cli.main(["run", "--config", "sim"]) == 1
    lives.sees = False
    assert cli.main(["run", "--config", "sim"]) == 1
    assert "it has worked before" in capsys.readouterr().err
    assert cli.main(["run", "--config", "ardrone"]) == 2  # other settings are not proven by these


def test_a_note_that_cannot_be_read_proves_nothing(tmp_path: Path) -> None:
    (tmp_path / "proven").write_bytes(b"\xff\xfe")
    assert not Proven(load("sim"), {"RUNTIME_DIRECTORY": str(tmp_path)}).known
    assert not Proven(load("sim"), {}).known


@pytest.mark.parametrize(("variable", "value"), [("NOTIFY_SOCKET", "nowhere"), ("WATCHDOG_USEC", "soon")])
def test_a_manager_that_is_not_understood_does_not_keep_the_service_down(variable, value, monkeypatch, caplog, tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "manager"))
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "manager"))
        monkeypatch.setenv(variable, value)
        settings = load("sim")
        service.make_daemon(settings, make_pilot(settings))
    assert "the service manager is not notified" in caplog.text


LATER = ("av", "cv2", "email", "importlib.metadata", "msgspec.inspect", "numpy.ma", "estimator.vision.track.tracker")
"""Modules that take long to load and that no guidance cycle needs."""
PROBE = """
import sys
from companion.cli import main, run
from companion.base import signals
from companion.service.daemon import Daemon, DaemonSetup

def first(self, decision):
    print(*sorted(set(sys.argv[2].split(",")) & set(sys.modules)))
    self.stop()

Daemon._tell = first
arguments = main.argparse.Namespace(config=sys.argv[1], set=[], check=False, once=False)
sys.exit(signals.leave(run.run(main.Parser().parse_args([], arguments))))
"""


def test_the_first_guidance_cycle_waits_for_nothing_that_it_does_not_need(tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    ports = "[expert.vehicle]\nnavdata_port = 45654\nvideo_port = 45655\nat_port = 45656\ncontrol_port = 45659"
    rig.write_text(
        f'[vehicle]\nkind = "ardrone"\nhost = "127.0.0.1"\n{ports}\n[camera]\nfile = "sim"\n[pad]\nfile = "thesis"\n'
        '[operator]\nsocket = "off"\n'
    )
    done = subprocess.run(
        [sys.executable, "-c", PROBE, str(rig), "", ",".join(LATER)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "\n"


class Order(NullObserver):
    """Notes decisions into a list that the preparation of vision shares."""

    def __init__(self, order: list[str]) -> None:
        self._order = order

    def on_decision(self, decision: Decision) -> None:
        self._order.append("decided")

    def on_frame(self, processed: ProcessedFrame) -> None:
        self._order.append("reported")


async def test_vision_is_prepared_once_between_the_first_cycle_and_the_first_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle, order, crate = FakeVehicle(), list[str](), PadCheck(MonoNs(1), 1.0)

    class Looks(Pilot):
        def detect(self, *args: object, **named: object) -> object:  # type: ignore[override]
            order.append(f"looked with {cv2.getNumThreads()}")
            return super().detect(*args, **named)  # type: ignore[arg-type]

    def read_deck(seen: Detection) -> Detection:
        order.append("deck read")
        return replace(seen, on_pad=crate)

    pilot = Looks(EYES, EstimatorOptions(), GuidanceOptions())
    monkeypatch.setattr(type(pilot.search), "has_unread", True)
    monkeypatch.setattr(pilot.search, "read_deck", read_deck)
    monkeypatch.setattr(pilot.landing, "on_pad", lambda check: order.append("told") if check is crate else None)
    restart, prepare = BackOff(0.01, 0.01, 5.0, 1.0), lambda: order.append(threading.current_thread().name)
    daemon = Daemon(vehicle.open, pilot, CLOCK, DaemonSetup(restart, 50.0, threads=1, prepare=prepare), observers=[Order(order)])
    cv2.setNumThreads(2)
    async with asyncio.TaskGroup() as group:
        group.create_task(daemon.run())
        await until(lambda: "vision" in order)
        for seq in (1, 2):
            for _ in range(2):  # the exposure lies between two attitudes
                vehicle.say(flying=True)
                await asyncio.sleep(0.04)
            vehicle.film(seq, late_s=0.05)
            await until(lambda n=seq: daemon.health.frames.total() >= n and "told" in order)  # type: ignore[misc]
        daemon.stop()
    assert order[0] == "decided"
    assert order.count("vision") == 1
    assert "looked with 2" not in order
    assert [entry for entry in order if entry != "decided"][:5] == ["vision", "looked with 1", "reported", "deck read", "told"]


_WITHOUT = """
import sys
from importlib.abc import MetaPathFinder
class Hidden(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "av":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Hidden())
import importlib.util, drivers.pyav
drivers.pyav.find_spec = lambda name: None
from companion.cli import main
for words in sys.argv[1:]:
    print(main.main(words.split()))
"""


def test_without_pyav_a_pixhawk_and_a_webcam_work_and_other_video_is_refused_by_its_setting(tmp_path: Path) -> None:
    photo, film = ROOT / "configs/examples/pad.jpg", tmp_path / "film.mp4"
    film.write_bytes(b"no image")
    (tmp_path / "near.toml").write_text(NEAR)
    commands = (
        "run --config raspberry_ardupilot --check",
        f"detect {photo} --camera sim --pad thesis",
        "simulate near.toml --seed 3 --perception model",
        "config check ardrone1",
        "run --config ardrone2 --check",
        f"detect {film} --camera sim --pad thesis",
    )
    program, environment = [sys.executable, "-c", _WITHOUT, *commands], {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(program, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    printed = done.stderr
    assert [line for line in done.stdout.splitlines() if line.isdigit()] == ["0", "0", "0", "0", "2", "2"], printed
    assert 'vehicle.model = "2.0" needs PyAV' in printed
    assert f"{film}: a video needs PyAV" in printed
    assert printed.count("decklander[video]") == 2
    assert "Traceback" not in printed


def robots(tmp_path: Path) -> dict[str, str]:
    """Return the environment of a robot whose workspace has folders of our names."""
    for name in (*PACKAGES, "configs", "study"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
    return {**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path), str(ROOT)))}


def test_folders_of_our_names_on_the_python_path_of_a_robot_hide_nothing(tmp_path: Path) -> None:
    environment = robots(tmp_path)
    child = "subprocess.run([sys.executable, '-P', '-c', 'import drivers.files'], check=True)"
    words = "sys.argv[1:] = ['config', 'check', 'sim']"
    probe = f"import subprocess, sys\nfrom decklander.__main__ import main\n{words}\nassert main() == 0\n{child}"
    subprocess.run([sys.executable, "-P", "-c", probe], timeout=240, env=environment, check=True)
    face = "from decklander import PadTracker, shipped\nimport drivers\nprint(drivers.__file__, shipped('sim.toml').is_file())"
    done = subprocess.run(
        [sys.executable, "-P", "-c", face], timeout=240, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [str(tmp_path / "drivers/__init__.py"), "True"], "the face takes what it needs, and no more"


def test_a_foreign_package_that_is_imported_already_is_named_in_one_line(tmp_path: Path) -> None:
    environment = robots(tmp_path)
    for probe in ("from decklander.__main__ import main\nsys.exit(main())", "from decklander import Pad"):
        program = f"import sys, estimator\n{probe}"
        done = subprocess.run(
            [sys.executable, "-P", "-c", program], timeout=240, env=environment, capture_output=True, text=True, check=False
        )
        last = done.stderr.splitlines()[-1]
        assert re.search(rf"a package 'estimator' of {re.escape(str(tmp_path))}.* is imported already", last), done.stderr
        assert done.returncode != 0


def test_a_name_that_the_terminal_s_encoding_lacks_is_refused_and_no_traceback(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    words = [sys.executable, "-m", "companion.cli.main", "detect", str(tmp_path / "foto é.jpg")]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=240, env=environment)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
