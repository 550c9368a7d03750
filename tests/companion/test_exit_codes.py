"""Exit code 2 says that the settings are wrong and nothing else: systemd starts the service again after every other end."""

import errno
import logging
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

import pytest

from companion.cli import main as cli
from companion.cli import run as run_command
from companion.guidance.make_pilot import make_pilot
from companion.service import assemble as service
from companion.service.assemble import Proven
from companion.settings.load import load
from estimator.contracts.errors import BadInput

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

    def broken(*_: object) -> IO[bytes]:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(Path, "open", broken)
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
