"""The whole service as a process beside an autopilot, killed in flight: a video as camera, a station's orders, a recording."""

import asyncio
import os
import sys
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import av
import numpy as np
import pytest

from companion.facts.records import LinkRecord
from companion.recording.reading import open_recording
from drivers.mavlink.dialect import mav
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.support.waiting import free_port, until

US = 191
RIG = """
[vehicle]
kind = "mavlink"
links = "udpin://127.0.0.1:{port}"
[camera]
file = "sim"
source = "stream"
device = "{video}"
[pad]
file = "thesis"
[recorder]
folder = "{folder}"
min_free_mb = 0.0
[expert.recorder]
flush_s = 0.2
"""


def grey_video(path: Path) -> None:
    """Make the video of a camera that sees nothing: half a minute of grey."""
    with av.open(str(path), "w") as out:
        stream = out.add_stream("mpeg4", rate=10)
        stream.width, stream.height = 640, 360
        frame = av.VideoFrame.from_ndarray(np.full((360, 640, 3), 120, np.uint8), format="bgr24")
        for _ in range(300):
            out.mux(stream.encode(frame))
        out.mux(stream.encode())


@asynccontextmanager
async def run_until_killed(rig: Path, kept: Path) -> AsyncIterator[None]:
    """Run the service, and kill it as a fault does."""
    words = (sys.executable, "-m", "companion.cli.main", "run", "--config", str(rig))
    with kept.with_suffix(".stderr").open("ab") as errors:
        service = await asyncio.create_subprocess_exec(*words, stderr=errors, env={**os.environ, "STATE_DIRECTORY": str(kept)})
    try:
        yield
    finally:
        service.kill()
        await service.wait()


@pytest.mark.hazard("H6")
async def test_killed_in_flight_it_goes_on_unless_a_pilot_changed_the_mode_meanwhile(tmp_path: Path) -> None:
    port = free_port()
    rig, kept = tmp_path / "rig.toml", tmp_path / "kept"
    kept.mkdir()
    grey_video(tmp_path / "grey.mp4")
    rig.write_text(RIG.format(port=port, video=tmp_path / "grey.mp4", folder=kept))
    craft = MiniatureAutopilot()

    async def taken() -> None:
        craft.setpoints.clear()
        await until(lambda: craft.mode == "guided" and bool(craft.setpoints))
        await asyncio.sleep(1.5)  # a HEARTBEAT of ours comes each second, and is written within a third of one

    async with craft.talking_to(f"udpout://127.0.0.1:{port}"):
        async with run_until_killed(rig, kept):
            await until(lambda: bool(ours(craft, "HEARTBEAT")))
            assert not craft.setpoints, "nobody has ordered it to fly"
            assert await told(craft, mav.MAV_CMD_LOGGING_START) == mav.MAV_RESULT_ACCEPTED
            # The pad is not in sight: it is ordered to begin, hovers in its own mode and does not descend
            assert await told(craft, mav.MAV_CMD_DO_PAUSE_CONTINUE, 1.0) == mav.MAV_RESULT_ACCEPTED
            await taken()
            assert all(m.vz <= 0.0 for _, m in craft.setpoints)
        async with run_until_killed(rig, kept):
            await taken()  # nobody orders it
        craft.set_mode("loiter")
        craft.messages.clear()
        craft.setpoints.clear()
        async with run_until_killed(rig, kept):
            await until(lambda: bool(ours(craft, "HEARTBEAT")))
            await asyncio.sleep(2.0)
            assert not craft.setpoints
            assert craft.mode == "loiter"
            assert await told(craft, mav.MAV_CMD_DO_PAUSE_CONTINUE, 1.0) == mav.MAV_RESULT_ACCEPTED
            await taken()
    events = open_recording(sorted(kept.glob("*.mcap"))).events()
    crossed = Counter((event.direction, event.name) for event in events if isinstance(event, LinkRecord))
    assert crossed["in", "ATTITUDE_QUATERNION"] > 10
    assert crossed["out", "HEARTBEAT"] >= 1


def ours(craft: MiniatureAutopilot, kind: str) -> list[mav.MAVLink_message]:
    return [m for m in craft.of(kind) if m.get_srcComponent() == US]


async def told(craft: MiniatureAutopilot, command: int, param1: float = 0.0) -> int:
    """Return the answer to a command."""
    before = len(craft.of("COMMAND_ACK"))
    craft.send(mav.MAVLink_command_long_message(7, US, command, 0, param1, 0, 0, 0, 0, 0, 0))
    await until(lambda: any(m.command == command for m in craft.of("COMMAND_ACK")[before:]))
    return next(int(m.result) for m in craft.of("COMMAND_ACK")[before:] if m.command == command)
