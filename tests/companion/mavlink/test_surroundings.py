"""The surroundings of the real service do not stop its flight: its log's reader, its terminal, signals, a standstill."""

import asyncio
import fcntl
import os
import pty
import signal
import sys
import time
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from companion.facts.records import LinkRecord
from companion.recording.reading import open_recording
from drivers.mavlink.dialect import mav
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.support.image_files import film
from tests.support.processes import ROOT, decklander, started
from tests.support.waiting import free_port, until, wait_until

_SLOW_S = 0.7
"""The longest gap between commands, of 0.04 s each, that a busy machine alone may make, s."""


def longest_gap_s(craft: MiniatureAutopilot, since: float) -> float:
    """Return the longest time without a command since an instant of the craft's clock, up to now."""
    times = [since, *(at for at, _ in craft.setpoints if at > since), craft.now_s]
    return max(b - a for a, b in pairwise(times))


def drained(reading: int) -> str:
    """Return the bytes that wait in a pipe or terminal."""
    output = b""
    with suppress(BlockingIOError, OSError):
        while data := os.read(reading, 65536):
            output += data
    return output.decode(errors="replace")


async def test_it_flies_on_whatever_becomes_of_its_log_its_terminal_and_its_signals(tmp_path: Path) -> None:
    port, video, rig = free_port(), tmp_path / "grey.mp4", tmp_path / "rig.toml"
    film(video, GREY, "mpeg4", 10)
    rig.write_text(RIG.format(port=port, video=video, folder=tmp_path / "kept"))
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)
    os.set_blocking(reading, False)
    craft = MiniatureAutopilot()
    with started(decklander("run", "--config", str(rig)), stdout=writing, stderr=writing) as service:
        os.close(writing)
        async with craft.talking_to(f"udpout://127.0.0.1:{port}"):
            await until(lambda: bool(craft.of("HEARTBEAT")))
            assert await told(craft, mav.MAV_CMD_DO_PAUSE_CONTINUE, 1.0) == mav.MAV_RESULT_ACCEPTED
            await until(lambda: len(craft.setpoints) > 10)
            output = drained(reading)
            assert "search" in output

            # Nobody reads its log, which would fill the pipe in these lines
            began = craft.now_s
            for n in range(50):
                assert await told(craft, mav.MAV_CMD_DO_PAUSE_CONTINUE, float(n % 2)) == mav.MAV_RESULT_ACCEPTED
            for number in (signal.SIGHUP, signal.SIGTSTP, signal.SIGPIPE, signal.SIGTTOU):
                service.send_signal(number)
                await asyncio.sleep(0.2)
            await until(lambda: craft.now_s > began + 2.0)
            assert longest_gap_s(craft, began) < _SLOW_S
            assert await told(craft, mav.MAV_CMD_DO_PAUSE_CONTINUE, 1.0) == mav.MAV_RESULT_ACCEPTED

            # It stands still, and does not go on as if nothing had been
            service.send_signal(signal.SIGSTOP)
            await asyncio.sleep(2.4)
            service.send_signal(signal.SIGCONT)
            lines = [output]

            def heard(words: str) -> bool:
                lines.append(drained(reading))
                return words in "".join(lines)

            await until(lambda: heard("the drone is commanded to hold"))
            await until(lambda: heard("stood still): hold: accepted"))
            for words in ("the terminal hung up (SIGHUP)", "Ctrl-Z (SIGTSTP) is not followed"):
                assert heard(words), "".join(lines)

            service.send_signal(signal.SIGQUIT)
            await until(lambda: service.poll() is not None)
            assert service.returncode == 0
            heard("")
            assert "thread MainThread:" in "".join(lines), "where it was is told before it ends"
    os.close(reading)


def test_a_terminal_that_hangs_up_does_not_end_it_and_sigterm_does(tmp_path: Path) -> None:
    port, video, rig = free_port(), tmp_path / "grey.mp4", tmp_path / "rig.toml"
    film(video, GREY, "mpeg4", 10)
    rig.write_text(RIG.format(port=port, video=video, folder=tmp_path / "kept"))
    number, terminal = pty.fork()
    if number == 0:
        os.chdir(ROOT)
        os.execv(sys.executable, decklander("run", "--config", str(rig)))
    os.set_blocking(terminal, False)
    output: list[str] = []

    def heard(words: str) -> bool:
        output.append(drained(terminal))
        return words in "".join(output)

    try:
        wait_until(lambda: heard("waiting for"))
        assert heard("started from a terminal"), output
        os.close(terminal)
        time.sleep(0.5)
        assert os.waitpid(number, os.WNOHANG) == (0, 0), "it went on"
        os.kill(number, signal.SIGTERM)
        assert os.waitstatus_to_exitcode(os.waitpid(number, 0)[1]) == 0
        number = 0
    finally:
        if number:
            os.kill(number, signal.SIGKILL)
            os.waitpid(number, 0)


US = 191
GREY = 300 * [np.full((360, 640, 3), 120, np.uint8)]
"""Half a minute of a camera that sees nothing."""
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
    film(tmp_path / "grey.mp4", GREY, "mpeg4", 10)
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
