"""A recording as CSV tables: every number of every message, under names that say what it is."""

import csv
from pathlib import Path

import pytest

from companion.base.observer import Decision
from companion.cli import main as cli
from companion.recording import rewriting
from companion.recording.reading import open_recording
from estimator.contracts.errors import BadInput


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_tables_hold_the_numbers_of_the_recording(flight_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "tables"
    assert cli.main(["record", "export", str(flight_file), "--output", str(folder)]) == 0
    reported = dict(line.rsplit(": ", 1) for line in capsys.readouterr().out.splitlines())
    beliefs = [e.belief for e in open_recording([flight_file]).events() if isinstance(e, Decision) and e.belief is not None]
    rows = table(folder / "belief_dead_reckoning.csv")
    assert len(rows) == len(beliefs) > 20
    assert reported[str(folder / "belief_dead_reckoning.csv")] == f"{len(rows)} rows"
    for row, belief in zip(rows, beliefs, strict=True):
        assert int(row["timestamp"]) == belief.at // 1000
        assert [float(row[f"d_body_pad_level[{k}]"]) for k in range(3)] == belief.d_body_pad_level.tolist()
        assert float(row["cov[48]"]) == belief.cov[6, 6]
        for name, value in belief.details:
            assert float(row[f"details.{name}"]) == value
    assert {row["yaw_rad"] for row in rows if row["yaw_rad"] == ""} <= {""}
    names = {path.name for path in folder.iterdir()}
    assert {"sample_imu.csv", "truth.csv", "decision.csv", "detection.csv"} <= names
    assert not any(name.startswith(("camera", "scene", "tf", "pose")) for name in names), "drawings for viewers are left out"


def test_what_cannot_be_written_or_is_damaged_is_reported(flight_file, tmp_path, monkeypatch, capsys):
    (tmp_path / "file").write_text("")
    assert cli.main(["record", "export", str(flight_file), "--output", str(tmp_path / "file")]) == 2
    assert "cannot write tables there" in capsys.readouterr().err
    monkeypatch.setattr(rewriting, "_COLUMNS_MAX", 5)
    with pytest.raises(BadInput, match="has more than 5 columns"):
        rewriting.export(open_recording([flight_file]), tmp_path / "tables")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(flight_file.read_bytes()[:-20_000])
    monkeypatch.setattr(rewriting, "_COLUMNS_MAX", 1000)
    assert rewriting.export(open_recording([cut]), tmp_path / "part")["sample_imu.csv"] > 20
