"""Varied keys, causes, comparison, tables and report of campaigns, on flights that cost nothing."""

import math
from contextlib import closing
from html import escape
from pathlib import Path

import numpy as np
import pytest

from companion.cli import main as cli
from estimator.contracts.errors import BadInput
from sitl.campaign.code import code_version
from sitl.campaign.figures import (
    as_json,
    bootstrap_interval,
    by_value,
    differences_of,
    effect_of,
    figures_of,
    in_rows,
    map_of,
    varied_point,
)
from sitl.campaign.overrides import Overridable, Point, described, factorial, parse_axis
from sitl.campaign.plan import Job
from sitl.campaign.report import REPORT, fly_again, render_report
from sitl.campaign.store import FolderStore, flights_in, manifest_of, manifest_of_plan
from sitl.campaign.summary import RULES, cause_of, in_words, severity, tally
from sitl.campaign.task import Flight, Order, fly_order
from sitl.flight.one_flight import settings_for
from tests.fly import near
from tests.sitl.campaign.fakes import RAISES, fake_fly, plan

AT = "--vary"


def overridable() -> Overridable:
    return Overridable(near(), settings_for(near(), None))


def flown(seed: int, point: Point = ()) -> Flight:
    return fly_order(Order(Job(seed, point), plan().base(), code_version(), fake_fly))


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


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["--vary", "wind.speed_m_s=0:30:10"], "--vary: wind.speed_m_s must be a number from 0 to 25 m/s, found 30"),
        (["--vary", "wind.speed_m_s=0:3"], "a range is LOW:HIGH:STEP"),
        (["--vary", "wind.speed_m_s=0:3:1", "--vary", "wind.speed_m_s=4,5"], "wind.speed_m_s is given twice"),
        (["--against", "x"], "--against goes with --report"),
        (["--report", "--against", "nothing"], "nothing is no campaign's folder: manifest.json: No such file"),
        (["calm"], "scenario 'calm' is listed twice"),
        (["--workers", "2", "--scheduler", "tcp://127.0.0.1:1"], "--workers does not go with --scheduler"),
    ],
)
def test_wrong_use_of_variation_is_one_clear_line(args, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["campaign", "calm", *args]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1


def test_a_scenario_that_an_ardrone_cannot_fly_is_refused_before_the_first_flight(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["campaign", "gimbal", "--perception", "model"]) == 2
    assert "gimbal: an AR.Drone has none" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_each_failure_has_the_cause_of_the_first_rule_that_fits() -> None:
    fine = flown(3)
    off = {**fine["touchdown"], "surface": "deck", "on_pad": False}
    bad = {**fine, "grade": "failed"}
    cases = {
        "the flight raised an error": flown(RAISES),
        "the service died in flight": {**bad, "unsafe": ["the service died in flight: KeyError"]},
        "in the water": {**bad, "in_water": True, "unsafe": ["came down 2 m"]},
        "came down without sight of the pad": {**bad, "unsafe": ["came down 0.8 m, to 0.2 m over the deck, without true sight"]},
        "struck the deck beside the pad, then landed on the pad": {**bad, "contacts": [off, *fine["contacts"]]},
        "a person was overruled": {**bad, "unsafe": ["a person ordered hold, and was sent: move, still 0.4 s later"]},
        "touched the pad harder than it bears": {**bad, "unsafe": ["a foot struck the pad at 1.29 m/s"]},
        "landed beside the pad": {**bad, "landed_on_pad": False, "touchdown": off, "contacts": [off]},
        "struck the deck beside the pad and did not land": {
            **bad,
            "landed_on_pad": False,
            "outcome": "gave up",
            "contacts": [off],
        },
        "gave up, though it should land: no pad": {
            **bad,
            "landed_on_pad": False,
            "outcome": "gave up",
            "refused": "no pad at 0.1 m; frames",
        },
        "time ran out": {**bad, "landed_on_pad": False, "outcome": "time ran out", "touchdown": None, "contacts": []},
    }
    assert [cause_of(flight) for flight in cases.values()] == list(cases)
    order = [severity(flight) for flight in cases.values()]
    assert order == sorted(order, reverse=True)
    assert len(cases) == len(RULES)
    assert severity(fine) == 0
    assert cause_of({**bad, "landed_on_pad": False, "outcome": "emergency", "contacts": []}) == "ended otherwise: emergency"


def test_unsafe_flights_are_counted_and_named() -> None:
    """A flight that landed well after a contact that nobody intended is no good flight, and one can find it again."""
    stray = "touched the pad at 0.55 m/s along it"
    flights = [flown(seed, (("wind.speed_m_s", 1.0),)) for seed in range(15)]
    flights[RAISES] = flown(20)
    for seed in (4, 1):
        flights[seed] |= {"grade": "failed", "unsafe": [stray], "contacts_outside_commit": 1}
    counted = tally(reversed(flights))
    summary = counted.summary("near", "truth", 1.0)
    assert (summary["unsafe"], summary["failed"], summary["contacts_outside_commit"]) == (2, 2, 2)
    assert [one["seed"] for one in summary["unsafe_flights"]] == [1, 4]
    assert f"UNSAFE near seed 1, wind.speed_m_s 1.0: {stray}\nUNSAFE near seed 4" in in_words(summary)
    page = render_report({**manifest_of_plan(plan(), range(15), None)}, flights, 1.0)
    assert page.count(escape(stray)) == 2
    assert "touched the pad harder than it bears" in page
    many = tally({**flights[1], "seed": seed} for seed in range(2500))
    assert (many.unsafe, [one["seed"] for one in many.unsafe_flights]) == (2500, list(range(100)))
    assert "and 2490 more unsafe flights" in in_words(many.summary("near", "truth", 1.0))


def test_other_failed_flights_are_named_with_why_they_failed() -> None:
    flights = [flown(seed) for seed in range(12) if seed != RAISES]
    flights[2] |= {"grade": "failed", "because": "gave up, though it should land"}
    flights[3] |= {"grade": "failed", "because": "in the water", "unsafe": ["in the water"]}
    raised = flown(RAISES)
    summary = tally([raised, *flights]).summary("near", "truth", 1.0)
    assert [(one["seed"], one["because"]) for one in summary["failed_flights"]] == sorted(
        [(flights[2]["seed"], "gave up, though it should land"), (RAISES, raised["because"])]
    )
    output = in_words(summary)
    assert f"FAILED near seed {RAISES}: {raised['because']}" in output
    assert "more that failed" not in output
    many = tally({**flights[2], "seed": seed} for seed in range(2500))
    assert len(many.failed_flights) == 100
    assert "and 2490 more that failed" in in_words(many.summary("near", "truth", 1.0))


def test_campaigns_are_compared_seed_by_seed() -> None:
    ours = [flown(seed, (("wind.speed_m_s", 1.0),)) for seed in range(30)]
    other = [{**flown(seed), "varied": {"wind.speed_m_s": 1.0}} for seed in range(10, 40)]
    rows = {row.name: row for row in differences_of(ours, other)}
    error = rows["standing error"]
    assert error.pairs == 19, "one of them raises"
    assert error.mean == pytest.approx(0.06, abs=1e-6)
    assert (error.low, error.high) == pytest.approx((0.06, 0.06), abs=1e-6)
    assert error.clear
    assert not rows["on the pad"].clear
    assert differences_of(ours[:10], other) == []
    noise = np.random.default_rng(1).normal(0.3, 1.0, 400)
    low, high = bootstrap_interval(noise)
    assert (low, high) == pytest.approx((noise.mean() - 1.96 * 0.05, noise.mean() + 1.96 * 0.05), abs=0.012)


def test_success_against_one_and_two_keys() -> None:
    points = [({"a": a, "b": b}, a + b < 3, 0.1 * a if a + b < 3 else math.nan) for a in range(3) for b in range(3)]
    one = effect_of(points, "a")
    assert one.values == [0, 1, 2]
    assert one.shares.tolist() == pytest.approx([1.0, 2 / 3, 1 / 3])
    assert one.lateral_m.tolist() == pytest.approx([0.0, 0.1, 0.2])
    two = map_of(points, "a", "b")
    assert two.shares.tolist() == [[1, 1, 1], [1, 1, 0], [1, 0, 0]]
    scattered = [({"a": x, "b": 1.0 - x}, x < 0.5, math.nan) for x in np.linspace(0.0, 1.0, 81)]
    assert effect_of(scattered, "a").shares.tolist() == [1, 1, 1, 1, 0, 0, 0, 0]
    assert np.isnan(map_of(scattered, "a", "b").shares[0, 0]), "no flight was there"


def test_success_by_value_is_a_table_and_plain_values() -> None:
    flights = [flown(seed, (("wind.speed_m_s", speed), ("vessel.moored", True))) for seed in range(4) for speed in (0.0, 7.0)]
    wind, moored = by_value([varied_point(flight) for flight in flights])
    assert in_rows([wind, moored]).splitlines() == [
        "wind.speed_m_s  flights   good  95 % interval  error, median",
        "             0        4  100 %    51 to 100 %         2.5 cm",
        "             7        4    0 %      0 to 49 %              -",
        "vessel.moored  flights  good  95 % interval  error, median",
        "         True        8  50 %     22 to 78 %         2.5 cm",
    ]
    assert [(row["value"], row["runs"], row["good"]) for row in as_json(wind)] == [(0.0, 4, 1.0), (7.0, 4, 0.0)]
    assert as_json(wind)[1]["lateral_median_m"] is None
    assert by_value([]) == []


def test_the_report_of_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = overridable()
    axes = [parse_axis(t, given, AT) for t in ("wind.speed_m_s=0:8:2", "sea.peak_period_s=4:8:2")]
    varied = plan().with_design(described("factorial", axes))
    for name, seeds in (("now", range(6)), ("before", range(3, 9))):
        with closing(FolderStore(tmp_path / name, varied, seeds)) as store:
            for seed in seeds:
                store.keep([flown(seed, point) for point in factorial(axes)], 1.0 + seed)
    command = ["campaign", "report", str(tmp_path / "now"), "--against", str(tmp_path / "before")]
    assert cli.main(command) == 0
    assert capsys.readouterr().out == f"report: {tmp_path / 'now' / REPORT}\n"
    page = (tmp_path / "now" / REPORT).read_text()
    for output in (
        "60 of 90 on the pad",
        "landed beside the pad",
        "decklander simulate near --seed 5 --set wind.speed_m_s=8.0 --set sea.peak_period_s=4.0 --report flight-5",
        "Wilson",
        "One factor",
        "Two factors",
        "may be chance",
        tally(flights_in(tmp_path / "now" / "flights.jsonl")).hash,
    ):
        assert output in page
    assert page.count("<svg") == 1 + 1 + 4 + 2 + 1
    assert "http" not in page.replace("http://www.w3.org", ""), "the page needs nothing else"
    worst = figures_of(flights_in(tmp_path / "now" / "flights.jsonl")).worst
    assert len(worst) == 10
    assert {flight["grade"] for flight in worst} == {"failed"}
    assert cli.main(["campaign", "report", str(tmp_path)]) == 2
    assert cli.main(["campaign", "report"]) == 2
    with pytest.raises(BadInput, match="no flights yet"):
        render_report(manifest_of(tmp_path / "now"), [], 0.0)
    assert fly_again(flown(3), ("--config", "a b.toml")).endswith("--seed 3 --config 'a b.toml' --report flight-3")
