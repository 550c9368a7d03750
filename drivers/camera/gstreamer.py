"""Read frames from a GStreamer pipeline: cameras of libcamera (Raspberry Pi), of NVIDIA's Jetson, and what else has a plug-in.

The pipeline runs in a process of its own (`gstreamer_program`): a plug-in's crash is a camera that is lost and opened again.
"""

from __future__ import annotations

import asyncio
import fcntl
import os
import re
import select
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from drivers.camera import gstreamer_program as wire
from drivers.camera.options import CameraOptions, Size, check_size
from drivers.camera.source import CameraCounters, CameraLost, VideoSource, stamp_of
from estimator.contracts.errors import BadInput, SetupImpossible
from estimator.contracts.samples import Frame
from estimator.contracts.time import Clock, MonoNs

PYTHONS = (sys.executable, "/usr/bin/python3")
"""The Pythons that may have GStreamer's bindings, the first that has them is used."""
_PROGRAM = Path(wire.__file__)
_FIRST_S = 10.0
"""Longest time from the start to the first frame: GStreamer lists its plug-ins, and a sensor starts."""
_BEHIND_MOST = 8
"""Number of frames that may be skipped at a time to reach the newest."""
_PIPE_BYTES = 1 << 20
_PREDICTING = re.compile(r"h26[345]|x26[45]|hevc|vp[89]|av1|mpeg[24]|decodebin")
"""Names of codec elements that predict frames from one another, or of any codec."""


class _Image(Struct, frozen=True, eq=False):
    px: NDArray[np.uint8]
    stamp_ns: int
    received_at: MonoNs


class GstreamerChannel:
    """One run from starting the pipeline to its end; run it again after that."""

    def __init__(
        self, options: CameraOptions, size: Size, clock: Clock, camera: VideoSource, pythons: Sequence[str] = PYTHONS
    ) -> None:
        self._o = options
        self._size = check_size(size)
        self._clock = clock
        self._camera = camera
        self._pythons = pythons
        self._seq = 0
        self._opened_before = False
        self._coded = _PREDICTING.search(options.device) is not None

    async def run(self) -> None:
        """Read frames until the pipeline ends or is silent.

        Raises:
            CameraLost: an element failed, the pipeline ended, its process died, no frame came, or what was opened before cannot
                be built now.
            BadInput: GStreamer cannot build the pipeline, the first time.
            SetupImpossible: no Python of this computer has GStreamer's bindings, the first time.
        """
        loop, pool = asyncio.get_running_loop(), ThreadPoolExecutor(1, "gstreamer")
        pipeline = _Pipeline(self._o, self._size, self._clock, self._camera.counters, self._pythons)
        try:
            await self._start(pipeline, pool)
            while True:
                image = await loop.run_in_executor(pool, pipeline.newest)
                self._camera.down = None
                self._give(image)
        finally:
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

    def _give(self, image: _Image) -> None:
        counters, o = self._camera.counters, self._o
        stamped = None if image.stamp_ns == wire.UNKNOWN else MonoNs(image.stamp_ns)
        stamp, refused = stamp_of(stamped, 0.0, image.received_at, o, o.exposure_s)
        counters.stamps_refused += refused
        counters.frames += 1
        frame = Frame(stamp, self._seq, image.px, o.exposure_s, coded=self._coded)
        self._seq += 1
        counters.frames_replaced += self._camera.frames.offer(frame) is not None


class _Pipeline:
    """The pipeline's process and the pipe from it. All but `kill` runs on one worker thread."""

    def __init__(
        self, options: CameraOptions, size: Size, clock: Clock, counters: CameraCounters, pythons: Sequence[str]
    ) -> None:
        self._o = options
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
            magic, length, _, _ = self._header()
            if magic == wire.READY:
                return
            text = self._text(length) if magic == wire.FAULT else "what it says is no message of ours"
            code = self._ended()
            if code == wire.WRONG_PIPELINE:
                raise BadInput(f"camera.device {self._o.device!r} is no pipeline that GStreamer can build: {text}")
            if code != wire.NO_BINDINGS:
                raise CameraLost("failed", text)
        raise SetupImpossible(
            f"no Python of {', '.join(self._pythons)} has GStreamer's bindings: install the packages python3-gi, "
            "gir1.2-gstreamer-1.0 and gstreamer1.0-plugins-base"
        )

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
            assert process.stdout is not None
            process.stdout.close()

    def _spawn(self, python: str) -> None:
        self.close()
        words = [python, "-I", str(_PROGRAM), str(os.getpid()), *map(str, self._size), self._o.device]
        try:
            self._process = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, bufsize=0, env=_environment()
            )
        except OSError as why:
            raise CameraLost("failed", f"{python}: {why.strerror or why}") from why
        if self._killed:
            self._process.kill()
        fcntl.fcntl(self._fd(), fcntl.F_SETPIPE_SZ, _PIPE_BYTES)

    def _image(self) -> _Image:
        magic, length, stamp_ns, number = self._header()
        received_at = self._clock.now()
        width, height = self._size
        stride = wire.stride_of(width)
        if magic == wire.FAULT:
            raise CameraLost("failed", self._text(length))
        if magic != wire.FRAME or length != stride * height:
            raise CameraLost("failed", "its process sent what is no frame")
        rows = np.empty((height, stride), np.uint8)
        self._fill(rows.data.cast("B"))
        self._counters.buffers += 1
        if wire.UNKNOWN != self._last_number < number:
            self._counters.frames_lost += number - self._last_number - 1
        self._last_number = number
        px = np.ascontiguousarray(rows[:, : 3 * width]).reshape(height, width, 3)
        return _Image(px, stamp_ns, received_at)

    def _header(self) -> tuple[bytes, int, int, int]:
        raw = bytearray(wire.HEADER.size)
        self._fill(memoryview(raw))
        magic, length, stamp_ns, number = wire.HEADER.unpack(raw)
        return magic, length, stamp_ns, number

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
                raise CameraLost("failed", f"its process ended ({_named(self._ended())})")
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


def _named(code: int | None) -> str:
    return "still there" if code is None else f"signal {-code}" if code < 0 else f"exit code {code}"


def _environment() -> dict[str, str]:
    """Return the environment, with GStreamer's list of plug-ins in the service's own cache: its home cannot be written."""
    cache = os.environ.get("CACHE_DIRECTORY")
    return {**os.environ, **({"GST_REGISTRY": f"{cache}/gstreamer.bin"} if cache and "GST_REGISTRY" not in os.environ else {})}
