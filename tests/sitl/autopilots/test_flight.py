"""`simulate --autopilot` from start to landing on a stand-in program, and on a real one where the environment names it."""

import itertools
import json
import os
import signal
import stat
import sys
from pathlib import Path

import pytest

from companion.cli.main import main
from companion.facts.records import TruthRecord
from companion.recording.reading import open_recording
from tests.fly import NEAR
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
def test_a_stand_in_arms_takes_off_and_is_landed_on_the_pad(tmp_path, near, capsys):
    binary = program(tmp_path, STAND_IN)
    kept = tmp_path / "kept"
    code = simulate(near, "--seed", "2", "--binary", binary, "--json", "--keep", str(kept), "--param", "LAND_SPEED=40")
    reported = json.loads(capsys.readouterr().out)
    assert code == 0, (reported, (kept / "texts.txt").read_text(), (kept / "output.txt").read_text())
    assert reported["landed_on_pad"]
    assert reported["outcome"] == "landed"
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
        assert simulate(near, "--binary", program(tmp_path, "exit 1"), "--record", str(kept)) == 1
        assert "ended with code 1" in capsys.readouterr().err
        assert (kept.read_bytes() if kept.exists() else None) == before


@pytest.mark.timeout(400)
def test_a_recorded_flight_holds_the_truth_and_replays_to_the_bit(tmp_path, near, capsys):
    kept, page = tmp_path / "flight.mcap", tmp_path / "report"
    words = ["--binary", "stand-in", "--perception", "model", "--record", str(kept), "--report", str(page), "--json"]
    assert simulate(near, "--seed", "2", *words) == 0
    reported = json.loads(capsys.readouterr().out)
    truths = [event for event in open_recording([kept]).events() if isinstance(event, TruthRecord)]
    assert max(b.at_ns - a.at_ns for a, b in itertools.pairwise(truths)) <= 24_000_000
    contact = truths[-1].touchdown
    assert contact is not None
    assert contact.lateral_m == pytest.approx(reported["touchdown"]["lateral_m"], abs=1e-4)
    assert truths[-1].phase == "landed"
    assert main(["replay", str(kept), "--json"]) == 0
    (ekf,) = (row for row in json.loads(capsys.readouterr().out)["against"]["the recording"] if row["path"] == "ekf")
    assert ekf["both"] > 300
    assert ekf["identical"] == ekf["both"]
    assert "Touchdown and trajectory" in (page / "index.html").read_text()


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
        ([], "needs --binary PATH"),
        (["--binary", "stand-in", "--physics", "own"], "simulates no vehicle by itself"),
        (["--binary", __file__], "is no program that can be run"),
        (["--binary", "/bin/sh", "--record", "/dev/null"], "--record /dev/null: is there already"),
        (["--binary", "/bin/sh", "--follow", "udpin://127.0.0.1:0"], "does not go with"),
        (["--binary", "/bin/sh", "--keep", "/dev/null"], "not an empty folder"),
        (["--binary", "/bin/sh", "--param", "PLND_LAG=nan"], "write NAME=VALUE"),
        (["--binary", "/bin/sh", "--autopilot", "px4"], "rcS"),
    ],
)
def test_wrong_use_is_one_line(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "calm", "--autopilot", "arducopter", *words]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
