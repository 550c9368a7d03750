"""The V4L2 driver above its device: stamps, gaps, decoding, unplugging, on a device that a socket pair makes readable.

The same driver on a real kernel device: qualification/v4l2_vm.
"""

import asyncio
import errno
import os
import shutil
import socket
import subprocess
import threading
from collections import deque
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import av
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.camera import v4l2_kernel
from drivers.camera import v4l2_kernel as kernel
from drivers.camera.exposure import ExposureDrive, ExposureRange, ExposureSetting
from drivers.camera.options import CameraOptions, ExposureOptions, Size
from drivers.camera.source import CameraCounters, CameraLost, VideoSource
from drivers.camera.v4l2 import CaptureDevice, V4l2Channel, cameras, find, kernel_stamp
from drivers.camera.v4l2_device import Buffer, KernelDevice
from drivers.camera.v4l2_exposure import KernelExposure
from drivers.camera.v4l2_frames import FrameLayout, H264Decoder, stands_alone, to_bgr
from drivers.clock import SystemClock
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs
from tests.support.image_files import claiming, encoded

W, H = 64, 48
CLOCK = SystemClock()


def image(shift: int = 0) -> NDArray[np.uint8]:
    """Four flat patches of different colours, so that a swapped plane or channel shows."""
    px = np.empty((H, W, 3), np.uint8)
    for i, colour in enumerate([(200, 60, 40), (40, 190, 60), (60, 40, 210), (128, 128, 128)]):
        px[:, i * W // 4 : (i + 1) * W // 4] = colour
    return np.roll(px, shift, axis=1)


def h264(n: int, px: NDArray[np.uint8] | None = None) -> list[bytes]:
    """Access units in Annex B, an IDR first and then none."""
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt, codec.time_base = W, H, "yuv420p", Fraction(1, 30)
    codec.options = {"preset": "ultrafast", "tune": "zerolatency", "g": "1000", "x264-params": "repeat-headers=1"}
    units = []
    for i in range(n):
        frame = av.VideoFrame.from_ndarray(image(4 * i) if px is None else px, format="bgr24")
        frame.pts = i
        units += [bytes(p) for p in codec.encode(frame)]
    return units


def camera_options(**more: Any) -> CameraOptions:
    usual = {"source": "v4l2", "device": os.devnull, "silence_s": 1.0, "reconnect_first_s": 0.01, "reconnect_most_s": 0.02}
    return CameraOptions(**(usual | more))


class SlowExposure:
    """An exposure whose bus takes its time, and refuses an exposure of over 15 ms."""

    def __init__(self) -> None:
        self.can, self.held = ExposureRange(1e-4, 0.026, 8.0), ExposureSetting(0.01, 1.0)
        self.go_on = threading.Event()

    def set(self, wanted: ExposureSetting) -> ExposureSetting:
        self.go_on.wait(30.0)
        if wanted.exposure_s > 0.015:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return wanted


class FakeDevice:
    """Buffers put in are read in order; `unplug` makes it answer as the kernel does."""

    def __init__(self, form: str = "YUYV", stride: int = 2 * W) -> None:
        self.layout = FrameLayout(form, W, H, stride)
        self.rate_hz = 30.0
        self.exposure_s: float | None = 0.01
        self.driven: Any = None
        self.queue: deque[Buffer] = deque()
        self.gone = False
        self.closed = False
        self._ours, self._theirs = socket.socketpair()
        self._ours.setblocking(False)

    def put(self, *buffers: Buffer) -> None:
        self.queue.extend(buffers)
        self._theirs.send(b"." * max(1, len(buffers)))

    def unplug(self) -> None:
        self.gone = True
        self._theirs.send(b".")

    def fileno(self) -> int:
        return self._ours.fileno()

    def dequeue(self) -> Buffer | None:
        if self.gone:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        if not self.queue:
            return None
        self._ours.recv(1)
        return self.queue.popleft()

    def close(self) -> None:
        self.closed = True
        self._ours.close()
        self._theirs.close()


def yuyv(shift: int = 0) -> bytes:
    return cv2.cvtColor(image(shift), cv2.COLOR_BGR2YUV_YUY2).tobytes()


def buffer(sequence: int, data: bytes | None = None, error: bool = False, age_s: float = 0.005) -> Buffer:
    stamp_ns = CLOCK.now() - round(age_s * 1e9)
    return Buffer(yuyv() if data is None else data, sequence, stamp_ns, True, False, error)


async def run_channel(camera: VideoSource, device: FakeDevice, story: Any, **more: Any) -> str:
    """Run the channel beside `story` until it is lost; the reason."""
    channel = V4l2Channel(camera_options(**more), (W, H), CLOCK, camera, lambda path, o, size: cast("Any", device))
    async with asyncio.timeout(60), asyncio.TaskGroup() as group:
        group.create_task(story())
        try:
            await channel.run()
        except CameraLost as why:
            return why.reason
    raise AssertionError("a channel never ends by itself")


def accounted(c: CameraCounters) -> bool:
    return c.buffers == c.frames + c.frames_overtaken + c.frames_damaged + c.frames_waiting


async def test_frames_gaps_damage_and_unplugging_are_all_counted() -> None:
    camera, device = VideoSource(), FakeDevice()
    seqs: list[int] = []

    async def story() -> None:
        for sequence in (7, 8, 11):
            device.put(buffer(sequence))
            frame = await camera.frames.get()
            seqs.append(frame.seq)
            assert frame.px.shape == (H, W, 3)
            assert frame.stamp.source == "kernel"
            assert frame.exposure_s == 0.01
        device.put(buffer(12, error=True), buffer(13), buffer(14, data=b"torn"))
        seqs.append((await camera.frames.get()).seq)
        device.put(buffer(15), buffer(16))
        while seqs[-1] != 16:
            seqs.append((await camera.frames.get()).seq)
        device.unplug()

    assert await run_channel(camera, device, story) == "unplugged"
    c = camera.counters
    assert seqs[:4] == [7, 8, 11, 13]
    assert (c.frames_lost, c.frames_damaged) == (2, 2)
    assert c.buffers == 8
    assert accounted(c)
    assert device.closed


def test_a_share_of_torn_frames_is_reported_with_its_cure(caplog: pytest.LogCaptureFixture) -> None:
    camera, layout = VideoSource(), FrameLayout("MJPG", W, H, 0)
    whole = cv2.imencode(".jpg", image())[1].tobytes()
    torn = whole[: len(whole) // 2] + whole[len(whole) // 2 + 40 :]
    at = 0
    for n in range(300):
        camera.counters.buffers += 1
        camera.counters.frames_damaged += n % 3 == 0 and to_bgr(torn, layout) is None
        camera.count_damage("USB camera", MonoNs(at))
        at += 33_333_333
    assert camera.damage is not None
    assert "USB camera: 9.9 of 30.0 frames a second are damaged" in caplog.text
    assert "cable" in caplog.text
    assert len(caplog.records) == 1, "once a minute"
    for _ in range(200):
        camera.counters.buffers += 1
        camera.count_damage("USB camera", MonoNs(at))
        at += 33_333_333
    assert camera.damage is None


async def test_a_slow_bus_holds_up_no_frame_and_the_stamp_follows_the_new_exposure() -> None:
    drive, device = ExposureDrive(settle_frames=2), FakeDevice()
    camera, slow = VideoSource(drive), SlowExposure()
    device.driven = slow
    new = ExposureSetting(0.002, 1.5)
    frames: list[Frame] = []

    async def look(sequence: int) -> None:
        device.put(buffer(sequence))
        frames.append(await camera.frames.get())

    async def story() -> None:
        await look(0)
        drive.ask(new)
        for sequence in (1, 2, 3):
            await look(sequence)
        assert (drive.held, drive.changes, drive.settled(3)) == (ExposureSetting(0.01, 1.0), 0, False)
        slow.go_on.set()
        sequence = 4
        while drive.changes == 0:
            await look(sequence)
            sequence += 1
        for more in range(4):
            await look(sequence + more)
        drive.ask(ExposureSetting(0.02, 1.0))
        while drive.refused == 0:
            sequence += 1
            await look(sequence + 4)
        device.unplug()

    assert await run_channel(camera, device, story) == "unplugged"
    assert [frame.exposure_s for frame in frames[:4]] == [0.01] * 4
    assert (frames[-1].exposure_s, frames[-1].gain) == (0.002, 1.5)
    # While a change may or may not show, mid-exposure is known to half the difference.
    between = [frame for frame in frames if frame.exposure_s == 0.006]
    assert between
    assert all(frame.stamp.sigma_s > frames[-1].stamp.sigma_s for frame in between)
    assert drive.held is None
    assert drive.why_refused == os.strerror(errno.EIO)


async def test_an_image_that_claims_another_size_is_named_once_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    camera, device = VideoSource(), FakeDevice("MJPG", 0)

    async def story() -> None:
        for sequence in range(3):
            device.put(buffer(sequence, data=claiming(".jpg", 30000, 30000)))
        while camera.counters.frames_damaged < 3:  # noqa: ASYNC110
            await asyncio.sleep(0.005)
        device.put(buffer(3, data=encoded(".jpg", W, H)))
        assert (await camera.frames.get()).seq == 3
        device.unplug()

    assert await run_channel(camera, device, story) == "unplugged"
    c = camera.counters
    assert (c.frames_wrong_size, c.frames_damaged, c.frames) == (3, 3, 1)
    assert accounted(c)
    assert caplog.text.count("claims 30000x30000 px in place of") == 1


async def test_cancelled_at_any_time_it_closes_the_device() -> None:
    loop = asyncio.get_running_loop()
    for delay_s in (0.0, 0.001, 0.01, 0.03):
        device = FakeDevice()
        opened = asyncio.Event()

        def open_device(
            path: str, o: CameraOptions, size: Size, device: FakeDevice = device, opened: asyncio.Event = opened
        ) -> Any:
            loop.call_soon_threadsafe(opened.set)
            return device

        task = loop.create_task(V4l2Channel(camera_options(), (W, H), CLOCK, VideoSource(), open_device).run())
        await opened.wait()
        device.put(*[buffer(i) for i in range(4)])
        await asyncio.sleep(delay_s)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert device.closed


@pytest.mark.parametrize("damage", ["gap", "error", "garbage"])
async def test_h264_waits_for_an_image_that_stands_alone_after_any_damage(damage: str) -> None:
    units = h264(6)
    camera, device = VideoSource(), FakeDevice("H264", 0)
    assert [stands_alone(u) for u in units] == [True] + [False] * 5
    seen: list[int] = []

    async def story() -> None:
        device.put(buffer(0, units[1]))  # joins in the middle
        device.put(buffer(1, units[0]))
        seen.append((await camera.frames.get()).seq)
        device.put(buffer(2, units[1]))
        seen.append((await camera.frames.get()).seq)
        if damage == "error":
            device.put(buffer(3, units[2], error=True))
        elif damage == "garbage":
            device.put(buffer(3, b"\0\0\1\x41" + bytes(range(200))))
        device.put(buffer(4, units[3]))
        device.put(buffer(5, units[0]))
        seen.append((await camera.frames.get()).seq)
        device.unplug()

    await run_channel(camera, device, story)
    assert seen == [1, 2, 5]
    assert accounted(camera.counters)
    assert camera.counters.frames_waiting >= 2


@pytest.mark.parametrize(("form", "w", "h", "stride"), [
    ("YUYV", W, H, 0), ("GREY", W, H, 0), ("NV12", W, H, 0), ("YUYV", W, H, 2 * W + 8), ("NV12", W, H, W + 8),
    ("GREY", W, H, W + 8), ("YUYV", 63, 47, 128), ("NV12", 63, 47, 64), ("NV12", 63, 47, 63), ("NV12", 64, 47, 72),
    ("GREY", 63, 47, 0), ("MJPG", W, H, 0), ("H264", W, H, 0),
])  # fmt: skip
def test_formats_of_any_size_and_stride_come_out_as_the_image_that_went_in(form: str, w: int, h: int, stride: int) -> None:
    px = np.full((H, W, 3), 128, np.uint8)
    px[:, W // 2 :] = (60, 40, 210)
    lines = grey = cv2.cvtColor(px, cv2.COLOR_BGR2GRAY)
    if form == "YUYV":
        lines = cv2.cvtColor(px, cv2.COLOR_BGR2YUV_YUY2).reshape(H, 2 * W)[:h]
    elif form == "NV12":
        i420 = cv2.cvtColor(px, cv2.COLOR_BGR2YUV_I420)
        u, v = (i420[H + i * H // 4 : H + (i + 1) * H // 4].reshape(H // 2, W // 2) for i in (0, 1))
        lines = np.vstack([i420[:h], np.stack([u, v], axis=2).reshape(H // 2, W)[: (h + 1) // 2]])
    elif form == "GREY":
        lines = grey[:h, :w]
    wide = stride or lines.shape[1]
    data = np.pad(lines, ((0, 0), (0, max(0, wide - lines.shape[1]))), constant_values=77)[:, :wide].tobytes()
    if form == "MJPG":
        data = cv2.imencode(".jpg", px, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes() + bytes(100)
    layout = FrameLayout(form, w, h, stride)
    out = H264Decoder().decode(h264(1, px)[0], layout) if form == "H264" else to_bgr(data, layout)
    wanted = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR) if form == "GREY" else px
    assert np.percentile(np.abs(out.astype(int) - wanted[:h, :w]), 80 if form == "H264" else 95) <= 8


@pytest.mark.parametrize(("form", "stride"), [("GREY", W - 1), ("YUYV", 2 * W - 2), ("NV12", 1)])
def test_a_line_that_cannot_hold_the_width_is_one_error_with_its_numbers(form: str, stride: int) -> None:
    with pytest.raises(BadInput, match=rf"line of {W} px in {form} takes {stride} bytes, but it takes \d+"):
        to_bgr(bytes(10 * W * H), FrameLayout(form, W, H, stride))


def test_a_webcams_jpeg_without_huffman_tables_is_read() -> None:
    """UVC cameras leave the standard tables out (RFC 2435 section 3.1.1 does the same)."""
    data = cv2.imencode(".jpg", image())[1].tobytes()
    out, at = b"\xff\xd8", 2
    while data[at + 1] != 0xDA:
        size = 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        out += b"" if data[at + 1] == 0xC4 else data[at : at + size]
        at += size
    bare = out + data[at:]
    assert b"\xff\xc4" not in bare
    px = to_bgr(bare, FrameLayout("MJPG", W, H, 0))
    assert np.median(np.abs(px.astype(int) - image())) <= 6


@given(form=st.sampled_from(["YUYV", "NV12", "GREY", "MJPG"]), data=st.binary(max_size=3 * W * H), cut=st.integers(0, 3000))
@settings(max_examples=60)
def test_torn_bytes_are_refused_and_never_raise(form: str, data: bytes, cut: int) -> None:
    layout = FrameLayout(form, W, H, 2 * W if form == "YUYV" else W)
    jpeg = cv2.imencode(".jpg", image())[1].tobytes()
    for bad in (data, jpeg[: min(cut, len(jpeg) - 3)]):
        out = to_bgr(bad, layout)
        assert out is None or out.shape == (H, W, 3)
    assert to_bgr(jpeg[: min(cut, len(jpeg) - 3)], FrameLayout("MJPG", W, H, 0)) is None
    decoder = H264Decoder()
    assert decoder.decode(data, layout) is None
    assert decoder.decode(b"\0\0\1\x65" + data, layout) is None


def test_the_stamp_is_the_middle_of_the_exposure() -> None:
    o = camera_options(latency_s=0.004, latency_sigma_s=0.002, rate_hz=50.0)
    received_at, stamped = MonoNs(10_000_000_000), 9_980_000_000
    at_end, refused = kernel_stamp(Buffer(b"", 0, stamped, True, False, False), received_at, o, 0.006)
    assert (at_end.measured_at, at_end.source, refused) == (9_980_000_000 - 3_000_000 - 4_000_000, "kernel", False)
    assert at_end.sigma_s == pytest.approx(0.002)
    at_start, _ = kernel_stamp(Buffer(b"", 0, stamped, True, True, False), received_at, o, 0.006)
    assert at_start.measured_at == 9_980_000_000 + 3_000_000 - 4_000_000
    unknown, _ = kernel_stamp(Buffer(b"", 0, stamped, True, False, False), received_at, o, 0.0)
    assert unknown.sigma_s > 0.005


@given(stamp_ns=st.integers(-(2**63), 2**63), monotonic=st.booleans(), at_start=st.booleans(), latency_s=st.floats(0.0, 0.5))
@settings(max_examples=200)
def test_no_kernel_stamp_whatever_makes_an_impossible_one(stamp_ns, monotonic, at_start, latency_s):
    received_at = MonoNs(5_000_000_000)
    o = camera_options(latency_s=latency_s)
    stamp, refused = kernel_stamp(Buffer(b"", 0, stamp_ns, monotonic, at_start, False), received_at, o, 0.004)
    assert stamp.received_at == received_at
    assert (stamp.source == "kernel") == (monotonic and not refused)
    if not 3_000_000_000 <= stamp_ns <= 5_005_000_000:
        assert stamp.source == "arrival"


def test_cameras_are_found_by_what_does_not_move(tmp_path: Path) -> None:
    by_id, sysfs, dev = tmp_path / "by-id", tmp_path / "sys", tmp_path / "dev"
    for folder in (by_id, sysfs, dev, tmp_path / "usb1", tmp_path / "usb2", tmp_path / "usb3"):
        folder.mkdir()
    for node, card, body, index, name in [
        ("video0", "Nice Cam", "usb1", 0, "usb-Nice_Cam_A1-video-index0"),
        ("video1", "Nice Cam", "usb1", 1, "usb-Nice_Cam_A1-video-index1"),
        ("video2", "Nice Cam", "usb2", 0, "usb-Nice_Cam_B2-video-index0"),
        ("video3", "bcm2835-isp", "", 0, ""),
        ("video10", "Nameless", "usb3", 1, ""),
        ("video9", "Nameless", "usb3", 0, ""),
    ]:
        (dev / node).touch()
        (sysfs / node).mkdir()
        (sysfs / node / "name").write_text(card + "\n")
        (sysfs / node / "index").write_text(f"{index}\n")
        if body:
            (sysfs / node / "device").symlink_to(tmp_path / body)
        if name:
            (by_id / name).symlink_to(dev / node)
    there = cameras((by_id,), sysfs, dev)
    assert CaptureDevice(by_id / "usb-Nice_Cam_B2-video-index0", dev / "video2", "Nice Cam", tmp_path / "usb2") in there
    assert find("nameless", there) == dev / "video9"
    assert find("cam_a1", there) == by_id / "usb-Nice_Cam_A1-video-index0"
    assert find("video3", there) == dev / "video3"
    assert find("bcm2835", there) == dev / "video3"
    assert find(str(dev / "video0"), there) == dev / "video0"
    assert find(str(dev / "video8"), there) is None
    assert find("other", there) is None
    with pytest.raises(BadInput, match=r"may be any of .*A1.*B2"):
        find("nice", there)


@pytest.mark.parametrize("call", ["listdir", "readlink", "lstat", "stat"])
def test_a_camera_that_is_plugged_out_while_it_is_looked_for_is_absent(tmp_path, monkeypatch, call):
    by_id, sysfs, body = tmp_path / "by-id", tmp_path / "sys", tmp_path / "usb1"
    for folder in (by_id, body, sysfs / "video0"):
        folder.mkdir(parents=True)
    (by_id / "usb-Cam-video-index0").symlink_to(tmp_path / "video0")
    (sysfs / "video0" / "device").symlink_to(body)
    real = getattr(os, call)

    def gone(path: str | os.PathLike[str], *more: Any, **camera_options: Any) -> Any:
        if str(path).startswith((str(by_id), str(sysfs))):
            raise FileNotFoundError(errno.ENOENT, "unplugged", str(path))
        return real(path, *more, **camera_options)

    monkeypatch.setattr(os, call, gone)
    assert find("usb", cameras((by_id,), sysfs, tmp_path)) is None


CALLS = (
    "QUERYCAP", "ENUM_FMT", "S_FMT", "REQBUFS", "QUERYBUF", "QBUF", "DQBUF", "STREAMON", "STREAMOFF", "G_PARM", "S_PARM",
    "G_CTRL", "S_CTRL", "QUERYMENU", "G_EXT_CTRLS", "S_EXT_CTRLS", "QUERY_EXT_CTRL",
)  # fmt: skip
STRUCTS = {
    "v4l2_capability": kernel.Capability, "v4l2_fmtdesc": kernel.FormatDescription, "v4l2_pix_format": kernel.PixelFormat,
    "v4l2_format": kernel.Format, "v4l2_requestbuffers": kernel.RequestBuffers, "v4l2_buffer": kernel.KernelBuffer,
    "v4l2_control": kernel.ControlValue, "v4l2_query_ext_ctrl": kernel.VideoControl, "v4l2_querymenu": kernel.MenuEntry,
    "v4l2_ext_control": kernel.WideControl, "v4l2_ext_controls": kernel.WideControls,
}  # fmt: skip


def test_the_calls_and_structs_are_those_of_the_kernel_s_header(tmp_path: Path) -> None:
    if shutil.which("cc") is None or not Path("/usr/include/linux/videodev2.h").is_file():
        pytest.skip("there is no compiler, or no header of the kernel")
    lines = [f'printf("VIDIOC_{name} %lu\\n", (unsigned long)VIDIOC_{name});' for name in CALLS]
    wanted = {f"VIDIOC_{name}": getattr(kernel, name) for name in CALLS}
    for name, ours in STRUCTS.items():
        for field in (field[0] for field in ours._fields_):
            lines.append(f'printf("{name}.{field} %zu\\n", offsetof(struct {name}, {field}));')
            wanted[f"{name}.{field}"] = getattr(ours, field).offset
    lines.append('printf("parm %zu\\n", offsetof(struct v4l2_streamparm, parm.capture.timeperframe));')
    wanted["parm"] = kernel.StreamParameters.numerator.offset
    source = tmp_path / "layout.c"
    source.write_text(
        "#include <linux/videodev2.h>\n#include <stddef.h>\n#include <stdio.h>\nint main(void) {\n"
        + "\n".join(lines)
        + "\nreturn 0; }\n"
    )
    subprocess.run(["cc", str(source), "-o", str(tmp_path / "layout")], check=True)
    output = subprocess.run([str(tmp_path / "layout")], capture_output=True, text=True, check=True).stdout
    assert {line.split()[0]: int(line.split()[1]) for line in output.splitlines()} == wanted


_MODE, _TIME = 0x009A0901, 0x009A0902


def controls(_: int) -> list[SimpleNamespace]:
    usual = {"minimum": 1, "maximum": 5000, "step": 1, "type": 1, "name": b"control"}
    return [SimpleNamespace(id=number, **usual) for number in (_MODE, _TIME)]


@pytest.fixture
def values(monkeypatch: pytest.MonkeyPatch) -> dict[int, int]:
    """Return the values of the device's controls, by number."""
    held = {_MODE: 3, _TIME: 156}
    monkeypatch.setattr(v4l2_kernel, "controls", controls)
    monkeypatch.setattr(v4l2_kernel, "control_value", lambda _fd, number, _type: held[number])
    monkeypatch.setattr(v4l2_kernel, "set_control", lambda _fd, number, value, _type: held.update({number: value}))
    return held


def refuse_times(monkeypatch: pytest.MonkeyPatch, held: dict[int, int], code: int) -> None:
    def set_control(_fd: int, number: int, value: int, _type: int) -> None:
        if number == _TIME:
            raise OSError(code, "refused")
        held[number] = value

    monkeypatch.setattr(v4l2_kernel, "set_control", set_control)


def test_a_camera_that_refuses_a_time_when_it_is_opened_gives_frames_with_the_one_it_holds(values, monkeypatch):
    """A camera that is lost in flight and comes back stubborn must not stay lost."""
    refuse_times(monkeypatch, values, errno.EILSEQ)
    exposure = KernelExposure(3, "/dev/video0", ExposureOptions(mode="pad"), 30.0)
    assert (exposure.held.exposure_s, exposure.held.gain) == (pytest.approx(0.0156), 1.0)
    assert values[_MODE] == 1


def test_a_camera_that_is_gone_while_its_exposure_is_taken_over_is_gone(values, monkeypatch):
    refuse_times(monkeypatch, values, errno.ENODEV)
    with pytest.raises(OSError, match="refused"):
        KernelExposure(3, "/dev/video0", ExposureOptions(mode="pad"), 30.0)


def test_an_exposure_longer_than_the_frame_allows_is_cut_when_it_is_taken_over(values: dict[int, int]) -> None:
    values[_TIME] = 5000
    exposure = KernelExposure(3, "/dev/video0", ExposureOptions(mode="pad"), 30.0)
    assert exposure.held.exposure_s == pytest.approx(1e-4 * values[_TIME])
    assert values[_TIME] == 266


@pytest.mark.parametrize("field", range(10))
def test_pictures_of_two_instants_are_refused_by_what_the_driver_says(monkeypatch: pytest.MonkeyPatch, field: int) -> None:
    def agreed(_fd: int, name: str, width: int, height: int) -> kernel.PixelFormat:
        return kernel.PixelFormat(width, height, int.from_bytes(name.encode(), "little"), field, 2 * width)

    monkeypatch.setattr(v4l2_kernel, "formats", lambda _fd: ["YUYV"])
    monkeypatch.setattr(v4l2_kernel, "set_rate", lambda _fd, hz: hz)
    monkeypatch.setattr(v4l2_kernel, "set_format", agreed)
    device = KernelDevice.__new__(KernelDevice)
    device._fd, device._path = 0, "/dev/video0"
    try:
        if field < 4:  # any, progressive, or one field alone
            assert device._set_format(CameraOptions(source="v4l2", device="any"), 640, 360)[0].width == 640
        else:
            with pytest.raises(BadInput, match="field order"):
                device._set_format(CameraOptions(source="v4l2", device="any"), 640, 360)
    finally:
        device._fd = None
