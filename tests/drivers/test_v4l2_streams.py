"""Video files, network cameras and GStreamer behind the camera's door: real files, pipes and RTP packets on this machine."""

import asyncio
import contextlib
import os
import signal
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.camera import camera_program as wire
from drivers.camera.camera_process import PYTHONS, ProcessChannel
from drivers.camera.live_bytes import Arrival, JpegSplitter
from drivers.camera.open_camera import open_camera
from drivers.camera.options import CameraOptions
from drivers.camera.source import CameraLost, VideoSource
from drivers.clock import SystemClock
from estimator.contracts.errors import BadInput, SetupImpossible
from estimator.contracts.samples import Frame
from tests.support.processes import gone
from tests.support.waiting import free_port, until

W, H, RATE = 64, 48, 50
CLOCK = SystemClock()


def write(path: str, n: int, form: str | None = None, stop: threading.Event | None = None) -> None:
    """`n` frames, each one grey level brighter than the last; at their own speed while `stop` is given."""
    began = time.monotonic()
    with av.open(path, "w", format=form) as out:
        stream = out.add_stream("libx264", rate=RATE, options={"preset": "ultrafast", "tune": "zerolatency", "g": "10"})
        stream.width, stream.height, stream.pix_fmt, stream.time_base = W, H, "yuv420p", Fraction(1, RATE)
        for i in range(n):
            frame = av.VideoFrame.from_ndarray(np.full((H, W, 3), 30 + 3 * (i % 60), np.uint8), format="bgr24")
            frame.pts = i
            out.mux(stream.encode(frame))
            if stop is not None and stop.wait(max(0.0, began + (i + 1) / RATE - time.monotonic())):
                return
        out.mux(stream.encode(None))


def stream(device: Path | str, **more: Any) -> CameraOptions:
    return CameraOptions(source="stream", device=str(device), **more)


async def test_a_file_is_played_at_its_own_speed_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "flight.mp4"
    write(str(path), 20)
    frames: list[Frame] = []
    async with asyncio.timeout(60), open_camera(stream(path), None, CLOCK) as camera:
        with contextlib.suppress(CameraLost):
            async for frame in camera.frames:
                frames.append(frame)
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


async def test_what_is_no_video_is_reported_at_once(tmp_path: Path) -> None:
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
                while sum(f.stamp.source != "arrival" for f in frames) < 10:  # its rate is a claim for two seconds
                    frames.append(await camera.frames.get())
            finally:
                stop.set()
                await asyncio.to_thread(thread.join)
            assert all(f.stamp.measured_at < f.stamp.received_at for f in frames)
            own = [f for f in frames[5:] if f.stamp.source != "arrival"]
            steps = np.diff([f.stamp.measured_at for f in own]) * 1e-9 / np.diff([f.seq for f in own])
            assert np.median(steps) == pytest.approx(1 / RATE, rel=0.1)
            await until(lambda: camera.down is not None)
        assert sum(camera.counters.restarts.values()) >= 1


def numbered(n: int) -> np.ndarray:
    """Return an image whose blocks hold the number `n` in binary."""
    return np.repeat(np.repeat(np.array([[(n >> b & 1) * 255 for b in range(8)]], np.uint8), H, 0), W // 8, 1)


def number_in(frame: Frame) -> int:
    row = frame.px[H // 2, W // 16 :: W // 8, 1]
    return sum(int(v > 127) << b for b, v in enumerate(row))


def parts(kind: str, n: int) -> list[bytes]:
    """Return the bytes of `n` numbered frames, one entry a frame, in a stream whose container holds no times."""
    if kind != "h264":
        jpegs = [cv2.imencode(".jpg", numbered(i))[1].tobytes() for i in range(n)]
        return [b"--f\r\nContent-Type: image/jpeg\r\n\r\n%s" % j for j in jpegs] if kind == "mjpeg" else jpegs
    coder = av.CodecContext.create("libx264", "w")
    coder.width, coder.height, coder.pix_fmt, coder.framerate = W, H, "yuv420p", Fraction(25)
    coder.options = {"preset": "ultrafast", "tune": "zerolatency", "g": "10"}
    images = (av.VideoFrame.from_ndarray(cv2.cvtColor(numbered(i), cv2.COLOR_GRAY2BGR), format="bgr24") for i in range(n))
    return [b"".join(bytes(p) for p in coder.encode(image)) for image in images]


@contextlib.contextmanager
def playing(kind: str, gaps_s: Sequence[float], sent: dict[int, int]) -> Iterator[str]:
    """Send frames to one client with these gaps, note when each left, and give the address."""
    door = socket.create_server(("127.0.0.1", 0))
    frames = parts(kind, len(gaps_s))

    def play() -> None:
        client, _ = door.accept()
        with client, contextlib.suppress(OSError):
            if kind == "mjpeg":
                client.recv(4096)
                client.sendall(b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=f\r\n\r\n")
            for number, (part, gap_s) in enumerate(zip(frames, gaps_s, strict=True)):
                time.sleep(gap_s)
                sent[number] = time.monotonic_ns()
                client.sendall(part)
            time.sleep(0.1)

    thread = threading.Thread(target=play)
    thread.start()
    port = door.getsockname()[1]
    try:
        yield f"http://127.0.0.1:{port}/" if kind == "mjpeg" else f"tcp://127.0.0.1:{port}"
    finally:
        door.close()
        thread.join()


async def stamped(kind: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the errors of the timestamps of a stream that is played, s, and the standard deviations that they state."""
    gaps_s = [0.0] * 100 + [0.02 if n % 40 < 20 else 0.055 for n in range(60)]
    sent: dict[int, int] = {}
    errors, sigmas, ahead, number = [], [], [], 0
    with playing(kind, gaps_s, sent) as address:
        async with (
            asyncio.timeout(60),
            open_camera(stream(address, reconnect_first_s=30.0, reconnect_most_s=30.0), None, CLOCK) as camera,
        ):
            with contextlib.suppress(CameraLost):
                while number < len(gaps_s) - 3:
                    frame = await camera.frames.get()
                    number = number_in(frame)
                    assert frame.stamp.source == "arrival"
                    if kind == "mjpeg" and number > 100:
                        ahead.append(max(sent) - number)
                    errors.append((frame.stamp.measured_at - sent[number]) * 1e-9)
                    sigmas.append(frame.stamp.sigma_s)
    assert len(errors) > 20
    assert not ahead or np.median(ahead) == 0, "a JPEG that is complete waits for the next one"
    return np.array(errors), np.array(sigmas)


@pytest.mark.parametrize("kind", ["mjpeg", "h264"])
async def test_a_stream_without_times_is_stamped_by_arrival(kind: str) -> None:
    """Frames come at an uneven rate that is nowhere near the 25 a second that the demuxer makes up, after a hundred at once.

    A busy machine suspends the sender, or a reader that waits, for longer than any stated error, so one of three plays counts.
    """
    for _ in range(3):
        errors, sigmas = await stamped(kind)
        if np.quantile(np.abs(errors) / sigmas, 0.9) < 3:
            break
    else:
        pytest.fail(f"the timestamps err by {np.abs(errors).round(3)} s and state {sigmas.round(3)}")
    assert sigmas.min() < 0.015


@pytest.mark.parametrize(("kind", "form"), [("udp", "mpegts"), ("rtp", "rtp")])
async def test_frames_that_ffmpeg_holds_back_are_stamped_by_their_own_arrival(kind: str, form: str, tmp_path: Path) -> None:
    """FFmpeg gives out a frame of these streams when the next one arrives, or the one after that: 0.1 or 0.2 s late here."""
    port = next(port for port in iter(free_port, None) if port % 2 == 0)
    device = f"udp://127.0.0.1:{port}"
    if kind == "rtp":
        described = tmp_path / "camera.sdp"
        device = str(described)
        described.write_text(
            f"v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video {port} RTP/AVP 96\n"
            "a=rtpmap:96 H264/90000\na=fmtp:96 packetization-mode=1\n"
        )
    sent: dict[int, int] = {}
    ends = threading.Event()

    def play() -> None:
        with av.open(f"{kind}://127.0.0.1:{port}?pkt_size=1316", "w", format=form) as out:
            made = out.add_stream("libx264", rate=10, options={"preset": "ultrafast", "tune": "zerolatency", "g": "5"})
            made.width, made.height, made.pix_fmt = W, H, "yuv420p"
            made.codec_context.time_base = Fraction(1, 90_000)
            for n in range(200):
                frame = av.VideoFrame.from_ndarray(cv2.cvtColor(numbered(n), cv2.COLOR_GRAY2BGR), format="bgr24")
                sent[n] = time.monotonic_ns()
                # It states ten frames a second, and sends fewer: arrival stamps them.
                frame.pts, frame.time_base = n * 9_000, Fraction(1, 90_000)
                out.mux(made.encode(frame))
                if ends.wait(0.11):
                    return

    errors: list[float] = []
    thread = threading.Thread(target=play)
    async with asyncio.timeout(60), open_camera(stream(device), None, CLOCK) as camera:
        thread.start()
        try:
            while len(errors) < 30:
                frame = await camera.frames.get()
                assert frame.stamp.source == "arrival"
                errors.append((frame.stamp.measured_at - sent[number_in(frame)]) * 1e-9)
        finally:
            ends.set()
            await asyncio.to_thread(thread.join)
    assert abs(float(np.quantile(errors[10:], 0.25))) < 0.03, "a busy machine is only later"


@pytest.mark.parametrize("kind", ["jpegs", "h264"])
async def test_a_named_pipe_is_a_live_stream(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "camera"
    os.mkfifo(path)
    sent: dict[int, int] = {}

    def play() -> None:
        with contextlib.suppress(BrokenPipeError), path.open("wb", buffering=0) as out:
            for number, part in enumerate(parts(kind, 120)):
                time.sleep(0.03)
                sent[number] = time.monotonic_ns()
                out.write(part)

    thread = threading.Thread(target=play)
    errors: list[float] = []
    async with asyncio.timeout(60), open_camera(stream(path), None, CLOCK) as camera:
        thread.start()
        with contextlib.suppress(CameraLost):
            while len(errors) < 40:
                frame = await camera.frames.get()
                errors.append((frame.stamp.measured_at - sent[number_in(frame)]) * 1e-9)
    await asyncio.to_thread(thread.join)
    assert abs(float(np.quantile(errors, 0.25))) < 0.02, "a busy machine is only later"


@given(st.integers(1, 5000), st.binary(max_size=40), st.booleans())
def test_jpegs_are_cut_out_whole_however_the_bytes_come(step: int, between: bytes, thumbnail: bool) -> None:
    between = between.replace(b"\xff", b"\n")
    jpegs = parts("jpegs", 5)
    if thumbnail:  # one within a JPEG's head, with an end mark of its own
        inner = b"\xff\xe1%s%s" % ((len(jpegs[0]) + 2).to_bytes(2, "big"), jpegs[0])
        jpegs = [jpeg[:2] + inner + jpeg[2:] for jpeg in jpegs]
    data, splitter, out = between + between.join(jpegs), JpegSplitter(), []
    for at in range(0, len(data), step):
        piece = data[at : at + step]
        out += [(jpeg, came.buffered_s) for jpeg, came in splitter.jpegs(piece, Arrival(CLOCK.now(), at, waited=True))]
    assert [jpeg for jpeg, _ in out] == jpegs
    begins = [len(between) * (n + 1) + sum(map(len, jpegs[:n])) for n in range(5)]
    assert all(begin - step < at <= begin + 2 for (_, at), begin in zip(out, begins, strict=True))


async def test_a_camera_that_is_not_there_is_waited_for() -> None:
    options = CameraOptions(source="v4l2", device="/dev/v4l/by-id/no-such-camera", reconnect_first_s=0.01, reconnect_most_s=0.02)
    async with asyncio.timeout(60), open_camera(options, (W, H), CLOCK) as camera:
        await until(lambda: camera.counters.restarts["absent"] >= 3)
        assert "no-such-camera" in camera.down


PIPED_W, PIPED_H = 66, 48  # rows of 198 bytes, which are padded by 2
LIVE = "videotestsrc is-live=true pattern=blue ! video/x-raw,framerate=50/1"


def _has_bindings(python: str) -> bool:
    probe = "import gi; gi.require_version('Gst', '1.0'); from gi.repository import Gst; Gst.init(None)"
    with suppress(OSError):
        return subprocess.run([python, "-I", "-c", probe], capture_output=True, timeout=60, check=False).returncode == 0
    return False


real = pytest.mark.skipif(
    not any(_has_bindings(python) for python in PYTHONS), reason="no Python here has GStreamer's bindings (python3-gi)"
)


def camera_options(pipeline: str, **more: Any) -> CameraOptions:
    usual: dict[str, Any] = {"silence_s": 5.0, "reconnect_first_s": 0.01, "reconnect_most_s": 0.02}
    return CameraOptions(source="gstreamer", device=pipeline, **(usual | more))


def message(magic: bytes, content: bytes = b"", stamp_ns: int = wire.UNKNOWN, number: int = wire.UNKNOWN) -> bytes:
    return wire.HEADER.pack(magic, len(content), stamp_ns, number, 0.0, 0.0) + content


def rows(value: int) -> bytes:
    """Return a frame whose padding would show if it became pixels."""
    return (bytes([value]) * 3 * PIPED_W + b"\xff\xff") * PIPED_H


def program(folder: Path, said: bytes, code: int = 0, *, stays: bool = False) -> str:
    """Return a stand-in for a program that prints this and ends."""
    words, path = folder / "words", folder / "python"
    words.write_bytes(said)
    path.write_text(f"#!/bin/sh\ncat {words}\n{'exec sleep 60' if stays else f'exit {code}'}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


async def ending(python: str, *, silence_s: float = 5.0) -> tuple[Exception, VideoSource, list[Frame]]:
    """Run once on this program; return what ended it, and the frames that came before."""
    camera, frames = VideoSource(), []
    channel = ProcessChannel(camera_options("any", silence_s=silence_s), (PIPED_W, PIPED_H), CLOCK, camera, None, [python])

    async def read() -> None:
        async for frame in camera.frames:
            frames.append(frame)

    reader = asyncio.create_task(read())
    try:
        async with asyncio.timeout(60):
            await channel.run()
    except (CameraLost, BadInput, SetupImpossible) as why:
        await asyncio.sleep(0)
        return why, camera, frames
    finally:
        reader.cancel()
    raise AssertionError("it ended without a word")


async def test_a_frame_is_rows_without_their_padding_and_a_hole_in_the_numbers_is_counted(tmp_path: Path) -> None:
    now = CLOCK.now()
    output = b"".join(message(wire.FRAME, rows(7), now - 10_000_000 + n, n) for n in (4, 5, 9))
    why, camera, frames = await ending(program(tmp_path, message(wire.READY) + output, 3))
    assert isinstance(why, CameraLost)
    assert why.reason == "failed"
    assert "exit code 3" in str(why)
    assert frames[-1].px.shape == (PIPED_H, PIPED_W, 3)
    assert np.all(frames[-1].px == 7)
    assert frames[-1].stamp.source == "kernel"
    counts = camera.counters
    assert counts.buffers == 3 == counts.frames + counts.frames_overtaken
    assert counts.frames_lost == 3


async def test_a_stamp_of_another_clock_is_refused_and_none_is_the_arrival(tmp_path: Path) -> None:
    output = message(wire.READY) + message(wire.FRAME, rows(1), 5)
    _, camera, frames = await ending(program(tmp_path, output))
    assert (frames[0].stamp.source, camera.counters.stamps_refused) == ("arrival", 1)
    (tmp_path / "b").mkdir()
    _, camera, frames = await ending(program(tmp_path / "b", message(wire.READY) + message(wire.FRAME, rows(1))))
    assert (frames[0].stamp.source, camera.counters.stamps_refused) == ("arrival", 0)


async def test_each_end_has_its_error(tmp_path: Path) -> None:
    cases = (
        (message(wire.FAULT, b'no element "foo"'), wire.WRONG_SETTINGS, BadInput, 'no element "foo"'),
        (message(wire.FAULT, b"No module named gi"), wire.NO_BINDINGS, SetupImpossible, "python3-gi"),
        (message(wire.FAULT, b"\xff\xfe strange"), 1, CameraLost, "strange"),
        (message(wire.READY) + message(wire.FAULT, b"camera0: in use"), 0, CameraLost, "camera0: in use"),
        (message(wire.READY) + message(wire.FRAME, b"short"), 0, CameraLost, "no frame"),
        (message(wire.READY) + message(wire.FRAME, rows(1))[:200], 0, CameraLost, "its process ended"),
        (message(wire.READY) + wire.HEADER.pack(wire.FRAME, 0xFFFFFFFF, 0, 0, 0.0, 0.0), 0, CameraLost, "no frame"),
        (b"hello, I am no camera at all, and write", 0, CameraLost, "no message of ours"),
        (b"", 0, CameraLost, "its process ended"),
    )
    for i, (output, code, kind, words) in enumerate(cases):
        folder = tmp_path / str(i)
        folder.mkdir()
        why, camera, _ = await ending(program(folder, output, code))
        assert isinstance(why, kind), (i, why)
        assert words in str(why), (i, why)
        assert camera.down is not None, "nothing came, so it was never up"
    why, _, _ = await ending("/no/such/python")
    assert isinstance(why, CameraLost)


@pytest.mark.parametrize("code", [wire.WRONG_SETTINGS, wire.NO_BINDINGS])
async def test_a_pipeline_that_cannot_be_built_again_is_lost_and_tried_again(tmp_path: Path, code: int) -> None:
    # In flight an error of the settings would end the service; only the first opening tells of the settings.
    good, bad = message(wire.READY) + message(wire.FRAME, rows(1)), message(wire.FAULT, b'no element "camerasrc"')
    python = program(tmp_path, good)
    camera = VideoSource()
    channel = ProcessChannel(camera_options("any"), (PIPED_W, PIPED_H), CLOCK, camera, None, [python])
    async with asyncio.timeout(60):
        with pytest.raises(CameraLost, match="its process ended"):
            await channel.run()
        program(tmp_path, bad, code)
        for _ in range(2):
            with pytest.raises(CameraLost) as why:
                await channel.run()
            assert why.value.reason == "failed"
        program(tmp_path, good)
        with pytest.raises(CameraLost, match="its process ended"):
            await channel.run()
    assert camera.counters.buffers == 2


async def test_a_pipeline_that_stops_giving_frames_is_silent(tmp_path: Path) -> None:
    output = message(wire.READY) + message(wire.FRAME, rows(1))
    why, _, frames = await ending(program(tmp_path, output, stays=True), silence_s=0.1)
    assert isinstance(why, CameraLost)
    assert why.reason == "silent"
    assert len(frames) == 1


@given(garbage=st.binary(max_size=200))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_garbage_is_a_lost_camera(garbage: bytes, tmp_path: Path) -> None:
    why, _, _ = asyncio.run(ending(program(tmp_path, message(wire.READY) + garbage)))
    assert isinstance(why, CameraLost)


@real
async def test_frames_of_a_real_pipeline_are_young_in_order_and_of_the_right_colour() -> None:
    async with asyncio.timeout(120), open_camera(camera_options(LIVE), (PIPED_W, PIPED_H), CLOCK) as camera:
        frames = [await camera.frames.get() for _ in range(12)]
        assert camera.down is None
    assert frames[0].px.shape == (PIPED_H, PIPED_W, 3)
    assert (frames[0].px.reshape(-1, 3).mean(axis=0) > 200).tolist() == [True, False, False], "blue, as B G R"
    assert {f.stamp.source for f in frames} == {"kernel"}
    assert not any(f.coded for f in frames), "no codec is in it"
    stamps = np.array([f.stamp.measured_at for f in frames])
    steps = np.diff(stamps) * 1e-9 / 0.02
    assert np.all(np.diff(stamps) > 0)
    assert np.abs(steps - np.round(steps)).max() < 0.01, "the source's own clock, whenever they are read"
    assert min(f.stamp.delay_s for f in frames) < 0.1


@real
async def test_a_process_that_crashes_or_hangs_is_started_again() -> None:
    async with asyncio.timeout(120), open_camera(camera_options(LIVE, silence_s=0.5), (PIPED_W, PIPED_H), CLOCK) as camera:
        for sent, reason in ((signal.SIGKILL, "failed"), (signal.SIGSTOP, "silent")):
            await camera.frames.get()
            (child,) = children()
            os.kill(child, sent)
            await until(lambda reason=reason: camera.counters.restarts[reason] >= 1)  # type: ignore[misc]
            await camera.frames.get()
            await until(lambda child=child: gone(child))  # type: ignore[misc]
    await until(lambda: children() == [])


def children() -> list[int]:
    """Return the processes of GStreamer pipelines that this test's process started."""
    found = []
    for task in Path("/proc/self/task").iterdir():
        with suppress(OSError):
            found += [int(pid) for pid in (task / "children").read_text().split()]
    return [pid for pid in found if b"camera_program" in _command(pid)]


def _command(pid: int) -> bytes:
    with suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    return b""


@real
def test_it_does_not_outlive_the_service(tmp_path: Path) -> None:
    code = (
        "import asyncio\n"
        "from drivers.camera.options import CameraOptions\n"
        "from drivers.camera.open_camera import open_camera\n"
        "from drivers.clock import SystemClock\n"
        "from tests.drivers.test_v4l2_streams import LIVE, children\n"
        "async def main():\n"
        "    async with open_camera(CameraOptions(source='gstreamer', device=LIVE), (66, 48), SystemClock()) as camera:\n"
        "        await camera.frames.get()\n"
        "        print(children()[0], flush=True)\n"
        "        await asyncio.sleep(60)\n"
        "asyncio.run(main())"
    )
    service = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    child = int(service.stdout.readline())
    service.kill()
    service.wait()
    service.stdout.close()
    asyncio.run(until(lambda: gone(child)))


@real
@pytest.mark.parametrize(
    ("pipeline", "words"),
    [
        ("nosuchsrc", 'no element "nosuchsrc"'),
        ("videotestsrc !", "no pipeline that GStreamer can build"),
        ("videotestsrc ! video/x-raw,width=320,height=240", f"width=.*{PIPED_W}, height=.*{PIPED_H}"),
        ("", "device must be given"),
    ],
)
async def test_a_text_that_is_no_pipeline_is_one_clear_error(pipeline: str, words: str) -> None:
    with pytest.raises((BadInput, ValueError), match=words):
        async with asyncio.timeout(60), open_camera(camera_options(pipeline), (PIPED_W, PIPED_H), CLOCK) as camera:
            await camera.frames.get()
