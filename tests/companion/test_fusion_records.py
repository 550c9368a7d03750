"""The estimator's results on their way out: health, recording, MQTT, metrics and report say what the estimator said.

Why: a figure that changes or gets lost between filter and observer is worse than none.
"""

import math
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from companion.base.health import NIS_WINDOW, Health
from companion.facts.records import FusionRecord
from companion.guidance.pilot import make_pilot
from companion.parts.metrics.endpoint import text
from companion.parts.mqtt import encode as mqtt_encode
from companion.parts.mqtt import messages
from companion.parts.recorder.recorder import Recorder
from companion.parts.recorder.setup import about
from companion.parts.recorder.storage_policy import SingleFile
from companion.recording import decode
from companion.recording.reading import open_recording
from companion.recording.rewriting import Cut, rewrite
from companion.settings.load import camera_model
from companion.settings.service import RecorderOptions
from companion.tools.replay.engine import Replay, pilot_of
from companion.tools.report.figures import innovation_series
from companion.tools.report.flight_log import FlightLog
from companion.tools.report.page import render
from estimator.contracts.estimates import COMPONENTS, FusionResult, Verdict
from estimator.contracts.time import MonoNs
from sitl.flight.flight import Flight
from sitl.scenario.scenario import load as load_scenario
from tests.companion.test_recorder import CAMERA
from tests.companion.test_records import result
from tests.companion.test_report import PAD
from tests.fly import ObservedCalls, sim_settings
from tests.make import same_bits
from tests.support.clocks import SteppedClock

T = 5_000_000_000


def test_a_replay_makes_the_results_of_the_flight_again(tmp_path: Path) -> None:
    settings = sim_settings()
    settings = msgspec.structs.replace(settings, estimator=msgspec.structs.replace(settings.estimator, path="ekf"))
    flown, again, path = ObservedCalls(), ObservedCalls(), tmp_path / "flown.mcap"
    options = RecorderOptions(frames="none")
    with Recorder(SingleFile(path), camera_model(settings), about(settings, {}), options, lossless=True) as recorder:
        flight = Flight(load_scenario("demo"), 1, settings, make_pilot(settings), observers=[flown, recorder])
        for _ in range(150):
            flight.step()
        flight.result()
    recording = open_recording([path])
    Replay(recording, pilot_of(recording, settings, None, own_camera=False, alone=True), sightings=True, observers=[again]).run()
    assert {r.source for _, r in flown.results} >= {"sighting", "attitude", "velocity", "baro", "imu"}
    assert len(again.results) == len(flown.results)
    assert all(a[0] == b[0] and same_bits(a[1], b[1]) for a, b in zip(again.results, flown.results, strict=True))
    recorded = [decode.fusion(e) for e in recording.events() if isinstance(e, FusionRecord)]
    expected = [r for _, r in flown.results if r.source != "imu" or r.verdict is not Verdict.FUSED]
    assert len(recorded) == len(expected) > 200
    assert all(same_bits(a, b) for a, b in zip(recorded, expected, strict=True))
    for cut, left in ((Cut(), len(expected)), (Cut(inputs=True), 0)):
        part = tmp_path / "part.mcap"
        rewrite(recording, part, cut)
        found = [decode.fusion(e) for e in open_recording([part]).events() if isinstance(e, FusionRecord)]
        assert len(found) == left, "what was concluded from the inputs is none of them"
        assert all(same_bits(a, b) for a, b in zip(found, expected, strict=False))
    for (_, source), tally in flight.health.tallies.items():
        assert tally.verdicts.total() == sum(r.source == source for _, r in flown.results), source


def health_with(*results: FusionResult) -> Health:
    health = Health(SteppedClock(MonoNs(T)))
    for one in results:
        health.fusion(one)
    return health


def test_health_keeps_the_newest_result_the_last_comparison_and_a_recent_mean() -> None:
    health = health_with(*[result("range", nis=1e9, test_ratio=7.0)] * NIS_WINDOW)
    health.fusion(result("range", nis=1.0, test_ratio=0.25))
    health.fusion(result("range", Verdict.GATED, nis=math.nan))
    (state,) = health.snapshot().fusion
    assert (state.path, state.source, state.test_ratio) == ("ekf", "range", 0.25)
    assert state.verdicts == {"fused": NIS_WINDOW + 1, "gated": 1}
    assert state.newest.verdict is Verdict.GATED
    assert state.nis_mean == pytest.approx((20.0 * (NIS_WINDOW - 1) + 1.0) / NIS_WINDOW), "one wild one weighs no more than 20"
    for _ in range(NIS_WINDOW):
        health.fusion(result("range", nis=1.0))
    assert health.fusion_states()[0].nis_mean == 1.0


def test_metrics_show_counts_by_verdict_the_last_test_ratio_and_the_mean_of_nis() -> None:
    health = health_with(result(), result(verdict=Verdict.GATED, nis=8.0, test_ratio=1.25), result("imu", nis=math.nan))
    page = text(health.snapshot()).decode()
    found = {(s.name, *s.labels.values()): s.value for f in text_string_to_metric_families(page) for s in f.samples}
    assert found["decklander_fusion_total", "ekf", "sighting", "fused"] == 1
    assert found["decklander_fusion_total", "ekf", "sighting", "gated"] == 1
    assert found["decklander_fusion_total", "ekf", "imu", "fused"] == 1
    assert found["decklander_innovation_test_ratio", "ekf", "sighting"] == 1.25
    assert found["decklander_normalized_nis_mean", "ekf", "sighting"] == (2.0 / 4 + 8.0 / 4) / 2
    assert ("decklander_innovation_test_ratio", "ekf", "imu") not in found


def test_the_message_over_mqtt_reads_back() -> None:
    health = health_with(result(), result("imu", nis=math.nan))
    output = mqtt_encode.fusion("0123456789ab", MonoNs(T), health.fusion_states())
    wire = messages.encode(output)
    assert messages.decode("fusion", wire) == output
    sighting, imu = sorted(output.sources, key=lambda source: source.newest.source, reverse=True)
    assert sighting.newest.components == list(COMPONENTS["sighting"])
    assert sighting.newest.innovation == pytest.approx([0.1, 0.2, 0.3, 0.4])
    assert (sighting.newest.nis, sighting.newest.test_ratio, sighting.nis_mean) == (2.0, 0.1, 0.5)
    assert sighting.verdicts == {"fused": 1}
    assert (imu.newest.innovation, imu.newest.nis, imu.newest.test_ratio, imu.nis_mean) == (None, None, None, None)


def test_the_report_draws_each_source_and_counts_what_was_refused() -> None:
    log = FlightLog("results", MonoNs(T), PAD, CAMERA)
    for i in range(50):
        log.add_result(result(at=T + i * 40_000_000))
        log.add_result(result("imu", nis=math.nan))
    for i in range(1500):
        log.add_result(result("range", Verdict.GATED if i % 10 == 0 else Verdict.FUSED, nis=1.0, at=T + i * 1_000_000))
    log.add_result(result("baro", Verdict.GATED, nis=math.nan))
    series = {s.source: s for s in innovation_series(log)}
    assert list(series) == ["sighting", "range", "baro"]
    np.testing.assert_allclose(series["sighting"].innovation, np.tile([0.1, 0.2, 0.3, 0.4], (50, 1)))
    np.testing.assert_allclose(series["sighting"].sigma[0] ** 2, [0.011, 0.021, 0.031, 0.041])
    np.testing.assert_allclose(series["sighting"].t_s[[0, -1]], [0.0, 49 * 0.04])
    assert (series["sighting"].nis_mean, series["range"].test_ratio_p95) == (0.5, 0.1)
    page = render(log, None)
    assert (
        "<tr><td>ekf: range</td><td>1500</td><td>1350</td><td>150</td><td>150 gated</td><td>1.00</td><td>0.10</td></tr>" in page
    )
    assert "<tr><td>ekf: baro</td><td>1</td><td>0</td><td>1</td><td>1 gated</td><td>-</td><td>-</td></tr>" in page
    drawn = re.findall(r"<span>(\w+): NIS over the number of components", page)
    assert drawn == ["sighting", "range"], "nothing of the barometer was compared"
    assert len(page) < 250_000
