"""Result of a soak's flights: failed ones fail it; a machine that is too slow is reported, not the product."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.base.mission import FlightOutcome
from companion.cli import main as cli
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Verdict
from sitl.campaign.growth import Reading
from sitl.campaign.soak_flights import Class, Flown, Outcomes, by_fault, real
from sitl.flight.ending import Load
from sitl.scenario.scenario import load
from sitl.scenario.with_fault import faulty
from tests.fly import NEAR

GOOD = Counter({Verdict.FUSED: 850, Verdict.NO_PAD: 50})
SAID: dict[str, Any] = {
    "ended": "landed", "seed": 3, "title": "A small ferry; faults/camera_freezes", "expect": "refuse", "duration_s": 30.0,
    "surface": "pad", "on_pad": True, "lateral_m": 0.08, "unsafe": [], "left_alone": False, "frames_sent": 880,
    "stood_still_s": 0.0,
}  # fmt: skip


def judged(outcome: FlightOutcome | None, frames: Counter[Verdict] = GOOD, **said: Any) -> Flown:
    return real(10.0, {**SAID, **said}, outcome, frames)


def flown(worth: Class, seed: int = 1, title: str = "a; faults/b") -> Flown:
    return Flown(60.0 * seed, seed, title, worth, "why", 30.0)


def test_a_flight_in_real_time_is_on_the_pad_refused_or_failed() -> None:
    assert judged(FlightOutcome.LANDED).worth is Class.ON_PAD
    away: dict[str, Any] = {"ended": "time is up", "on_pad": False, "surface": None, "lateral_m": None}
    assert judged(FlightOutcome.GAVE_UP, **away).worth is Class.REFUSED_RIGHTLY
    assert judged(FlightOutcome.GAVE_UP, expect="land", **away).worth is Class.FAILED
    late = judged(FlightOutcome.EMERGENCY, **away)
    assert (late.worth, late.because) == (Class.FAILED, "time ran out: it neither landed nor gave up")
    wet = judged(FlightOutcome.LANDED, on_pad=False, surface="water", unsafe=["in the water, 2.50 m from the pad's centre"])
    assert (wet.worth, wet.because) == (Class.FAILED, "in the water, 2.50 m from the pad's centre")
    struck = judged(FlightOutcome.LANDED, unsafe=["touched the deck 0.48 m from the pad's centre"])
    assert struck.worth is Class.FAILED, "a landing does not make good what was struck before"
    assert judged(FlightOutcome.EMERGENCY, ended="emergency", on_pad=False).worth is Class.FAILED


@pytest.mark.parametrize(
    ("frames", "said", "reason"),
    [
        (GOOD, {"stood_still_s": 4.0}, "the simulated drone stood still for 4.0 s"),
        (GOOD, {"frames_sent": 200}, "22% of the frames were rendered in time"),
        (Counter({Verdict.REPLACED: 600, Verdict.FUSED: 280}), {}, "68% of the frames were overtaken by newer ones"),
        (Counter({Verdict.NO_ATTITUDE: 600, Verdict.FUSED: 280}), {}, "68% of the frames had no attitude"),
    ],
)
def test_a_machine_that_is_too_slow_is_named_for_a_failure_and_a_good_flight_stays_good(frames, said, reason):
    failed = judged(FlightOutcome.EMERGENCY, frames, ended="emergency", on_pad=False, **said)
    assert failed.worth is Class.STARVED
    assert reason in failed.because
    assert "emergency" in failed.because, "what happened is told beside"
    assert judged(FlightOutcome.LANDED, frames, **said).worth is Class.ON_PAD
    assert Load(30.0, 880, 0.2, GOOD).starved() is None


def test_a_flight_whose_guidance_came_late_is_the_machines() -> None:
    failed = {**SAID, "ended": "emergency", "on_pad": False}
    assert real(10.0, failed, FlightOutcome.EMERGENCY, GOOD, 0.02).worth is Class.FAILED
    late = real(10.0, failed, FlightOutcome.EMERGENCY, GOOD, 0.045)
    assert late.worth is Class.STARVED
    assert late.because.startswith("half of the guidance cycles came 45 ms late or later")


def test_failed_flights_and_a_starved_soak_are_faults() -> None:
    good = Outcomes([flown(Class.ON_PAD), flown(Class.REFUSED_RIGHTLY)])
    assert good.faults(0) == []
    bad = Outcomes([*good.flights, flown(Class.FAILED, 7), flown(Class.STARVED)])
    assert bad.faults(0) == ["1 of 4 flights failed"]
    assert bad.faults(1) == []
    assert "  seed 7, faults/b: failed: why" in bad.in_words("demo")
    assert bad.as_json()["classes"] == {"on_pad": 1, "refused_rightly": 1, "failed": 1, "starved": 1}
    slow = Outcomes([flown(Class.STARVED), flown(Class.STARVED), flown(Class.ON_PAD)])
    assert slow.faults(0) == ["this machine was too slow for 2 of 3 flights, so the run shows nothing"]
    assert by_fault(bad.flights) == {"faults/b": Counter(dict.fromkeys(Class, 1))}


def test_the_plot_is_written_and_a_place_that_takes_none_is_named(tmp_path: Path) -> None:
    from sitl.campaign import plots  # matplotlib takes half a second

    readings = [Reading(30.0 * n, n, 100.0 + n, 10, 3, None, 1.0 * n) for n in range(12)]
    flights = [flown(worth, n + 1, f"a; faults/{n}") for n, worth in enumerate(Class)]
    plots.soak(tmp_path / "soak.png", readings, flights)
    assert (tmp_path / "soak.png").read_bytes()[:4] == b"\x89PNG"
    plots.soak(tmp_path / "empty.svg", readings, [])
    with pytest.raises(BadInput, match="--plot"):
        plots.soak(tmp_path / "soak.tiff.nothing", readings, flights)


@pytest.mark.parametrize("words", [["--failed-max", "-1"], ["--virtual", "--runs", "1", "--plot", "/dev/null/x.png"]])
def test_wrong_words_are_one_line(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["campaign", "demo", "--soak", *words]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_flight_that_failed_is_flown_again_by_its_fault_and_seed(capsys: pytest.CaptureFixture[str]) -> None:
    """WHY: a seed selects another fault as soon as fault scenarios are added, so the seed alone does not tell the flight."""
    outcomes = Outcomes([flown(Class.ON_PAD, 6), flown(Class.FAILED, 7, "a ferry; faults/link_lost_4_s")])
    again = "decklander campaign demo --soak --virtual --runs 1 --seed 7 --fault faults/link_lost_4_s"
    assert outcomes.in_words("demo")[-1].endswith(again)
    assert outcomes.in_words("demo", ("--config", "my rig.toml"))[-1].endswith(f"{again} --config 'my rig.toml'")
    named = faulty(load("demo"), 7, possible=lambda _: True, name="faults/link_lost_4_s")
    assert named.faults == load("faults/link_lost_4_s").faults
    assert named.unreached_contacts
    for words, why in (
        (["--virtual", "--fault", "none"], "not a fault scenario"),
        (["--fault", "link_lost_4_s"], "needs --virtual"),
        (["--virtual", "--fault", "wrong_pad", "--perception", "model"], "seen in rendered frames only"),
    ):
        assert cli.main(["campaign", "demo", "--soak", *words]) == 2
        assert why in capsys.readouterr().err


def test_a_virtual_soak_names_the_flight_that_failed(tmp_path, capsys, monkeypatch):
    """A bug of the service in flight does not end the soak: it fails that flight, by name."""
    from companion.guidance.pilot import Pilot

    near = tmp_path / "near.toml"
    near.write_text(NEAR.replace("duration_limit_s = 40.0", "duration_limit_s = 3.0"))

    def broken(self: Pilot, *_: Any) -> None:
        raise KeyError(int(np.array(7)))

    monkeypatch.setattr(Pilot, "detect", broken)
    words = ["--virtual", "--runs", "2", "--no-faults", "--plot", str(tmp_path / "p.png")]
    assert cli.main(["campaign", str(near), "--soak", *words]) == 1
    output = capsys.readouterr().out
    assert "FAULT: 2 of 2 flights failed" in output
    assert "the service died in flight: KeyError: 7 (test_soak_flights.py:" in output
    assert (tmp_path / "p.png").exists()
