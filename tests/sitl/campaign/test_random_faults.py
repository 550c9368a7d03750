"""A campaign of random faults: what it counts, which flights are the worst, and how small a case becomes."""

import json
import tomllib
from collections import Counter
from collections.abc import Sequence
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from companion.cli import main as cli
from sitl.campaign import random_faults
from sitl.campaign.random_faults import FaultTally, shrunk
from sitl.campaign.task import Flight
from sitl.faults.corrupted import SIGNALS, UNSIZED, Corrupted, errors_of
from sitl.faults.drawn import SHARES, Drawable, draw, simpler
from sitl.faults.kinds import AnyFault, CommandStream, LowBattery, OperatorActs, OtherPad, ServiceKilled, WeakRotor
from sitl.scenario.scenario import from_mapping, load
from sitl.scenario.with_fault import as_toml, with_random_faults
from tests.fly import NEAR

GYRO = Corrupted(signal="gyro", error="biased", size=40.0, at_s=3.0)
RANGE = Corrupted(signal="range", error="scaled", size=3.0, at_s=2.0, for_s=8.0)


def test_a_case_keeps_the_fault_that_matters_as_long_and_as_large_as_it_must_be() -> None:
    tried = []

    def fails(faults: Sequence[Any]) -> bool:
        tried.append(tuple(faults))
        return any(f.signal == "range" and f.size >= 2.0 and (f.for_s or 99.0) >= 1.5 for f in faults)

    (left,) = shrunk((GYRO, RANGE), fails)
    assert (left.signal, left.size, left.for_s) == ("range", 2.0, 2.0)
    assert left.at_s == RANGE.at_s
    assert len(tried) <= 12


def test_shrinking_ends_with_its_budget_and_never_with_what_does_not_fail() -> None:
    flown = 0

    def fails(faults: Sequence[Any]) -> bool:
        nonlocal flown
        flown += 1
        return True

    (left,) = shrunk((GYRO, RANGE), fails, 4)
    assert flown == 4
    assert left.for_s is not None
    assert shrunk((GYRO, RANGE), lambda _: False) == (GYRO, RANGE)


THERE = Drawable(SIGNALS, (0.2, 7.0))
SIMPLE = {
    "weak_rotor": WeakRotor(thrust_fraction=0.8, at_s=1.0),
    "commands": CommandStream(dropped_fraction=0.4, in_phase="gate", for_s=4.0),
    "service_killed": ServiceKilled(for_s=2.0, at_s=1.0),
    "low_battery": LowBattery(fraction=0.1, at_s=1.0),
}


def test_every_kind_is_made_simpler_until_nothing_is_left_of_it() -> None:
    """A person's order that ends the flight has no length, and only sticks have a size."""
    for fault in (*SIMPLE.values(), OperatorActs(order="manual", right=0.2, climb=0.1, at_s=1.0)):
        for (weaker,) in simpler((fault,)):
            assert weaker != fault
            assert type(weaker) is type(fault)
            assert (weaker.for_s or 16.0) <= (fault.for_s or 16.0)
    assert [one.thrust_fraction for (one,) in simpler((SIMPLE["weak_rotor"],))] == [0.8, 0.9]  # type: ignore[union-attr]
    assert list(simpler((OperatorActs(order="emergency", at_s=1.0),))) == []
    two = shrunk((OperatorActs(order="land", at_s=1.0), SIMPLE["commands"]), lambda faults: len(faults) == 2, 40)
    assert [fault.kind for fault in two] == ["operator", "commands"]
    assert two[1].dropped_fraction < 0.4


def test_many_seeds_draw_every_kind_and_every_error_that_is_there_and_no_other() -> None:
    drawn = [draw(seed, THERE) for seed in range(8000)]
    every = [fault for faults in drawn for fault in faults]
    corrupted = [fault for fault in every if isinstance(fault, Corrupted)]
    assert SHARES.keys() - {"pad_size"} <= {fault.kind for fault in every}
    assert {(f.signal, f.error) for f in corrupted} == {(s, e) for s in SIGNALS for e in errors_of(s)}
    assert all((f.size == 0.0) == (f.error in UNSIZED) for f in corrupted)
    assert {"hold", "manual", "abort", "land", "emergency", "begin"} == {f.order for f in every if isinstance(f, OperatorActs)}
    pairs = [faults for faults in drawn if len(faults) == 2]
    assert 0.45 < len(pairs) / len(drawn) < 0.55
    assert 0.4 < sum(started(a) == started(b) for a, b in pairs) / len(pairs) < 0.65
    phases = Counter(fault.in_phase for fault in every if fault.in_phase)
    assert min(phases[near] for near in ("gate", "commit", "press")) > max(phases[far] for far in ("intercept", "descend"))
    gyro = Drawable(("gyro",), (0.2, 7.0), rendered=True)
    few = [fault for seed in range(200) for fault in draw(seed, gyro)]
    assert {f.signal for f in few if isinstance(f, Corrupted)} == {"gyro", "commands"}
    assert {f.size for f in few if isinstance(f, OtherPad) and f.instead}


def started(fault: AnyFault) -> tuple[object, ...]:
    return fault.at_s, fault.below_height_m, fault.in_phase


def test_a_wrong_pad_size_names_a_shipped_pad_by_its_name_wherever_the_program_is_installed() -> None:
    drawn = [with_random_faults(load("calm"), seed, "pixels") for seed in range(60)]
    assert {f.file for scenario in drawn for f in scenario.faults if isinstance(f, OtherPad)} == {"thesis"}


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["model", "pixels"]))
def test_a_drawn_fault_is_one_that_a_file_may_hold_and_the_file_flies_the_same(seed: int, level: str) -> None:
    base = load("rendezvous")
    drawn = with_random_faults(base, seed, level)
    faults = drawn.faults
    assert 1 <= len(faults) <= 2
    words = f"{', '.join(fault.words for fault in faults)}: {base.title}".split()
    assert len(drawn.title) <= 120
    assert drawn.title.removesuffix(" ...").split() == words[: len(drawn.title.removesuffix(" ...").split())], "whole words"
    data = tomllib.loads(as_toml("rendezvous", drawn, faults, ["head"]))
    assert data.pop("base") == "rendezvous"
    data |= {
        "vessel": {"reports_hz": 1.0, "reports_place": True},
        "vehicle": {"gnss_hz": 5.0},
        "start": {"height_m": 8.0},
    }  # of the base
    written = from_mapping(data, "written")
    assert (written.faults, written.expect, written.unreached_contacts) == (faults, "either", drawn.unreached_contacts)
    assert drawn.unreached_contacts == any(isinstance(fault, ServiceKilled) for fault in faults)


def flight_row(seed: int, **over: Any) -> Flight:
    touch = {"lateral_m": 0.1 * seed, "lateral_speed_m_s": 1.0 / (1 + seed)}
    own = {
        "scenario": "near",
        "seed": seed,
        "outcome": "landed",
        "grade": "on pad",
        "unsafe": [],
        "highest_m": 7.0 + seed,
        "contacts": [touch],
    }
    return {**own, "faults": [{"kind": "gyro sign", "at_s": 1.0}], "because": "", **over}


def test_shares_and_worst_flights_are_counted_and_reported() -> None:
    tally = FaultTally()
    for seed in range(20):
        tally.take(flight_row(seed))
    tally.take(flight_row(20, grade="failed", unsafe=["flew high"], contacts=[], outcome="gave up"))
    tally.take(flight_row(21, grade="refused rightly", highest_m=None, contacts=[]))
    tally.take(flight_row(22, grade="failed", contacts=[], highest_m=1.0))
    output = tally.as_json()
    assert output["counts"] == {"landed": 20, "refused": 1, "undecided": 1, "unsafe": 1, "error": 0}
    assert [f["seed"] for f in output["worst"]["height"]] == [20, *range(19, 10, -1)]
    assert [f["seed"] for f in output["worst"]["speed"]] == list(range(10))
    assert [f["seed"] for f in output["worst"]["distance"]] == list(range(19, 9, -1))
    assert "20 landed (87.0 %), 1 refused (4.3 %)" in tally.in_words()
    assert "near seed 20, unsafe: gyro sign from 1.0 s" in tally.in_words()
    assert [f["seed"] for f in tally.failing] == [20, 22]


def test_a_campaign_writes_cases_that_fly_again_and_simulate_draws_the_same(tmp_path, monkeypatch, capsys):
    scenario = tmp_path / "near.toml"
    scenario.write_text(NEAR)
    monkeypatch.setattr(random_faults, "verdict_of", lambda flight_row: "unsafe")  # a safe flight stands for an unsafe one
    monkeypatch.setattr(random_faults, "shrunk", lambda faults, fails: shrunk(faults, fails, 2))
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
