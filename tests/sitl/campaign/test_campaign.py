"""A campaign loses no flight and doubles none, whatever ends it, and its flights do not depend on where they were flown."""

import os
import resource
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from companion.cli import main as cli
from estimator.contracts.errors import BadInput
from sitl.campaign.figures import wilson
from sitl.campaign.plan import Job, code_version, differences, sources_digest
from sitl.campaign.store import FLIGHTS, MANIFEST, FolderStore, flights_in
from sitl.campaign.task import Flight, Order, OtherCode, fly_order
from sitl.campaign.workers import LocalWorkers
from tests.fly import NEAR
from tests.sitl.campaign.fakes import KILLS, RAISES, fake_fly, plan, tally_of


def fly_job(job: Job) -> Flight:
    return fly_order(Order(job, plan().base(), code_version(), fake_fly))


def keep(folder: Path, seeds: range) -> None:
    with closing(FolderStore(folder, plan(), seeds)) as kept:
        for seed in seeds:
            kept.keep([fly_job(Job(seed))], 1.0 + seed)


def drive(folder: Path, *args: str, **more: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tests.sitl.campaign.fakes", str(folder), *args]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **more)


def test_processes_that_are_killed_cost_no_flight_and_double_none(tmp_path: Path) -> None:
    reference = tally_of(map(fly_job, map(Job, range(12))))
    child = drive(tmp_path, "12", "0.2", "2", start_new_session=True)
    assert child.stdout is not None
    for _ in range(3):
        child.stdout.readline()
    child.kill()
    child.wait()
    child.stdout.close()
    before = list(flights_in(tmp_path / FLIGHTS))
    assert 3 <= len(before) < 12
    with (tmp_path / FLIGHTS).open("ab") as file:
        file.write(b'{"session":1,"at_s":2.0,"flight":{"seed":11,"gra')
    child = drive(tmp_path, "12", "0.2", "2")
    out, _ = child.communicate(timeout=60)
    assert child.returncode == 0
    flights = list(flights_in(tmp_path / FLIGHTS))
    assert sorted(f["seed"] for f in flights) == list(range(12))
    assert len(out.split()) == 12 - len(before), "what was kept is not flown again"
    assert len((tmp_path / FLIGHTS).read_bytes().splitlines()) == 12
    assert tally_of(flights).hash == reference.hash, "the same flights as in one process"


def test_an_error_is_a_result_and_so_is_a_process_that_dies() -> None:
    with LocalWorkers(plan(), code_version(), 2, fake_fly) as workforce:
        seeds = [11, RAISES, 12, KILLS, 14, 15, 16]
        flights = {f["seed"]: f for f in workforce.results(map(Job, seeds))}
    assert sorted(flights) == sorted(seeds)
    assert {seed for seed, f in flights.items() if f["outcome"] == "error"} == {RAISES, KILLS}
    assert flights[RAISES]["because"].startswith("ValueError: an unlucky number (fakes.py:")
    assert flights[KILLS]["because"] == "the process that flew it died"
    assert tally_of(flights.values()).counts["errors"] == 2
    assert flights[14]["hash"] == fly_job(Job(14))["hash"], "the same wherever it is flown"


def test_a_full_disk_ends_the_session_and_leaves_whole_lines(tmp_path: Path) -> None:
    keep(tmp_path / "measured", range(2))
    whole_manifest = (tmp_path / "measured" / MANIFEST).stat().st_size
    most = max(whole_manifest + 100, 5 * (tmp_path / "measured" / FLIGHTS).stat().st_size)

    def small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    tmp_path /= "full"
    child = drive(tmp_path, "200", stderr=subprocess.PIPE, preexec_fn=small)
    _, output = child.communicate(timeout=60)
    assert child.returncode == 1
    assert "flights are kept, and the same command goes on from there" in output
    text = (tmp_path / FLIGHTS).read_bytes()
    assert text.endswith(b"\n")
    kept = list(flights_in(tmp_path / FLIGHTS))
    assert 1 <= len(kept) < 200
    child = drive(tmp_path, "200")
    child.communicate(timeout=60)
    assert sorted(f["seed"] for f in flights_in(tmp_path / FLIGHTS)) == list(range(200))


def test_a_folder_of_another_campaign_or_code_is_refused_by_name_and_left_alone(tmp_path, monkeypatch):
    keep(tmp_path, range(2))
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    with pytest.raises(BadInput, match="another campaign: it was flown with another scenario"):
        FolderStore(tmp_path, plan(duration_limit_s=9.0), range(2))
    with pytest.raises(BadInput, match="another campaign: its name is 'near'"):
        FolderStore(tmp_path, plan("far"), range(2))
    with closing(FolderStore(tmp_path, plan(), range(2))), pytest.raises(BadInput, match="another campaign is writing"):
        FolderStore(tmp_path, plan(), range(2))
    monkeypatch.setattr("sitl.campaign.plan.code_version", lambda: {**code_version(), "sources": "0" * 32, "numpy": "1.0"})
    with pytest.raises(
        BadInput, match=r"begun with other code \(numpy \S+ instead of 1.0, sources \w+ instead of 000000000000\)"
    ):
        FolderStore(tmp_path, plan(), range(2))
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
    other = tmp_path / "other"
    other.mkdir()
    (other / "letter.txt").write_text("mine")
    with pytest.raises(BadInput, match=r"holds 'letter.txt' and no campaign"):
        FolderStore(other, plan(), range(2))


def test_a_damaged_line_is_named_and_a_doubled_one_counts_once(tmp_path: Path) -> None:
    keep(tmp_path, range(3))
    path = tmp_path / FLIGHTS
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines, lines[0]]))
    assert [f["seed"] for f in flights_in(path)] == [0, 1, 2]
    changed = lines[1].replace(b'"vertical_speed_m_s":0.4', b'"vertical_speed_m_s":0.3')
    path.write_bytes(lines[0] + changed + lines[2])
    with pytest.raises(BadInput, match="line 2 is damaged"):
        FolderStore(tmp_path, plan(), range(3))


def test_a_worker_with_other_code_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    order = Order(Job(1), plan().base(), {**code_version(), "sources": "f" * 32}, fake_fly)
    with pytest.raises(
        OtherCode, match=r"the worker on \S+, process \d+, has other code: sources \w{12} instead of ffffffffffff"
    ):
        fly_order(order)
    assert differences(code_version(), code_version()) == ""
    assert sources_digest() == code_version()["sources"]
    monkeypatch.setattr("sitl.campaign.plan._PACKAGES", ("estimator",))
    assert sources_digest() != code_version()["sources"]


def test_wilsons_interval() -> None:
    low, high = wilson(987, 1000)  # published examples: R. G. Newcombe, Statistics in Medicine 17 (1998), table I
    assert (low, high) == pytest.approx((0.9779, 0.9924), abs=1e-4)
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)
    assert wilson(29, 29) == pytest.approx((0.8830, 1.0), abs=1e-4)
    assert wilson(0, 0) == (0.0, 1.0)


SOAK, VIRTUAL = ["demo", "--soak"], ["demo", "--soak", "--virtual"]
WRONG_USE = [
    (["calm", "--runs", "0"], "--runs must be 1 or more, got 0"),
    (["calm", "--workers", "0"], "--workers must be 1 or more, got 0"),
    (["calm", "--workers", "2", "--scheduler", "tcp://127.0.0.1:1"], "--workers does not go with --scheduler"),
    (["calm", "--set", "wind.sped_m_s=3"], "have a key 'wind.sped_m_s'; did you mean 'wind.speed_m_s'?"),
    (["calm", "--perception", "dreams"], "there is no level 'dreams'"),
    (["clam"], "did you mean 'calm'"),
    (["calm", "calm"], "scenario 'calm' is listed twice"),
    (["gimbal", "--perception", "model"], "gimbal: an AR.Drone has none"),
    (["calm", "--vary", "wind.speed_m_s=0:3:1", "--vary", "wind.speed_m_s=4,5"], "wind.speed_m_s is given twice"),
    (["calm", "--against", "x"], "--against goes with --report"),
    (["calm", "--report", "--against", "nothing"], "nothing is no campaign's folder: manifest.json: No such file"),
    (["thirty_faults", "--vary", "wind.speed_m_s=0:4:2"], "--vary goes with one scenario"),
    (["thirty_faults", "--perception", "truth"], "thirty_faults: faults/camera_freezes: the fault frames_frozen acts on vision"),
    ([*SOAK, "--hours", "0"], "--hours must lie in"),
    ([*SOAK, "--runs", "3"], "--runs with --soak needs --virtual"),
    ([*SOAK, "--workers", "2"], "--workers does not go with --soak"),
    ([*SOAK, "--set", "wind.speed_m_s=3"], "--set with --soak needs --virtual"),
    ([*SOAK, "--perception", "model"], "--perception needs --virtual"),
    ([*SOAK, "--fault", "link_lost_4_s"], "needs --virtual"),
    ([*VIRTUAL, "--runs", "3", "--hours", "1"], "takes the place of --hours"),
    ([*VIRTUAL, "--fault", "none"], "not a fault scenario"),
    ([*VIRTUAL, "--fault", "wrong_pad", "--perception", "model"], "seen in rendered frames only"),
    ([*VIRTUAL, "--runs", "1", "--readings", "/dev/null/there"], "--readings: /dev/null/there"),
    ([*VIRTUAL, "--runs", "1", "--plot", "/dev/null/x.png"], "--plot: /dev/null/x.png"),
]


@pytest.mark.parametrize(("args", "said"), WRONG_USE)
def test_wrong_use_is_one_clear_line_before_the_first_flight(args, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["campaign", *args]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_signal_ends_the_command_with_what_is_kept(tmp_path: Path) -> None:
    near = tmp_path / "near.toml"
    near.write_text(NEAR)
    command = [sys.executable, "-m", "companion.cli.main", "campaign", str(near), "--runs", "50", "--workers", "1", "--out", "c"]
    child = subprocess.Popen(
        command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": os.getcwd()}
    )
    assert child.stderr is not None
    assert child.stderr.readline() == "50 flights to fly, by 1 process; results in c\n"
    child.send_signal(signal.SIGINT)
    _, output = child.communicate(timeout=60)
    assert child.returncode == 130
    assert " flights are kept in c; the same command goes on from there" in output


def test_a_worker_that_is_born_after_its_campaign_reports_nothing_and_an_error_of_ours_is_reported() -> None:
    source = "import sitl.campaign.unborn; raise {}"
    for error, reported in (("FileNotFoundError(2, 'no semaphore')", False), ("EOFError", False), ("ImportError('ours')", True)):
        ended = subprocess.run(
            [sys.executable, "-c", source.format(error)], capture_output=True, text=True, check=False, timeout=60
        )
        assert ended.returncode == 1
        assert ("ImportError: ours" in ended.stderr) == reported
        assert bool(ended.stderr) == reported


def test_a_ctrl_c_while_the_server_of_the_workers_starts_is_for_the_campaign_alone() -> None:
    source = """
import os, signal
from multiprocessing import forkserver
from sitl.campaign.workers import _start_server
_start_server()
server = forkserver._forkserver._forkserver_pid
blocked = int(open(f"/proc/{server}/status").read().split("SigBlk:")[1].split()[0], 16)
print(blocked >> signal.SIGINT - 1 & 1, signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))
"""
    ended = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=False, timeout=60)
    assert (ended.stdout, ended.stderr) == ("1 False\n", "")
