"""The recorder: what it was told reads back the same, frames as H.264, no disk stops a flight, and it comes back."""

import base64
import errno
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from mcap.reader import make_reader
from msgspec.structs import replace

from companion.base.containment import Audience
from companion.base.health import Health
from companion.base.observer import Decision, ProcessedFrame
from companion.cli import main as cli
from companion.facts.records import TruthRecord
from companion.parts.recorder.folder import Folder, SingleFile, recordings, start_of
from companion.parts.recorder.recorder import Recorder, RecorderState
from companion.recording import channels, mcap_file
from companion.recording.channels import TOPICS
from companion.recording.frame_encoder import KEY_EACH, RECORDED, FrameEncoder, FrameSequence, is_key_frame
from companion.recording.mcap_file import About
from companion.recording.reading import RecordedFrame, Recording, open_recording
from companion.settings.load import camera_model
from companion.settings.service import RecorderOptions
from drivers.clock import SystemClock
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import COMPONENTS, Verdict
from estimator.contracts.samples import Imu, Sample
from estimator.contracts.time import MonoNs, Stamp
from tests.fly import ObservedCalls, record_to, sim_settings
from tests.make import frame, imu, processed_frame, same_bits, tuned
from tests.support.waiting import wait_until

CAMERA = camera_model(sim_settings())
ABOUT = About({"flight": {"kind": "test"}})


def numbered_imu(at_s: float) -> Imu:
    return imu(at_s, (0.0, 0.0, at_s))


def numbered_frame(at_s: float, seq: int) -> ProcessedFrame:
    px = np.full((CAMERA.height, CAMERA.width, 3), seq % 256, np.uint8)
    return processed_frame(frame(at_s, seq, px), verdict=Verdict.NO_ATTITUDE)


def samples_of(path: Path) -> list[Sample]:
    return [event for event in open_recording([path]).events() if isinstance(event, Imu)]


ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def png_flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ObservedCalls]:
    path = tmp_path_factory.mktemp("recorder") / "flight.mcap"
    return path, record_to(path, seconds=1.2, frames="png")


def test_everything_reported_reads_back_the_same_to_the_bit(png_flight):
    path, reported = png_flight
    recording = open_recording([path])
    events = list(recording.events())
    assert recording.cut == {}
    assert recording.skipped == {}
    samples = [e for e in events if not isinstance(e, RecordedFrame | Decision) and hasattr(e, "stamp")]
    assert len(samples) == len(reported.samples) > 300
    assert all(same_bits(a, b) for a, b in zip(samples, reported.samples, strict=True))
    frames = [e for e in events if isinstance(e, RecordedFrame)]
    assert len(frames) == len(reported.frames) > 20
    for read, seen in zip(frames, reported.frames, strict=True):
        assert read.record.verdict is seen.verdict
        assert same_bits(read.attitude, seen.attitude)
        back = read.frame((640, 360))
        assert same_bits(back, seen.frame)
        detection = read.detection()
        assert (detection is None) == (seen.detection is None)
        if detection is not None and seen.detection is not None:
            assert detection.chosen == seen.detection.chosen
            assert dict(detection.methods).keys() == dict(seen.detection.methods).keys()
            for method, sighting in (*seen.detection.methods.items(), (None, seen.detection.selected)):
                back_again = detection.selected if method is None else detection.methods[method]
                assert same_bits(back_again, sighting and replace(sighting, features=()))
    decisions = [e for e in events if isinstance(e, Decision)]
    assert len(decisions) == len(reported.decisions) > 50
    assert all(same_bits(a, b) for a, b in zip(decisions, reported.decisions, strict=True))
    assert sum(isinstance(e, TruthRecord) for e in events) == 60


def test_settings_camera_pad_and_versions_travel_with_it(png_flight):
    recording = open_recording([png_flight[0]])
    assert recording.settings() == sim_settings()
    camera, pad = recording.camera(), recording.pad()
    assert (camera.width, pad.disc_radius_m) == (640, 0.39)
    assert recording.metadata["versions"]["numpy"] == np.__version__
    assert recording.metadata["flight"] == {"scenario": "demo", "seed": "1"}


def test_the_reference_reader_finds_an_indexed_file_whose_messages_keep_their_schemas(png_flight):
    with png_flight[0].open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.message_count > 1000
        checked = set()
        for schema, channel, message in reader.iter_messages():
            conforms(json.loads(schema.data), json.loads(message.data), channel.topic)
            checked.add(channel.topic)
    unseen = set(TOPICS) - checked
    not_flown = {topic(path) for path in ("ekf", "constant_velocity") for topic in (channels.belief, channels.pose)}
    compared = {channels.fusion(source) for source in COMPONENTS if source != "sighting"}  # by the ekf alone, which does not run
    others = {f"/sample/{name}" for name in ("vessel", "gimbal", "fix", "motion", "wind", "baseline")}
    assert unseen == others | {"/link", "/camera/video"} | not_flown | compared, unseen


def conforms(schema: dict[str, object], value: object, where: str) -> None:
    """Return whether data conforms to a schema, for the part of JSON Schema that viewers read."""
    kinds: dict[str, Any] = {
        "number": (int, float), "integer": int, "string": str, "boolean": bool, "array": list, "object": dict,
    }  # fmt: skip
    kind = schema["type"]
    assert isinstance(kind, str)
    assert isinstance(value, kinds[kind]), f"{where}: {value!r} is no {kind}"
    if isinstance(value, dict):
        known, required = schema["properties"], schema.get("required", [])
        assert isinstance(known, dict)
        assert isinstance(required, list)
        assert set(required) <= set(value) <= set(known), where
        for name, inner in value.items():
            conforms(known[name], inner, f"{where}.{name}")
    elif isinstance(value, list):
        items = schema["items"]
        assert isinstance(items, dict)
        for inner in value:
            conforms(items, inner, f"{where}[]")


def test_a_file_cut_anywhere_reads_up_to_the_cut(png_flight: tuple[Path, ObservedCalls], tmp_path: Path) -> None:
    data = png_flight[0].read_bytes()
    whole = list(open_recording([png_flight[0]]).events())
    counts = []
    for share in (0.3, 0.6, 0.9, 0.999):
        part = tmp_path / "cut.mcap"
        part.write_bytes(data[: int(share * len(data))])
        recording = open_recording([part])
        counts.append(sum(1 for _ in recording.events()))
        assert part in recording.cut
    assert counts == sorted(counts)
    assert 0 < counts[0] < counts[2] <= len(whole)
    torn = tmp_path / "zeros.mcap"
    torn.write_bytes(data[: int(0.6 * len(data))] + bytes(4096))
    recording = open_recording([torn])
    assert sum(1 for _ in recording.events()) == counts[1]
    assert torn in recording.cut


@pytest.mark.parametrize(
    ("content", "said"),
    [(b"", "it is empty"), (b"RIFF....AVI ", "not an MCAP file"), (b"\x89MCAP0\r\n", "holds no recording")],
)
def test_what_is_no_recording_is_refused_in_one_line(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(BadInput, match=said):
        open_recording([path])
    with pytest.raises(BadInput, match="No such file"):
        open_recording([tmp_path / "none.mcap"])


def test_what_a_killed_process_leaves_reads_up_to_its_last_flush(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    program = f"""
        import time
        from tests.companion.test_recorder import ABOUT, CAMERA, Path, Recorder, RecorderOptions, SingleFile, numbered_imu
        with Recorder(SingleFile(Path({str(path)!r})), CAMERA, ABOUT, RecorderOptions(flush_s=0.1)) as recorder:
            for i in range(100_000):
                recorder.on_sample(numbered_imu(i * 0.005))
                time.sleep(0.0005)
                if i % 200 == 0:
                    print(i, flush=True)
    """
    child = subprocess.Popen([sys.executable, "-c", textwrap.dedent(program)], stdout=subprocess.PIPE, cwd=ROOT, text=True)
    with child:
        for line in child.stdout:
            if int(line) >= 400:
                child.send_signal(signal.SIGKILL)
                break
    assert child.returncode == -signal.SIGKILL
    recording = open_recording([path])
    kept = [e for e in recording.events() if isinstance(e, Imu)]
    assert path in recording.cut
    assert len(kept) > 400 - 100
    assert [round(e.w_body[2] / 0.005) for e in kept] == list(range(len(kept)))


def test_files_follow_one_another_and_the_oldest_go(tmp_path: Path) -> None:
    other = tmp_path / "decklander-20200101T000000Z-0001.mcap"
    other.write_bytes(bytes(1_000_000))
    precious = tmp_path / "notes.txt"
    precious.write_bytes(bytes(3_000_000))
    folder = Folder(tmp_path, "20261120T050000Z", max_file_mb=0.2, max_total_mb=0.65, min_free_mb=0.0)
    rng = np.random.default_rng(3)
    with Recorder(folder, CAMERA, ABOUT, RecorderOptions(flush_s=0.1, sync_s=0.1), lossless=True) as recorder:
        for i in range(12_000):
            at = MonoNs(i * 5_000_000)
            recorder.on_sample(Imu(Stamp(at, at, 0.001, "sim"), rng.normal(size=3), rng.normal(size=3)))
    assert recorder.files >= 5
    left = sorted(p.name for p in tmp_path.glob("*.mcap"))
    assert not other.exists()
    assert precious.exists()
    assert left[-1] == f"decklander-20261120T050000Z-{recorder.files:04d}.mcap"
    assert sum((tmp_path / name).stat().st_size for name in left) < 900_000
    recording = open_recording([tmp_path / name for name in left])
    seen = [e.stamp.measured_at for e in recording.events() if isinstance(e, Imu)]
    assert recording.cut == {}
    assert np.all(np.diff(seen) == 5_000_000)
    assert seen[-1] == 11_999 * 5_000_000


@pytest.mark.parametrize("behind_days", [0, 300])
def test_a_clock_that_starts_in_the_past_removes_no_newer_flight(tmp_path, monkeypatch, behind_days, caplog):
    """A computer without a clock of its own: the names give the order, and this flight is the newest whatever its clock says."""
    now_s = time.time()
    earlier = [time.strftime("decklander-%Y%m%dT%H%M%SZ-0001.mcap", time.gmtime(now_s - day * 86400)) for day in (3, 2, 1)]
    for name in earlier:
        (tmp_path / name).write_bytes(bytes(1_000_000))
    monkeypatch.setattr(time, "gmtime", lambda s=0.0, _gmtime=time.gmtime: _gmtime(now_s - behind_days * 86400))
    folder = Folder(tmp_path, start_of(tmp_path), max_file_mb=1.0, max_total_mb=3.0, min_free_mb=0.0)
    ours = [folder.next_path()]
    for _ in range(2):
        ours[-1].write_bytes(bytes(1_000_000))
        ours.append(folder.next_path())
        folder.tidy(ours[-1])
    assert [p.name for p in recordings(tmp_path)] == [earlier[2], ours[0].name, ours[1].name]
    assert ("is behind" in caplog.text) is (behind_days > 0)


def test_pause_ends_the_file_and_resume_begins_another(tmp_path: Path) -> None:
    with Recorder(SingleFile(tmp_path / "a.mcap"), CAMERA, ABOUT, RecorderOptions(), lossless=True) as recorder:
        audience = Audience([recorder], Health(SystemClock()))
        for i in range(30):
            if i == 10:
                wait_until(lambda: recorder._queue.empty())
                recorder.switch(False)
            if i == 20:
                wait_until(lambda: recorder._queue.empty())
                assert (recorder.state, audience.takes_fusion) == (RecorderState.PAUSED, False)
                recorder.switch(True)
                assert audience.takes_fusion
            audience.on_samples([numbered_imu(0.01 * i)])
    assert len(samples_of(tmp_path / "a.mcap")) in (9, 10)
    assert len(samples_of(tmp_path / "a-2.mcap")) == 10


def test_the_same_flight_makes_the_same_file_to_the_byte(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        record_to(tmp_path / name, seconds=0.6)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_link_bytes_are_kept_both_ways(tmp_path: Path) -> None:
    with Recorder(SingleFile(tmp_path / "a.mcap"), CAMERA, ABOUT, RecorderOptions(), lossless=True) as recorder:
        recorder.on_link(MonoNs(5), "autopilot", "out", b"\xfd\x00\xff", "LANDING_TARGET")
        recorder.on_link(MonoNs(6), "autopilot", "in", bytes(range(256)))
    messages = make_reader(io.BytesIO((tmp_path / "a.mcap").read_bytes())).iter_messages(topics=["/link"])
    found = [json.loads(m.data) for _, _, m in messages]
    assert [(f["direction"], f.get("name")) for f in found] == [("out", "LANDING_TARGET"), ("in", None)]
    events = list(open_recording([tmp_path / "a.mcap"]).events())
    assert [e.data for e in events if hasattr(e, "data")] == [b"\xfd\x00\xff", bytes(range(256))]


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
        "recorder: nothing is recorded now: No space left on device; the flight goes on, trying again from 20 MB of free space on"
    ]
    assert any("recording again, into" in r.getMessage() for r in caplog.records)
    before, after = samples_of(path), samples_of(tmp_path / "a-2.mcap")
    assert len(before) + len(after) + recorder.lost + recorder.dropped["imu"] == 900
    assert 80 <= len(before) <= 110
    assert 200 <= len(after) <= 300
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a-2.mcap", "a.mcap"]


@pytest.mark.hazard("H11")
def test_a_disk_that_stands_still_costs_records_and_never_the_callers_time(tmp_path, disk, monkeypatch, caplog):
    options = tuned(RecorderOptions, flush_s=0.05, queue_records=50, queue_frames=3)
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
    free = {"bytes": 9_000_000}
    monkeypatch.setattr("companion.parts.recorder.folder.shutil.disk_usage", lambda _: type("Usage", (), {"free": free["bytes"]}))
    folder = Folder(tmp_path, "20261120T050000Z", 100.0, 1000.0, min_free_mb=5.0)
    with Recorder(folder, CAMERA, ABOUT, RecorderOptions(flush_s=0.1, retry_s=0.5)) as recorder:
        for i in range(300):
            if i == 100:
                wait_until(lambda: recorder._queue.empty())
                free["bytes"] = 4_000_000
            if i == 200:
                wait_until(lambda: recorder._queue.empty())
                assert recorder.state is RecorderState.BLOCKED
                assert "4 MB free" in recorder.why, recorder.why
                free["bytes"] = 6_000_000
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
    monkeypatch.setattr("companion.parts.recorder.folder.shutil.disk_usage", lambda _: type("Usage", (), {"free": 300_000}))
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
    recorder = Recorder(folder(tmp_path), CAMERA, ABOUT, tuned(RecorderOptions, flush_s=0.05, queue_records=16), close_s=0.3)
    with recorder:
        disk.moving.clear()
        recorder.on_sample(numbered_imu(0.0))
        wait_until(lambda: recorder._queue.empty())
        for i in range(100):
            recorder.on_sample(numbered_imu(0.01 * i))
        began = time.perf_counter()
    assert time.perf_counter() - began < 15.0, "twenty seconds before"
    disk.moving.set()


def moving_picture(n: int) -> list[np.ndarray]:
    """Return n frames of a bright square that moves over a gradient."""
    ground = np.repeat(np.linspace(20, 120, 96, dtype=np.uint8)[:, None, None], 128, axis=1).repeat(3, axis=2)
    out = []
    for k in range(n):
        image = ground.copy()
        image[30:60, k : k + 30] = (40, 200, 240)
        out.append(image)
    return out


def test_any_frame_can_be_requested_and_looks_as_it_was() -> None:
    images = moving_picture(40)
    encoder, sequence = FrameEncoder(RECORDED), FrameSequence()
    units = [encoder.encoded(image) for image in images]
    assert [k for k, unit in enumerate(units) if is_key_frame(unit)] == [0, KEY_EACH]
    frames = [sequence.add(unit) for unit in units]
    for k in (39, 3, 4, 29, 31, 0):
        frame = frames[k]
        px = frame.px()
        assert np.abs(px.astype(int) - images[k]).mean() < 4.0
    assert sum(map(len, units)) < 40 * 128 * 96 / 10


def test_what_is_missing_or_damaged_gives_no_frame_until_the_next_key_frame() -> None:
    encoder, sequence = FrameEncoder(RECORDED), FrameSequence()
    units = [encoder.encoded(image) for image in moving_picture(KEY_EACH + 5)]
    assert sequence.add(units[5]) is None, "nothing before the first key frame"
    for junk in (b"", b"\0" * 40, b"\0\0\1", b"\0\0\1\x65" + bytes(range(200))):
        found = FrameSequence().add(junk)
        assert found is None or found.px() is None
    frames = [sequence.add(unit) for unit in units[:3]] + [sequence.add(b"\0\0\1\x41\xff\xff")] + [sequence.add(units[KEY_EACH])]
    assert frames[2].px() is not None
    assert frames[4].px() is not None


def test_an_odd_size_is_refused_and_a_changed_size_begins_again() -> None:
    encoder = FrameEncoder(RECORDED)
    with pytest.raises(ValueError, match="even width and height, got 127x96 px"):
        encoder.encoded(np.zeros((96, 127, 3), np.uint8))
    assert is_key_frame(encoder.encoded(np.zeros((96, 128, 3), np.uint8)))
    assert not is_key_frame(encoder.encoded(np.zeros((96, 128, 3), np.uint8)))
    assert is_key_frame(encoder.encoded(np.zeros((64, 64, 3), np.uint8)))


def images_of(recording: Recording) -> list[np.ndarray]:
    camera = recording.camera()
    assert camera is not None
    found = (e.frame((camera.width, camera.height)) for e in recording.events() if isinstance(e, RecordedFrame))
    return [frame.px for frame in found if frame is not None]


def test_a_recording_holds_a_video_that_viewers_and_replay_read(tmp_path: Path) -> None:
    path, part = tmp_path / "flight.mcap", tmp_path / "part.mcap"
    flown = record_to(path, seconds=1.2, frames="h264")
    images = images_of(open_recording([path]))
    assert len(images) == len(flown.frames) > 20
    for px, seen in zip(images, flown.frames, strict=True):
        assert np.abs(px.astype(int) - seen.frame.px).mean() < 6.0
    with path.open("rb") as stream:
        units = [
            (schema.name, message.data) for schema, _, message in make_reader(stream).iter_messages(topics=["/camera/video"])
        ]
    assert {name for name, _ in units} == {"foxglove.CompressedVideo"}
    decoder = av.CodecContext.create("h264", "r")
    whole = b"".join(base64.b64decode(json.loads(data)["data"]) for _, data in units)
    packets = [*decoder.parse(whole), *decoder.parse()]
    decoded = [frame for packet in packets for frame in decoder.decode(packet)] + list(decoder.decode(None))
    assert len(decoded) == len(images)
    assert cli.main(["record", "cut", str(path), "--output", str(part), "--from", "0.5"]) == 0
    assert 5 < len(images_of(open_recording([part]))) < len(images)
    assert cli.main(["report", str(path), "--output", str(tmp_path / "page.html")]) == 0
    assert "film-0" in (tmp_path / "page.html").read_text()
