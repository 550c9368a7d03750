"""Campaigns of a set, each scenario at its own level with its own line, and of faults that a seed draws."""

import json
import math
import re
import shlex
import tomllib
from collections import Counter
from collections.abc import Sequence
from html import unescape
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.cli import main as cli
from decklander.place import SHIPPED
from estimator.contracts.errors import BadInput
from sitl.campaign import random_faults
from sitl.campaign.plan import digest_of, is_set, load_set, make_plan, shipped_sets
from sitl.campaign.random_faults import FaultTally, shrunk
from sitl.campaign.report import REPORT
from sitl.campaign.workers import Flight
from sitl.faults.carried import refuse_others
from sitl.faults.corrupted import SIGNALS, UNSIZED, Corrupted, errors_of
from sitl.faults.drawn import SHARES, Drawable, draw, simpler
from sitl.faults.kinds import AnyFault, CommandStream, Failsafe, LowBattery, OperatorActs, OtherPad, ServiceKilled, WeakRotor
from sitl.perception.levels import perceive
from sitl.scenario.overrides import Overridable
from sitl.scenario.scenario import from_mapping, load
from sitl.scenario.scenario import load as load_scenario
from sitl.scenario.settings import rig_for, settings_for
from sitl.scenario.with_fault import as_toml, with_random_faults
from tests.fly import NEAR

TWO = 'title = "two"\nperception = "truth"\n[[scenario]]\nname = "near.toml"\n[[scenario]]\nname = "held.toml"\n'


def set_file(folder: Path, text: str = TWO) -> str:
    (folder / "near.toml").write_text(NEAR)
    (folder / "held.toml").write_text(
        'title = "held"\nbase = "near.toml"\nexpect = "hold"\nduration_limit_s = 2.0\n[[faults]]\nkind = "operator"\nat_s = 0.5\n'
    )
    path = folder / "two.toml"
    path.write_text(text)
    return str(path)


def test_a_set_is_flown_scenario_by_scenario_into_one_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chosen, out = set_file(tmp_path), str(tmp_path / "out")
    command = ["campaign", chosen, "--runs", "2", "--workers", "1", "--out", out]
    code = cli.main([*command, "--json"])
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    flights, summary = lines[:-1], lines[-1]["summary"]
    assert [(f["scenario"], f["seed"], f["perception"]) for f in flights] == [
        ("near.toml", 0, "truth"), ("near.toml", 1, "truth"), ("held.toml", 0, "truth"), ("held.toml", 1, "truth"),
    ]  # fmt: skip
    assert all(f["grade"] == "refused rightly" for f in flights[2:])
    assert code == (0 if all(f["grade"] != "failed" for f in flights) else 1)
    held = summary["scenarios"][1]
    assert [held[key] for key in ("scenario", "expect", "runs", "refused")] == ["held.toml", "hold", 2, 2]
    assert cli.main(command) == code
    output = capsys.readouterr()
    assert "4 of 4 flights are there already" in output.err
    assert [line.split()[0] for line in output.out.splitlines()[:3]] == ["scenario", "near.toml", "held.toml"]
    assert summary["hash"] in output.out


def test_the_report_of_a_set_prints_commands_that_fly_the_same_flights_again(tmp_path, capsys):
    chosen, out = set_file(tmp_path, TWO.replace('[[scenario]]\nname = "near.toml"\n', "")), tmp_path / "out"
    own = ["--set", "wind.speed_m_s=3.5", "--set", "guidance.cone.descent_rate_m_s=0.4"]
    assert cli.main(["campaign", chosen, "--runs", "2", "--workers", "1", "--out", str(out), *own, "--report", "--json"]) == 0
    flights = [json.loads(line) for line in capsys.readouterr().out.splitlines()][:-1]
    page = (out / REPORT).read_text()
    assert "Those by truth render none" in page
    assert " to the bit, and writes its report" in page
    commands = [shlex.split(unescape(text)) for text in re.findall("<code>(.*?)</code>", page)]
    assert len(commands) == 2
    for words in commands:
        assert words[-2] == "--report"
        assert cli.main([*words[1:-2], "--json"]) == 0
        again = json.loads(capsys.readouterr().out)
        flight = next(f for f in flights if f["seed"] == again["seed"])
        apart = {"cpu_s", "scenario"}
        assert again["scenario"] == str(tmp_path / flight["scenario"])
        assert {k: v for k, v in again.items() if k not in apart} == {k: flight[k] for k in again if k not in apart}
    for limit_s, now in (("2.0", ""), ("3.0", "members.held.toml.scenario.duration_limit_s 3.0 instead of 2.0")):
        (tmp_path / "held.toml").write_text((tmp_path / "held.toml").read_text().replace("limit_s = 2.0", f"limit_s = {limit_s}"))
        assert cli.main(["campaign", "report", str(out)]) == 0
        page, said = (out / REPORT).read_text(), capsys.readouterr().err
        assert (" to the bit, and writes" in page, now in page, now in said, bool(said)) == (not now, True, True, bool(now))


@pytest.mark.parametrize("name", shipped_sets())
def test_shipped_sets_load_and_every_scenario_acts_at_its_level(name: str) -> None:
    chosen, scenarios = load_set(name)
    assert is_set(name)
    for member in chosen.scenario:
        perceive(chosen.level(member)).refuse(scenarios[member.name].faults)


def test_a_set_may_give_its_scenarios_another_base(tmp_path: Path) -> None:
    path = set_file(tmp_path, TWO.replace('[[scenario]]\nname = "near.toml"\n', 'base = "sea_state_4"\n'))
    _, scenarios = load_set(path)
    rough = load_scenario("sea_state_4")
    assert scenarios["held.toml"].sea == rough.sea
    assert scenarios["held.toml"].expect == "hold"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('title = "x"\nscenario = []\n', "scenario"),
        (TWO + '[[scenario]]\nname = "near.toml"\n', "scenario 'near.toml' is listed twice"),
        (TWO.replace("held.toml", "hald.toml"), "scenario[1].name: "),
        (TWO.replace('"truth"', '"eyes"'), 'perception must be one of "model", "pixels", "truth", found "eyes"'),
        (TWO + 'level = "x"\n', "scenario"),
    ],
)
def test_what_is_wrong_with_a_set_is_named(tmp_path: Path, text: str, said: str) -> None:
    path = set_file(tmp_path, text)
    with pytest.raises(BadInput) as why:
        load_set(path)
    assert str(why.value).startswith(f"{path}: ")
    assert said in str(why.value)


ROWS = "time_s,surge_m,sway_m,heave_down_m,roll_deg,pitch_deg,yaw_deg\n"


def recorded(folder: Path, heave_m: float) -> Path:
    """Return a scenario on a vessel that moves as recorded."""
    rows = "".join(f"{0.5 * n},0,0,{heave_m if n == 7 else 0},0,0,0\n" for n in range(200))
    (folder / "motion.csv").write_text(ROWS + rows)
    (folder / "boat.toml").write_text(
        'title = "boat"\nsource = "a test"\nlength_m = 8\nbeam_m = 3\ndraught_m = 0.4\nfreeboard_m = 0.6\n'
        '[recording]\nfile = "motion.csv"\n'
    )
    path = folder / "recorded.toml"
    path.write_text('title = "x"\nduration_limit_s = 40\n[vessel]\nfile = "boat.toml"\nmoored = false\n')
    return path


def test_a_changed_recording_behind_the_vessels_file_is_another_campaign(tmp_path: Path) -> None:
    plans = []
    for heave_m in (0.1, 0.1, 0.2):
        scenario = load(recorded(tmp_path, heave_m))
        plans.append(make_plan("recorded", scenario, settings_for(scenario, None), "truth"))
    assert "scenario: vessel: recording" in plans[0].files
    assert digest_of(plans[0]) == digest_of(plans[1])
    assert digest_of(plans[0]) != digest_of(plans[2])
    assert {key for key in plans[0].files if plans[0].files[key] != plans[2].files[key]} == {"scenario: vessel: recording"}


def test_the_settings_follow_the_scenarios_camera_and_pad() -> None:
    scenario = load("calm")
    given = Overridable(scenario, settings_for(scenario, None))

    def files(*texts: str) -> tuple[str, str, str]:
        own, settings = given.with_values([given.parse(text, "--set") for text in texts], "--set")
        return tuple(Path(file).stem for file in (own.camera.file, settings.camera.file, settings.pad.file))  # type: ignore[return-value]

    assert files() == ("sim", "sim", "thesis")
    assert files("camera.file=usb_640x480") == ("usb_640x480", "usb_640x480", "thesis")
    assert files("pad.file=printed") == ("sim", "sim", "printed")
    assert files("camera.file=usb_640x480", "settings.camera.file=sim") == ("usb_640x480", "sim", "thesis")
    assert files("settings.camera.file=usb_640x480") == ("sim", "usb_640x480", "thesis")
    assert files("settings.camera.file=usb_640x480", "vehicle.file=hexa_7kg") == ("sim", "usb_640x480", "thesis")
    with pytest.raises(BadInput, match=r"nothing\.toml"):
        make_plan("x", *given.with_values([("camera.file", "nothing.toml")], "--set"), "truth")
    assert (SHIPPED / "cameras" / "usb_640x480.toml").is_file()


@pytest.mark.parametrize("of_a_file", [False, True])
def test_settings_that_follow_the_scenario_follow_its_other_vehicle_and_ship(of_a_file: bool) -> None:
    scenario = load("calm")
    rig = rig_for(scenario, str(SHIPPED / "ardrone1.toml") if of_a_file else None)
    scenario, own = rig.scenario, rig.settings
    wanted = [
        ("vehicle.file", "hexa_7kg"),
        ("vessel.reports_place", True),
        ("vessel.reports_hz", 1.0),
        ("guidance.cone.gate_height_m", 0.4),
    ]
    _, settings = Overridable(scenario, own, own=of_a_file).with_values(wanted, "--set")
    cone, follow = settings.guidance.cone, settings.guidance.follow_deck
    assert cone.gate_height_m == 0.4
    assert (cone.feet_below_m, follow.response, settings.guidance.rendezvous.enabled) == (
        (0.25, own.guidance.follow_deck.response, False) if of_a_file else (0.25, "hexa_7kg", True)
    )


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
    own = {"pad_size", "level", "landing", "late_order", "failsafe"}
    assert SHARES.keys() - own | {"corrupted", "operator"} <= {fault.kind for fault in every}
    assert "failsafe" not in {fault.kind for fault in every}, "an AR.Drone has none"
    assert {(f.signal, f.error) for f in corrupted} == {(s, e) for s in SIGNALS for e in errors_of(s)}
    assert all((f.size == 0.0) == (f.error in UNSIZED) for f in corrupted)
    acts = [fault for fault in every if isinstance(fault, OperatorActs)]
    assert {"hold", "manual", "abort", "land", "emergency", "begin", "stay"} == {act.order for act in acts}
    assert {act.order for act in acts if act.late_s} == {"begin", "stay", "land"}
    levels = {f.signal for f in corrupted if f.error == "biased" and f.at_s == 0.0}
    assert {"velocity", "range", "gyro", "ship_velocity"} <= levels, "wrong from the first sample on, and never a leap"
    mounts = {abs(f.size) for f in corrupted if (f.signal, f.error, f.at_s) == ("sighting", "biased", 0.0)}
    assert 0.0 < max(mounts) <= 0.05, "a camera that sits elsewhere than its file says shows in nothing on board"
    late = [f.for_s for f in corrupted if (f.signal, f.error) == ("commands", "late") and f.size > 0.4]
    assert all(for_s is not None and for_s <= 0.5 for for_s in late), "nobody flies an axis that is late by a second"
    drifts = [f for f in corrupted if (f.signal, f.error) == ("commands", "drifting")]
    assert all(abs(f.size) * (f.for_s or math.inf) <= 0.31 for f in drifts), "nor one that drifts to a full stick"
    leaps = [f.size for f in corrupted if (f.signal, f.error, f.in_phase) == ("sighting", "biased", "intercept")]
    assert max(map(abs, leaps)) <= 0.05, "before a pad's place is known no leap of it is seen"
    others = [faults for faults in drawn if not any(isinstance(fault, OperatorActs) for fault in faults)]
    pairs = [faults for faults in others if len(faults) == 2]
    assert 0.35 < len(pairs) / len(others) < 0.55
    assert 0.4 < sum(started(a) == started(b) for a, b in pairs) / len(pairs) < 0.65
    phases = Counter(fault.in_phase for fault in every if fault.in_phase)
    assert min(phases[near] for near in ("gate", "commit", "press")) > max(phases[far] for far in ("intercept", "descend"))
    gyro = Drawable(("gyro",), (0.2, 7.0), rendered=True)
    few = [fault for seed in range(200) for fault in draw(seed, gyro)]
    assert {f.signal for f in few if isinstance(f, Corrupted)} == {"gyro", "commands"}
    assert {f.size for f in few if isinstance(f, OtherPad) and f.instead}


def test_an_autopilots_faults_are_those_that_act_beside_it() -> None:
    drawn = [with_random_faults(load("rendezvous"), seed, "model", autopilot=True).faults for seed in range(600)]
    every = [fault for faults in drawn for fault in faults]
    for faults in drawn:
        refuse_others("drawn", faults, "stand-in")
    assert {fault.kind for fault in every} > {"failsafe", "corrupted", "operator", "service_killed", "low_battery"}
    assert {f.takes for f in every if isinstance(f, Failsafe)} == {"land", "hold"}
    assert {f.order for f in every if isinstance(f, OperatorActs)} > {"mode", "disarm", "land"}
    assert {f.signal for f in every if isinstance(f, Corrupted)} > {"barometer", "range", "commands"}
    with pytest.raises(BadInput, match=r"low_battery.*cannot act: a program has"):
        refuse_others("it", [LowBattery(at_s=1.0)], "program")


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
    assert 1 <= len(faults) <= 4, "a person orders one thing after the other"
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
