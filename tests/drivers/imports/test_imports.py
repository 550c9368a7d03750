"""Recordings of others: read with the right axes, units and times, distinguished by content, or refused in one line."""

import gc
import itertools
import struct
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.tools.doctor.gather_outside import parameters_of
from drivers.ardrone import capture
from drivers.file_kinds import FileKind, kind_of
from drivers.imports import dataflash, pictures, px4_ulog, tlog
from drivers.log_stamps import Tell, timeline
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, GeoFix, Imu, Range, Sample, VehicleStatus
from tests.support import flight_logs as made
from tests.support.image_files import film

DATA = Path(__file__).parents[3] / "../shared/data"
ULOG, DATAFLASH = DATA / "mavlink/px4_sample.ulg", DATA / "mavlink/arducopter_flight.bin"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the shared recordings are not here")


def of(kind: type, samples: Sequence[Sample]) -> list[Sample]:
    return [s for s in samples if isinstance(s, kind)]


def turn_rates(attitudes: Sequence[Sample]) -> tuple[np.ndarray, np.ndarray]:
    """(n, 2) instants in seconds and (n, 3) mean body rates between neighbouring attitudes."""
    at, rates = [], []
    for a, b in itertools.pairwise(attitudes):
        assert isinstance(a, Attitude)
        assert isinstance(b, Attitude)
        dt = (b.stamp.measured_at - a.stamp.measured_at) * 1e-9
        if 0 < dt < 0.25:
            at.append((a.stamp.measured_at * 1e-9, b.stamp.measured_at * 1e-9))
            rates.append((a.R_ned_body.inv @ b.R_ned_body).rotvec_rad / dt)
    return np.array(at), np.array(rates)


@needs_data
@pytest.mark.parametrize(("read", "path", "least"), [(px4_ulog.read, ULOG, 0.9), (dataflash.read, DATAFLASH, 0.5)])
def test_gyro_and_attitude_of_one_log_turn_the_same_way(read: object, path: Path, least: float) -> None:
    assert callable(read)
    samples = read(path)
    received_at = [s.stamp.received_at for s in samples]
    assert received_at == sorted(received_at)
    assert received_at[0] >= 0
    imu = of(Imu, samples)
    at, rates = turn_rates(of(Attitude, samples))
    t = np.array([s.stamp.measured_at * 1e-9 for s in imu])
    w = np.array([s.w_body for s in imu if isinstance(s, Imu)])
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (w[1:] + w[:-1]) * np.diff(t)[:, None], axis=0)])
    for axis in range(3):
        begin, end = (np.interp(at[:, k], t, angle[:, axis]) for k in (0, 1))
        gyro = (end - begin) / (at[:, 1] - at[:, 0])
        assert np.corrcoef(gyro, rates[:, axis])[0, 1] > least, f"axis {axis}"
    severity = np.median([s.f_body[2] for s in imu if isinstance(s, Imu)])
    assert -10.5 < severity < -8.5


@needs_data
def test_the_dataflash_log_holds_what_its_own_tools_count() -> None:
    samples = dataflash.read(DATAFLASH)
    counts = Counter(type(s).__name__ for s in samples)
    assert counts["Imu"] == 11916
    assert counts["Attitude"] == counts["Baro"] == counts["BodyVelocity"] == 2383
    assert samples[-1].stamp.measured_at * 1e-9 == pytest.approx(242.6, abs=0.1)
    speed = max(float(np.linalg.norm(s.v_level)) for s in samples if isinstance(s, BodyVelocity))
    assert 0.5 < speed < 30.0


@needs_data
@pytest.mark.parametrize(("name", "images", "seconds"), [("video_56_frames", 56, 1.793), ("video_starts_on_p_frames", 17, 0.511)])
def test_pave_captures_give_the_images_that_decode_at_the_drones_times(name: str, images: int, seconds: float) -> None:
    frames = list(capture.frames(DATA / f"ardrone/{name}.pave"))
    assert len(frames) == images
    assert frames[0].px.shape == (360, 640, 3)
    assert frames[0].stamp.measured_at == 0
    assert frames[-1].stamp.measured_at * 1e-9 == pytest.approx(seconds, abs=0.002)
    steps = np.diff([f.stamp.measured_at for f in frames]) * 1e-6
    assert np.median(steps) == pytest.approx(33.0, abs=1.0)
    assert all(f.stamp.delay_s == 0.05 for f in frames)


@needs_data
def test_navdata_captures_are_parted_and_timed_by_the_drones_clock(tmp_path: Path) -> None:
    one = (DATA / "ardrone/navdata_full_gps.bin").read_bytes()
    at = one.index(struct.pack("<HH", 1, 8)) + 4
    (word,) = struct.unpack_from("<I", one, at)

    def later(milliseconds: int) -> bytes:
        """Return the same datagram with another time and a checksum that fits."""
        data = bytearray(one)
        us = (word >> 21) * 1_000_000 + (word & 0x1FFFFF) + 1000 * milliseconds
        struct.pack_into("<I", data, at, (us // 1_000_000) << 21 | us % 1_000_000)
        struct.pack_into("<I", data, len(data) - 4, sum(data[:-8]) & 0xFFFFFFFF)
        return bytes(data)

    path = tmp_path / "navdata.bin"
    path.write_bytes(one + b"\x00\x01" + later(5) + later(10)[:700] + later(15) + later(2000))
    samples = capture.samples(path)
    instants = sorted({s.stamp.measured_at for s in samples})
    assert instants == [0, 5_000_000, 15_000_000, 2_000_000_000]
    assert {Imu, Attitude, BodyVelocity, Range, Baro, GeoFix, VehicleStatus} == {type(s) for s in samples}


def test_attitude_tables_begin_at_zero_and_know_their_heading(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time_s,roll_deg,pitch_deg,yaw_deg\n10.5,3,-4,90\n10.0,1,2,\n")
    first, second = pictures.attitudes(path)
    assert isinstance(first, Attitude)
    assert isinstance(second, Attitude)
    assert (first.stamp.measured_at, second.stamp.measured_at) == (0, 500_000_000)
    assert np.degrees(second.R_ned_body.rpy_rad) == pytest.approx([3.0, -4.0, 90.0])
    path.write_text("\ufefftime_s; roll_deg; pitch_deg\n1700000000.5;1;2\n5;0;0\n1700000000.75;3;4\n1700000000.75;3;4\n")
    reported: list[str] = []
    assert [s.stamp.measured_at for s in pictures.attitudes(path, reported.append)] == [0, 250_000_000]
    assert "1 of 4 lines have the time of one above and are left out; 1 of 3 stamps" in "; ".join(reported)


@pytest.mark.parametrize("form", ["h264", "mjpeg"])
def test_a_raw_video_is_read_at_its_rate(tmp_path: Path, form: str) -> None:
    greys = [np.full((48, 64, 3), 20 * i, np.uint8) for i in range(10)]
    coded = ("libx264", 25, "yuv420p") if form == "h264" else ("mjpeg", 25, "yuvj420p")
    path = film(tmp_path / f"flight.{form}", greys, *coded)
    frames = list(pictures.video_frames(path))
    assert np.allclose([f.stamp.measured_at * 1e-9 for f in frames], np.arange(10) / 25, atol=1e-6)


@pytest.mark.parametrize("size", [None, (64, 48)])
def test_videos_keep_their_own_times_behind_a_preview(size: tuple[int, int] | None, tmp_path: Path) -> None:
    """The rate varies, frames are coded out of order, and a smaller video stands before the one that is meant."""
    path = tmp_path / "v.mp4"
    at_ms = [10 * i * i for i in range(10)]
    with av.open(str(path), "w") as out:
        streams = [out.add_stream("libx264", rate=20, options={"bf": "2"}) for _ in range(2)]
        for stream, half in zip(streams, (2, 1), strict=True):
            stream.width, stream.height, stream.pix_fmt = 64 // half, 48 // half, "yuv420p"
            stream.codec_context.time_base = Fraction(1, 1000)
        for i, at in enumerate(at_ms):
            for stream in streams:
                px = np.full((stream.height, stream.width, 3), 20 * i, np.uint8)
                image = av.VideoFrame.from_ndarray(px, format="bgr24")
                image.pts, image.time_base = at, Fraction(1, 1000)
                out.mux(stream.encode(image))
        for stream in streams:
            out.mux(stream.encode(None))
    frames = list(pictures.video_frames(path, size))
    assert {f.px.shape for f in frames} == {(48, 64, 3)}
    assert [round(f.stamp.measured_at * 1e-6) for f in frames] == at_ms
    assert [int(f.px.mean()) for f in frames] == pytest.approx([20 * i for i in range(10)], abs=6)


@pytest.mark.parametrize(
    ("read", "content", "said"),
    [
        (px4_ulog.read, b"ULog\x01\x12\x35\x01" + bytes(30), "neither sensor_combined"),
        (px4_ulog.read, b"nonsense", "not a readable PX4 log"),
        (dataflash.read, b"1, FMT", "not a dataflash log"),
        (dataflash.read, b"\xa3\x95" + bytes(200), "neither IMU|not a readable"),
        (capture.samples, b"\x88\x77\x66\x55" + bytes(100), "no whole navdata"),
        (lambda p: list(capture.frames(p)), b"PaVE" + bytes(300), "no frame"),
        (lambda p: list(pictures.video_frames(p)), b"RIFF1234AVI nonsense", "readable video|holds no video"),
        (pictures.attitudes, b"time_s,roll_deg\n1,2\n", "column 'pitch_deg' is missing"),
        (pictures.attitudes, b"time_s,roll_deg,pitch_deg\n1,2,x\n", "line 2: not a number"),
        (pictures.attitudes, b"time_s,roll_deg,pitch_deg\n1,2,inf\n", "line 2: not a finite"),
        (pictures.attitudes, b"time_s,roll_deg,pitch_deg\n", "holds no attitudes"),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_line(read: object, content: bytes, said: str, tmp_path: Path) -> None:
    assert callable(read)
    path = tmp_path / "x"
    path.write_bytes(content)
    with pytest.raises(BadInput, match=said) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    with pytest.raises(BadInput):
        read(tmp_path / "missing")


@pytest.mark.parametrize("content", [b"\xa3\x95\x80" + b"\xff" * 86, b"\xa3\x95\x80\x80\x59FMT\0" + b"\xff" * 80])
def test_a_dataflash_log_that_is_refused_is_closed(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(content)
    with pytest.raises(BadInput, match="not a readable dataflash log"):
        dataflash.read(path)
    left = [link for link in Path("/proc/self/fd").iterdir() if link.is_symlink() and link.resolve() == path.resolve()]
    assert left == []
    gc.collect()  # a file that was not closed says so here, which is an error in these tests


BEGAN, STEP = 20_000_000, 100_000
TIMES = [BEGAN + STEP * n for n in range(50)]
HEIGHTS = [5.0 - 0.09 * n for n in range(50)]
PARAMETERS = {
    "copter.param": "#NOTE: 24.11.2026 quad\r\nSYSID_THISMAV,1\r\nGUID_TIMEOUT,0.2\r\nINS_ACCOFFS_X,-0.01325\r\n",
    "copter.parm": "SYSID_THISMAV    1.000000\nGUID_TIMEOUT     0.200000\nINS_ACCOFFS_X    -0.013250\n",
    "px4.params": "# Stack: PX4 Pro\n# Version: 1.15.4 \n#\n1\t1\tMAV_SYS_ID\t1\t6\n1\t1\tCOM_DISARM_LAND\t9.0000000000\t9\n",
}


def heard(read: Callable[[Path, Tell], Iterable[Sample]], path: Path, data: bytes) -> tuple[list[Sample], str]:
    """Return the samples of a file with these bytes, and what was told of it."""
    path.write_bytes(data)
    reported: list[str] = []
    samples = list(read(path, reported.append))
    assert [s.stamp.received_at for s in samples] == sorted(s.stamp.received_at for s in samples)
    return samples, "; ".join(reported)


def heights(samples: Iterable[Sample]) -> tuple[list[float], list[float]]:
    ranges = [s for s in samples if isinstance(s, Range)]
    return [s.stamp.measured_at * 1e-9 for s in ranges], [s.range_m for s in ranges]


@pytest.mark.parametrize("write", [made.dataflash, made.text_dataflash])
def test_both_forms_of_a_dataflash_log_give_the_height_below_and_not_the_wall_ahead(write, tmp_path):
    samples, reported = heard(dataflash.read, tmp_path / "log", write(made.flight(TIMES, HEIGHTS, forward_m=8.0)))
    at, found = heights(samples)
    assert found == pytest.approx(HEIGHTS, abs=0.011)
    assert np.diff(at) == pytest.approx(0.1)
    assert sum(isinstance(s, Imu) for s in samples) == 50
    assert reported == ""
    assert dataflash.read_history(tmp_path / "log").parameters["GUID_TIMEOUT"] == pytest.approx(0.2)


def test_of_two_that_look_down_the_better_one_is_read(tmp_path: Path) -> None:
    rows = made.flight(TIMES, HEIGHTS)
    rows += [("RFND", (at + 3000, 1, 7.0, 2 if n % 5 else 4, 25)) for n, at in enumerate(TIMES)]
    samples, reported = heard(dataflash.read, tmp_path / "log", made.dataflash(rows))
    assert heights(samples)[1] == pytest.approx(HEIGHTS, abs=0.011)
    assert "2 rangefinders look down" in reported


@pytest.mark.parametrize(
    ("form", "columns", "values"),
    [
        ("Qffffff", "TimeUS,DesPitch,Pitch,DesRoll,Roll,DesYaw,Yaw", (0.0, -1.0, 0.0, 1.0, 90.0, 90.0)),
        ("Qfff", "TimeUS,Roll,Pitch,Yaw", (1.0, -1.0, 90.0)),
    ],
)
def test_a_message_that_is_described_anew_is_read_by_what_holds_there(form, columns, values, tmp_path, capsys):
    data = made.dataflash(made.flight(TIMES, HEIGHTS)) + made.described("ATT", form, columns)
    data += b"".join(made.message("ATT", form, (TIMES[-1] + STEP * n, *values)) for n in range(1, 51))
    samples, reported = heard(dataflash.read, tmp_path / "log", data)
    angles = np.degrees([s.R_ned_body.rpy_rad for s in samples if isinstance(s, Attitude)])
    assert angles == pytest.approx(np.tile([1.0, -1.0, 90.0], (100, 1)), abs=1e-3)
    assert reported == capsys.readouterr().out == ""


def test_the_second_imu_is_read_where_the_first_is_switched_off(tmp_path: Path) -> None:
    rows = [(name, (v[0], 1, *v[2:]) if name == "IMU" else v) for name, v in made.flight(TIMES, HEIGHTS)]
    samples, reported = heard(dataflash.read, tmp_path / "log", made.dataflash(rows))
    assert sum(isinstance(s, Imu) for s in samples) == 50
    assert "number 1" in reported


@pytest.mark.parametrize(
    ("times", "lasts_s", "said"),
    [
        ([t - 500_000 * (n >= 25) for n, t in enumerate(TIMES)], 4.9, "went back by about 0.4"),
        ([t - 19_000_000 * (n >= 25) for n, t in enumerate(TIMES)], 4.9, "went back by about 18.9"),
        ([t + 40_000_000_000 * (n >= 25) for n, t in enumerate(TIMES)], 4.9, "went ahead by 40000 s"),
        ([t + 2**60 * (n == 25) for n, t in enumerate(TIMES)], 4.9, "stamps are absurd"),
        ([t + 60_000_000 * (n >= 25) for n, t in enumerate(TIMES)], 64.9, ""),
    ],
)
def test_a_log_whose_clock_steps_goes_on_and_reports_it(times: list[int], lasts_s: float, said: str, tmp_path: Path) -> None:
    samples, reported = heard(dataflash.read, tmp_path / "log", made.dataflash(made.flight(times, HEIGHTS)))
    at, found = heights(samples)
    assert all(np.diff(found) < 0), "it falls all the time"
    assert all(np.diff(at) > 0)
    assert at[-1] - at[0] == pytest.approx(lasts_s, abs=0.35)
    assert said in reported
    assert dataflash.read_history(tmp_path / "log").history.lasted_s <= lasts_s + 0.1


@given(st.lists(st.one_of(st.integers(0, 10**9), st.integers(-(2**63), 2**64)), max_size=60))
@settings(max_examples=80)
def test_any_stamps_make_a_time_that_begins_at_zero(stamps: list[int]) -> None:
    out = timeline(stamps)
    assert len(out) == len(stamps)
    assert all(at is None or at >= 0 for at in out)


def test_a_px4_log_begins_where_its_header_says_and_reads_the_sensor_that_looks_down(tmp_path: Path) -> None:
    samples, reported = heard(px4_ulog.read, tmp_path / "log", made.px4_flight(BEGAN, retained_us=BEGAN - 10_000_000))
    at, found = heights(samples)
    assert found == pytest.approx(HEIGHTS, abs=1e-5)
    assert (at[0], at[-1]) == pytest.approx((0.0, 4.9))
    assert not any(isinstance(s, VehicleStatus) for s in samples)
    assert reported == ""
    assert px4_ulog.read_history(tmp_path / "log").history.lasted_s == pytest.approx(4.9, abs=0.01)
    lost = made.px4_flight(BEGAN, foreign=made.ULOG_GAP)
    assert "0.70 s are lost, the first after 2.5 s" in heard(px4_ulog.read, tmp_path / "log", lost)[1]


@pytest.mark.parametrize("seed", range(6))
def test_foreign_bytes_in_a_px4_log_are_left_out_and_reported(seed, tmp_path, capsys):
    foreign = np.random.default_rng(seed).bytes(50 + 90 * seed)
    samples, reported = heard(px4_ulog.read, tmp_path / "log", made.px4_flight(BEGAN, foreign=foreign))
    assert sum(isinstance(s, Attitude) for s in samples) >= 49
    assert "damaged" in reported
    assert capsys.readouterr().out == ""


def test_a_telemetry_log_gives_samples_and_parameters(tmp_path: Path) -> None:
    data = made.telemetry_log()
    samples, reported = heard(tlog.read, tmp_path / "log", data)
    at, found = heights(samples)
    assert found == pytest.approx([5.0 - 0.04 * n for n in range(50)])
    assert np.diff(at) == pytest.approx(0.05, abs=0.002)
    assert reported == ""
    assert tlog.read_history(tmp_path / "log").parameters == {"GUID_TIMEOUT": pytest.approx(0.2)}
    cut, reported = heard(tlog.read, tmp_path / "log", data[:900] + b"\x12\x34" * 30 + data[960:])
    assert len(cut) > 60
    assert "damaged" in reported


def test_files_of_parameters_of_each_station_are_read(tmp_path: Path) -> None:
    for name, text in PARAMETERS.items():
        (tmp_path / name).write_text(text, newline="")
        log = parameters_of(tmp_path / name)
        assert log.stack == ("PX4" if "px4" in name else "ArduPilot")
        assert kind_of(tmp_path / name) is FileKind.PARAMETERS
    assert log.parameters == {"MAV_SYS_ID": 1.0, "COM_DISARM_LAND": 9.0}
    assert log.firmware == (1, 15, 4)
    gimbal = PARAMETERS["px4.params"] + "1\t154\tCOM_DISARM_LAND\t2\t9\n"
    for text, said in (
        (gimbal, ""), (gimbal + "2\t1\tMAV_SYS_ID\t2\t6\n", "several vehicles"), ("A_B,1\nA_B,2\n", "A_B stands in it twice"),
        *((f"GUID_TIMEOUT{mark}0,2\nLAND_SPEED{mark}50.0\n", f"commas.*GUID_TIMEOUT{mark}0,2") for mark in ",; ="),
        ("1\t1\tGUID_TIMEOUT\t0,2\t9\n1\t1\tLAND_SPEED\t50\t9\n", "decimal commas"),
        ("# Vehicle-Id Component-Id Name Value Type\n1\t1\tPSC_D\t3,6e-05\t9\n", "decimal commas"),
        ("@include base.parm\nA_B 1\n", "base.parm"),
        *((f"A_B,1\nPLND_LAG,{value}\n", "PLND_LAG has no number as its value") for value in ("zzz", "nan", "1.2.3", "1e39")),
    ):  # fmt: skip
        (tmp_path / "odd.param").write_text(text)
        if said:
            with pytest.raises(BadInput, match=said):
                parameters_of(tmp_path / "odd.param")
        else:
            assert parameters_of(tmp_path / "odd.param").parameters == {"MAV_SYS_ID": 1.0, "COM_DISARM_LAND": 9.0}


CAPTURE = [1_000_000_000 + 5000 * n for n in range(300)]


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (CAPTURE, ""),
        ([t - 400_000 * (n > 150) for n, t in enumerate(CAPTURE)], "went back"),
        ([t if n < 150 else (n - 150) * 5000 for n, t in enumerate(CAPTURE)], "went back"),
        ([t - 30_000 * (n == 150) for n, t in enumerate(CAPTURE)], ""),
        ([(2047_500_000 + n * 5000) % 2048_000_000 for n in range(300)], ""),
    ],
)
def test_a_capture_of_navdata_lasts_as_long_as_it_did(times: list[int], said: str, tmp_path: Path) -> None:
    data = b"".join(made.navdata(n + 1, t) for n, t in enumerate(times))
    samples, reported = heard(capture.samples, tmp_path / "navdata", data)
    assert samples[-1].stamp.measured_at * 1e-9 == pytest.approx(1.5, abs=0.05)
    assert (reported == "") == (said == "")
    assert said in reported


NMEA = "".join(made.sentence(f"GPGGA,1015{n:02d}.00,5423.41,N,01010.22,E,1,09,0.9,4.0,M,42.1,M,,") for n in range(60))
FILES = {
    FileKind.DATAFLASH: made.dataflash(made.flight(TIMES, HEIGHTS)),
    FileKind.ULOG: made.px4_flight(BEGAN),
    FileKind.TLOG: made.telemetry_log(),
    FileKind.NAVDATA: made.navdata(1, 5000),
    FileKind.SENTENCES: NMEA.encode(),
    FileKind.PARAMETERS: PARAMETERS["copter.parm"].encode(),
    FileKind.TABLE: b"time_s,roll_deg,pitch_deg\n0,1,2\n",
    FileKind.TEXT: b"\x02a log of the bridge\x03\n" * 20,
    FileKind.ROS_BAG: b"#ROSBAG V2.0\n\0\1\2",
    FileKind.MCAP: b"\x89MCAP0\r\n\x01" + (28).to_bytes(8, "little") + b"\4\0\0\0ros1\x10\0\0\0somebody's writer",
    FileKind.RECORDING: b"\x89MCAP0\r\n\x01" + (18).to_bytes(8, "little") + b"\0\0\0\0\x0a\0\0\0decklander",
    FileKind.MAVLINK: b"\xfd\2" + bytes(12) + b"\xfe\1" + bytes(7) + b"\xfd\0" + bytes(10) + b"\xfe\0" + bytes(6),
    FileKind.OTHER: b"\0\0\0\x1cftypisom\0\0\2\0",
}
READERS = {
    FileKind.DATAFLASH: (dataflash.read, dataflash.read_history), FileKind.ULOG: (px4_ulog.read, px4_ulog.read_history),
    FileKind.TLOG: (tlog.read, tlog.read_history), FileKind.NAVDATA: (capture.samples,),
}  # fmt: skip


@pytest.mark.parametrize("kind", FILES)
def test_a_file_is_what_its_content_says_whatever_its_name(kind: FileKind, tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes(FILES[kind])
    assert kind_of(path) is kind


def test_an_encrypted_log_without_a_head_is_one_by_its_name(tmp_path: Path) -> None:
    for name, kind in (("log.ulgc", FileKind.ENCRYPTED), ("log.ulgk", FileKind.ENCRYPTED), ("log.bin", FileKind.OTHER)):
        (tmp_path / name).write_bytes(bytes(range(256)))
        assert kind_of(tmp_path / name) is kind


@given(st.sampled_from(sorted(READERS, key=lambda k: k.name)), st.data())
@settings(max_examples=60, deadline=None)
def test_damage_ends_in_a_refusal_or_in_samples_in_order(kind: FileKind, draw: st.DataObject) -> None:
    data = bytearray(FILES[kind])
    for _ in range(draw.draw(st.integers(1, 4))):
        at = draw.draw(st.integers(0, len(data) - 1))
        size = draw.draw(st.integers(1, 300))
        how = draw.draw(st.sampled_from(["cut", "double", "overwrite", "huge", "end"]))
        if how == "cut":
            del data[at : at + size]
        elif how == "double":
            data[at:at] = data[at : at + size]
        elif how == "overwrite":
            data[at : at + size] = draw.draw(st.binary(min_size=size, max_size=size))
        elif how == "huge":
            data[at : at + 8] = b"\xff" * 8
        else:
            del data[at:]
        if not data:
            return
    with tempfile.TemporaryDirectory() as folder:
        _read_all(kind, Path(folder) / "log", bytes(data))


def test_an_absurd_stamp_in_a_topics_first_row_moves_none_of_the_others(tmp_path: Path) -> None:
    """WHY: the topic's own time began at the absurd one, and its samples were centuries after the others."""
    stamp = FILES[FileKind.ULOG].index(b"\x1b\x00D\x04\x00") + 5
    _read_all(FileKind.ULOG, tmp_path / "log", FILES[FileKind.ULOG][:stamp] + b"\xff" * 8 + FILES[FileKind.ULOG][stamp + 8 :])


def _read_all(kind: FileKind, path: Path, data: bytes) -> None:
    path.write_bytes(data)
    for read in READERS[kind]:
        reported: list[str] = []
        try:
            found = read(path, reported.append)
        except BadInput:
            continue
        if isinstance(found, list):
            instants = [s.stamp.received_at for s in found]
            assert instants == sorted(instants)
            assert not instants or instants[-1] - instants[0] < 4 * 3600e9


def _images(folder: Path, names: Iterable[str]) -> None:
    folder.mkdir()
    for n, name in enumerate(names):
        px = np.full((24, 32, 3), 10 * n, np.uint8)
        (folder / name).write_bytes(cv2.imencode(Path(name).suffix, px)[1].tobytes())


def _at_s(folder: Path) -> tuple[list[float], list[int], str]:
    """Return the instants of a folder's frames, the grey of each over ten, and what was told."""
    reported: list[str] = []
    frames = list(pictures.folder_frames(folder, tell=reported.append))
    return [f.stamp.measured_at * 1e-9 for f in frames], [int(f.px[0, 0, 0]) // 10 for f in frames], "; ".join(reported)


def image_name(form: str, s: float) -> str:
    made_by = form.format(s=s, ms=1e3 * s, us=1e6 * s, n=1e9 * s, day=datetime.fromtimestamp(s, UTC))
    return made_by if made_by.endswith((".png", ".bmp")) else f"{made_by[:-3]}.png"  # milliseconds


@pytest.mark.parametrize("name", [
    "{n:.0f}.png", "frame07_{s:.3f}.png", "{ms:.0f}.bmp", "image-1_{us:.0f}.png", "cam0_{day:%Y%m%d%H%M%S%f}",
    "IMG_{day:%Y%m%d_%H%M%S%f}", "{day:%Y-%m-%dT%H-%M-%S.%f}", "{day:%Y-%m-%d %H.%M.%S.%f}",
])  # fmt: skip
def test_the_names_of_images_tell_their_times(name: str, tmp_path: Path) -> None:
    at = [1_700_000_000.0 + 0.25 * n for n in range(5)]
    _images(tmp_path / "f", [image_name(name, s) for s in at])
    assert kind_of(tmp_path / "f") is FileKind.IMAGES
    seconds, *rest = _at_s(tmp_path / "f")
    assert seconds == pytest.approx([0.25 * n for n in range(5)], abs=1e-6)
    assert rest == [[0, 1, 2, 3, 4], ""]


@pytest.mark.parametrize(("head", "row"), [
    ("#timestamp [ns],filename", "{ns:.0f},{name}"), ("time_s,source", "{s:.2f},{name}"),
    ("# timestamp filename", "{s:.2f} rgb/{name}"),
    ("name;t (ms)", "{name};{ms:.1f}"), ("file,stamp", "\"{name}\",{s:.2f}"), ("frame,time_s,source", "7,{s:.2f},{name}"),
    ("name,x,y,time [msec]", "{name},1.5,-2,{ms:.0f}"), ("", "{unix:.2f} rgb/{name} {unix:.2f} d.png"),
    ("name,time", "{name},2026-11-25T10:00:{s:06.3f}Z"), ("time_s,source", "{s:.6e},{name}"),
    ("source;time_s", "{name};{comma}"),
])  # fmt: skip
def test_a_table_reports_the_times_of_images(head: str, row: str, tmp_path: Path) -> None:
    names = [f"{n}.png" for n in (3, 1, 4, 0, 2)]
    _images(tmp_path / "f", names)
    lines = [head]
    for n, name in enumerate(names):
        s = 7.5 + 0.5 * n
        lines.append(row.format(s=s, ms=1e3 * s, ns=1e9 * s, unix=1.4e9 + s, comma=f"{s:.2f}".replace(".", ","), name=name))
    lines[-1:] = [lines[1], lines[1].replace("3.png", "77.png")]
    (tmp_path / "f" / "times.csv").write_text("\r\n".join(lines) + "\n")
    seconds, greys, reported = _at_s(tmp_path / "f")
    assert seconds == pytest.approx([0.0, 0.5, 1.0, 1.5])
    assert greys == [0, 1, 2, 3]
    assert all(t in reported for t in ("1 of 7 lines", "77.png is not in the folder", "3.png has a line above", "1 of 5 images"))


def test_images_without_times_damaged_ones_and_twins_are_named(tmp_path: Path) -> None:
    _images(tmp_path / "counted", [f"img{n:04d}.png" for n in range(3)])
    _images(tmp_path / "kitti", [f"{n:010d}.png" for n in range(3)])
    for name, why in (("counted", "put a table"), ("kitti", "put a table"), ("", "counted does: give that folder")):
        with pytest.raises(BadInput, match=why):
            list(pictures.folder_frames(tmp_path / name))
    (tmp_path / "kitti" / "a.csv").write_text("".join(f"{n},{0.05 * n},{n:010d}.png\n" for n in range(3)))
    with pytest.raises(BadInput, match="no head says which"):
        list(pictures.folder_frames(tmp_path / "kitti"))
    _images(tmp_path / "f", [f"{n}_{1_700_000_000 + n // 2 * 2}.png" for n in range(6)])
    (tmp_path / "f" / "4_1700000004.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    seconds, _, reported = _at_s(tmp_path / "f")
    assert seconds == pytest.approx([0.0, 2.0, 4.0])
    assert all(text in reported for text in ("the time of the one before", "4_1700000004.png"))
