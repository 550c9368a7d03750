"""Read frames from a process that opens the camera: a Pi's by libcamera, one by GStreamer, or an image topic of ROS 2.

It runs `camera_program`: a crash of the camera's stack is a camera that is lost and opened again.
"""

from __future__ import annotations

import asyncio
import fcntl
import json
import logging
import os
import re
import select
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from drivers.camera import camera_program as wire
from drivers.camera.exposure import FRAME_PART, ExposureDrive, ExposureRange, ExposureSetting
from drivers.camera.options import CameraOptions, Lens, Size, check_size
from drivers.camera.source import CameraCounters, CameraLost, VideoSource, stamp_of
from drivers.clock import SystemClock
from estimator.contracts.address import raw
from estimator.contracts.errors import BadInput, SetupImpossible
from estimator.contracts.samples import Frame
from estimator.contracts.time import Clock, MonoNs

PYTHONS = (sys.executable, "/usr/bin/python3")
"""The Pythons that may have the library, the first that has it is used."""
_PROGRAM = Path(wire.__file__)
_FIRST_S = 10.0
"""Longest time from the start to the first frame: GStreamer lists its plug-ins, and a sensor starts."""
_BEHIND_MOST = 8
"""Number of frames that may be skipped at a time to reach the newest."""
_PIPE_BYTES = 1 << 20  # size of the pipe from the camera's process, which holds a frame or several
_PADDING_MOST = 256
"""The bytes that may follow the pixels of a row: an image processor aligns rows."""
log = logging.getLogger(__name__)
_PREDICTING = re.compile(r"h26[345]|x26[45]|hevc|vp[89]|av1|mpeg[24]|decodebin")
"""Names of codec elements that predict frames from one another, or of any codec."""
_SET_FRAMES = 12
"""Frames after which a setting counts as what the camera makes of it: the newest requests that it holds, and its delay."""
_SAME = 0.05
"""Part by which a setting may differ from what was wanted: exposures are whole rows, gains a sensor's steps."""


class _Library(Struct, frozen=True):
    name: str
    packages: str
    """The system's packages that bring it."""
    fault: str
    """The fault of settings that it cannot build, with the device's name."""


_LIBRARIES = {
    "gstreamer": _Library(
        "GStreamer's bindings",
        "python3-gi, gir1.2-gstreamer-1.0 and gstreamer1.0-plugins-base",
        "camera.device {!r} is no pipeline that GStreamer can build",
    ),
    "ros2": _Library("ROS 2", "the extra decklander[ros2]", "camera.device {!r} cannot be opened"),
    "libcamera": _Library("picamera2", "python3-picamera2 (of Raspberry Pi OS)", "camera {!r} cannot do what the settings want"),
}


def libcamera_models() -> list[str]:
    """Return the models of the CSI cameras that libcamera lists; none where no Python has picamera2. It takes about a second."""
    camera = VideoSource()
    pipeline = _Pipeline(CameraOptions(source="libcamera"), '{"list": true}', (16, 16), SystemClock(), camera.counters, PYTHONS)
    try:
        pipeline.start()
    except (CameraLost, BadInput, SetupImpossible):
        return []
    finally:
        pipeline.close()
    return [str(model) for model in pipeline.about]


def libcamera_request(options: CameraOptions) -> str:
    """Return what the process is to open, as JSON: the camera, its rate, what is fixed, and the white balance of a driven one."""
    exposure = options.exposure
    request = {
        "camera": options.device, "rate_hz": options.rate_hz, "controls": _numbers(options.control_values()),
        "exposure_s": options.exposure_s, "driven": exposure.driven, "white_balance_k": exposure.white_balance_k,
    }  # fmt: skip
    return json.dumps(request)


def _numbers(controls: dict[str, int | bool | str]) -> dict[str, float | str]:
    """Return controls with those that are decimal fractions as numbers: V4L2 has none of them."""
    out: dict[str, float | str] = dict(controls)
    for name, value in controls.items():
        with suppress(ValueError):
            out[name] = float(value) if isinstance(value, str) else value
    return out


class _Image(Struct, frozen=True, eq=False):
    px: NDArray[np.uint8]
    stamp_ns: int
    received_at: MonoNs
    exposure_s: float
    gain: float


class ProcessChannel:
    """One run from starting the process to its end; run it again after that."""

    def __init__(
        self, options: CameraOptions, size: Size, clock: Clock, camera: VideoSource, lens: Lens, pythons: Sequence[str] = ()
    ) -> None:
        self._o = options
        self._size = check_size(size)
        self._clock = clock
        self._camera = camera
        self._pythons = pythons or PYTHONS
        self._seq = 0
        self._opened_before = False
        self._coded = options.source == "gstreamer" and _PREDICTING.search(options.device) is not None
        self._text = libcamera_request(options) if options.source == "libcamera" else raw(options.device)
        if options.source == "ros2":
            self._text = json.dumps({"topic": raw(options.device), "lens": lens})

    async def run(self) -> None:
        """Read frames until the process ends or is silent.

        Raises:
            CameraLost: the camera is absent or failed, its pipeline or process ended, no frame came, or what was opened before
                cannot be built now.
            BadInput: the library cannot build what the settings describe, the first time.
            SetupImpossible: no Python of this computer has the library, the first time.
        """
        loop, pool = asyncio.get_running_loop(), ThreadPoolExecutor(1, self._o.source)
        pipeline = _Pipeline(self._o, self._text, self._size, self._clock, self._camera.counters, self._pythons)
        try:
            await self._start(pipeline, pool)
            readout_s = pipeline.about["readout_s"] if pipeline.about else 0.0
            if pipeline.about:
                about = pipeline.about
                log.info(
                    "camera %s, mode %s: its rows are read out within %.1f ms", about["model"], about["mode"], 1e3 * readout_s
                )
            exposure = _LibcameraExposure(self._camera.exposure, pipeline, self._o.rate_hz)
            while True:
                image = await loop.run_in_executor(pool, pipeline.newest)
                self._camera.down = None
                exposure.tend(self._seq, image)
                self._give(image, readout_s)
        finally:
            if self._camera.exposure is not None:
                self._camera.exposure.closed()
            # The process's end ends the read that is under way as well, so that nothing here waits for it.
            pipeline.kill()
            pool.submit(pipeline.close)
            pool.shutdown(wait=False)

    async def _start(self, pipeline: _Pipeline, pool: ThreadPoolExecutor) -> None:
        """Start the pipeline. GStreamer drops a plug-in that crashed from its list: later on that is a lost camera, in flight."""
        again, self._opened_before = self._opened_before, True
        try:
            await asyncio.get_running_loop().run_in_executor(pool, pipeline.start)
        except (BadInput, SetupImpossible) as why:
            if not again:
                raise
            raise CameraLost("failed", str(why)) from why

    def _give(self, image: _Image, readout_s: float) -> None:
        counters, o = self._camera.counters, self._o
        stamped = None if image.stamp_ns == wire.UNKNOWN else MonoNs(image.stamp_ns)
        exposure_s = image.exposure_s or o.exposure_s
        # A Pi's receiver stamps the begin of a frame on its bus, which ends the first row's exposure; a buffer of GStreamer is
        # stamped as its source likes, which latency_s says.
        to_middle_s = 0.5 * (readout_s - exposure_s) if o.source == "libcamera" else 0.0
        stamp, refused = stamp_of(stamped, to_middle_s, image.received_at, o, exposure_s)
        counters.stamps_refused += refused
        counters.frames += 1
        frame = Frame(stamp, self._seq, image.px, exposure_s, image.gain if o.exposure.driven else 0.0, self._coded)
        self._seq += 1
        counters.frames_replaced += self._camera.frames.offer(frame) is not None


class _LibcameraExposure:
    """Sends the settings of a drive, one at a time; each frame says with which it was taken."""

    def __init__(self, drive: ExposureDrive | None, pipeline: _Pipeline, rate_hz: float) -> None:
        self._pipeline, self._drive = pipeline, drive
        self._wanted: ExposureSetting | None = None
        self._frames = 0
        if drive is None:
            return
        least, most = pipeline.about["AnalogueGain"]
        shortest_us, longest_us = pipeline.about["ExposureTime"]
        self._least = max(least, 1e-3)
        longest_s = min(1e-6 * longest_us, FRAME_PART / rate_hz)
        self._can = ExposureRange(1e-6 * max(shortest_us, 1), longest_s, max(1.0, most / self._least))
        self._open = False

    def tend(self, number: int, image: _Image) -> None:
        """Note what a frame was taken with, and send the next setting."""
        if (drive := self._drive) is None or not image.exposure_s:
            return
        held = ExposureSetting(image.exposure_s, max(1.0, image.gain / self._least))
        if not self._open:
            self._open = True
            drive.opened(self._can, held)
        if (wanted := self._wanted) is not None:
            self._frames += 1
            there = abs(held.exposure_s / wanted.exposure_s - 1.0) < _SAME and abs(held.gain / wanted.gain - 1.0) < _SAME
            if not there and self._frames < _SET_FRAMES:
                return
            self._wanted = None
            # Half a row more than the limit is no reason to set it again.
            drive.changed(wanted if there else held, number - 1, number - 1)
        if (wanted := drive.take()) is not None:
            self._wanted, self._frames = wanted, 0
            self._pipeline.send(f"{round(1e6 * wanted.exposure_s)} {wanted.gain * self._least:.4f}\n")


class _Pipeline:
    """The camera's process and the pipes to and from it. All but `kill` and `send` runs on one worker thread."""

    def __init__(
        self, options: CameraOptions, text: str, size: Size, clock: Clock, counters: CameraCounters, pythons: Sequence[str]
    ) -> None:
        self._o, self._said = options, text
        self._library = _LIBRARIES[options.source]
        self.about: Any = {}
        """The process's description of the camera; empty if it gave none."""
        self._size = size
        self._clock = clock
        self._counters = counters
        self._pythons = tuple(dict.fromkeys(pythons))
        self._process: subprocess.Popen[bytes] | None = None
        self._killed = False
        self._patience_s = max(_FIRST_S, options.silence_s)
        self._last_number = wire.UNKNOWN
        self._end: CameraLost | None = None

    def start(self) -> None:
        for python in self._pythons:
            self._spawn(python)
            magic, length, *_ = self._header()
            if magic == wire.READY:
                self.about = json.loads(self._text(length) or "{}")
                return
            text = self._text(length) if magic == wire.FAULT else "what it says is no message of ours"
            code = self._ended()
            if code == wire.WRONG_SETTINGS:
                raise BadInput(f"{self._library.fault.format(self._o.device)}: {text}")
            if code != wire.NO_BINDINGS:
                raise CameraLost("absent" if code == wire.NO_CAMERA else "failed", text)
        raise SetupImpossible(
            f"no Python of {', '.join(self._pythons)} has {self._library.name}: install {self._library.packages}"
        )

    def send(self, line: str) -> None:
        """Send a line to the process; one that ended says so by its other pipe."""
        assert self._process is not None
        assert self._process.stdin is not None
        with suppress(OSError):
            os.write(self._process.stdin.fileno(), line.encode())

    def newest(self) -> _Image:
        """Return the newest frame, waiting for it; frames before it are counted as overtaken."""
        if self._end is not None:
            raise self._end
        image = self._image()
        self._patience_s = self._o.silence_s
        for _ in range(_BEHIND_MOST):
            if not self._readable(0.0):
                break
            try:
                image = self._image()
            except CameraLost as why:
                self._end = why
                break
            self._counters.frames_overtaken += 1
        return image

    def kill(self) -> None:
        """End the process, from any thread."""
        self._killed = True
        if self._process is not None:
            self._process.kill()

    def close(self) -> None:
        """Reap the process."""
        if (process := self._process) is not None:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                assert pipe is not None
                pipe.close()

    def _spawn(self, python: str) -> None:
        self.close()
        program = ["-P", "-m", wire.__name__] if self._o.source == "ros2" else ["-I", str(_PROGRAM)]
        words = [python, *program, str(os.getpid()), *map(str, self._size), self._o.source, self._said]
        try:
            self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, env=_environment())
        except OSError as why:
            raise CameraLost("failed", f"{python}: {why.strerror or why}") from why
        if self._killed:
            self._process.kill()
        fcntl.fcntl(self._fd(), fcntl.F_SETPIPE_SZ, _PIPE_BYTES)

    def _image(self) -> _Image:
        magic, length, stamp_ns, number, exposure_s, gain = self._header()
        while magic == wire.DAMAGED:
            text = self._text(length)
            if not self._counters.frames_damaged:
                log.warning("camera %s: an image is not used: %s; more are counted", self._o.device, text)
            self._counters.buffers += 1
            self._counters.frames_damaged += 1
            magic, length, stamp_ns, number, exposure_s, gain = self._header()
        received_at = self._clock.now()
        width, height = self._size
        stride = length // height
        if magic == wire.FAULT:
            raise CameraLost("failed", self._text(length))
        if magic != wire.FRAME or length != stride * height or not 0 <= stride - 3 * width < _PADDING_MOST:
            raise CameraLost("failed", "its process sent what is no frame")
        rows = np.empty((height, stride), np.uint8)
        self._fill(rows.data.cast("B"))
        self._counters.buffers += 1
        if wire.UNKNOWN != self._last_number < number:
            self._counters.frames_lost += number - self._last_number - 1
        self._last_number = number
        px = np.ascontiguousarray(rows[:, : 3 * width]).reshape(height, width, 3)
        return _Image(px, stamp_ns, received_at, exposure_s, gain)

    def _header(self) -> tuple[bytes, int, int, int, float, float]:
        raw = bytearray(wire.HEADER.size)
        self._fill(memoryview(raw))
        magic, length, stamp_ns, number, exposure_s, gain = wire.HEADER.unpack(raw)
        return magic, length, stamp_ns, number, exposure_s, gain

    def _text(self, length: int) -> str:
        raw = bytearray(min(length, wire.MOST_TEXT))
        self._fill(memoryview(raw))
        return raw.decode(errors="replace")

    def _fill(self, room: memoryview) -> None:
        while room:
            if not self._readable(self._patience_s):
                raise CameraLost("silent", f"no frame for {self._patience_s:g} s")
            n = os.readv(self._fd(), [room])
            if n == 0:
                code = self._ended()
                why = "still there" if code is None else f"signal {-code}" if code < 0 else f"exit code {code}"
                raise CameraLost("failed", f"its process ended ({why})")
            room = room[n:]

    def _readable(self, seconds: float) -> bool:
        poll = select.poll()
        poll.register(self._fd(), select.POLLIN)
        return bool(poll.poll(1e3 * seconds))

    def _fd(self) -> int:
        assert self._process is not None
        assert self._process.stdout is not None
        return self._process.stdout.fileno()

    def _ended(self) -> int | None:
        """Return the exit code of the process, which has closed its pipe; None if it is still there."""
        assert self._process is not None
        try:
            return self._process.wait(1.0)
        except subprocess.TimeoutExpired:
            return None


def _environment() -> dict[str, str]:
    """Return the environment, with GStreamer's list of plug-ins in the service's own cache: its home cannot be written."""
    cache = os.environ.get("CACHE_DIRECTORY")
    return {**os.environ, **({"GST_REGISTRY": f"{cache}/gstreamer.bin"} if cache and "GST_REGISTRY" not in os.environ else {})}
