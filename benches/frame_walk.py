"""Trace one frame through the service: `python -m benches.frame_walk [--vision]`.

The service runs as it does beside an autopilot: its camera is a video file, its autopilot a stand-in on a loopback socket. One
frame that ends as a LANDING_TARGET on the socket is followed, and the functions of ours that it passes through are printed in the
order of their calls: those that receive the frame, or what was made of it, and their callers. Hand-ons, whose body is one call
whose result they return, are marked. At the end the rooms (modules) and hand-ons outside `estimator.vision` are counted.
"""

import argparse
import ast
import asyncio
import sys
import tempfile
import threading
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import CodeType, FrameType

import av
import numpy as np

import companion.settings.load as settings_of
from companion.base.observer import ProcessedFrame
from companion.guidance.make_pilot import make_pilot
from companion.service.assemble import make_daemon
from drivers.mavlink.dialect import mav
from drivers.mavlink.vehicle import Stack
from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.fusion import FusionResult
from estimator.contracts.samples import Frame
from estimator.vision.detection import Detection
from sitl.emulators.autopilots.body import Body
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from sitl.scenario.scenario import load
from tests.support.waiting import free_port, until

HOST = "127.0.0.1"
ROOT = Path(__file__).parents[1]
PACKAGES = ("companion", "drivers", "estimator")
CARRIED = (Frame, Sighting, Detection, ProcessedFrame, RelativeState, FusionResult, av.VideoFrame, av.Packet)
"""Types of the frame, and of its results on the way to the message."""
FRAMES = 150
VISION = "estimator.vision"
_CAMERA = {"_Reader.next", "StreamChannel._play"}
_SERVICE = {"Daemon._read_frames", "Worker._work"}
"""Functions that a frame's own calls have above them: samples and messages of the same types come by other ways."""


@dataclass(frozen=True, slots=True)
class Step:
    """A function that a frame passes through."""

    thread: str
    depth: int
    """Number of functions of ours above it in its thread."""
    module: str
    function: str
    hands_on: bool


class Tracer:
    """A trace function for every thread that records the functions which carry a frame, frame by frame."""

    def __init__(self) -> None:
        self.on = False
        self._camera: list[Step] = []
        """Steps of the frame that the camera reads now."""
        self._read: dict[int, list[Step]] = {}
        """Steps of frames that wait for the service, by sequence number."""
        self._walks: list[list[Step]] = []
        self._own: dict[int, bool] = {}
        self._known: set[int] = set()
        """Calls that are recorded, so that a caller is recorded once."""
        self._kept: list[FrameType] = []
        """Keeps the calls, so that none takes the identity of another."""
        self._lock = threading.Lock()

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        code = frame.f_code
        if not self.on or not self._ours(code):
            return
        values = [frame.f_locals.get(name) for name in code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]]
        reading = code.co_qualname == "_Reader.next"
        if not (reading or any(isinstance(v, CARRIED) or _landing_target(v) for v in values)):
            return
        chain: list[FrameType] = []
        at: FrameType | None = frame
        while at is not None:
            if self._ours(at.f_code):
                chain.insert(0, at)
            at = at.f_back
        names = [one.f_code.co_qualname for one in chain]
        seq = next((v.seq for v in values if isinstance(v, Frame)), None)
        with self._lock:
            if reading:
                self._camera = []
            if _CAMERA & set(names):
                self._record(chain, self._camera)
                if seq is not None:
                    self._read[seq] = self._camera
            elif _SERVICE & set(names):
                if names[-1] == "Daemon._process" and seq is not None and id(frame) not in self._known:
                    self._walks.append(self._read.pop(seq, []))
                if self._walks:
                    self._record(chain, self._walks[-1])

    def _ours(self, code: CodeType) -> bool:
        known = self._own.get(id(code))  # the hash of a code object is slow
        if known is None:
            known = self._own[id(code)] = bool(_module(code)) and not code.co_name.startswith("<")
        return known

    def _record(self, chain: list[FrameType], walk: list[Step]) -> None:
        for depth, one in enumerate(chain):
            if id(one) not in self._known:
                self._known.add(id(one))
                self._kept.append(one)
                name = one.f_code.co_qualname.replace(".<locals>", "")
                step = Step(threading.current_thread().name, depth, _module(one.f_code), name, _hands_on(one.f_code))
                walk.append(step)

    def newest(self) -> list[Step] | None:
        """Return the newest walk that is over and went from the camera to the link; None before the first."""
        for walk in reversed(self._walks[:-1]):
            sent = any(step.module == "drivers.mavlink.links" for step in walk)
            if sent and walk[0].module.startswith("drivers.camera"):
                return walk
        return None


def _landing_target(value: object) -> bool:
    if isinstance(value, list):
        return any(_landing_target(one) for one in value)
    return isinstance(value, mav.MAVLink_landing_target_message)


@cache
def _module(code: CodeType) -> str:
    """Return the dotted name of one of our modules, or nothing for anybody else's."""
    try:
        path = Path(code.co_filename).relative_to(ROOT)
    except ValueError:
        return ""
    return ".".join(path.with_suffix("").parts) if path.parts[0] in PACKAGES else ""


@cache
def _hands_on(code: CodeType) -> bool:
    """Return whether the function's body, after its docstring, is one call whose result it returns, awaits or drops."""
    tree = ast.parse(Path(code.co_filename).read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and node.name == code.co_name:
            first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
            if first != code.co_firstlineno:
                continue
            body = node.body[1:] if ast.get_docstring(node) else node.body
            if len(body) != 1 or not isinstance(body[0], (ast.Return, ast.Expr)):
                return False
            value = body[0].value
            return isinstance(value.value if isinstance(value, ast.Await) else value, ast.Call)
    return False


def film(path: Path, body: Body) -> None:
    """Write a video of the pad from one place, `FRAMES` long."""
    px = body.expose()().px
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=15)
        stream.height, stream.width = px.shape[:2]
        stream.bit_rate = 30_000_000
        rng = np.random.default_rng(1)
        for _ in range(FRAMES):
            noise = rng.normal(0.0, 3.0, px.shape)  # the integrity checks refuse frames that repeat
            noisy = np.clip(px + noise, 0, 255).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(noisy, "bgr24")))
        container.mux(stream.encode())


async def traced(folder: Path) -> list[Step]:
    """Run the service over the video and return the walk of the last frame whose LANDING_TARGET left."""
    body = Body(load("calm"), 1, 0.005)
    film(folder / "pad.mp4", body)
    port = free_port()
    settings = settings_of.from_mapping(
        {
            "vehicle": {"kind": "mavlink", "links": f"udpin://{HOST}:{port}"},
            "camera": {"file": "sim", "source": "stream", "device": str(folder / "pad.mp4"), "latency_s": 0.05},
            "pad": {"file": "thesis"},
            "vision": {"colours": "simulator"},
            # The stand-in shares this process, and its readings repeat while the tracer is at work.
            "estimator": {"integrity": {"imu_frozen_s": 10.0, "attitude_frozen_s": 60.0}},
            "guidance": {"start": "signal"},
            "service": {"health_period_s": 0.0},
        },
        "benches.frame_walk",
    )
    state = body.state()
    fake = MiniatureAutopilot(Stack.PX4, mode="auto.loiter", p_ned=state.p_ned, gyro_mrad_s=(0, 0, 0))
    fake.rpy = lambda t: state.R_ned_body.rpy_rad
    daemon = make_daemon(settings, make_pilot(settings))
    tracer = Tracer()
    threading.settrace(tracer)  # reaches threads that begin after it: the camera's and the one for vision
    try:
        async with fake.talking_to(f"udpout://{HOST}:{port}"), asyncio.TaskGroup() as group:
            group.create_task(daemon.run())
            await until(lambda: bool(fake.of("LANDING_TARGET")))
            tracer.on = True
            sys.settrace(tracer)
            await until(lambda: tracer.newest() is not None)
            daemon.stop()
    finally:
        sys.settrace(None)
        threading.settrace(None)
    walk = tracer.newest()
    assert walk is not None
    return walk


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description="Trace one frame from the camera to its LANDING_TARGET.")
    parser.add_argument("--vision", action="store_true", help="print the functions inside estimator.vision too")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        steps = asyncio.run(traced(Path(folder)))
    outside = [step for step in steps if not step.module.startswith(VISION)]
    thread = ""
    for step in steps if chosen.vision else outside:
        if step.thread != thread:
            thread = step.thread
            print(f"{thread}:")
        mark = "  (hands on)" if step.hands_on else ""
        print(f"  {'  ' * step.depth}{step.module}: {step.function}{mark}")
    rooms = {step.module for step in outside}
    hand_ons = {(step.module, step.function) for step in outside if step.hands_on}
    functions = {(step.module, step.function) for step in outside}
    print(f"outside {VISION}: {len(rooms)} rooms, {len(functions)} functions, {len(hand_ons)} of them hand-ons")


if __name__ == "__main__":
    main()
