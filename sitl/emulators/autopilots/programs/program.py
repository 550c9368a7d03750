"""Run an autopilot program as a child process in a folder of its own, on the loopback, and end it in any case."""

import asyncio
import contextlib
import ctypes
import os
import signal
import socket
import sys
import time
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from estimator.contracts.errors import BadInput, Recoverable

GUIDE = "docs/sitl.md"
OUTPUT = "output.txt"
_END_S = 0.5
"""Time in which a program ends that is asked to, before it is killed."""
_HOST = "127.0.0.1"
_PORTS = range(24_000, 32_000)
"""Ports below those that Linux hands out by itself (net.ipv4.ip_local_port_range, from 32768)."""
_PR_SET_PDEATHSIG = 1
"""Option of prctl(2)."""


def parameters_of(name: str) -> dict[str, float]:
    """Return the parameters in a file beside this module: a name and a value a line, as ArduPilot's tools write them."""
    lines = Path(__file__).with_name(name).read_text(encoding="ascii").splitlines()
    pairs = (line.split() for line in lines if not line.startswith("#"))
    return {key: float(value) for key, value in pairs}


class Program:
    """A running program."""

    def __init__(self, process: asyncio.subprocess.Process, folder: Path) -> None:
        self._process = process
        self.folder = folder

    @property
    def last_line(self) -> str:
        """The newest line that the program printed, for people."""
        with contextlib.suppress(OSError):
            lines = [line.strip() for line in (self.folder / OUTPUT).read_text(errors="replace").splitlines()]
            return next((line for line in reversed(lines) if line), "nothing")[:200]
        return "nothing"

    def run_for(self, seconds: float) -> None:
        """Let the program go on for a time, and let it stand still then; the flight, in virtual time, waits for it."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGCONT)
            time.sleep(seconds)
            os.killpg(self._process.pid, signal.SIGSTOP)

    async def ended(self) -> None:
        """Wait until the program ends.

        Raises:
            Recoverable: always, with the last line that the program printed.
        """
        code = await self._process.wait()
        raise Recoverable(f"the autopilot program ended with code {code}; its last line: {self.last_line} (see {GUIDE})")


def executable(path: str) -> Path:
    """Return the path of the program.

    Raises:
        BadInput: the file cannot be executed.
    """
    found = Path(path).expanduser().absolute()
    if not found.is_file() or not os.access(found, os.X_OK):
        raise BadInput(f"--binary: {str(found)!r} is no program that can be run ({GUIDE} says what to point at)")
    return found


@asynccontextmanager
async def running(argv: Sequence[str], folder: Path, environment: Mapping[str, str] | None = None) -> AsyncIterator[Program]:
    """Run the program while the context is open. On Linux it ends with this process, even if this process is killed.

    Args:
        argv: the command line.
        folder: the working directory; the program's output goes to a file in it.
        environment: variables to add to the environment.

    Raises:
        BadInput: the program cannot be run on this machine.
    """
    with (folder / OUTPUT).open("wb") as output:
        try:
            process = await asyncio.create_subprocess_exec(
                *argv,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=output,
                stderr=asyncio.subprocess.STDOUT,
                cwd=folder,
                env={**os.environ, **(environment or {})},
                start_new_session=True,
                preexec_fn=_die_with_parent if sys.platform == "linux" else None,
            )
        except OSError as why:
            raise BadInput(f"--binary: {argv[0]!r} cannot be run: {why.strerror} (see {GUIDE})") from why
    try:
        yield Program(process, folder)
    finally:
        await _end(process)


async def _end(process: asyncio.subprocess.Process) -> None:
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)
            os.killpg(process.pid, signal.SIGCONT)  # one that stands still would not end
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_END_S):
                await process.wait()
    # The program's own children may outlive it.
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    await process.wait()


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


@contextlib.contextmanager
def reserved_port() -> Iterator[int]:
    """Yield a port of the loopback, free for UDP and TCP, that no other caller on this machine gets while the context is open.

    It lies below the ports that the system hands out by itself, which can be another program's by the time that they are used.

    Raises:
        Recoverable: every port is taken.
    """
    offset = os.getpid() * 31 % len(_PORTS)  # processes that start together look at different ports
    for port in (*_PORTS[offset:], *_PORTS[:offset]):
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as reservation:
            try:
                reservation.bind(f"\0decklander-port-{port}")  # a name that ends with the process
                for kind in (socket.SOCK_DGRAM, socket.SOCK_STREAM):
                    with socket.socket(socket.AF_INET, kind) as probe:
                        probe.bind((_HOST, port))
            except OSError:
                continue
            yield port
            return
    raise Recoverable(f"each port from {_PORTS.start} to {_PORTS.stop - 1} of {_HOST} is taken")
