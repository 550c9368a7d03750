"""The recorder where the disk or the folder fails: nothing is recorded then, the flight goes on, and it comes back by itself."""

import errno
import os
import re
import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.base.observer import Decision
from companion.parts.recorder.recorder import Folder, Recorder, RecorderState, SingleFile
from companion.recording import mcap_file
from companion.recording.reading import RecordedFrame, open_recording
from companion.settings.service import RecorderOptions
from estimator.contracts.samples import Imu
from estimator.contracts.time import MonoNs
from tests.companion.test_recorder import ABOUT, CAMERA, numbered_frame, numbered_imu, samples_of
from tests.support.waiting import wait_until


class Disk:
    """A disk that can be full, and one that can stand still."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.full = False
        self.moving = threading.Event()
        self.moving.set()
        monkeypatch.setattr(mcap_file.McapFile, "_write", lambda file, data: self.write(file, data))

    def write(self, file: mcap_file.McapFile, data: memoryview) -> int:
        self.moving.wait(20.0)
        if self.full:
            os.write(file._file.fileno(), data[: len(data) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return os.write(file._file.fileno(), data)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[Disk]:
    disk = Disk(monkeypatch)
    monkeypatch.setattr("companion.parts.recorder.recorder._GATHER_S", 0.0)
    yield disk
    disk.moving.set()


def test_a_full_disk_is_reported_once_flown_through_and_left_behind(tmp_path, disk, caplog):
    path = tmp_path / "a.mcap"
    with Recorder(SingleFile(path), CAMERA, ABOUT, RecorderOptions(flush_s=0.1, retry_s=1.0, retry_cap_s=1.0)) as recorder:
        for i in range(100):
            recorder.on_sample(numbered_imu(0.01 * i))
        wait_until(lambda: recorder.written == 100)
        disk.full = True
        for i in range(100, 600):
            recorder.on_sample(numbered_imu(0.01 * i))
            wait_until(lambda: recorder._queue.empty())
        wait_until(lambda: recorder.state is RecorderState.BLOCKED and recorder._queue.empty())
        assert recorder.why == "No space left on device"
        disk.full = False
        for i in range(600, 900):
            recorder.on_sample(numbered_imu(0.01 * i))
        wait_until(lambda: recorder._queue.empty() and recorder.state is RecorderState.RECORDING)
    output = [r for r in caplog.records if r.levelname == "ERROR"]
    assert [r.getMessage() for r in output] == [
        "recorder: nothing is recorded now: No space left on device; the flight goes on, trying again"
    ]
    assert any("recording again, into" in r.getMessage() for r in caplog.records)
    before, after = samples_of(path), samples_of(tmp_path / "a-2.mcap")
    assert len(before) + len(after) + recorder.lost + recorder.dropped["imu"] == 900
    assert 80 <= len(before) <= 110
    assert 200 <= len(after) <= 300
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a-2.mcap", "a.mcap"]


@pytest.mark.hazard("H11")
def test_a_disk_that_stands_still_costs_records_and_never_the_callers_time(tmp_path, disk, monkeypatch, caplog):
    options = RecorderOptions(flush_s=0.05, queue_records=50, queue_frames=3)
    with Recorder(SingleFile(tmp_path / "a.mcap"), CAMERA, ABOUT, options) as recorder:
        recorder.on_sample(numbered_imu(0.0))
        wait_until(lambda: recorder.written == 1)
        disk.moving.clear()
        recorder.on_sample(numbered_imu(1.0))
        wait_until(lambda: recorder._queue.empty())
        began = time.perf_counter()
        for i in range(1000):
            recorder.on_sample(numbered_imu(1.0 + 0.001 * i))
            if i % 10 == 0:
                recorder.on_frame(numbered_frame(1.0 + 0.001 * i, i))
        spent_s = time.perf_counter() - began
        assert spent_s < 60.0, "one call that waited for this disk would not have come back"
        assert recorder.dropped["imu"] + recorder.dropped["detection"] == 1100 - 50
        assert recorder.dropped["frame"] + 3 >= 5 - 1
        monkeypatch.setattr("companion.parts.recorder.recorder._HANGS_S", 0.0)
        recorder.on_decision(Decision(MonoNs(2_000_000_000), "search", None, None))
        recorder.on_decision(Decision(MonoNs(3_500_000_000), "search", None, None))
        assert [m for m in caplog.messages if "has taken nothing" in m] == [caplog.messages[0]], "it is told once"
        disk.moving.set()
        wait_until(lambda: recorder._queue.empty() and recorder._busy_since_s is None)
        recorder.on_decision(Decision(MonoNs(5_000_000_000), "search", None, None))
        assert "recorder: the disk takes records again; 1 were dropped" in caplog.messages
        recorder.on_frame(numbered_frame(3.0, 7))
    kept = [e for e in open_recording([tmp_path / "a.mcap"]).events() if isinstance(e, RecordedFrame)]
    assert kept[-1].record.seq == 7
    assert kept[-1].image is not None


def test_too_little_free_space_ends_the_file_before_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    free = {"bytes": 900_000_000}
    monkeypatch.setattr(
        "companion.parts.recorder.recorder.shutil.disk_usage", lambda _: type("Usage", (), {"free": free["bytes"]})
    )
    folder = Folder(tmp_path, "20261120T050000Z", 100.0, 1000.0, min_free_mb=500.0)
    with Recorder(folder, CAMERA, ABOUT, RecorderOptions(flush_s=0.1, retry_s=0.5)) as recorder:
        for i in range(300):
            if i == 100:
                wait_until(lambda: recorder._queue.empty())
                free["bytes"] = 400_000_000
            if i == 200:
                wait_until(lambda: recorder._queue.empty())
                assert recorder.state is RecorderState.BLOCKED
                assert "400 MB free" in recorder.why, recorder.why
                free["bytes"] = 600_000_000
            recorder.on_sample(numbered_imu(0.01 * i))
        wait_until(lambda: recorder._queue.empty())
    first, second = sorted(tmp_path.glob("*.mcap"))
    recording = open_recording([first, second])
    kept = [round(e.w_body[2] / 0.01) for e in recording.events() if isinstance(e, Imu)]
    assert recording.cut == {}
    assert set(range(100)) <= set(kept)
    assert set(range(260, 300)) <= set(kept)
    assert not set(range(115, 195)) & set(kept)
    assert len(kept) + recorder.dropped["imu"] == 300


def test_a_full_disk_with_a_little_room_is_left_alone(tmp_path, disk, caplog, monkeypatch):
    monkeypatch.setattr("companion.parts.recorder.recorder.shutil.disk_usage", lambda _: type("Usage", (), {"free": 300_000}))
    folder = Folder(tmp_path, "20261120T050000Z", 100.0, 1000.0, min_free_mb=0.0)
    with Recorder(folder, CAMERA, ABOUT, RecorderOptions(flush_s=0.1, retry_s=0.5)) as recorder:
        for i in range(500):
            disk.full = 50 < i < 90
            recorder.on_sample(numbered_imu(0.01 * i))
            wait_until(lambda: recorder._queue.empty())
    assert len([r for r in caplog.records if r.levelname == "ERROR"]) == 1
    assert len(list(tmp_path.iterdir())) == 1


def record_samples(recorder: Recorder, at_s: float, seconds: float) -> float:
    """Return samples at 100 Hz from an instant on, taken in before this returns; the instant after them."""
    for i in range(round(100 * seconds)):
        recorder.on_sample(numbered_imu(at_s + 0.01 * i))
    wait_until(lambda: recorder._queue.empty())
    return at_s + seconds


def folder(path: Path) -> Folder:
    return Folder(path, "20261120T050000Z", max_file_mb=10.0, max_total_mb=20.0, min_free_mb=0.0)


def test_a_link_that_leads_nowhere_among_the_recordings_is_stepped_over(tmp_path: Path) -> None:
    """One such file under a name of ours ended every recording at its first look at the folder's size."""
    for name in ("decklander-20200101T000000Z-0001.mcap", "decklander-20261120T050000Z-0001.mcap"):
        (tmp_path / name).symlink_to(tmp_path / "nowhere")
    with Recorder(folder(tmp_path), CAMERA, ABOUT, RecorderOptions(flush_s=0.1, sync_s=0.1)) as recorder:
        record_samples(recorder, 0.0, 2.0)
        wait_until(lambda: recorder.written == 200)
        assert recorder.state is RecorderState.RECORDING
        assert (recorder.blocked, recorder.faults, recorder.files) == (0, 0, 1)
    assert len(samples_of(tmp_path / "decklander-20261120T050000Z-0002.mcap")) == 200


@pytest.mark.parametrize(
    ("spoil", "mend", "why"),
    [
        (
            lambda path: path.symlink_to(path.with_name("unplugged")),
            lambda path: path.with_name("unplugged").mkdir(),
            "recordings is a link to .*unplugged, which does not exist",
        ),
        (Path.touch, Path.unlink, "recordings: File exists"),
    ],
)
def test_a_folder_that_cannot_be_used_is_tried_until_it_can(tmp_path, caplog, spoil, mend, why):
    path = tmp_path / "recordings"
    spoil(path)
    with Recorder(folder(path), CAMERA, ABOUT, RecorderOptions(flush_s=0.1, retry_s=1.0, retry_cap_s=4.0)) as recorder:
        at_s = record_samples(recorder, 0.0, 30.0)
        assert recorder.state is RecorderState.BLOCKED
        assert re.search(why, recorder.why)
        assert 8 <= recorder.blocked <= 11, "after 1, 2, 4, 4, 4 ... s"
        assert recorder.counted()["dropped_imu"] == 3000
        mend(path)
        record_samples(recorder, at_s, 5.0)
        assert recorder.state is RecorderState.RECORDING
        assert recorder.why == ""
    assert len([r for r in caplog.records if r.levelname == "ERROR"]) == 1
    (file,) = path.glob("*.mcap")
    assert len(samples_of(file)) >= 100


def test_a_folder_that_is_taken_away_in_flight_is_begun_again(tmp_path: Path) -> None:
    path = tmp_path / "recordings"
    with Recorder(folder(path), CAMERA, ABOUT, RecorderOptions(flush_s=0.1, sync_s=0.5, retry_s=1.0)) as recorder:
        at_s = record_samples(recorder, 0.0, 2.0)
        shutil.rmtree(path)
        record_samples(recorder, at_s, 4.0)
        assert recorder.state is RecorderState.RECORDING
        assert recorder.files == 2
    (file,) = path.glob("*.mcap")
    assert len(samples_of(file)) >= 200


def test_a_file_that_cannot_be_removed_does_not_end_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old = tmp_path / "decklander-20200101T000000Z-0001.mcap"
    old.write_bytes(bytes(30_000_000))
    unlink = Path.unlink

    def refusing(path: Path, missing_ok: bool = False) -> None:
        if path == old:
            raise PermissionError(errno.EPERM, "Operation not permitted", str(path))
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", refusing)
    with Recorder(folder(tmp_path), CAMERA, ABOUT, RecorderOptions(flush_s=0.1, sync_s=0.5)) as recorder:
        record_samples(recorder, 0.0, 2.0)
        wait_until(lambda: recorder.written == 200)
        assert recorder.counted()["not_removed"] >= 1
        assert recorder.state is RecorderState.RECORDING


def test_a_disk_that_hangs_holds_up_the_end_of_the_service_for_a_moment_only(tmp_path: Path, disk: Disk) -> None:
    recorder = Recorder(folder(tmp_path), CAMERA, ABOUT, RecorderOptions(flush_s=0.05, queue_records=16), close_s=0.3)
    with recorder:
        disk.moving.clear()
        recorder.on_sample(numbered_imu(0.0))
        wait_until(lambda: recorder._queue.empty())
        for i in range(100):
            recorder.on_sample(numbered_imu(0.01 * i))
        began = time.perf_counter()
    assert time.perf_counter() - began < 15.0, "twenty seconds before"
    disk.moving.set()
