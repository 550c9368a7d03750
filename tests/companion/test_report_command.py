"""`decklander report`: recorded flights as they were flown, alone and compared."""

import json
import re
from pathlib import Path

import av
import numpy as np
import pytest

from companion.cli import main as cli
from companion.recording.reading import open_recording
from companion.tools.replay.recorded_log import log_of
from companion.tools.report.page import landing_began_s
from estimator.contracts.errors import BadInput
from estimator.contracts.time import seconds_between
from tests.companion.test_report import column, parts_of
from tests.fly import record_to


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two whole landings, the second with another limit."""
    folder = tmp_path_factory.mktemp("flights")
    paths = [folder / f"seed{seed}.mcap" for seed in (1, 2)]
    for seed, path in enumerate(paths, 1):
        words = ["simulate", "demo", "--perception", "truth", "--seed", str(seed), "--record", str(path), "--json"]
        changed = [] if seed == 1 else ["--set", "guidance.cone.gate_height_m=0.4"]
        assert cli.main([*words, *changed]) == 0
    return paths


def test_the_log_of_a_recording_is_that_of_the_flight(flights: list[Path]) -> None:
    log = log_of(open_recording([flights[0]]), "one")
    assert log.outcome == "landed"
    assert (log.steering, log.settings.startswith("[")) == ("ekf", True)
    (contact,) = log.contacts
    assert contact.on_pad
    assert np.hypot(*contact.p_pad_m) == pytest.approx(contact.lateral_m, abs=0.02)
    assert contact.lateral_m == log.touchdown.lateral_m if log.touchdown else False
    ahead = {round(seconds_between(one.made_at, one.at), 3) for one in log.decks}
    assert ahead == {0.0, 1.0, 2.0}
    assert all(one.p_pad_ned is not None and one.R_ned_pad is not None for one in log.truth)
    first, last = log.truth[0], log.truth[-1]
    assert seconds_between(first.at, last.at) > 5.0
    assert sum(log.verdicts.values()) == len(log.frames)
    assert [change.target.name for change in log.transitions][-1] in ("DOWN", "LANDED")


def test_the_command_writes_one_file_and_says_its_size(flights, tmp_path, capsys):
    capsys.readouterr()
    page = tmp_path / "one.html"
    assert cli.main(["report", str(flights[0]), "--output", str(page)]) == 0
    assert re.fullmatch(rf"report: {page} \(\d+\.\d MB, one file; open it in a browser\)\n", capsys.readouterr().out)
    data = json.loads(parts_of(page.read_text()).texts["data"])
    heave = next(plot for plot in data["plots"] if plot["title"] == "heave")
    assert {layer["name"] for layer in heave["layers"]} == {"truth", "filter", "forecast 1 s ago", "forecast 2 s ago"}


def test_two_flights_are_laid_over_each_other_from_where_their_landings_began(flights: list[Path], tmp_path: Path) -> None:
    page = tmp_path / "both.html"
    assert cli.main(["report", *map(str, flights), "--output", str(page)]) == 0
    text = page.read_text()
    data = json.loads(parts_of(text).texts["data"])
    down = next(plot for plot in data["plots"] if plot["title"] == "down")
    lines = {layer["name"]: layer for layer in down["layers"] if layer["style"] == "line"}
    assert set(lines) == {"A", "B"}
    for path, name in zip(flights, "AB", strict=True):
        log = log_of(open_recording([path]), name)
        began = landing_began_s(log)
        assert began > 0.0
        states = [e for e in log.estimates if e.path == "ekf"]
        t = column(data, lines[name]["t"])
        assert t[0] == pytest.approx(seconds_between(log.started, states[0].at) - began, abs=1e-3)
        assert column(data, lines[name]["y"])[-1] == pytest.approx(states[-1].height_m, abs=1e-5)
        assert any(abs(when) < 1e-3 for when, _ in data["flights"]["AB".index(name)]["phases"]), "a phase begins at zero"
    assert {mark["label"] for mark in data["views"][0]["marks"]} == {"A1", "B1"}
    assert "A landed, B landed" in text
    rows = re.findall(
        r"<tr><td>off centre at touchdown</td><td>([\d.]+) cm</td><td>([\d.]+) cm</td><td>([-+][\d.]+) cm</td>", text
    )
    (row,) = rows
    assert float(row[1]) - float(row[0]) == pytest.approx(float(row[2]), abs=0.011)
    assert "<td>guidance.cone.gate_height_m</td>" in text, "the settings that differ"
    assert text.count("<td>guidance.") == 1


def test_a_part_of_a_flight_and_strange_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "short.mcap"
    record_to(path, seconds=0.8)
    page = tmp_path / "short.html"
    drawn = tmp_path / "short.gif"
    assert cli.main(["report", str(path), "--animation", str(drawn)]) == 0
    with av.open(str(drawn)) as animation:
        first, *_, last = (frame.to_ndarray(format="bgr24").astype(int) for frame in animation.decode(video=0))
    assert first.shape == last.shape
    assert abs(first - last).max() > 50, "the drone moved between the first image and the last"
    assert cli.main(["report", str(path), "--animation", str(tmp_path / "no" / "folder.gif")]) == 2
    assert "no/folder.gif" in capsys.readouterr().err
    assert cli.main(["report", str(path), "--output", str(page), "--no-video"]) == 0
    assert "unfinished" in page.read_text()
    assert "film-0" not in parts_of(page.read_text()).ids
    assert cli.main(["report", str(path), str(tmp_path / "none.mcap"), "--output", str(page)]) == 2
    assert "none.mcap" in capsys.readouterr().err
    assert cli.main(["report", str(path), "--output", str(tmp_path / "no" / "folder.html")]) == 2
    golden = open_recording([Path(__file__).parents[1] / "golden" / "frames.mcap"])
    golden.attachments.pop("pad.toml")
    with pytest.raises(BadInput, match="does not hold its camera and its pad"):
        log_of(golden, "golden")
