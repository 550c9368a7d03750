"""The lag of the event loop is measured for each flight, and what held it has a name."""

import asyncio
import logging
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.base.health import Health
from companion.base.loop_lag import HELD_S, STOOD_S, Lags, LoopWatch
from companion.base.observer import Decision
from companion.parts.recorder.setup import about, recorder_to_file
from companion.recording.reading import open_recording
from companion.settings.load import camera_model
from companion.tools.replay.recorded_log import log_of
from drivers.clock import SystemClock
from tests.fly import sim_settings


@given(st.lists(st.floats(0.0, 20.0), min_size=1, max_size=300), st.floats(0.01, 1.0))
def test_a_quantile_is_known_to_five_percent(values: list[float], q: float) -> None:
    lags = Lags()
    for value in values:
        lags.add(value)
    ordered = sorted(values)
    true = next(v for n, v in enumerate(ordered, 1) if n >= q * len(ordered) - 1e-9)
    assert lags.worst_s == ordered[-1]
    assert true <= lags.quantile(q) + 1e-12
    assert lags.quantile(q) <= max(1.05 * true, 1e-4) + 1e-12


def watch(flying: bool = False) -> tuple[LoopWatch, Health, list[str]]:
    health, held = Health(SystemClock()), list[str]()
    return LoopWatch(health, lambda: flying, lambda: held.append("hold")), health, held


async def test_a_long_hold_is_named_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    def grinds_the_loop() -> None:
        end = time.monotonic() + 3 * HELD_S
        while time.monotonic() < end:
            sum(range(1000))

    watching, health, held = watch(flying=True)
    task = asyncio.create_task(watching.run())
    await asyncio.sleep(0.1)
    assert watching.lags.count >= 1
    grinds_the_loop()
    await asyncio.sleep(0.1)
    task.cancel()
    reported = [r.getMessage() for r in caplog.records if "was held for" in r.getMessage()]
    assert len(reported) >= 1
    assert any("grinds_the_loop (test_loop_lag.py:" in text for text in reported)
    counts = health.snapshot().counters["loop"]
    assert counts["held"] >= 1
    assert counts["lag_worst_s"] >= 2 * HELD_S
    assert held == []


@pytest.mark.parametrize(
    ("flying", "late_s", "away_s", "said", "holds"),
    [
        (True, 0.0, 20.0, "this computer was suspended for 20.0 s: the drone is commanded to hold", 1),
        (
            True,
            3.0,
            3.0,
            "the service stood still (stopped, or without processor time) for 3.0 s: the drone is commanded to hold",
            1,
        ),
        (False, 0.0, 20.0, "this computer was suspended for 20.0 s", 0),
        (True, STOOD_S - 0.1, STOOD_S - 0.1, "was held for 1.90 s", 0),
    ],
)
def test_a_standstill_holds_what_flies(flying, late_s, away_s, said, holds, caplog):
    watching, _, held = watch(flying)
    watching._worked_s = time.process_time()
    with caplog.at_level(logging.WARNING):
        watching._note(late_s, away_s)
    assert said in caplog.messages[-1]
    assert caplog.messages[-1].endswith("hold") == (holds == 1)
    assert len(held) == holds


def test_each_flight_has_its_own_worst() -> None:
    flies = [False]
    health = Health(SystemClock())
    watching = LoopWatch(health, lambda: flies[0], lambda: None)
    watching._note(0.15, 0.17)
    flies[0] = True
    watching._note(0.01, 0.03)
    watching._note(0.02, 0.04)
    assert watching.counts()["lag_worst_s"] == 0.02
    flies[0] = False
    watching._note(0.001, 0.02)
    assert watching.counts()["lag_worst_s"] == 0.02, "it is told until the next flight"


def test_a_recorded_flight_says_in_its_report_how_late_the_loop_was(tmp_path: Path) -> None:
    health, settings = Health(SystemClock()), sim_settings()
    watching = LoopWatch(health, lambda: True, lambda: None)
    for late_s in (*[0.002] * 2000, 0.3):
        watching._note(late_s, late_s)
    with recorder_to_file(tmp_path / "flight.mcap", camera_model(settings), about(settings, {"kind": "test"}), live=True) as kept:
        kept.watch(health)
        kept.on_decision(Decision(health.now(), "search", None, None))
    facts = dict(log_of(open_recording([tmp_path / "flight.mcap"]), "one").facts)
    assert facts["event loop"] == "late by at most 300 ms, 99.9 % within 2.1 ms, held longer than 0.2 s 1 times"


async def test_a_wall_clock_that_is_set_is_reported_once(caplog, monkeypatch):
    ahead, real = [0.0], time.time
    monkeypatch.setattr(time, "time", lambda: real() + ahead[0])
    watching, *_ = watch()
    task = asyncio.create_task(watching.run())
    await asyncio.sleep(0.05)
    ahead[0] = 200 * 86400.0
    await asyncio.sleep(0.1)
    task.cancel()
    reported = [m for m in caplog.messages if "wall clock" in m]
    assert reported == ["the wall clock was set by +17280000.0 s: the flight does not go by it"]
