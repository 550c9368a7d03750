"""Replay: the same outputs each time, the recorded beliefs to the bit, and what settings change is said.

The estimator's results on their way out: health, recording, MQTT, metrics and report say what the estimator said. Why: a figure
that changes or gets lost between filter and observer is worse than none.
"""

import asyncio
import json
import math
import re
import socket
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from companion.base.health import NIS_WINDOW, Health
from companion.cli import main as cli
from companion.cli import replay as cli_replay
from companion.facts.records import FusionRecord
from companion.guidance.pilot import make_pilot
from companion.parts.metrics.endpoint import text
from companion.parts.mqtt import encode as mqtt_encode
from companion.parts.mqtt import messages
from companion.parts.recorder.setup import about, recorder_to_file
from companion.recording import decode
from companion.recording.reading import open_recording
from companion.recording.rewriting import Cut, rewrite
from companion.settings.load import camera_model, pad_of_file, read_camera
from companion.tools.replay.engine import Replay, pilot_of
from companion.tools.replay.recorded_log import differences, log_of, recorded_beliefs
from companion.tools.report.figures import innovation_series
from companion.tools.report.flight_log import FlightLog
from companion.tools.report.page import render
from decklander.place import SHIPPED
from estimator.contracts.commands import Land
from estimator.contracts.estimates import COMPONENTS, FusionResult, Verdict
from estimator.contracts.time import MonoNs
from sitl.ardrone.flight import Flight
from sitl.scenario.scenario import load as load_scenario
from tests.companion.test_recorder import CAMERA
from tests.companion.test_records import result
from tests.companion.test_report import PAD
from tests.fly import ObservedCalls, sim_settings
from tests.make import same_bits
from tests.support.clocks import SteppedClock


def replayed(path: Path, *words: str, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert cli.main(["replay", str(path), "--json", *words]) == 0
    out: dict[str, Any] = json.loads(capsys.readouterr().out)
    return out


def test_recorded_sightings_give_the_recorded_beliefs_and_commands_to_the_bit(recorded_flight):
    recording = open_recording([recorded_flight[0]])
    settings = sim_settings()
    reported = ObservedCalls()
    replay = Replay(recording, pilot_of(settings, None), sightings=True, observers=[reported])
    replay.run()
    again = cli_replay.replayed(recording, settings, sightings=True)
    assert again.replay.digest == replay.digest
    assert replay.counts.as_recorded == replay.counts.frames == len(recorded_flight[1].frames) > 20
    orders = ["terminal 1: record on: accepted", "terminal 1: clear: refused, nothing is seen that bars a landing"]
    for log in (again.log, log_of(recording, "as recorded")):
        assert [str(each) for each in log.orders] == orders
    found = {d.path: d for d in differences(again.beliefs, recorded_beliefs(recording))}
    assert {"dead_reckoning", "median_mean"} <= set(found)
    for difference in found.values():
        assert difference.both == difference.identical > 40
        assert difference.only_one == 0
    assert [d.phase for d in reported.decisions] == [d.phase for d in recorded_flight[1].decisions]
    for ours, theirs in zip(reported.decisions, recorded_flight[1].decisions, strict=True):
        assert type(ours.command) is type(theirs.command)
        if hasattr(ours.command, "v_level"):
            assert np.array_equal(ours.command.v_level, theirs.command.v_level)  # type: ignore[union-attr]


def test_the_same_replay_has_the_same_hash_and_a_change_another(recorded_flight, tmp_path, capsys):
    digest = replayed(recorded_flight[0], "--sightings", capsys=capsys)["passes"][0]["sha256"]
    config = tmp_path / "other.toml"
    own = open_recording([recorded_flight[0]]).attachments["settings.toml"].decode()
    config.write_text(re.sub(r"(dead_reckoning\]\n[^\[]*sigma_velocity_scale = )[0-9.]+", r"\g<1>0.7", own))
    both = replayed(recorded_flight[0], "--against", str(config), "--sightings", capsys=capsys)
    first, second = both["passes"]
    assert first["sha256"] == digest != second["sha256"]
    assert first["counts"]["as_recorded"] > 20
    against = {d["path"]: d for d in both["against"][str(config)]}
    assert against["median_mean"]["identical"] > against["dead_reckoning"]["identical"] == 0
    wider = "estimator.dead_reckoning.sigma_velocity_scale=0.7"
    by_key = replayed(recorded_flight[0], "--set", wider, "--sightings", capsys=capsys)
    assert by_key["passes"][0]["sha256"] == second["sha256"]
    out, key = tmp_path / "out.mcap", ["--set=pad.file=icao", "--set=expert.camera.file=ardrone2_bottom"]
    other = replayed(recorded_flight[0], *key, "--record", str(out), capsys=capsys)["passes"][0]["errors"]
    assert "ekf" in {row["name"] for row in first["errors"]} - {row["name"] for row in other}
    kept = open_recording([out])
    assert (kept.pad(), kept.settings().pad.file) == (pad_of_file(SHIPPED / "pads" / "icao.toml"), "icao")
    assert kept.camera() == read_camera(SHIPPED / "cameras" / "ardrone2_bottom.toml")
    config.write_text((SHIPPED / "sim.toml").read_text() + '[mqtt]\ndrone = "other"\n')
    given = ["--config", str(config), "--set", "pad.file=nope", "--set", "http.port=9"]
    assert cli.main(["replay", str(recorded_flight[0]), *given]) == 2
    idle = "decklander: http.port, mqtt.drone: without effect in a replay\n"
    assert re.match(f"{idle}(?s:.*)no file 'nope'", capsys.readouterr().err)
    nees = {row["name"]: row["nees"] for row in by_key["passes"][0]["errors"]}
    assert 0.0 < nees["dead_reckoning"] != {row["name"]: row["nees"] for row in first["errors"]}["dead_reckoning"]


def test_images_seen_again_agree_with_what_was_seen_then_and_with_truth(recorded_flight, tmp_path, capsys):
    out = replayed(recorded_flight[0], "--path", "median_mean", "--report", str(tmp_path / "report"), capsys=capsys)
    done = out["passes"][0]
    assert done["counts"]["searched"] > 20
    errors = {row["name"]: row for row in done["errors"]}
    best = errors["registration"]
    assert best["count"] > 20
    assert best["lateral_median_m"] < 0.1
    difference = {d["path"]: d for d in out["against"]["the recording"]}["dead_reckoning"]
    assert 0 < difference["d_max_m"] < 0.3, "JPEG costs a little, and only a little"
    page = (tmp_path / "report" / "index.html").read_text()
    assert "Replay of flight.mcap" in page
    assert len(re.findall(r'id="film-0">([^<]*)<', page)[0]) > 10_000


def test_the_operators_words_are_followed_again(tmp_path: Path) -> None:
    settings = sim_settings()
    settings = msgspec.structs.replace(settings, guidance=msgspec.structs.replace(settings.guidance, start="signal"))
    pilot, reported, path = make_pilot(settings), ObservedCalls(), tmp_path / "told.mcap"
    with recorder_to_file(path, camera_model(settings), about(settings, {}), frames="none") as recorder:
        flight = Flight(load_scenario("demo"), 2, settings, pilot, observers=[reported, recorder])
        for step in range(240):
            if step == 100:
                pilot.begin()
            if step == 150:
                pilot.hold()
            if step == 200:
                pilot.abort()
            flight.step()
    again = ObservedCalls()
    recording = open_recording([path])
    Replay(recording, pilot_of(settings, None), observers=[again]).run()
    assert [d.phase for d in again.decisions] == [d.phase for d in reported.decisions]
    assert {"waiting for the start", "paused", "aborted"} < {d.phase for d in reported.decisions}
    assert [type(d.command) for d in again.decisions] == [type(d.command) for d in reported.decisions]
    assert not isinstance(again.decisions[-1].command, Land)


def test_without_recorded_guidance_it_runs_at_its_own_rate(recorded_flight: tuple[Path, ObservedCalls], tmp_path: Path) -> None:
    settings, path, reported = sim_settings(), tmp_path / "inputs.mcap", ObservedCalls()
    with recorder_to_file(path, camera_model(settings), about(settings, {}), frames="none") as out:
        for sample in recorded_flight[1].samples:
            out.on_sample(sample)
    recording = open_recording([path])
    Replay(recording, pilot_of(settings, None), rate_hz=40.0, observers=[reported]).run()
    instants = [d.at for d in reported.decisions]
    assert np.all(np.diff(instants) == 25_000_000)
    assert (instants[-1] - instants[0]) * 1e-9 == pytest.approx(1.5, abs=0.1)


async def test_in_real_time_it_speaks_to_an_autopilot_as_if_it_happened_now(recorded_flight: tuple[Path, ObservedCalls]) -> None:
    from pymavlink.dialects.v20 import ardupilotmega as mav

    peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    peer.bind(("127.0.0.1", 0))
    peer.setblocking(False)
    speaker = mav.MAVLink(None, srcSystem=1, srcComponent=1)
    beat = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 209, 9, mav.MAV_STATE_ACTIVE, 3)
    loop, received_at = asyncio.get_running_loop(), list[Any]()

    async def autopilot() -> None:
        listener = mav.MAVLink(None)
        listener.robust_parsing = True
        while True:
            data, where = await loop.sock_recvfrom(peer, 4096)
            received_at.extend(listener.parse_buffer(data) or [])
            await loop.sock_sendto(peer, beat.pack(speaker), where)

    words = ["replay", str(recorded_flight[0]), "--sightings", "--json", "--realtime", "--path", "median_mean"]
    words += ["--mavlink", f"udpout://127.0.0.1:{peer.getsockname()[1]}"]
    targets: list[Any] = []
    async with asyncio.TaskGroup() as group:
        task = group.create_task(autopilot())
        for _ in range(40):  # the recording lasts 1.5 s, in which a busy machine may not even have met the autopilot
            began = time.monotonic()
            assert await asyncio.to_thread(cli.main, words) == 0
            assert time.monotonic() - began >= 1.4
            targets = [m for m in received_at if m.get_type() == "LANDING_TARGET"]
            if len(targets) >= 3:
                break
        task.cancel()
    peer.close()
    assert len(targets) >= 3
    # Which of the flight's moments was the last to be told depends on how busy the machine is.
    true = [float(np.linalg.norm(d.shadows[0].d_body_pad_level)) for d in recorded_flight[1].decisions if d.shadows]
    assert 0.8 * min(true) < targets[-1].distance < 1.2 * max(true)
    assert math.isfinite(targets[-1].angle_x)


T = 5_000_000_000


def test_a_replay_makes_the_results_of_the_flight_again(tmp_path: Path) -> None:
    settings = sim_settings()
    settings = msgspec.structs.replace(settings, estimator=msgspec.structs.replace(settings.estimator, path="ekf"))
    flown, again, path = ObservedCalls(), ObservedCalls(), tmp_path / "flown.mcap"
    with recorder_to_file(path, camera_model(settings), about(settings, {}), frames="none") as recorder:
        flight = Flight(load_scenario("demo"), 1, settings, make_pilot(settings), observers=[flown, recorder])
        for _ in range(150):
            flight.step()
        flight.result()
    recording = open_recording([path])
    Replay(recording, pilot_of(settings, None, alone=True), sightings=True, observers=[again]).run()
    assert {r.source for _, r in flown.results} >= {"sighting", "attitude", "velocity", "baro", "imu"}
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
    assert "<tr><td>ekf: range</td><td>1500</td><td>1350</td><td>150</td><td>150 gated</td><td>1.00</td><td>0.10</td></" in page
    assert "<tr><td>ekf: baro</td><td>1</td><td>0</td><td>1</td><td>1 gated</td><td>-</td><td>-</td></tr>" in page
    drawn = re.findall(r"<span>(\w+): NIS over the number of components", page)
    assert drawn == ["sighting", "range"], "nothing of the barometer was compared"
    assert len(page) < 250_000
