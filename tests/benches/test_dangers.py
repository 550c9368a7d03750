"""The bench of the faults: which flights it flies, what its table says, and what it says when it is ended early."""

import json
import signal
import sys
from typing import Any

import pytest

from benches import dangers
from companion.base.signals import Stopped
from companion.settings.model import Settings


def contact(surface: str, lateral_m: float, down_m_s: float = 0.4) -> dict[str, Any]:
    return {"surface": surface, "lateral_m": lateral_m, "vertical_speed_m_s": down_m_s}


def flight(name: str, seed: int, contacts: list[dict[str, Any]], unsafe: list[str] | None = None) -> dict[str, Any]:
    return {
        "scenario": name, "seed": seed, "expect": "pad", "outcome": "landed", "grade": "failed" if unsafe else "on pad",
        "because": "; ".join(unsafe or ["on the pad"]), "unsafe": unsafe or [], "contacts": contacts, "cpu_s": 10.0,
        "vision": "registration",
    }  # fmt: skip


class Flights:
    """Stand-in for flying."""

    def __init__(self, ended_after: int | None = None) -> None:
        self.flown: list[tuple[str, int]] = []
        self._ended_after = ended_after

    def __call__(self, name: str, seed: int, settings: Settings) -> dict[str, Any]:
        if len(self.flown) == self._ended_after:
            raise Stopped(signal.SIGTERM)
        self.flown.append((name, seed))
        return flight(name, seed, []) | {"vision": settings.vision.method}


def run(monkeypatch: pytest.MonkeyPatch, flights: Flights, *words: str) -> int:
    monkeypatch.setattr(dangers, "fly", flights)
    monkeypatch.setattr(sys, "argv", ["dangers", *words])
    return dangers.main()


def test_the_worst_touch_is_on_the_worst_surface_and_the_hardest_may_be_another() -> None:
    flights = [
        flight("gust_8_m_s", 1, [contact("pad", 0.9, 1.25)]),
        flight("gust_8_m_s", 2, [contact("deck", 0.6), contact("deck", 0.7)]),
    ]
    assert dangers.worst_touch(flights) == "deck, 70 cm off (seed 2); hardest 1.25 m/s"
    assert dangers.worst_touch([flight("gust_8_m_s", 1, [])]) == "none"


def test_the_table_has_a_row_for_each_fault_with_what_was_unsafe() -> None:
    water = flight("a", 1, [contact("water", 3.0)], ["in water"])
    output = dangers.table([flight("b", 1, [contact("pad", 0.1)]), water, flight("b", 2, [])])
    a, b = output.splitlines()[2:4]
    assert (
        a == "| a | 1 | pad | 1 failed (landed) | yes, 1 of 1 | water, 300 cm off (seed 1); hardest 0.40 m/s | seed 1: in water |"
    )
    assert b == "| b | 2 | pad | 2 on pad (landed) | no | pad, 10 cm off (seed 1); hardest 0.40 m/s |  |"


def test_it_flies_the_requested_seeds_of_the_requested_faults(monkeypatch, capsys):
    flights = Flights()
    words = ("--first", "211", "--seeds", "2", "--only", "imu_spike", "battery_low")
    assert run(monkeypatch, flights, *words) == 0
    assert flights.flown == [("imu_spike", 211), ("battery_low", 211), ("imu_spike", 212), ("battery_low", 212)]
    assert "vision: registration; settings: sim; seeds: 211 to 212\n" in capsys.readouterr().out


def test_a_run_that_is_ordered_to_end_reports_it_and_the_next_one_goes_on_with_it(monkeypatch, capsys, tmp_path):
    words = ("--only", "imu_spike", "battery_low", "--out", str(tmp_path / "flights.jsonl"))
    assert run(monkeypatch, Flights(ended_after=1), *words) == 128 + signal.SIGTERM
    output = capsys.readouterr().out
    assert "INTERRUPTED by SIGTERM: 1 of 2 flights were not flown" in output
    assert "| imu_spike | 1 |" in output
    flights = Flights()
    assert run(monkeypatch, flights, *words) == 0
    assert flights.flown == [("battery_low", 1)]
    assert "INTERRUPTED" not in capsys.readouterr().out


def test_a_flight_kept_from_other_methods_of_vision_is_not_taken_for_one_of_these(monkeypatch, tmp_path):
    kept = tmp_path / "flights.jsonl"
    words = ("--only", "imu_spike", "--out", str(kept))
    assert run(monkeypatch, Flights(), *words) == 0
    flights = Flights()
    assert run(monkeypatch, flights, *words, "--fused") == 0
    assert flights.flown == [("imu_spike", 1)]
    assert [json.loads(line)["vision"] for line in kept.read_text().splitlines()] == ["registration", "fused"]
