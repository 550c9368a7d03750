"""Guides whose flights take long: the first hour, and the AR.Drone's page against a simulated drone in real time."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from companion.cli.main import main
from tests.docs.test_guides import ROOT, commands_of, elsewhere, reader
from tests.support.processes import started
from tests.support.waiting import free_port

__all__ = ["reader"]
PAGE = (ROOT / "docs/ardrone.md").read_text().partition("## An AR.Drone 1.0")[0]
CLI = (sys.executable, "-m", "companion.cli.main")
LANDS_S, BEGINS = 90.0, 3
"""Limits for a busy machine. One that starves the service for seconds makes it give up, rightly; its advice is to begin again."""


def test_the_first_hour_s_commands_run(reader: Path) -> None:
    """Its blocks marked `run` are run by tests/docs/test_guides.py, its orders are those of the page operator."""
    ran = []
    for words in commands_of("first-hour"):
        line = " ".join(words)
        later = any(" ".join(more).startswith(f"{line} ") for more in commands_of("first-hour"))
        if elsewhere(words) or later or words[0] == "fly" or "wrong.toml" in words or "--draw" in words:
            continue
        flight = ["--perception", "model"] if words[0] == "simulate" else []
        assert main([*words, *flight]) == 0, line
        ran.append(words[0])
    assert ran.count("simulate") == 2
    assert "replay" in ran
    assert (reader / "calm.mcap").is_file()
    assert (reader / "seastate4/index.html").is_file()


@pytest.mark.timeout(420)
def test_the_guide_s_settings_and_commands_fly_and_land_the_simulated_drone(tmp_path, monkeypatch, capsys):
    block = re.search(r"```toml rig\n(.*?)```", PAGE, re.DOTALL)
    assert block is not None
    sea = 'title = "x"\nbase = "calm"\ncamera.file = "ardrone2_bottom"\nstart = {height_m = 1.5, pad_right_m = 0.2}\n'
    (tmp_path / "sea.toml").write_text(sea)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    monkeypatch.chdir(tmp_path)

    def cli(*words: str) -> tuple[int, str]:
        """Return exit code and output of a command, which runs in this process."""
        named = ("--config", "rig.toml") if words[0] == "fly" else ()  # other services may run on this computer
        code = main([*words, *named])
        return code, "".join(capsys.readouterr())

    def status_once(done: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        ends = time.monotonic() + LANDS_S
        while time.monotonic() < ends:
            code, answer = cli("fly", "status", "--json")
            if code == 0 and done(status := json.loads(answer)):
                return status
            time.sleep(1.0)
        raise AssertionError(f"{answer}{(tmp_path / 'log').read_text()}")

    drone = [sys.executable, "-m", "sitl.emulators.ardrone.serve", str(tmp_path / "sea.toml"), "--seed", "3"]
    drone += ["--navdata-port", "0", "--video-port", "0", "--at-port", "0", "--control-port", "0"]
    with started(drone, stdin=subprocess.PIPE, lasting_s=400) as emulator:
        ports = json.loads(emulator.stdout.readline())["ports"]
        text = "".join(line[3:] or "\n" for line in block[1].splitlines(keepends=True))
        text = text.replace("192.168.1.1", "127.0.0.1").replace("[http]\n", f"[http]\nport = {free_port()}\n")
        text += "[expert.vehicle]\n" + "".join(f"{name}_port = {port}\n" for name, port in ports.items())
        (tmp_path / "rig.toml").write_text(text)
        # Every command that the guide prints on a line of its own, without its comment.
        todo = [re.split(r" {2,}#", line)[0].strip() for line in PAGE.splitlines() if re.match(r" {7}decklander ", line)]
        for wanted in ("decklander keys token page.token", "decklander run --config rig.toml --check"):
            assert todo.pop(0) == wanted
            code, printed = cli(*wanted.split()[1:])
            assert code == 0, printed
        assert todo.pop(0) == "decklander run --config rig.toml"
        with (
            (tmp_path / "log").open("w") as log,
            started([*CLI, "run", "--config", "rig.toml"], cwd=tmp_path, env=environment, stdout=log, stderr=log, lasting_s=400),
        ):
            status_once(lambda status: status["flying"])  # the simulated drone begins in the air
            assert [line.split()[2] if len(line.split()) > 2 else "keys" for line in todo] == ["takeoff", "keys", "begin", "land"]
            takeoff, _, begin, land = ([*line.split()[1:]] for line in todo)
            for _ in range(BEGINS):
                assert cli(*begin)[0] == 0
                if not status_once(lambda status: not status["flying"] or status["phase"] == "gave up")["flying"]:
                    break
            else:
                raise AssertionError((tmp_path / "log").read_text())
            for order in (takeoff, land):
                code, printed = cli(*order)
                assert code == 0, printed
            status_once(lambda status: not status["flying"])
