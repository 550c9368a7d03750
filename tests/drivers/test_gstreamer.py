"""The GStreamer source: its process's messages, faults and end, and real pipelines where a Python has GStreamer's bindings."""

import asyncio
import os
import signal
import stat
import struct
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.camera import gstreamer_program as wire
from drivers.camera.gstreamer import PYTHONS, GstreamerChannel
from drivers.camera.open_camera import open_camera
from drivers.camera.options import CameraOptions
from drivers.camera.source import CameraLost, VideoSource
from drivers.clock import SystemClock
from estimator.contracts.errors import BadInput, SetupImpossible
from estimator.contracts.samples import Frame
from tests.support.processes import gone
from tests.support.waiting import until

CLOCK = SystemClock()
W, H = 66, 48  # rows of 198 bytes, which are padded by 2
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
    return wire.HEADER.pack(magic, len(content), stamp_ns, number) + content


def rows(value: int) -> bytes:
    """Return a frame whose padding would show if it became pixels."""
    return (bytes([value]) * 3 * W + b"\xff\xff") * H


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
    channel = GstreamerChannel(camera_options("any", silence_s=silence_s), (W, H), CLOCK, camera, [python])

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
    assert frames[-1].px.shape == (H, W, 3)
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
        (message(wire.FAULT, b'no element "foo"'), wire.WRONG_PIPELINE, BadInput, 'no element "foo"'),
        (message(wire.FAULT, b"No module named gi"), wire.NO_BINDINGS, SetupImpossible, "python3-gi"),
        (message(wire.FAULT, b"\xff\xfe strange"), 1, CameraLost, "strange"),
        (message(wire.READY) + message(wire.FAULT, b"camera0: in use"), 0, CameraLost, "camera0: in use"),
        (message(wire.READY) + message(wire.FRAME, b"short"), 0, CameraLost, "no frame"),
        (message(wire.READY) + message(wire.FRAME, rows(1))[:200], 0, CameraLost, "its process ended"),
        (message(wire.READY) + struct.pack("<4sIqq", wire.FRAME, 0xFFFFFFFF, 0, 0), 0, CameraLost, "no frame"),
        (b"hello, I am no camera at all", 0, CameraLost, "no message of ours"),
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


@pytest.mark.parametrize("code", [wire.WRONG_PIPELINE, wire.NO_BINDINGS])
async def test_a_pipeline_that_cannot_be_built_again_is_lost_and_tried_again(tmp_path: Path, code: int) -> None:
    # In flight an error of the settings would end the service; only the first opening tells of the settings.
    good, bad = message(wire.READY) + message(wire.FRAME, rows(1)), message(wire.FAULT, b'no element "camerasrc"')
    python = program(tmp_path, good)
    camera = VideoSource()
    channel = GstreamerChannel(camera_options("any"), (W, H), CLOCK, camera, [python])
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
    async with asyncio.timeout(120), open_camera(camera_options(LIVE), (W, H), CLOCK) as camera:
        frames = [await camera.frames.get() for _ in range(12)]
        assert camera.down is None
    assert frames[0].px.shape == (H, W, 3)
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
    async with asyncio.timeout(120), open_camera(camera_options(LIVE, silence_s=0.5), (W, H), CLOCK) as camera:
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
    return [pid for pid in found if b"gstreamer_program" in _command(pid)]


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
        "from tests.drivers.test_gstreamer import LIVE, children\n"
        "async def main():\n"
        "    async with open_camera(CameraOptions(source='gstreamer', device=LIVE), (66, 48), SystemClock()) as camera:\n"
        "        await camera.frames.get()\n"
        "        print(children()[0], flush=True)\n"
        "        await asyncio.sleep(60)\n"
        "asyncio.run(main())"
    )
    service = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert service.stdout is not None
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
        ("videotestsrc ! video/x-raw,width=320,height=240", f"width=.*{W}, height=.*{H}"),
        ("", "device must be given"),
    ],
)
async def test_a_text_that_is_no_pipeline_is_one_clear_error(pipeline: str, words: str) -> None:
    with pytest.raises((BadInput, ValueError), match=words):
        async with asyncio.timeout(60), open_camera(camera_options(pipeline), (W, H), CLOCK) as camera:
            await camera.frames.get()
