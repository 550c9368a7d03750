"""Campaigns of a set: each scenario at its own level with its own line, one folder, one hash."""

import json
import re
import shlex
from html import unescape
from pathlib import Path

import pytest

from companion.cli import main as cli
from companion.settings.load import SHIPPED
from estimator.contracts.errors import BadInput
from sitl.campaign.overrides import Overridable
from sitl.campaign.plan import digest_of, is_set, load_set, make_plan, shipped_sets
from sitl.campaign.report import REPORT
from sitl.flight.one_flight import settings_for
from sitl.perception.levels import perceive
from sitl.scenario.scenario import load
from sitl.scenario.scenario import load as load_scenario
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
    assert [(s["scenario"], s["expect"], s["runs"], s["refused"]) for s in summary["scenarios"][1:]] == [
        ("held.toml", "hold", 2, 2)
    ]
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
    own = settings_for(scenario, str(SHIPPED / "ardrone1.toml") if of_a_file else None)
    wanted = [
        ("vehicle.file", "hexa_7kg"),
        ("vessel.reports_place", True),
        ("vessel.reports_hz", 1.0),
        ("guidance.cone.gate_height_m", 0.4),
    ]
    _, settings = Overridable(scenario, own).with_values(wanted, "--set")
    cone, follow = settings.guidance.cone, settings.guidance.follow_deck
    assert cone.gate_height_m == 0.4
    assert (cone.feet_below_m, follow.response, settings.guidance.rendezvous.enabled) == (
        (own.guidance.cone.feet_below_m, own.guidance.follow_deck.response, False) if of_a_file else (0.25, "hexa_7kg", True)
    )
