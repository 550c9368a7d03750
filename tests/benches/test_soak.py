"""The soak: its judgement on made-up readings and flights, its view of this very process, and a few real ones."""

import mmap
import os
import tracemalloc
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benches.soak import Flown, Reading, Records, Tally, findings, give_back, main, read, real, warm_up_s
from companion.base.mission import FlightOutcome
from estimator.contracts.estimates import Verdict
from sitl.flight.ending import Grade, Load
from sitl.scenario.scenario import load
from sitl.scenario.with_fault import faulty
from tests.fly import NEAR

BRIEF = NEAR.replace("duration_limit_s = 40.0", "duration_limit_s = 1.5").replace("height_m = 2.0", "height_m = 3.0")
"""Flights that are over before they come down: what is tested here is not how they end."""
GOOD = Counter({Verdict.FUSED: 850, Verdict.NO_PAD: 50})
SAID: dict[str, Any] = {
    "ended": "landed", "seed": 3, "title": "A small ferry; faults/camera_freezes", "expect": "refuse", "duration_s": 30.0,
    "surface": "pad", "on_pad": True, "lateral_m": 0.08, "unsafe": [], "left_alone": False, "frames_due": 900, "frames_sent": 880,
    "stood_still_s": 0.0,
}  # fmt: skip
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


AWAY: dict[str, Any] = {"ended": "time is up", "on_pad": False, "surface": None, "lateral_m": None}
CUT: dict[str, Any] = {"ended": "emergency", "on_pad": False}
LANDED, GAVE_UP, EMERGENCY = FlightOutcome.LANDED, FlightOutcome.GAVE_UP, FlightOutcome.EMERGENCY
WET, STRAY = "in the water, 2.50 m from the pad's centre", "touched the deck 0.48 m from the pad's centre"
OVERTAKEN, UNLEVELLED = (Counter({verdict: 600, Verdict.FUSED: 280}) for verdict in (Verdict.REPLACED, Verdict.NO_ATTITUDE))
FLIGHTS: list[tuple[FlightOutcome, dict[str, Any], Counter[Verdict], float, Grade, str]] = [
    (LANDED, {}, GOOD, 0.0, Grade.ON_PAD, ""),
    (GAVE_UP, AWAY, GOOD, 0.0, Grade.REFUSED_RIGHTLY, ""),
    (GAVE_UP, AWAY | {"expect": "land"}, GOOD, 0.0, Grade.FAILED, ""),
    (EMERGENCY, AWAY, GOOD, 0.0, Grade.FAILED, "time ran out: it neither landed nor gave up"),
    (LANDED, {"on_pad": False, "surface": "water", "unsafe": [WET]}, GOOD, 0.0, Grade.FAILED, WET),
    (LANDED, {"unsafe": [STRAY]}, GOOD, 0.0, Grade.FAILED, STRAY),
    (EMERGENCY, CUT, GOOD, 0.02, Grade.FAILED, "emergency"),
    (EMERGENCY, CUT, GOOD, 0.045, Grade.STARVED, "half of the guidance cycles came 45 ms late or later"),
    (EMERGENCY, CUT | {"stood_still_s": 4.0}, GOOD, 0.0, Grade.STARVED, "the simulated drone stood still for 4.0 s"),
    (EMERGENCY, CUT | {"frames_sent": 200}, GOOD, 0.0, Grade.STARVED, "22% of the frames were rendered in time"),
    (EMERGENCY, CUT, OVERTAKEN, 0.0, Grade.STARVED, "68% of the frames were overtaken by newer ones"),
    (EMERGENCY, CUT, UNLEVELLED, 0.0, Grade.STARVED, "68% of the frames had no attitude"),
    (LANDED, {"stood_still_s": 4.0}, OVERTAKEN, 0.0, Grade.ON_PAD, ""),
]


@pytest.mark.parametrize(("outcome", "said", "frames", "late_s", "worth", "because"), FLIGHTS)
def test_a_flight_in_real_time_is_good_failed_or_starved_by_the_machine(outcome, said, frames, late_s, worth, because):
    flight = real(SAID | said, outcome, frames, late_s)
    assert flight.worth is worth
    assert because in flight.because
    assert worth is not Grade.STARVED or "emergency" in flight.because, "what happened is reported beside"
    assert Load(900, 880, 0.2, GOOD).starved() is None


def flown(worth: Grade, seed: int = 1, title: str = "a; faults/b") -> Flown:
    return Flown(seed, title, worth, "why")


def test_failed_flights_and_a_starved_soak_are_faults_and_a_failed_flight_is_flown_again_by_fault_and_seed() -> None:
    """WHY: a seed selects another fault as soon as fault scenarios are added, so the seed alone does not tell the flight."""
    failed = flown(Grade.FAILED, 7, "a ferry; faults/link_lost_4_s")
    bad = Tally([flown(Grade.ON_PAD), flown(Grade.REFUSED_RIGHTLY), failed, flown(Grade.STARVED)])
    assert bad.faults(0) == ["1 of 4 flights failed"]
    assert bad.faults(1) == []
    assert "  seed 7, faults/link_lost_4_s: failed: why" in bad.in_words("demo")
    assert [bad.count(worth) for worth in Grade] == [1] * 4
    slow = Tally([flown(Grade.STARVED), flown(Grade.STARVED), flown(Grade.ON_PAD)])
    assert slow.faults(0) == ["this machine was too slow for 2 of 3 flights, so the run shows nothing"]
    again = "python -m benches.soak demo --virtual --runs 1 --seed 7 --fault faults/link_lost_4_s"
    assert bad.in_words("demo")[-1].endswith(again)
    named = faulty(load("demo"), 7, possible=lambda _: True, name="faults/link_lost_4_s")
    assert named.faults == load("faults/link_lost_4_s").faults
    assert named.unreached_contacts


def record_number(n: int) -> Flown:
    return Flown(n, f"a ferry; faults/number_{n}", Grade.FAILED if n % 3 else Grade.ON_PAD, f"because of {n}")


def test_a_day_of_records_takes_no_memory_and_more_may_come_while_one_reads() -> None:
    records = Records(Flown)
    records.append(record_number(0))
    tracemalloc.start()
    try:
        for n in range(1, 5000):
            records.append(record_number(n))
        assert tracemalloc.get_traced_memory()[0] < 20_000, "a list of them takes two megabytes"
    finally:
        tracemalloc.stop()
    seen = []
    for record in records:
        seen.append(record)
        records.append(record)
    assert seen == [record_number(n) for n in range(5000)]
    assert len(records) == 10_000


def test_a_few_seconds_of_the_real_thing_fly_and_end_cleanly(capsys: pytest.CaptureFixture[str]) -> None:
    descriptors = len(os.listdir("/proc/self/fd"))
    assert main(["calm", "--hours", "0.001"]) == 1
    assert "too short to measure growth" in capsys.readouterr().out
    assert len(os.listdir("/proc/self/fd")) <= descriptors


def test_a_virtual_soak_names_the_flight_that_failed(tmp_path, capsys, monkeypatch):
    """A bug of the service in flight does not end the soak: it fails that flight, by name."""
    from companion.guidance.pilot import Pilot

    near = tmp_path / "near.toml"
    near.write_text(NEAR.replace("duration_limit_s = 40.0", "duration_limit_s = 3.0"))

    def broken(self: Pilot, *_: Any) -> None:
        raise KeyError(int(np.array(7)))

    monkeypatch.setattr(Pilot, "detect", broken)
    words = ["--virtual", "--runs", "2", "--no-faults"]
    assert main([str(near), *words]) == 1
    output = capsys.readouterr().out
    assert "FAULT: 2 of 2 flights failed" in output
    assert "the service died in flight: KeyError: 7 (test_soak.py:" in output
