"""Replay: the same outputs each time, the recorded beliefs to the bit, and what settings change is said."""

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

from companion.cli import main as cli
from companion.guidance.pilot import make_pilot
from companion.parts.recorder.recorder import Recorder
from companion.parts.recorder.setup import about
from companion.parts.recorder.storage_policy import SingleFile
from companion.recording.reading import open_recording
from companion.settings.load import camera_model
from companion.settings.service import RecorderOptions
from companion.tools.replay.engine import Replay, pilot_of
from companion.tools.replay.recorded_log import BeliefLogObserver, differences, log_of, recorded_beliefs
from companion.tools.report.flight_log import FlightLog
from estimator.contracts.commands import Land
from estimator.contracts.time import MonoNs
from sitl.flight.flight import Flight
from sitl.scenario.scenario import load as load_scenario
from tests.fly import ObservedCalls, sim_settings


def replayed(path: Path, *words: str, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert cli.main(["replay", str(path), "--json", *words]) == 0
    out: dict[str, Any] = json.loads(capsys.readouterr().out)
    return out


def test_recorded_sightings_give_the_recorded_beliefs_and_commands_to_the_bit(
    recorded_flight: tuple[Path, ObservedCalls],
) -> None:
    recording = open_recording([recorded_flight[0]])
    settings = sim_settings()
    reported = ObservedCalls()
    pilot = pilot_of(recording, settings, None, own_camera=True)
    log_observer = BeliefLogObserver(FlightLog("replay", MonoNs(0), pilot.pad, pilot.camera))
    replay = Replay(recording, pilot, sightings=True, observers=[log_observer, reported])
    replay.run()
    assert replay.counts.as_recorded == replay.counts.frames == len(recorded_flight[1].frames) > 20
    orders = ["terminal 1: record on: accepted", "terminal 1: clear: accepted"]
    for log in (log_observer.log, log_of(recording, "as recorded")):
        assert [str(each) for each in log.orders] == orders
    assert pilot.landing._flight.overruled, "what the operator ordered about things on the pad counts in the replay too"
    found = {d.path: d for d in differences(log_observer.beliefs, recorded_beliefs(recording))}
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
    digests = [replayed(recorded_flight[0], "--sightings", capsys=capsys)["passes"][0]["sha256"] for _ in range(2)]
    assert digests[0] == digests[1]
    config = tmp_path / "other.toml"
    own = open_recording([recorded_flight[0]]).attachments["settings.toml"].decode()
    config.write_text(re.sub(r"sigma_pad_v_m_s = [0-9.]+", "sigma_pad_v_m_s = 0.7", own))
    both = replayed(recorded_flight[0], "--against", str(config), "--sightings", capsys=capsys)
    first, second = both["passes"]
    assert first["sha256"] == digests[0] != second["sha256"]
    assert first["counts"]["as_recorded"] > 20
    against = {d["path"]: d for d in both["against"][str(config)]}
    assert against["median_mean"]["identical"] > against["dead_reckoning"]["identical"] == 0
    by_key = replayed(recorded_flight[0], "--set", "estimator.dead_reckoning.sigma_pad_v_m_s=0.7", "--sightings", capsys=capsys)
    assert by_key["passes"][0]["sha256"] == second["sha256"]
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
    options = RecorderOptions(frames="none")
    with Recorder(SingleFile(path), camera_model(settings), about(settings, {}), options, lossless=True) as recorder:
        flight = Flight(load_scenario("demo"), 2, settings, pilot, observers=[reported, recorder])
        for step in range(240):
            if step == 100:
                pilot.begin()
            if step == 150:
                pilot.pause()
            if step == 200:
                pilot.abort()
            flight.step()
    again = ObservedCalls()
    recording = open_recording([path])
    Replay(recording, pilot_of(recording, settings, None, own_camera=True), observers=[again]).run()
    assert [d.phase for d in again.decisions] == [d.phase for d in reported.decisions]
    assert {"waiting for the start", "paused", "aborted"} < {d.phase for d in reported.decisions}
    assert [type(d.command) for d in again.decisions] == [type(d.command) for d in reported.decisions]
    assert not isinstance(again.decisions[-1].command, Land)


def test_without_recorded_guidance_it_runs_at_its_own_rate(recorded_flight: tuple[Path, ObservedCalls], tmp_path: Path) -> None:
    settings, path, reported = sim_settings(), tmp_path / "inputs.mcap", ObservedCalls()
    options = RecorderOptions(frames="none")
    with Recorder(SingleFile(path), camera_model(settings), about(settings, {}), options, lossless=True) as out:
        for sample in recorded_flight[1].samples:
            out.on_sample(sample)
    recording = open_recording([path])
    Replay(recording, pilot_of(recording, settings, None, own_camera=True), rate_hz=40.0, observers=[reported]).run()
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
