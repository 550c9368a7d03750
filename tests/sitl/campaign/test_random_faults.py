"""A campaign of random faults: what it counts, which flights are the worst, and how small a case becomes."""

import json
import tomllib
from collections.abc import Sequence
from typing import Any

from companion.cli import main as cli
from sitl.campaign import random_faults
from sitl.campaign.random_faults import FaultTally, shrunk
from sitl.campaign.task import Flight
from sitl.faults.corrupted import Corrupted
from tests.sitl.near import NEAR

GYRO = Corrupted(signal="gyro", error="biased", size=40.0, at_s=3.0)
RANGE = Corrupted(signal="range", error="scaled", size=3.0, at_s=2.0, for_s=8.0)


def test_a_case_keeps_the_fault_that_matters_as_long_and_as_large_as_it_must_be() -> None:
    tried = []

    def fails(faults: Sequence[Corrupted]) -> bool:
        tried.append(tuple(faults))
        return any(f.signal == "range" and f.size >= 2.0 and (f.for_s or 99.0) >= 1.5 for f in faults)

    (left,) = shrunk((GYRO, RANGE), fails)
    assert (left.signal, left.size, left.for_s) == ("range", 2.0, 2.0)
    assert left.at_s == RANGE.at_s
    assert len(tried) <= 12


def test_shrinking_ends_with_its_budget_and_never_with_what_does_not_fail() -> None:
    flown = 0

    def fails(faults: Sequence[Corrupted]) -> bool:
        nonlocal flown
        flown += 1
        return True

    (left,) = shrunk((GYRO, RANGE), fails, 4)
    assert flown == 4
    assert left.for_s is not None
    assert shrunk((GYRO, RANGE), lambda _: False) == (GYRO, RANGE)


def flight(seed: int, **over: Any) -> Flight:
    touch = {"lateral_m": 0.1 * seed, "lateral_speed_m_s": 1.0 / (1 + seed)}
    own = {"seed": seed, "outcome": "landed", "grade": "on pad", "unsafe": [], "highest_m": 7.0 + seed, "contacts": [touch]}
    return {**own, "faults": [{"kind": "gyro sign", "at_s": 1.0}], "because": "", **over}


def test_shares_and_worst_flights_are_counted_and_reported() -> None:
    tally = FaultTally()
    for seed in range(20):
        tally.take(flight(seed))
    tally.take(flight(20, grade="failed", unsafe=["flew high"], contacts=[], outcome="gave up"))
    tally.take(flight(21, grade="refused rightly", highest_m=None, contacts=[]))
    tally.take(flight(22, grade="failed", contacts=[], highest_m=1.0))
    output = tally.as_json()
    assert output["counts"] == {"landed": 20, "refused": 1, "undecided": 1, "unsafe": 1, "error": 0}
    assert [f["seed"] for f in output["worst"]["height"]] == [20, *range(19, 10, -1)]
    assert [f["seed"] for f in output["worst"]["speed"]] == list(range(10))
    assert [f["seed"] for f in output["worst"]["distance"]] == list(range(19, 9, -1))
    assert "20 landed (87.0 %), 1 refused (4.3 %)" in tally.in_words()
    assert "seed 20, unsafe: gyro sign from 1.0 s" in tally.in_words()
    assert [f["seed"] for f in tally.failing] == [20, 22]


def test_a_campaign_writes_cases_that_fly_again_and_simulate_draws_the_same(tmp_path, monkeypatch, capsys):
    scenario = tmp_path / "near.toml"
    scenario.write_text(NEAR)
    monkeypatch.setattr(random_faults, "verdict_of", lambda flight: "unsafe")  # a safe flight stands for an unsafe one
    common = [str(scenario), "--perception", "model", "--seed", "3", "--json", "--faults", "random"]
    cli.main(["campaign", *common, "--runs", "1", "--workers", "1", "--out", str(tmp_path / "out")])
    flown, summary = map(json.loads, capsys.readouterr().out.splitlines())
    assert summary["summary"]["random_faults"]["counts"]["unsafe"] == 1
    case = tmp_path / "out" / "unsafe-3.toml"
    assert tomllib.loads(case.read_text())["base"] == str(scenario)
    again = case.read_text().splitlines()[2].removeprefix("# decklander ").replace("FILE", str(case)).split()
    assert again == ["simulate", str(case), "--seed", "3", "--perception", "model"]
    cli.main([*again, "--json"])
    assert json.loads(capsys.readouterr().out)["unsafe"] == []
    cli.main(["simulate", *common])
    assert json.loads(capsys.readouterr().out)["contacts"] == flown["contacts"]
