"""Land the demo's flight by a network camera: python -m benches.streams [--kinds NAME...] [--flights 1] [--first 1].

The emulated AR.Drone films as the demo does, and its frames reach the real service by another stream than its own: MJPEG over
HTTP with and without lengths at five rates and a varying one, raw H.264 over TCP and a named pipe, H.264 over RTP and MPEG-TS. A
second reader, the service's own driver, compares each stamp with the instant of exposure; the frame's first rows hold its number.
Printed: the landing, frames, their share within three stated sigmas, the median sigma, and errors. A busy machine is in them.
"""

import argparse
import asyncio
import os
import random
import socket
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from benches.chaos import until
from drivers.camera.open_camera import open_camera
from drivers.camera.options import CameraOptions
from drivers.clock import SystemClock
from estimator.contracts.errors import DecklanderError
from estimator.contracts.time import seconds_between
from sitl.emulators.ardrone.server import ArDroneServer, Ports
from sitl.emulators.ardrone.truth_log import read as read_truth
from sitl.emulators.ardrone.wire_pictures import Encoder
from sitl.scenario.scenario import load
from sitl.world.world import World
from tests.support.processes import decklander, started
from tests.support.waiting import free_port

HOST = "127.0.0.1"
DELAY_S = 0.04
"""Delay from mid-exposure to the first byte, s; the settings state it."""
LASTING_S = 75.0
KINDS = (
    "mjpeg-10", "mjpeg-15", "mjpeg-20", "mjpeg-24", "mjpeg-30", "mjpeg-varying", "mjpeg-nolength-15", "mjpeg-nolength-30",
    "h264-tcp-30", "h264-pipe-30", "rtp-30", "mpegts-30",
)  # fmt: skip
_BITS, _SQUARE = 12, 8
_PATTERN = (16, 235)


def marked(px: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    """Return the frame with its number as squares in its first rows."""
    out = px.copy()
    bits = np.array([_PATTERN[number >> bit & 1] for bit in range(_BITS)], np.uint8)
    out[:_SQUARE, : _BITS * _SQUARE] = bits.repeat(_SQUARE)[None, :, None]
    return out


def number_of(px: NDArray[np.uint8]) -> int:
    """Return the number that `marked` wrote."""
    row = px[_SQUARE // 2, _SQUARE // 2 : _BITS * _SQUARE : _SQUARE, 1]
    return sum(int(value > 127) << bit for bit, value in enumerate(row))


class Outlet:
    """Sends frames in the way of one kind to two readers."""

    def __init__(self, kind: str, folder: Path, stack: ExitStack, leaves: Callable[[int], None]) -> None:
        self._kind, self._leaves = kind, leaves
        self._queues: list[deque[tuple[int, bytes]]] = []
        self._came = threading.Condition()
        self._encoder = Encoder(640, 360, 30.0, 4000.0) if kind.startswith("h264") else None
        self._muxers: list[tuple[av.container.OutputContainer, av.VideoStream]] = []
        if kind.startswith(("rtp", "mpegts")):
            self.devices = [self._muxed(folder, n, stack) for n in range(2)]
        elif "pipe" in kind:
            self.devices = [str(folder / f"pipe{n}") for n in range(2)]
            for device in self.devices:
                os.mkfifo(device)
                threading.Thread(target=self._write, args=(device, self._queue()), daemon=True).start()
        else:
            door = stack.enter_context(socket.create_server((HOST, 0)))
            scheme = "tcp" if "tcp" in kind else "http"
            self.devices = [f"{scheme}://{HOST}:{door.getsockname()[1]}/"] * 2
            threading.Thread(target=self._serve, args=(door,), daemon=True).start()

    @property
    def timed(self) -> bool:
        """True if the stream carries the times of exposure."""
        return bool(self._muxers)

    def _queue(self) -> deque[tuple[int, bytes]]:
        self._queues.append(deque(maxlen=8))
        return self._queues[-1]

    def _muxed(self, folder: Path, n: int, stack: ExitStack) -> str:
        port = next(port for port in iter(free_port, None) if port % 2 == 0)
        form, scheme = ("rtp", "rtp") if self._kind.startswith("rtp") else ("mpegts", "udp")
        out = stack.enter_context(
            av.open(f"{scheme}://{HOST}:{port}?pkt_size=1316", "w", format=form, options={"flush_packets": "1"})
        )
        made = out.add_stream("libx264", rate=30, options={"preset": "ultrafast", "tune": "zerolatency", "g": "15", "crf": "23"})
        made.width, made.height, made.pix_fmt, made.time_base = 640, 360, "yuv420p", Fraction(1, 90000)
        made.codec_context.time_base = Fraction(1, 90000)
        self._muxers.append((out, made))
        if form == "mpegts":
            return f"udp://{HOST}:{port}"
        path = folder / f"camera{n}.sdp"
        path.write_text(
            f"v=0\no=- 0 0 IN IP4 {HOST}\ns=x\nc=IN IP4 {HOST}\nt=0 0\nm=video {port} RTP/AVP 96\n"
            "a=rtpmap:96 H264/90000\na=fmtp:96 packetization-mode=1\n"
        )
        return str(path)

    def _serve(self, door: socket.socket) -> None:
        with suppress(OSError):
            while True:
                client, _ = door.accept()
                threading.Thread(target=self._feed, args=(client,), daemon=True).start()

    def _feed(self, client: socket.socket) -> None:
        with client, suppress(OSError):
            if self._kind.startswith("mjpeg"):
                client.recv(4096)
                client.sendall(b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=f\r\n\r\n")
            mine = self._queue()
            while True:
                client.sendall(self._next(mine))

    def _write(self, path: str, mine: deque[tuple[int, bytes]]) -> None:
        with suppress(OSError), open(path, "wb", buffering=0) as out:
            mine.clear()
            while True:
                out.write(self._next(mine))

    def _next(self, mine: deque[tuple[int, bytes]]) -> bytes:
        with self._came:
            self._came.wait_for(lambda: mine)
            number, data = mine.popleft()
        self._leaves(number)
        return data

    def encode(self, px: NDArray[np.uint8]) -> bytes:
        """Return a frame's bytes."""
        if self._muxers:
            return b""
        if self._encoder is not None:
            return self._encoder.encode(px).data
        jpeg = cv2.imencode(".jpg", px, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()
        length = b"" if "nolength" in self._kind else b"Content-Length: %d\r\n" % len(jpeg)
        return b"--f\r\nContent-Type: image/jpeg\r\n%s\r\n%s\r\n" % (length, jpeg)

    def send(self, number: int, data: bytes, px: NDArray[np.uint8], at_s: float) -> None:
        """Send a frame that was exposed at `at_s`."""
        for out, made in self._muxers:
            frame = av.VideoFrame.from_ndarray(px, format="bgr24")
            frame.pts, frame.time_base = round(at_s * 90000), Fraction(1, 90000)
            for packet in made.encode(frame):
                out.mux(packet)
        with self._came:
            for queue in self._queues:
                queue.append((number, data))
            self._came.notify_all()


@dataclass
class Stamps:
    """Errors of stamps and their stated sigmas, s."""

    exposed: dict[int, int] = field(default_factory=dict)
    errors: list[float] = field(default_factory=list)
    sigmas: list[float] = field(default_factory=list)

    def leaves(self, number: int) -> None:
        """Note that a frame leaves now: a host that is late with it is no error of its stamp."""
        self.exposed[number] = SystemClock().now() - round(1e9 * DELAY_S)


class FilmedByStream(ArDroneServer):
    """The emulated drone, whose frames go to an outlet instead of its own video port."""

    outlet: Outlet
    kind: str
    stamps: Stamps

    async def _film(self, pool: ThreadPoolExecutor) -> None:
        loop, rng, clock, number = asyncio.get_running_loop(), random.Random(1), self._clock, 0
        rate = self.kind.rpartition("-")[2]
        due = began = clock.now()
        while True:
            await clock.sleep(max(0.0, seconds_between(clock.now(), due)))
            period_s = rng.uniform(0.033, 0.1) if rate == "varying" else 1.0 / float(rate)
            due = type(due)(max(due, clock.now() - round(1e9 * period_s)) + round(1e9 * period_s))
            image = await loop.run_in_executor(pool, self.world.expose())
            number = (number + 1) % (1 << _BITS)
            px = marked(image.px, number)
            data = await loop.run_in_executor(pool, self.outlet.encode, px)
            await clock.sleep(max(0.0, DELAY_S - seconds_between(image.exposed_at, clock.now())))
            if self.outlet.timed:
                self.stamps.exposed[number] = image.exposed_at
            at_s = seconds_between(began, image.exposed_at) + 1.0
            await loop.run_in_executor(pool, self.outlet.send, number, data, px, at_s)


async def read(device: str, stamps: Stamps) -> None:
    """Compare the stamps of a second reader with the truth."""
    clock = SystemClock()
    options = CameraOptions(source="stream", device=device, latency_s=DELAY_S, latency_sigma_s=0.005)
    async with open_camera(options, (640, 360), clock) as camera:
        async for frame in camera.frames:
            exposed = stamps.exposed.get(number_of(frame.px))
            if exposed is not None:
                stamps.errors.append(1e-9 * (frame.stamp.measured_at - exposed))
                stamps.sigmas.append(frame.stamp.sigma_s)


async def fly(kind: str, seed: int) -> str:
    """Fly once and return the row."""
    clock, stamps = SystemClock(), Stamps()
    with tempfile.TemporaryDirectory(prefix="decklander-streams-") as name, ExitStack() as stack:
        folder = Path(name)
        world = World(load("demo"), seed, start=clock.now())
        drone = FilmedByStream(world, HOST, Ports(0, 0, 0, 0), clock, truth_path=folder / "truth")
        drone.kind, drone.stamps, drone.outlet = kind, stamps, Outlet(kind, folder, stack, stamps.leaves)
        async with drone:
            ports = drone.ports
            keys = "\n".join(f"{name}_port = {getattr(ports, name)}" for name in ("navdata", "video", "at", "control"))
            rig = folder / "rig.toml"
            rig.write_text(
                f'[vehicle]\nkind = "ardrone"\nhost = "{HOST}"\n[expert.vehicle]\n{keys}\n[pad]\nfile = "thesis"\n'
                f'[camera]\nfile = "sim"\nsource = "stream"\ndevice = "{drone.outlet.devices[0]}"\nlatency_s = {DELAY_S}\n'
                '[vision]\ncolours = "simulator"\n[guidance]\nstart = "automatic"\n'
            )
            log = (folder / "log").open("w+")
            service = stack.enter_context(
                started(decklander("run", "--config", str(rig)), stdout=log, stderr=subprocess.STDOUT, lasting_s=LASTING_S + 30)
            )
            reader = asyncio.create_task(read(drone.outlet.devices[1], stamps))
            with suppress(TimeoutError):
                await until(lambda: world.truth().touchdown is not None or service.poll() is not None, "a landing", LASTING_S)
            await asyncio.sleep(2.0)
            reader.cancel()
            with suppress(asyncio.CancelledError, DecklanderError):
                await reader
            if service.poll() is not None:
                print((folder / "log").read_text())
        touched = read_truth(folder / "truth")[-1]["contacts"]
        errors, sigmas = np.array(stamps.errors[20:]), np.array(stamps.sigmas[20:])
        if not len(errors):
            print((folder / "log").read_text()[-1500:])
            return f"{kind:18s} {seed:5d} no frames"
        within = float((np.abs(errors) < 3.0 * sigmas).mean())
        landed = "lands" if touched and all(contact["on_pad"] for contact in touched) else "DOES NOT LAND"
        where = f" {100 * touched[-1]['lateral_m']:.1f} cm" if touched else ""
        most_ms = 1e3 * np.quantile(np.abs(errors), 0.997)
        return (
            f"{kind:18s} {seed:5d} {landed}{where}, {len(errors)} frames, {100 * within:.1f} % within 3 sigma, sigma "
            f"{1e3 * np.median(sigmas):.1f} ms, error {1e3 * np.median(errors):+.1f} ms, p99.7 {most_ms:.1f} ms"
        )


def main() -> int:
    """Fly and print; return 0 if every flight landed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS))
    parser.add_argument("--flights", type=int, default=1)
    parser.add_argument("--first", type=int, default=1)
    args = parser.parse_args()
    rows = []
    for kind in args.kinds:
        for seed in range(args.first, args.first + args.flights):
            rows.append(asyncio.run(fly(kind, seed)))
            print(rows[-1], flush=True)
    landed = sum(" lands" in row for row in rows)
    print(f"{landed} of {len(rows)} land; load {os.getloadavg()[0]:.1f}")
    return 0 if landed == len(rows) else 1


if __name__ == "__main__":
    sys.exit(main())
