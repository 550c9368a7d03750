"""Video files and network cameras behind the camera's door: real files and real RTP packets on this machine's loopback."""

import asyncio
import contextlib
import socket
import threading
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from drivers.camera.options import CameraOptions
from drivers.camera.source import CameraLost
from drivers.camera.video_source import open_camera
from drivers.clock import SystemClock
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Frame

W, H, RATE = 64, 48, 50
CLOCK = SystemClock()


def write(path: str, n: int, form: str | None = None, stop: threading.Event | None = None) -> None:
    """`n` frames, each one grey level brighter than the last; at their own speed while `stop` is given."""
    with av.open(path, "w", format=form) as out:
        stream = out.add_stream("libx264", rate=RATE, options={"preset": "ultrafast", "tune": "zerolatency", "g": "10"})
        stream.width, stream.height, stream.pix_fmt, stream.time_base = W, H, "yuv420p", Fraction(1, RATE)
        for i in range(n):
            frame = av.VideoFrame.from_ndarray(np.full((H, W, 3), 30 + 3 * (i % 60), np.uint8), format="bgr24")
            frame.pts = i
            out.mux(stream.encode(frame))
            if stop is not None and stop.wait(1 / RATE):
                return
        out.mux(stream.encode(None))


def stream(device: Path | str, **more: Any) -> CameraOptions:
    return CameraOptions(source="stream", device=str(device), **more)


async def until(true: Callable[[], bool]) -> None:
    while not true():  # noqa: ASYNC110
        await asyncio.sleep(0.01)


async def test_a_file_is_played_at_its_own_speed_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "flight.mp4"
    write(str(path), 20)
    frames: list[Frame] = []
    async with asyncio.timeout(60), open_camera(stream(path), None, CLOCK) as camera:
        with contextlib.suppress(CameraLost):
            async for frame in camera.frames:
                frames.append(frame)
        assert camera.down is not None
        assert "over" in camera.down
    assert [f.seq for f in frames] == sorted({f.seq for f in frames})
    assert frames[-1].seq == 19
    last, first = frames[-1], frames[0]
    assert (last.stamp.measured_at - first.stamp.measured_at) * 1e-9 == pytest.approx((last.seq - first.seq) / RATE, abs=1e-4)
    assert last.stamp.received_at - first.stamp.received_at > last.stamp.measured_at - first.stamp.measured_at - 0.1e9, (
        "a busy machine is only later"
    )
    assert abs(int(last.px.mean()) - (30 + 3 * 19)) <= 3
    assert camera.counters.restarts == {}
    assert all(f.coded for f in frames), "its codec predicts frames"


async def test_a_file_that_is_repeated_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "flight.mp4"
    write(str(path), 5)
    async with asyncio.timeout(60), open_camera(stream(path, repeat=True), None, CLOCK) as camera:
        while (await camera.frames.get()).seq < 12:
            pass


async def test_what_is_no_video_is_said_at_once(tmp_path: Path) -> None:
    (tmp_path / "text.mp4").write_text("not a film")
    for name, words in (("none.mp4", "no such file"), ("text.mp4", "not a video")):
        with pytest.raises(BadInput, match=words):
            async with asyncio.timeout(60), open_camera(stream(tmp_path / name), None, CLOCK) as camera:
                await camera.frames.get()


async def test_a_live_stream_is_stamped_by_its_own_clock_and_comes_back() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    url = f"udp://127.0.0.1:{port}"
    options = stream(url, latency_s=0.01, silence_s=1.0, reconnect_first_s=0.05, reconnect_most_s=0.1)

    def send(stop: threading.Event) -> threading.Thread:
        thread = threading.Thread(target=write, args=(f"{url}?pkt_size=1316", 1000, "mpegts", stop))
        thread.start()
        return thread

    async with asyncio.timeout(60), open_camera(options, None, CLOCK) as camera:
        for _ in range(2):
            stop = threading.Event()
            thread = send(stop)
            try:
                frames = [await camera.frames.get() for _ in range(15)]
            finally:
                stop.set()
                await asyncio.to_thread(thread.join)
            assert frames[-1].stamp.source == "synced"
            assert all(f.stamp.measured_at < f.stamp.received_at for f in frames)
            steps = np.diff([f.stamp.measured_at for f in frames[5:]]) * 1e-9 / np.diff([f.seq for f in frames[5:]])
            assert np.median(steps) == pytest.approx(1 / RATE, rel=0.1)
            await until(lambda: camera.down is not None)
        assert sum(camera.counters.restarts.values()) >= 1


async def test_a_camera_that_is_not_there_is_waited_for() -> None:
    options = CameraOptions(source="v4l2", device="/dev/v4l/by-id/no-such-camera", reconnect_first_s=0.01, reconnect_most_s=0.02)
    async with asyncio.timeout(60), open_camera(options, (W, H), CLOCK) as camera:
        await until(lambda: camera.counters.restarts["absent"] >= 3)
        assert camera.down is not None
        assert "no-such-camera" in camera.down


async def test_a_video_of_far_larger_frames_than_the_camera_s_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "large.mp4"
    write(str(path), 2)
    with pytest.raises(BadInput, match=r"large\.mp4: frames of 64x48 px, expected 16x16 px"):
        async with asyncio.timeout(60), open_camera(stream(path), (16, 16), CLOCK) as camera:
            await camera.frames.get()
