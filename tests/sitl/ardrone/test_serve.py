"""The drone as a process: it says where it listens, and it always ends when it should."""

import json
import signal
import subprocess
import sys
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from sitl.emulators.ardrone import serve, truth_log
from tests.support.processes import started

ANY = ("--navdata-port", "0", "--video-port", "0", "--at-port", "0", "--control-port", "0")


def start(*arguments: str, **options: Any) -> AbstractContextManager[subprocess.Popen[str]]:
    return started([sys.executable, "-m", "sitl.emulators.ardrone.serve", *arguments], stderr=subprocess.PIPE, **options)


@pytest.mark.parametrize("how", ["stdin closes", "SIGTERM"])
def test_it_ends_when_ordered_and_leaves_the_whole_truth(how: str, tmp_path: Path) -> None:
    truth = tmp_path / "truth.jsonl"
    with start("calm", "--truth", str(truth), *ANY, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
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
    assert all(r["at_ns"] >= ready["started_ns"] for r in records)


@pytest.mark.parametrize(
    ("arguments", "code", "what"),
    [
        (("nowhere",), 2, "there is no file 'nowhere' and no shipped one"),
        (("calm", "--seed", "-1"), 2, "--seed must be 0 or more"),
        (("calm", "--truth", "/nowhere/at/all", *ANY), 2, "truth log /nowhere/at/all: No such file"),
    ],
)
def test_wrong_use_is_one_line(arguments: tuple[str, ...], code: int, what: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert serve.main(list(arguments)) == code
    output = capsys.readouterr()
    assert output.out == ""
    assert what in output.err
    assert output.err.count("\n") == 1
