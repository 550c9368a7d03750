"""Measure what the service takes of a core, by thread: python -m benches.cost [PROFILE ...].

The service is `decklander run` in a process of its own. Around it, in other processes: an AR.Drone that sends 200 navdata and 30
H.264 frames a second and is landed; or autopilots in miniature that stand still above the pad, over one link or four, beside a
V4L2 camera of 30 or 60 frames a second whose buffers come through a pipe. `+` after a profile's name adds page, recorder, MQTT: a
browser watches with pictures, and a broker listens. Printed are percentages of one core by thread, wake-ups (voluntary context
switches) and page faults a second. `--tree FOLDER` runs the service of another checkout.

`python -m benches.latency` times frames likewise, from arrival to the bytes of the LANDING_TARGET: the pad tracked, and searched
for in each frame; `--scenario night` shows one by its lamps. A floor is one BGR to HSV conversion and one inRange of a frame.
"""

import argparse
import asyncio
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from itertools import count, product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np

from benches.options import alive, described, failed, parsed, program

HOST, TOKEN = "127.0.0.1", "0123456789abcdef" * 4
PROFILES = {"ardrone": (0, 30.0), "autopilot": (1, 30.0), "links4": (4, 30.0), "v4l2_60": (1, 60.0)}
"""The number of MAVLink links, 0 for an AR.Drone, and the frames a second."""
LIMITS = {"tracked": (9.0, 18.0), "searched": (22.0, 36.0)}
"""Limits of p50 and p99 from frame in to bytes out, floors."""
CHANNELS = ("navdata", "video", "at", "control")
BEGIN, END = signal.SIGRTMIN, signal.SIGRTMIN + 1


def serve(rig: str, how: str) -> None:
    """Run the service here: threads carry their names, a pipe is a camera, calls and times are noted between two signals."""
    from companion.cli.main import main
    from companion.guidance.pilot import Pilot
    from companion.parts.mavlink.component import Component
    from drivers.camera import v4l2
    from drivers.camera.v4l2_device import Buffer
    from drivers.camera.v4l2_frames import FrameLayout

    begin_thread, on_frame = threading.Thread._bootstrap_inner, Component.on_frame  # type: ignore[attr-defined]
    ms = list[float]()

    def named(thread: threading.Thread) -> None:
        Path(f"/proc/self/task/{threading.get_native_id()}/comm").write_text(thread.name[:15])
        begin_thread(thread)

    class Pipe:
        """A camera whose frames a pipe announces, a byte each."""

        driven, rate_hz = None, 30.0

        def __init__(self, path: str, options: Any, size: tuple[int, int]) -> None:
            self._fd, self._n = os.open(path, os.O_RDONLY | os.O_NONBLOCK), 0
            data, each = Path(path).with_suffix(".yuyv").read_bytes(), 2 * size[0] * size[1]
            self._images = [bytearray(data[at : at + each]) for at in range(0, len(data), each)]
            self.layout, self.exposure_s, self._row = FrameLayout("YUYV", *size, 2 * size[0]), options.exposure_s, 16 * size[0]
            self.fileno, self.close = lambda: self._fd, lambda: os.close(self._fd)

        def dequeue(self) -> Buffer | None:
            try:
                os.read(self._fd, 1)
            except BlockingIOError:
                return None
            self._n += 1
            data = self._images[self._n % len(self._images)]
            data[self._row + 2 * (self._n % 640)] ^= 1  # no frame of a camera is that of another exposure
            return Buffer(bytes(data), self._n, time.monotonic_ns(), True, False, False)

    def timed(component: Any, processed: Any) -> None:
        counters = component._links.all[0].counters
        sent = counters.bytes_out
        on_frame(component, processed)
        if counters.bytes_out > sent:
            ms.append(1e-6 * (time.monotonic_ns() - processed.frame.stamp.received_at))

    def note(*_: Any) -> None:
        Path(f"{rig}.ms").write_text(json.dumps(ms))

    threading.Thread._bootstrap_inner = named  # type: ignore[attr-defined]
    v4l2.V4l2Channel.__init__.__defaults__ = (Pipe,)
    Component.on_frame = timed  # type: ignore[assignment, method-assign]
    if how == "searched":
        Pilot.look_at = lambda self, frame, attitude, held=None: self.search.anywhere(frame, attitude)  # type: ignore[method-assign]
    signal.signal(BEGIN, lambda *_: ms.clear())
    signal.signal(END, note)
    sys.exit(main(["run", "--config", rig]))


def rig_of(profile: str, all_on: bool, scenario: str, folder: Path, ports: list[int]) -> str:
    """Return the settings of a profile."""
    from sitl.scenario.scenario import load

    links, rate_hz = PROFILES[profile]
    start = "signal" if links else "automatic"  # an autopilot that was lifted off by hand is left to its pilot
    rig = f'[pad]\nfile = "{load(scenario).pad.file}"\n[vision]\ncolours = "simulator"\n[guidance]\nstart = "{start}"\n'
    if links:
        urls = ", ".join(f"udpin://{HOST}:{port}" for port in ports[:links])
        rig += f'[vehicle]\nkind = "mavlink"\nlinks = "{urls}"\n[camera]\nfile = "sim"\nsource = "v4l2"\n'
        rig += f'device = "{folder}/camera"\nrate_hz = {rate_hz}\nexposure_s = 0.005\n'
    else:
        numbers = "".join(f"{name}_port = {port}\n" for name, port in zip(CHANNELS, ports[:4], strict=True))
        rig += f'[camera]\nfile = "sim"\n[vehicle]\nkind = "ardrone"\nhost = "{HOST}"\n[expert.vehicle]\n{numbers}'
    if all_on:
        (folder / "token").write_text(TOKEN)
        (folder / "token").chmod(0o600)
        rig += f'[http]\nendpoint = "http"\nport = {ports[-2]}\ntoken_file = "{folder}/token"\n'
        rig += f'[recorder]\nenabled = true\nfolder = "{folder}/recordings"\nmin_free_mb = 1.0\n'
        rig += f'[mqtt]\ntransport = "tcp"\nhost = "{HOST}"\nport = {ports[-1]}\n'
    return rig


@asynccontextmanager
async def autopilots(profile: str, scenario: str, folder: Path, ports: list[int]) -> AsyncIterator[float]:
    """Send an autopilot's messages over each link, and a camera's frames; yield the time of a floor, ms."""
    from benches.search import floor_ms
    from drivers.mavlink.vehicle import Stack
    from sitl.emulators.autopilots.body import Body
    from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
    from sitl.scenario.scenario import load

    links, rate_hz = PROFILES[profile]
    body = Body(load(scenario), 1, 0.005)
    images, state = [body.expose()().px for _ in range(4)], body.state()
    (folder / "camera.yuyv").write_bytes(np.array([cv2.cvtColor(px, cv2.COLOR_BGR2YUV_YUY2) for px in images]).tobytes())
    os.mkfifo(folder / "camera")
    pipe, (x, y, z) = os.open(folder / "camera", os.O_RDWR | os.O_NONBLOCK), state.f_body

    async def film() -> None:
        began = time.monotonic()
        for n in count(1):
            await asyncio.sleep(max(0.0, began + n / rate_hz - time.monotonic()))
            os.write(pipe, b".")

    async with AsyncExitStack() as stack:
        for port in ports[:links]:
            one = MiniatureAutopilot(Stack.ARDUPILOT, p_ned=state.p_ned, gyro_mrad_s=(0, 0, 0), f_body=(x, y, z))
            one.rpy = lambda t: state.R_ned_body.rpy_rad
            one._on_set_position_target_local_ned = lambda m, received: None  # type: ignore[method-assign]
            await stack.enter_async_context(one.talking_to(f"udpout://{HOST}:{port}"))
        filming = asyncio.create_task(film())
        yield min(floor_ms(images[0]) for _ in range(40))
        filming.cancel()


async def watch(address: str) -> None:
    """Watch the page with its pictures."""
    from tests.support.page_service import browsing

    async with browsing(SimpleNamespace(address=address), TOKEN) as browser:  # type: ignore[arg-type]
        while True:
            await browser.send(kind="drawn", number=(await browser.read("picture"))["number"])


def used(session: int) -> dict[str, Counter[str]]:
    """Return ns of processor time by thread of the service and its children, their wake-ups and page faults."""
    found: dict[str, Counter[str]] = {"ns": Counter(), "wakes": Counter(), "faults": Counter()}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(FileNotFoundError, ProcessLookupError):
            fields = (folder / "stat").read_text().rsplit(")", 1)[1].split()
            if session not in (int(fields[1]), int(fields[3])):
                continue
            found["faults"]["all"] += int(fields[7])
            for task in (folder / "task").iterdir():
                named = "loop" if task.name == str(session) else (task / "comm").read_text().strip().partition("_")[0]
                name = named if int(folder.name) == session else "sender"
                found["ns"][name] += int((task / "schedstat").read_text().split()[0])
                found["wakes"][name] += int((task / "status").read_text().split("\nvoluntary_ctxt_switches:")[1].split()[0])
    return found


async def measure(name: str, how: str, args: argparse.Namespace) -> None:
    """Fly one profile and print its cost, or its times if `how` is a key of `LIMITS`."""
    from tests.support.processes import started
    from tests.support.waiting import free_port

    profile, all_on, floor = name.rstrip("+"), name.endswith("+"), 1.0
    with tempfile.TemporaryDirectory(prefix="cost-") as made:
        folder, ports = Path(made), [free_port() for _ in range(6)]
        (folder / "rig.toml").write_text(rig_of(profile, all_on, args.scenario, folder, ports))
        words = [sys.executable, "-P", __file__, "--serve", f"{folder}/rig.toml", how]
        async with AsyncExitStack() as stack:
            if profile == "ardrone":
                drone = [sys.executable, "-m", "sitl.emulators.ardrone.serve", "sea_state_4", "--seed", "1"]
                drone += [f"--{channel}-port={port}" for channel, port in zip(CHANNELS, ports[:4], strict=True)]
                shown = stack.enter_context(started(drone))
                await asyncio.to_thread(shown.stdout.readline)  # type: ignore[union-attr]
            else:
                floor = await stack.enter_async_context(autopilots(profile, args.scenario, folder, ports))
            if all_on:
                (folder / "broker").write_text(f"listener {ports[-1]} {HOST}\nallow_anonymous true\n")
                broker = [program("mosquitto", "mosquitto"), "-c", str(folder / "broker")]
                stack.enter_context(started(broker, stderr=subprocess.DEVNULL))
            there = {"cwd": args.tree, "env": {**os.environ, "PYTHONPATH": str(args.tree)}}
            said = stack.enter_context((folder / "said").open("w"))
            service = stack.enter_context(started(words, stderr=said, **there))
            await asyncio.sleep(args.warm)
            alive(service, "the service", folder / "said")
            watching = asyncio.create_task(watch(f"http://{HOST}:{ports[-2]}") if all_on else asyncio.sleep(0.0))
            service.send_signal(BEGIN)
            before, began = used(service.pid), time.monotonic()
            await asyncio.sleep(args.seconds)
            after, took_s = used(service.pid), time.monotonic() - began
            alive(service, "the service", folder / "said")
            service.send_signal(END)
            await asyncio.sleep(1.0)
            watching.cancel()
        share = {n: 1e-7 * (after["ns"][n] - before["ns"][n]) / took_s for n in after["ns"]}
        if how:
            if not (ms := json.loads((folder / "rig.toml.ms").read_text())):
                failed(f"no frame led to a LANDING_TARGET; the service's words: {(folder / 'said').read_text()[-2000:]}")
            p50, p99 = np.quantile(ms, [0.5, 0.99])
            (a, b), rate_hz = LIMITS[how], PROFILES[profile][1]
            held = "held" if p50 <= a * floor and p99 <= b * floor else "not held"
            print(f"{rate_hz:2.0f} fps {how}: p50 {p50:.2f} ms, p99 {p99:.2f}, most {max(ms):.2f} of {len(ms)} frames; ", end="")
            print(f"{p50 / floor:.1f} and {p99 / floor:.1f} floors of {floor:.2f} ms (limit {a:g} and {b:g} {held}); ", end="")
            print(f"vision {10.0 * share['vision'] / rate_hz:.2f} ms a frame, loop {share['loop']:.1f} %", flush=True)
            return
        wakes, faults = ((after[k].total() - before[k].total()) / took_s for k in ("wakes", "faults"))
        threads = ", ".join(f"{n} {x:.1f}" for n, x in sorted(share.items(), key=lambda i: -i[1]) if x >= 0.05)
        each_s = f"{wakes:.0f} wake-ups, {faults:.0f} faults a second"
        print(f"{name:<11} {sum(share.values()):5.1f} %: {threads}; {each_s}", flush=True)


def main(latency: bool = False) -> None:
    parser = described(__doc__)
    every = ["autopilot", "v4l2_60"] if latency else [*PROFILES, *(f"{name}+" for name in PROFILES)]
    parser.add_argument("profiles", nargs="*", default=every)
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--warm", type=float, default=5.0, help="seconds before it is measured")
    parser.add_argument("--scenario", default="calm", help="whose frames the camera shows")
    parser.add_argument("--tree", type=Path, default=Path(__file__).parents[1], help="the checkout whose service runs")
    parser.add_argument("--serve", nargs=2, default=("", ""), help=argparse.SUPPRESS)
    args = parsed(parser, "--seconds 1 --warm 4 autopilot" if latency else "--seconds 1 --warm 4 autopilot+")
    if args.serve[0]:
        serve(*args.serve)
    for how, name in product(LIMITS if latency else ("",), args.profiles):
        asyncio.run(measure(name, how, args))


if __name__ == "__main__":
    main()
