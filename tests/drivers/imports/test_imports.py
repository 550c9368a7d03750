"""Recordings of others: real logs and captures read with the right axes, units and times, or refused in one line."""

import gc
import itertools
import struct
from collections import Counter
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from drivers.imports import ardrone_capture, dataflash, px4_ulog, video
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, GeoFix, Imu, Range, Sample, VehicleStatus

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
    frames = list(ardrone_capture.frames(DATA / f"ardrone/{name}.pave"))
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
    samples = ardrone_capture.samples(path)
    instants = sorted({s.stamp.measured_at for s in samples})
    assert instants == [0, 5_000_000, 15_000_000, 2_000_000_000]
    assert {Imu, Attitude, BodyVelocity, Range, Baro, GeoFix, VehicleStatus} == {type(s) for s in samples}


def test_attitude_tables_begin_at_zero_and_know_their_heading(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time_s,roll_deg,pitch_deg,yaw_deg\n10.5,3,-4,90\n10.0,1,2,\n")
    first, second = video.attitudes(path)
    assert isinstance(first, Attitude)
    assert isinstance(second, Attitude)
    assert (first.stamp.measured_at, second.stamp.measured_at) == (0, 500_000_000)
    assert np.degrees(second.R_ned_body.rpy_rad) == pytest.approx([3.0, -4.0, 90.0])
    path.write_text("\ufefftime_s; roll_deg; pitch_deg\n1700000000.5;1;2\n5;0;0\n1700000000.75;3;4\n")
    reported: list[str] = []
    assert [s.stamp.measured_at for s in video.attitudes(path, reported.append)] == [0, 250_000_000]
    assert "1 of 3 stamps" in reported[0]


@pytest.mark.parametrize("form", ["h264", "mjpeg"])
def test_a_raw_video_is_read_at_its_rate(tmp_path: Path, form: str) -> None:
    path = tmp_path / f"flight.{form}"
    with av.open(str(path), "w", format=form) as out:
        video_stream = out.add_stream("libx264" if form == "h264" else "mjpeg", rate=25)
        video_stream.width, video_stream.height = 64, 48
        video_stream.pix_fmt = "yuv420p" if form == "h264" else "yuvj420p"
        for i in range(10):
            out.mux(video_stream.encode(av.VideoFrame.from_ndarray(np.full((48, 64, 3), 20 * i, np.uint8), format="bgr24")))
        out.mux(video_stream.encode(None))
    frames = list(video.frames(path))
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
    frames = list(video.frames(path, size))
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
        (ardrone_capture.samples, b"\x88\x77\x66\x55" + bytes(100), "no whole navdata"),
        (lambda p: list(ardrone_capture.frames(p)), b"PaVE" + bytes(300), "no frame"),
        (lambda p: list(video.frames(p)), b"RIFF1234AVI nonsense", "readable video|holds no video"),
        (video.attitudes, b"time_s,roll_deg\n1,2\n", "column 'pitch_deg' is missing"),
        (video.attitudes, b"time_s,roll_deg,pitch_deg\n1,2,x\n", "line 2: not a number"),
        (video.attitudes, b"time_s,roll_deg,pitch_deg\n1,2,inf\n", "line 2: not a finite"),
        (video.attitudes, b"time_s,roll_deg,pitch_deg\n", "holds no attitudes"),
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
