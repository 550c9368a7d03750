"""`decklander record`: contents, parts, tables, and recordings of what others recorded; uploads to moto's S3 server."""

import csv
import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest

from companion.base.observer import Decision
from companion.cli import main as cli
from companion.cli.record import Storage, storage, upload
from companion.facts.records import TruthRecord
from companion.parts.recorder.folder import Folder, digest_file
from companion.recording import rewriting
from companion.recording.mcap_file import About
from companion.recording.reading import MAGIC, RecordedFrame, open_recording
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Attitude, Imu
from tests.support.waiting import accepts, free_port, wait_until

DATA = Path(__file__).parents[2] / "../shared/data"


def test_info_counts_what_there_is(flight_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["record", "info", "--json", str(flight_file)]) == 0
    info = json.loads(capsys.readouterr().out)
    assert info["seconds"] == pytest.approx(1.5, abs=0.02)
    assert info["messages"]["/sample/imu"] == 300
    assert info["frames"] == sum(info["verdicts"].values()) > 25
    assert info["flight"]["scenario"] == "demo"
    assert cli.main(["record", "info", str(flight_file)]) == 0
    assert "     300  /sample/imu" in capsys.readouterr().out


def test_a_cut_file_is_mended_and_replays_like_its_whole_part(flight_file, tmp_path, capsys):
    torn, mended = tmp_path / "torn.mcap", tmp_path / "mended.mcap"
    data = flight_file.read_bytes()
    torn.write_bytes(data[: len(data) * 19 // 20])
    assert cli.main(["record", "cut", str(torn), "--output", str(mended)]) == 0
    before, after = open_recording([torn]), open_recording([mended])
    assert len(list(before.events())) == len(list(after.events())) > 500
    assert (len(before.cut), len(after.cut)) == (1, 0)
    capsys.readouterr()
    digests = []
    for path in (torn, mended):
        assert cli.main(["replay", str(path), "--sightings", "--json"]) == 0
        digests.append(json.loads(capsys.readouterr().out)["passes"][0]["sha256"])
    assert digests[0] == digests[1]


def test_the_files_of_one_recording_are_joined_in_the_order_of_their_times_and_two_recordings_are_refused(
    flight_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second, other, out = (tmp_path / f"{name}.mcap" for name in ("first", "second", "other", "out"))
    assert cli.main(["record", "cut", str(flight_file), "--to", "0.7", "--output", str(first)]) == 0
    assert cli.main(["record", "cut", str(flight_file), "--from", "0.70001", "--output", str(second)]) == 0
    whole, joined = open_recording([flight_file]), open_recording([second, first])
    assert joined.paths == (first, second)
    assert sum(1 for _ in joined.events()) == sum(1 for _ in whole.events())
    monkeypatch.setattr(rewriting, "About", lambda facts, *more: About({**facts, "flight": {"seed": "4"}}, *more))
    assert cli.main(["record", "cut", str(flight_file), "--output", str(other)]) == 0
    for more, why in ((flight_file, "their times overlap"), (other, "they differ in flight"), (first, "their times overlap")):
        for command in ("replay", "record info", "record cut", "record export", "calibrate delay"):
            given = ["--output", str(out)] if command in ("record cut", "record export") else []
            assert cli.main([*command.split(), str(first), str(more), *given]) == 2
            assert f"are two recordings ({why})" in capsys.readouterr().err
    assert not out.exists()


def test_a_part_can_be_thinned_to_its_inputs(flight_file: Path, tmp_path: Path) -> None:
    part = tmp_path / "part.mcap"
    words = ["--from", "0.4", "--to", "0.9", "--inputs", "--samples-each", "4", "--frames-each", "3", "--no-frames"]
    assert cli.main(["record", "cut", str(flight_file), "--output", str(part), *words]) == 0
    events = list(open_recording([part]).events())
    frames = [e for e in events if isinstance(e, RecordedFrame)]
    assert not any(isinstance(e, Decision) for e in events)
    assert sum(isinstance(e, Imu) for e in events) == pytest.approx(25, abs=2)
    assert len(frames) == pytest.approx(5, abs=1)
    assert all(f.image is None for f in frames)
    assert any(isinstance(e, TruthRecord) for e in events)
    assert part.stat().st_size < flight_file.stat().st_size / 10


def test_a_video_and_an_attitude_table_become_a_recording_that_replays(flight_file, tmp_path, capsys):
    frames = [e for e in open_recording([flight_file]).events() if isinstance(e, RecordedFrame)]
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (640, 360))
    lines = ["time_s,roll_deg,pitch_deg,yaw_deg"]
    for i, recorded in enumerate(frames):
        frame, a = recorded.frame((640, 360)), recorded.record.attitude
        writer.write(frame.px)
        lines.append(f"{i / 30:.5f},{a.roll_deg:.4f},{a.pitch_deg:.4f},{a.yaw_deg:.4f}")
    writer.release()
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    out, sources = tmp_path / "imported.mcap", [f"{tmp_path / 'v.avi'}@0.5", f"{tmp_path / 'a.csv'}@0.5"]
    assert cli.main(["record", "import", *sources, "--config", "sim", "--output", str(out)]) == 0
    events = list(open_recording([out]).events())
    assert sum(isinstance(e, RecordedFrame) for e in events) == len(frames)
    assert min(e.stamp.measured_at for e in events if isinstance(e, Attitude)) == 500_000_000
    assert "no attitude" not in capsys.readouterr().err
    sources[1] = f"{tmp_path / 'a.csv'}@9"
    assert cli.main(["record", "import", *sources, "--config", "sim", "--output", str(tmp_path / "late.mcap")]) == 0
    assert f"{len(frames)} of {len(frames)} frames have no attitude" in capsys.readouterr().err
    assert cli.main(["replay", str(out), "--json", "--path", "median_mean", "--record", str(tmp_path / "seen.mcap")]) == 0
    done = json.loads(capsys.readouterr().out)["passes"][0]
    assert done["counts"]["searched"] == len(frames)
    seen = [e for e in open_recording([tmp_path / "seen.mcap"]).events() if isinstance(e, RecordedFrame)]
    pairs = [(a.detection(), b.detection()) for a, b in zip(seen, frames, strict=True)]
    found = [(a.selected, b.selected) for a, b in pairs if a is not None and b is not None]
    both = [(a, b) for a, b in found if a is not None and b is not None]
    assert len(both) > 20
    for ours, theirs in both:
        assert ours.d_body_pad_level == pytest.approx(theirs.d_body_pad_level, abs=0.15)


@pytest.mark.skipif(not DATA.is_dir(), reason="the shared recordings are not here")
def test_a_capture_and_a_log_go_into_one_recording(tmp_path: Path) -> None:
    out = tmp_path / "imported.mcap"
    sources = [str(DATA / "ardrone/video_starts_on_p_frames.pave"), f"{DATA / 'mavlink/arducopter_flight.bin'}@-3.5"]
    assert cli.main(["record", "import", *sources, "--config", "ardrone2", "--output", str(out)]) == 0
    events = list(open_recording([out]).events())
    frames = [e for e in events if isinstance(e, RecordedFrame)]
    assert len(frames) == 17
    assert frames[0].stamp.measured_at == 3_500_000_000
    assert sum(isinstance(e, Imu) for e in events) == 11916


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
    assert "Not a directory" in capsys.readouterr().err
    monkeypatch.setattr(rewriting, "_COLUMNS_MAX", 5)
    with pytest.raises(BadInput, match="has more than 5 columns"):
        rewriting.export(open_recording([flight_file]), tmp_path / "tables")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(flight_file.read_bytes()[:-20_000])
    monkeypatch.setattr(rewriting, "_COLUMNS_MAX", 1000)
    assert rewriting.export(open_recording([cut]), tmp_path / "part")["sample_imu.csv"] > 20


FIRST, SECOND = (f"decklander-20261120T050000Z-000{i}.mcap" for i in (1, 2))


def written(folder: Path, name: str, size: int = 300_000) -> bytes:
    """Write a finished recording of random messages, and return its bytes."""
    content = MAGIC + os.urandom(size) + MAGIC
    (folder / name).write_bytes(content)
    return content


@pytest.fixture
def s3(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[str]:
    """The URL of a bucket of an S3 server on loopback."""
    port = free_port()
    for name, value in (
        ("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}"), ("AWS_ACCESS_KEY_ID", "drone"), ("AWS_SECRET_ACCESS_KEY", "secret"),
        ("AWS_DEFAULT_REGION", "us-east-1"),
    ):  # fmt: skip
        monkeypatch.setenv(name, value)
    server = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    with (tmp_path / "moto.log").open("wb") as log, subprocess.Popen(server, stdout=log, stderr=log) as process:
        try:
            wait_until(lambda: process.poll() is not None or accepts(port))
            assert process.poll() is None, (tmp_path / "moto.log").read_text()
            storage("s3://ship").system.mkdir("ship")
            yield "s3://ship/drone_1"
        finally:
            process.kill()


def test_an_s3_server_gets_each_finished_recording_once(s3: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "recordings"
    folder.mkdir()
    content = written(folder, FIRST)
    (folder / SECOND).write_bytes(MAGIC + bytes(1000))
    (folder / "notes.txt").write_text("not ours")
    assert cli.main(["record", "upload", str(folder), "--to", s3]) == 0
    assert capsys.readouterr().out == f"{FIRST}: uploaded, 0.3 MB\n"
    there = storage(s3)
    assert sorted(path.rsplit("/")[-1] for path in there.system.ls(there.root)) == [FIRST, f"{FIRST}.sha256"]
    assert there.system.cat_file(there.at(FIRST)) == content
    line = f"{hashlib.sha256(content).hexdigest()}  {FIRST}\n"
    assert there.system.cat_file(there.at(f"{FIRST}.sha256")).decode() == digest_file(folder / FIRST).read_text() == line
    assert cli.main(["record", "upload", str(folder), "--to", s3]) == 0
    assert capsys.readouterr().out == ""
    os.utime(folder / SECOND, (time.time() - 100.0,) * 2)
    assert cli.main(["record", "upload", str(folder), "--to", s3]) == 0
    assert SECOND in capsys.readouterr().out, "a crash left it without its end"


class Bent:
    """A file system that changes what is written, until it is mended."""

    def __init__(self, whole: Storage) -> None:
        self._whole, self.broken = whole, True

    def __getattr__(self, name: str) -> object:
        return getattr(self._whole.system, name)

    def put_file(self, path: str, there: str) -> None:
        if self.broken:
            Path(there).write_bytes(bytes(Path(path).stat().st_size))
        else:
            self._whole.system.put_file(path, there)


def test_what_comes_back_changed_does_not_count(tmp_path: Path) -> None:
    content = written(tmp_path, FIRST)
    whole = storage(str(tmp_path / "there"))
    bent = Bent(whole)
    (done,) = upload(tmp_path, whole._replace(system=bent))
    assert "differs" in done.why
    assert not digest_file(tmp_path / FIRST).exists()
    bent.broken = False
    (done,) = upload(tmp_path, whole._replace(system=bent))
    assert done.why is None
    assert (tmp_path / "there" / FIRST).read_bytes() == content


class Rights:
    """A file system that grants some operations alone, and counts what was sent."""

    def __init__(self, whole: Storage, *granted: str) -> None:
        self._whole, self.granted, self.sent = whole, set(granted), 0

    def __getattr__(self, name: str) -> object:
        if name not in self.granted:
            raise PermissionError("Access Denied")
        self.sent += name == "put_file"
        return getattr(self._whole.system, name)


WRITES = "put_file", "pipe_file"


@pytest.mark.parametrize("granted", [{*WRITES, "open"}, {*WRITES, "open", "exists", "size"}, {*WRITES, "open", "rm_file"}])
def test_an_upload_needs_to_write_and_to_read_back_and_nothing_else(tmp_path: Path, granted: set[str]) -> None:
    content = written(tmp_path, FIRST)
    (tmp_path / "there").mkdir()
    (done,) = upload(tmp_path, Storage(Rights(storage("/"), *granted), str(tmp_path / "there")))
    assert done.why is None
    assert (tmp_path / "there" / FIRST).read_bytes() == content


def test_a_right_that_is_refused_is_named_and_nothing_goes_out_twice(tmp_path: Path) -> None:
    for name in (FIRST, SECOND):
        written(tmp_path, name)
    (tmp_path / "there").mkdir()
    rights, sent = Rights(storage("/")), set[Path]()
    to = Storage(rights, str(tmp_path / "there"))
    for granted, said in (((), "s3:PutObject"), (WRITES, "s3:GetObject"), (WRITES, "s3:GetObject")):
        rights.granted = set(granted)
        (done,) = upload(tmp_path, to, sent)
        assert said in (done.why or "")
        assert not digest_file(done.path).exists()
    assert rights.sent == 1
    rights.granted.add("open")
    assert [done.why for done in upload(tmp_path, to, sent)] == [None, None]
    assert rights.sent == 2


def test_a_storage_that_does_not_answer_costs_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = written(tmp_path, FIRST)
    (tmp_path / "there").write_text("a file where the folder should be")
    assert cli.main(["record", "upload", str(tmp_path), "--to", str(tmp_path / "there")]) == 1
    assert f"{FIRST}: not uploaded" in capsys.readouterr().err
    assert (tmp_path / FIRST).read_bytes() == content
    assert not digest_file(tmp_path / FIRST).exists()


def test_the_recorder_deletes_no_recording_before_it_is_uploaded(tmp_path: Path) -> None:
    folder = Folder(tmp_path, "20261121T050000Z", max_file_mb=0.2, max_total_mb=0.5, min_free_mb=0.0, delete="uploaded")
    for name in (FIRST, SECOND):
        written(tmp_path, name)
    folder.tidy(None)
    assert {FIRST, SECOND} <= {path.name for path in tmp_path.iterdir()}
    assert "not uploaded" in (folder.lacks_room() or "")
    list(upload(tmp_path, storage(str(tmp_path / "there"))))
    assert folder.lacks_room() is None
    assert sorted(path.name for path in tmp_path.glob("*.mcap*")) == [SECOND, f"{SECOND}.sha256"]
