"""The soak's judgement on made-up readings, its view of this very process, and that it finds a leak in a real one."""

import json
import mmap
import os
import signal
import sys
from pathlib import Path

import pytest

from companion.cli import main as cli
from sitl.campaign.growth import Reading, findings, give_back, read
from sitl.campaign.soak import OPERATOR_WAIT_S, flown_settings, warm_up_s
from sitl.flight.one_flight import settings_for
from sitl.scenario.scenario import load as load_scenario
from tests.fly import NEAR
from tests.support.processes import started
from tests.support.waiting import wait_until

BRIEF = NEAR.replace("duration_limit_s = 40.0", "duration_limit_s = 1.5").replace("height_m = 2.0", "height_m = 3.0")
"""Flights that are over before they come down: what is tested here is not how they end."""
pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="there is no /proc here")


def made(n: int, memory: float = 0.0, descriptors: float = 0.0, tasks: float = 0.0) -> list[Reading]:
    """Return a warm-up that grows by half, then `n` readings that grow by this much each."""
    warm = [Reading(float(i), 0, 100.0 + 10.0 * i, 10, 3, 5, 0.5 * i) for i in range(5)]
    grown = [
        Reading(5.0 + i, i, 150.0 + memory * i, int(20 + descriptors * i), 4, int(8 + tasks * i), 2.5 + 0.3 * i) for i in range(n)
    ]
    return warm + grown


def test_what_is_flat_has_no_fault_and_warm_up_does_not_count() -> None:
    found = findings(made(40), 5.0)
    assert found is not None
    assert found.faults == []
    assert found.memory_mib.growth == 0.0
    assert found.flights == 39
    assert found.cpu_share == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("leak", "said"),
    [({"memory": 0.2}, "memory grew"), ({"descriptors": 0.1}, "descriptors grew"), ({"tasks": 0.1}, "tasks grew")],
)
def test_what_grows_is_reported(leak: dict[str, float], said: str) -> None:
    found = findings(made(40, **leak), 5.0)
    assert found is not None
    assert [fault.startswith(said) for fault in found.faults] == [True]


def test_in_a_long_run_the_first_thirty_flights_are_warm_up_whatever_they_fill() -> None:
    """WHY: 2.7 MiB that were taken once, in the 21st flight, failed a run of 75 flights as growth of 1.4 %."""
    step = [Reading(100.0 * n, n, 204.0 + 2.8 * (n > 21), 6, 4, None, 50.0 * n) for n in range(1, 76)]
    judged = findings(step, warm_up_s(step))
    assert judged is not None
    assert warm_up_s(step) == 3000.0
    assert judged.faults == []
    leak = [Reading(100.0 * n, n, 204.0 + 0.1 * n, 6, 4, None, 50.0 * n) for n in range(1, 76)]
    judged = findings(leak, warm_up_s(leak))
    assert judged is not None
    assert "memory grew by 1.7%" in judged.faults[0]
    assert warm_up_s(step[:40]) == pytest.approx(0.2 * 4000.0), "half of a short run would be too much"


def test_too_few_readings_say_nothing() -> None:
    assert findings(made(7), 5.0) is None
    assert findings([], 5.0) is None


def test_it_sees_this_process() -> None:
    before = read(0.0, 0, None)
    pipe = os.pipe()
    with mmap.mmap(-1, 32 * 2**20) as ballast:  # of its own: an allocation may fit into memory that was freed and not given back
        ballast.write(os.urandom(32 * 2**20))
        after = read(1.0, 0, None)
    for end in pipe:
        os.close(end)
    assert after.descriptors == before.descriptors + 2
    assert after.memory_mib - before.memory_mib > 25.0
    assert after.cpu_s >= before.cpu_s > 0.0


def test_free_memory_is_given_back_before_it_is_read() -> None:
    """Blocks below the size that the C library maps one by one, and a last one that keeps the heap from being cut at its end."""
    blocks = [os.urandom(60_000) for _ in range(600)]
    del blocks[:-1]
    before_mib = give_back()
    after = read(1.0, 0, None, before_mib)
    assert after.before_mib == before_mib
    assert after.memory_mib < before_mib - 20.0


def test_nobody_is_there_to_answer_so_the_wait_for_a_word_is_short() -> None:
    """A question late in a flight was still open when the scenario's 90 s ended, and the flight counted as undecided."""
    demo = load_scenario("demo")
    assert flown_settings(settings_for(demo, None)).guidance.tries.operator_wait_s == OPERATOR_WAIT_S
    assert demo.duration_limit_s / 2 > OPERATOR_WAIT_S


@pytest.mark.parametrize(
    "words",
    [
        ["--hours", "0"],
        ["--runs", "3"],
        ["--virtual", "--runs", "0"],
        ["--virtual", "--runs", "3", "--hours", "1"],
        ["--workers", "2"],
        ["--vary", "wind.speed_m_s=1,2"],
        ["--set", "wind.speed_m_s=3"],
        ["--seed", "-1"],
        ["--perception", "model"],
        ["--virtual", "--perception", "eyes"],
    ],
)
def test_wrong_words_are_one_line(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["campaign", "demo", "--soak", *words]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_few_seconds_of_the_real_thing_fly_and_end_cleanly(capsys: pytest.CaptureFixture[str]) -> None:
    descriptors = len(os.listdir("/proc/self/fd"))
    assert cli.main(["campaign", "calm", "--soak", "--hours", "0.001", "--json"]) == 1
    output = json.loads(capsys.readouterr().out)
    assert output["findings"] is None, "too short to measure growth"
    assert output["flown_s"] >= 3.0
    assert len(os.listdir("/proc/self/fd")) <= descriptors


def test_a_soak_that_is_cut_keeps_what_it_has_seen(tmp_path: Path) -> None:
    readings, near = tmp_path / "readings.jsonl", tmp_path / "near.toml"
    near.write_text(BRIEF)
    words = ["--virtual", "--hours", "1", "--no-faults", "--json", "--readings", str(readings)]
    command = [sys.executable, "-m", "companion.cli.main", "campaign", str(near), "--soak", *words]
    with started(command) as soak:
        wait_until(lambda: readings.exists() and readings.read_text())
        soak.send_signal(signal.SIGTERM)
        out, _ = soak.communicate(timeout=60)
    assert soak.returncode == 143
    lines = [json.loads(line) for line in readings.read_text().splitlines()]
    reported = json.loads(out)
    assert len(lines) == lines[-1]["flights"] == reported["flights"] == len(reported["outcomes"]) >= 1
    assert reported["classes"]["failed"] == reported["flights"], "none of them came down in its time"
    assert reported["flight_faults"]


def test_a_file_that_cannot_be_written_is_reported_before_the_first_flight(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["campaign", "demo", "--soak", "--virtual", "--runs", "1", "--readings", "/dev/null/there"]) == 2
    assert "--readings: /dev/null/there" in capsys.readouterr().err


def test_a_full_disk_is_reported_and_flown_through(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    near = tmp_path / "near.toml"
    near.write_text(BRIEF)
    words = ["--virtual", "--runs", "2", "--no-faults", "--json", "--readings", "/dev/full"]
    assert cli.main(["campaign", str(near), "--soak", *words]) == 1
    output = capsys.readouterr()
    assert json.loads(output.out)["flights"] == 2
    assert output.err.count("--readings: /dev/full: No space left on device") == 1


def test_flights_without_pictures_are_flown_and_graded_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    near = tmp_path / "near.toml"
    near.write_text(BRIEF)
    words = ["--virtual", "--runs", "1", "--no-faults", "--json", "--perception", "model"]
    assert cli.main(["campaign", str(near), "--soak", *words]) == 1
    output = json.loads(capsys.readouterr().out)
    assert output["classes"]["failed"] == output["flights"] == 1, "its time ends before it comes down"
