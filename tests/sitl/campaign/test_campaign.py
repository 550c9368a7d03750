"""A campaign loses no flight and doubles none, whatever ends it, and its flights do not depend on where they were flown.

Varied keys, causes, comparison, tables and report of campaigns are tested on flights that cost nothing.
"""

import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from companion.cli import main as cli
from estimator.contracts.errors import BadInput, Recoverable
from sitl.campaign.figures import (
    RULES,
    bootstrap_interval,
    by_scenario,
    cause_of,
    differences_of,
    effect_of,
    effects_of,
    in_columns,
    in_rows,
    in_words,
    map_of,
    severity,
    tallies_of,
    wilson,
)
from sitl.campaign.plan import (
    Job,
    Point,
    code_version,
    described,
    differences,
    factorial,
    parse_axis,
    sources_digest,
)
from sitl.campaign.report import REPORT, SEA, VEHICLE, WIND, fly_again, render_map, render_report
from sitl.campaign.store import FLIGHTS, MANIFEST, FolderStore, flights_in, manifest_of, manifest_of_plan
from sitl.campaign.workers import ClusterWorkers, Flight, LocalWorkers, Order, OtherCode, fly_order
from sitl.scenario.overrides import Overridable
from sitl.scenario.scenario import load
from sitl.scenario.settings import settings_for
from tests.fly import NEAR, near
from tests.sitl.campaign.fakes import KILLS, RAISES, fake_fly, plan, tally_of


def flown(seed: int, point: Point = ()) -> Flight:
    return fly_order(Order(Job(seed, point), plan().base(), code_version(), fake_fly))


def keep(folder: Path, seeds: range) -> None:
    with closing(FolderStore(folder, plan(), seeds)) as kept:
        for seed in seeds:
            kept.keep([flown(seed)], 1.0 + seed)


def drive(folder: Path, *args: str, **more: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tests.sitl.campaign.fakes", str(folder), *args]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **more)


def test_processes_that_are_killed_cost_no_flight_and_double_none(tmp_path: Path) -> None:
    reference = tally_of(map(flown, range(12)))
    child = drive(tmp_path, "12", "0.2", "2", start_new_session=True)
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
    assert flights[14]["hash"] == flown(14)["hash"], "the same wherever it is flown"


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
    with pytest.raises(BadInput, match=r"another campaign: scenario.duration_limit_s 40.0 instead of 9.0; nothing"):
        FolderStore(tmp_path, plan(duration_limit_s=9.0), range(2))
    with pytest.raises(BadInput, match="another campaign: name near instead of far;"):
        FolderStore(tmp_path, plan("far"), range(2))
    with closing(FolderStore(tmp_path, plan(), range(2))), pytest.raises(BadInput, match="another campaign is writing"):
        FolderStore(tmp_path, plan(), range(2))
    monkeypatch.setattr("sitl.campaign.plan.code_version", lambda: {**code_version(), "sources": "0" * 32, "numpy": "1.0"})
    with pytest.raises(BadInput, match=r"begun with other code \(sources \w+ instead of 0{32}, numpy \S+ instead of 1.0\)"):
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
    with pytest.raises(OtherCode, match=r"the worker on \S+, process \d+, has other code: sources \w{32} instead of f{32}"):
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


WRONG_USE = [
    (["calm", "--runs", "0"], "--runs must be 1 or more, got 0"),
    (["calm", "--workers", "0"], "--workers must be 1 or more, got 0"),
    (["calm", "--workers", "2", "--scheduler", "tcp://127.0.0.1:1"], "--workers does not go with --scheduler"),
    (["calm", "--set", "wind.sped_m_s=3"], "have a key 'wind.sped_m_s'; did you mean 'wind.speed_m_s'?"),
    (["calm", "--set", "weather.gusts=dryden"], "--set: weather.gusts acts beside weather.wind_m_s or weather.sea_state alone"),
    (["weather_4", "--vary", "wind.model=dryden,gauss_markov"], "--vary: wind.model follows from the weather: set weather.w"),
    (["calm", "--perception", "dreams"], "there is no level 'dreams'"),
    (["clam"], "did you mean 'calm'"),
    (["calm", "calm"], "scenario 'calm' is listed twice"),
    (["gimbal", "--perception", "model"], "gimbal: an AR.Drone has none"),
    (["calm", "--vary", "wind.speed_m_s=0:3:1", "--vary", "wind.speed_m_s=4,5"], "wind.speed_m_s is given twice"),
    (["calm", "--vary", "wind.speed_m_s=4,5", "--set", "wind.speed_m_s=1"], "--set and --vary both give wind.speed_m_s"),
    (["calm", "--against", "x"], "--against goes with --report"),
    (["calm", "--report", "--against", "nothing"], "nothing is no campaign's folder: manifest.json: No such file"),
    (["thirty_faults", "--vary", "wind.speed_m_s=0:4:2"], "--vary goes with one scenario"),
    (["thirty_faults", "--perception", "truth"], "thirty_faults: faults/camera_freezes: the fault frames_frozen acts on vision"),
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
        command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": os.getcwd()}
    )
    assert child.stderr.readline() == "50 flights to fly, by 1 process; results in c\n"
    child.send_signal(signal.SIGINT)
    _, output = child.communicate(timeout=60)
    assert child.returncode == 130
    assert " flights are kept in c; the same command goes on from there" in output


def test_a_worker_that_is_born_after_its_campaign_reports_nothing_and_an_error_of_ours_is_reported() -> None:
    source = "import sitl.campaign.unborn; raise {}"
    for error, reported in (("FileNotFoundError(2, 'no semaphore')", False), ("EOFError", False), ("ImportError('ours')", True)):
        run = [sys.executable, "-c", source.format(error)]
        ended = subprocess.run(run, capture_output=True, text=True, check=False, timeout=60)
        assert (ended.returncode, "ImportError: ours" in ended.stderr, bool(ended.stderr)) == (1, reported, reported)


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


AT = "--vary"


def overridable() -> Overridable:
    return Overridable(near(), settings_for(near(), None))


def test_a_factorial_design_combines_all_values() -> None:
    given = overridable()
    axes = [parse_axis(t, given, AT) for t in ("wind.speed_m_s=0:1:0.1", "vessel.moored=true,false", "sea.peak_period_s=8:4:-2")]
    points = factorial(axes)
    assert len(points) == 11 * 2 * 3
    assert axes[0].values[3] == 0.3
    assert axes[2].values == (8.0, 6.0, 4.0)
    assert dict(points[1]) == {"wind.speed_m_s": 0.0, "vessel.moored": True, "sea.peak_period_s": 6.0}
    assert factorial([]) == [()]
    whole = parse_axis("vision.threads=1:3:1", given, AT)
    assert whole.values == (1, 2, 3)
    assert all(isinstance(v, int) for v in whole.values)
    calm = Overridable(load("calm"), given.settings)
    axes = [parse_axis(text, calm, AT) for text in ("sea.sea_state=0:4:2", "vessel.file=patrol_boat")]
    flown_on, _ = calm.with_values(factorial(axes)[1], AT)
    assert (flown_on.sea.sea_state, flown_on.vessel.file, flown_on.vessel.hull) == (2, "patrol_boat", None)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("wind.speed=0:1:1", "have a key 'wind.speed'; did you mean 'wind.speed_m_s'?"),
        ("wind.speed_m_s", "write KEY=LOW:HIGH:STEP or KEY=A,B,C"),
        ("wind.speed_m_s=0:1:0", "steps of 0 do not lead from 0 to 1"),
        ("wind.speed_m_s=0:1:-1", "steps of -1 do not lead from 0 to 1"),
        ("wind.speed_m_s=0:1:2:3", "a range is LOW:HIGH:STEP"),
        ("wind.speed_m_s=0:9999999:1", "are more than 1000000"),
        ("wind.speed_m_s=a:2:1", "needs a number, found 'a'"),
        ("vessel.moored=1,2", "is true or false, found '1'"),
    ],
)
def test_a_wrong_axis_is_refused(text: str, said: str) -> None:
    with pytest.raises(BadInput) as why:
        parse_axis(text, overridable(), AT)
    assert said in str(why.value)


def test_each_failure_has_the_cause_of_the_first_rule_that_fits() -> None:
    fine = flown(3)
    off = {**fine["touchdown"], "surface": "deck", "on_pad": False}
    away: dict[str, Any] = {"landed_on_pad": False, "touchdown": None, "contacts": []}
    cases: dict[str, dict[str, Any]] = {
        "the flight raised an error": flown(RAISES),
        "the service died in flight": {"referee": {"died": [1, 0]}},
        "in the water": {"in_water": True, "referee": {"blind_m": [2.0, 0.5]}},
        "came down without sight of the pad": {"referee": {"blind_m": [0.8, 0.5]}},
        "struck the deck beside the pad, then landed on the pad": {"contacts": [off, *fine["contacts"]]},
        "a person was overruled": {"referee": {"disobeyed_s": [0.4, 0.3]}},
        "touched the pad harder than it bears": {"referee": {"into_deck_m_s": [1.29, 1.0]}},
        "landed beside the pad": {"landed_on_pad": False, "touchdown": off, "contacts": [off]},
        "struck the deck beside the pad and did not land": {**away, "outcome": "gave up", "contacts": [off]},
        "gave up, though it should land: no pad": {**away, "outcome": "gave up", "refused": "no pad at 0.1 m; frames"},
        "time ran out": {**away, "outcome": "time ran out"},
        "ended otherwise: emergency": {**away, "outcome": "emergency"},
    }
    flights = [{**fine, "grade": "failed", **differs} for differs in cases.values()]
    assert [cause_of(flight) for flight in flights] == list(cases)
    order = [severity(flight) for flight in flights]
    assert order == sorted(order, reverse=True)
    assert len(cases) == len(RULES) + 1
    assert severity(fine) == 0


@pytest.mark.parametrize("unsafe", [True, False])
def test_bad_flights_are_counted_named_and_reported(unsafe: bool) -> None:
    """A flight that landed well after a contact that nobody intended is no good flight, and one can find it again."""
    why, word = "touched the pad at 0.55 m/s along it", "UNSAFE" if unsafe else "FAILED"
    flights = [flown(seed, (("wind.speed_m_s", 1.0),)) for seed in range(12)]
    for seed in (4, 1):
        bad = {"unsafe": [why], "contacts_outside_commit": 1} if unsafe else {"because": why}
        flights[seed] |= {"grade": "failed", **bad}
    summary = tally_of(reversed(flights)).summary("near", "truth", 1.0)
    assert (summary["unsafe"], summary["failed"], summary["contacts_outside_commit"]) == (2 * unsafe, 2, 2 * unsafe)
    assert [one["seed"] for one in summary["unsafe_flights" if unsafe else "failed_flights"]] == [1, 4]
    assert f"{word} near seed 1, wind.speed_m_s 1.0: {why}\n{word} near seed 4" in in_words(summary)
    page = render_report({**manifest_of_plan(plan(), range(12), None)}, flights, 1.0)
    assert page.count(escape(why)) == 2 * unsafe
    many = tally_of({**flights[1], "seed": seed} for seed in range(2500)).summary("near", "truth", 1.0)
    assert [one["seed"] for one in many["unsafe_flights" if unsafe else "failed_flights"]] == list(range(100))
    assert "and 2490 more" in in_words(many)


def test_campaigns_are_compared_seed_by_seed() -> None:
    ours = [flown(seed, (("wind.speed_m_s", 1.0),)) for seed in range(31)]
    other = [{**flown(seed), "varied": {"wind.speed_m_s": 1.0}} for seed in range(10, 40)]
    rows = {row.name: row for row in differences_of(ours, other)}
    error = rows["standing error"]
    assert error.pairs == 20, "one of them raises"
    assert error.mean == pytest.approx(0.06, abs=1e-6)
    assert (error.low, error.high) == pytest.approx((0.06, 0.06), abs=1e-6)
    assert error.clear
    assert not any(row.clear for row in (rows["on the pad"], *differences_of(ours[:29], other))), "or of too few pairs"
    assert differences_of(ours[:10], other) == []
    noise = np.random.default_rng(1).normal(0.3, 1.0, 400)
    low, high = bootstrap_interval(noise)
    assert (low, high) == pytest.approx((noise.mean() - 1.96 * 0.05, noise.mean() + 1.96 * 0.05), abs=0.012)


def graded(varied: Mapping[str, Any], good: bool, error_m: float | None) -> Flight:
    """Return a flight that landed this far off, or did not land."""
    touch = None if error_m is None else {**flown(3)["touchdown"], "lateral_m": error_m}
    grade = "on pad" if good else "failed"
    return {**flown(3), "varied": varied, "grade": grade, "landed_on_pad": touch is not None, "touchdown": touch}


def test_success_against_one_and_two_keys() -> None:
    grid = [({"a": a, "b": b}, a + b < 3, 0.1 * a if a + b < 3 else None) for a in range(3) for b in range(3)]
    tallies = tallies_of(graded(*point) for point in grid)
    assert list(effects_of(tallies)) == ["a", "b"]
    one = effect_of(tallies, "a")
    assert [row["value"] for row in one] == [0, 1, 2]
    assert [row["good"] for row in one] == pytest.approx([1.0, 2 / 3, 1 / 3], abs=1e-6)
    assert [row["standing_median_m"] for row in one] == pytest.approx([0.0, 0.1, 0.2])
    assert map_of(tallies, "a", "b").shares.tolist() == [[1, 1, 1], [1, 1, 0], [1, 0, 0]]
    scattered = tallies_of(graded({"a": x, "b": 1.0 - x}, x < 0.5, None) for x in np.linspace(0.0, 1.0, 81).tolist())
    assert [row["good"] for row in effect_of(scattered, "a")] == [1, 1, 1, 1, 0, 0, 0, 0]
    assert np.isnan(map_of(scattered, "a", "b").shares[0, 0]), "no flight was there"
    assert effects_of({}) == {}


def test_success_by_value_and_by_scenario_is_a_table_and_plain_values() -> None:
    flights = [flown(seed, (("wind.speed_m_s", speed), ("vessel.moored", True))) for seed in range(4) for speed in (0.0, 7.0)]
    tallies = tallies_of(flights)
    effects = effects_of(tallies)
    assert in_rows(effects).splitlines() == [
        "wind.speed_m_s  flights   good  95 % interval  error, median",
        "             0        4  100 %    51 to 100 %         2.5 cm",
        "             7        4    0 %      0 to 49 %              -",
        "vessel.moored  flights  good  95 % interval  error, median",
        "         True        8  50 %     22 to 78 %         2.5 cm",
    ]
    idle = effects_of(tallies_of(flown(seed, (("vessel.moored", moored),)) for seed in range(4) for moored in (True, False)))
    assert in_rows(idle).endswith("\nvessel.moored: every flight is the same at all its values; it does not act here")
    acts = ({**flown(1, (("vessel.moored", moored),)), "highest_m": 4.0 + moored} for moored in (True, False))
    assert "every flight" not in in_rows(effects_of(tallies_of(acts))), "the same median is not the same flight"
    wind = effects["wind.speed_m_s"]
    assert [(row["value"], row["runs"], row["good"]) for row in wind] == [(0.0, 4, 1.0), (7.0, 4, 0.0)]
    assert wind[1]["standing_median_m"] is None
    (row,) = by_scenario({"near": {"scenario": {"expect": "go_around"}, "perception": "truth"}}, tallies)
    assert in_columns([row]).splitlines()[1] == (
        "near      go around  truth        8       4        0       4               0      0       4  4 landed beside the pad"
    )
    assert row["causes"] == {"landed beside the pad": 4}


def test_the_report_of_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    axes = [parse_axis(t, overridable(), AT) for t in ("wind.speed_m_s=0:8:2", "sea.peak_period_s=4:8:2")]
    varied = described("factorial", axes)
    for name, seeds, level in (("now", range(6), "truth"), ("before", range(3, 9), "model")):
        with closing(FolderStore(tmp_path / name, replace(plan(), design=varied, perception=level), seeds)) as store:
            for seed in seeds:
                store.keep([flown(seed, point) for point in factorial(axes)], 1.0 + seed)
            assert store.wall_s(45) == pytest.approx(0.5 * seeds.stop), "the share of half of the flights"
    command = ["campaign", "report", str(tmp_path / "now"), "--against", str(tmp_path / "before")]
    assert cli.main(command) == 0
    assert capsys.readouterr().out == f"report: {tmp_path / 'now' / REPORT}\n"
    page = (tmp_path / "now" / REPORT).read_text()
    whole = tally_of(flights_in(tmp_path / "now" / "flights.jsonl"))
    for output in (
        "60 of 90 on the pad",
        "landed beside the pad",
        "decklander simulate near --seed 5 --set wind.speed_m_s=8.0 --set sea.peak_period_s=4 --report flight-near-5-wind",
        "<td>perception</td><td>model</td><td>truth</td>",
        "One factor",
        "Two factors",
        "may be chance",
        whole.hash,
    ):
        assert output in page
    assert page.count("<svg") == 1 + 1 + 4 + 2 + 1
    assert "http" not in page.replace("http://www.w3.org", ""), "the page needs nothing else"
    assert [flight["grade"] for flight in whole.worst] == ["failed"] * 10
    stood = [{**flown(n), "standing": {"lateral_m": off_m}} for n, off_m in enumerate((0.02, 0.05, 0.03))]
    assert [flight["seed"] for flight in tally_of(stood).worst] == [1, 2, 0], "as the report shows them"
    assert [cli.main(["campaign", "report", *folder]) for folder in ([str(tmp_path)], [])] == [2, 2]
    with pytest.raises(BadInput, match="no flights yet"):
        render_report(manifest_of(tmp_path / "now"), [], 0.0)
    assert fly_again(flown(3), ("--config", "a b.toml")).endswith("--seed 3 --config 'a b.toml' --report flight-near-3")


def test_a_map_shows_what_lands_how_well_and_why_not() -> None:
    leans = "it leans by 17.9 deg against the wind (limit 15 deg); frames: none"
    flights = [
        graded({VEHICLE: "quad", SEA: 4, WIND: wind}, True, error_m) | {"refused": leans if error_m is None else None}
        for wind, error_m in ((6.0, 0.02), (6.0, 0.04), (9.0, None))
    ]
    page = render_map("weather_4", "model", flights)
    for output in ("2/2", "3.0, 3.9 cm", "0/1", "1 refused: it leans against the wind", "sea state 4", "9 m/s"):
        assert output in page
    with pytest.raises(BadInput, match="a map needs flights that vary"):
        render_map("weather_4", "model", [flown(1)])


@contextmanager
def worker_program(*args: str, ready: str, **env: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run a program of Dask until the end of the context; the text is the line in which it says that it is ready."""
    more = {**os.environ, "PYTHONPATH": os.getcwd(), **env}
    child = subprocess.Popen([sys.executable, "-m", *args], stderr=subprocess.PIPE, text=True, env=more)
    try:
        line = next((line for line in child.stderr if ready in line), "")
        assert line, f"{args} ended before it was ready"
        yield child, line
    finally:
        child.kill()
        child.communicate()


def worker(address: str, name: str, **env: str):
    command = ("distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", "--name", name)
    return worker_program(*command, ready="Registered to", **env)


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Yield a scheduler with one worker, and its address. The last test here ends it."""
    command = ("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
    with worker_program(*command, ready="Scheduler at") as (head, line):
        address = re.search(r"tcp://\S+", line)[0]
        with worker(address, "one"):
            yield head, address


def test_a_cluster_gives_the_same_results_although_a_worker_is_killed(served) -> None:
    own, (_, address) = plan(start={"height_m": 2.1}), served
    seeds = range(RAISES - 12, RAISES + 13)
    alone = tally_of(fly_order(Order(Job(seed), own.base(), code_version(), fake_fly)) for seed in seeds)
    with worker(address, "two") as (victim, _), ClusterWorkers(own, code_version(), address, fake_fly) as cluster:
        assert cluster.threads == 2
        flights = []
        for flight in cluster.results(map(Job, seeds)):
            flights.append(flight)
            if len(flights) == 5:
                victim.kill()
    assert sorted(flight["seed"] for flight in flights) == list(seeds)
    assert tally_of(flights).hash == alone.hash
    assert tally_of(flights).counts["errors"] == 1


def test_orders_that_a_broken_connection_cancelled_are_given_again(served) -> None:
    own = plan(start={"height_m": 2.2})
    seeds = range(RAISES + 1, RAISES + 13)
    with ClusterWorkers(own, code_version(), served[1], fake_fly) as cluster:
        flights = []
        for flight in cluster.results(map(Job, seeds)):
            flights.append(flight)
            if len(flights) == 3:
                client = cluster._client
                client.loop.add_callback(client.scheduler_comm.comm.abort)
    assert sorted(flight["seed"] for flight in flights) == list(seeds)


def test_a_worker_of_the_cluster_with_other_code_is_refused_by_name(served) -> None:
    other = {**code_version(), "sources": "0" * 32}
    with pytest.raises(OtherCode, match=r"worker tcp://\S+ has other code: sources \w{32} instead of 0{32}"):
        ClusterWorkers(plan(), other, served[1], fake_fly)


def test_no_scheduler_and_a_wrong_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sitl.campaign.workers._CONNECT_S", 1.0)
    assert cli.main(["campaign", "calm", "--runs", "2", "--scheduler", "tcp://127.0.0.1:9"]) == 1
    output = capsys.readouterr().err
    assert "--scheduler tcp://127.0.0.1:9: no scheduler answers there" in output
    assert output.count("\n") == 1
    with pytest.raises(BadInput, match="write it as tcp://host:8786"):
        ClusterWorkers(plan(), code_version(), "carrier-pigeon://x", fake_fly)


def test_a_scheduler_that_dies_is_one_clear_line(served) -> None:
    own, (head, address) = plan(start={"height_m": 2.3}), served
    with ClusterWorkers(own, code_version(), address, fake_fly) as cluster:
        flights = cluster.results(map(Job, range(40)))
        next(flights)
        head.kill()
        began_s = time.monotonic()
        with pytest.raises(Recoverable, match=rf"--scheduler {address}: the scheduler is gone; the same command goes on"):
            list(flights)
        assert time.monotonic() - began_s < 60.0
