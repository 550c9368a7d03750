"""The soak: its judgement on made-up readings, its view of this very process, and a few real flights."""

import mmap
import os
from pathlib import Path
from typing import Any

import pytest

from benches.soak import Reading, findings, give_back, main, read, warm_up_s
from companion.guidance.pilot import Pilot
from tests.fly import NEAR

pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="there is no /proc here")


@pytest.mark.parametrize(
    ("leak", "said"),
    [
        ({}, []),
        ({"memory": 0.2}, ["memory grew"]),
        ({"descriptors": 0.1}, ["descriptors grew"]),
        ({"tasks": 0.1}, ["tasks grew"]),
    ],
)
def test_what_grows_after_the_warm_up_is_reported(leak: dict[str, float], said: list[str]) -> None:
    memory, descriptors, tasks = (leak.get(name, 0.0) for name in ("memory", "descriptors", "tasks"))
    readings = [Reading(float(i), 0, 100.0 + 10.0 * i, 10, 3, 5, 0.5 * i) for i in range(5)]
    readings += [
        Reading(5.0 + i, i, 150.0 + memory * i, int(20 + descriptors * i), 4, int(8 + tasks * i), 2.5 + 0.3 * i)
        for i in range(40)
    ]
    found = findings(readings, 5.0)
    assert [fault[: len(said[0])] for fault in found.faults] == said
    assert found.cpu_share == pytest.approx(0.3)
    assert findings(readings[:12], 5.0) is None, "too few say nothing"


def test_in_a_long_run_the_first_thirty_flights_are_warm_up_whatever_they_fill() -> None:
    """WHY: 2.7 MiB that were taken once, in the 21st flight, failed a run of 75 flights as growth of 1.4 %."""
    step = [Reading(100.0 * n, n, 204.0 + 2.8 * (n > 21), 6, 4, None, 50.0 * n) for n in range(1, 76)]
    leak = [Reading(100.0 * n, n, 204.0 + 0.1 * n, 6, 4, None, 50.0 * n) for n in range(1, 76)]
    assert warm_up_s(step) == 3000.0
    once, always = (findings(readings, warm_up_s(readings)) for readings in (step, leak))
    assert once.faults == []
    assert "memory grew by 1.7%" in always.faults[0]
    assert warm_up_s(step[:40]) == pytest.approx(0.2 * 4000.0), "half of a short run would be too much"


def test_it_sees_this_process_and_gives_free_memory_back_before() -> None:
    """Blocks below the size that the C library maps one by one, and a last one that keeps the heap from being cut at its end."""
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
    blocks = [os.urandom(60_000) for _ in range(600)]
    del blocks[:-1]
    before = read(1.0, 0, None)
    give_back()
    assert read(2.0, 0, None).memory_mib < before.memory_mib - 20.0


def test_a_few_seconds_of_the_real_thing_fly_and_end_cleanly(capsys: pytest.CaptureFixture[str]) -> None:
    descriptors = len(os.listdir("/proc/self/fd"))
    assert main(["calm", "--hours", "0.001"]) == 0
    assert "too short to measure growth" in capsys.readouterr().out
    assert len(os.listdir("/proc/self/fd")) <= descriptors


def test_a_service_that_dies_in_every_flight_does_not_end_the_soak(tmp_path, capsys, monkeypatch):
    near = tmp_path / "near.toml"
    near.write_text(NEAR.replace("duration_limit_s = 40.0", "duration_limit_s = 3.0"))

    def broken(self: Pilot, *_: Any) -> None:
        raise KeyError(7)

    monkeypatch.setattr(Pilot, "detect", broken)
    assert main([str(near), "--virtual", "--runs", "2", "--no-faults"]) == 0
    assert capsys.readouterr().out == "2 flights: 2 time is up\ntoo short to measure growth\n"
