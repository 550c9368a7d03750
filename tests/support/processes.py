"""Programs that a test starts, in a group of their own that is gone when the test is; and a process without file descriptors."""

import os
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tests.support.waiting import PATIENCE_S, wait_until

ROOT = Path(__file__).parents[2]


def ran(*words: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a program to its end, with this checkout on Python's path."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    return subprocess.run(words, cwd=cwd, env=environment, capture_output=True, text=True, timeout=240, check=False)


@contextmanager
def started(words: Sequence[str], *, lasting_s: float = PATIENCE_S + 30.0, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """Yield a program with its standard output as lines of text. Its whole group is killed at the end.

    Args:
        lasting_s: after this it is killed in any case, so that reading from it cannot take for ever.
    """
    options = {"cwd": ROOT, "stdout": subprocess.PIPE, "text": True, **options}
    process = subprocess.Popen(words, start_new_session=True, **options)
    watchdog = threading.Timer(lasting_s, kill_group, (process.pid,))
    watchdog.daemon = True
    watchdog.start()
    try:
        with process:
            try:
                yield process
            finally:
                kill_group(process.pid)
    finally:
        watchdog.cancel()


def kill_group(group: int) -> None:
    """Kill the program and what it left behind."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(group, signal.SIGKILL)


@contextmanager
def python(source: str, *words: str, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """Yield a program of a few lines."""
    with started([sys.executable, "-c", source, *words], **options) as process:
        yield process


def decklander(*words: str) -> list[str]:
    """Return the command line of our own program."""
    return [sys.executable, "-m", "companion.cli.main", *words]


@contextmanager
def burners(n: int) -> Iterator[None]:
    """Run a number of programs that only take CPU time, for a machine under load."""
    burning = [subprocess.Popen([sys.executable, "-c", "while 1: pass"]) for _ in range(n)]
    try:
        yield
    finally:
        for process in burning:
            process.kill()
            process.wait()


def alive(number: int) -> bool:
    """Return whether a process runs. A zombie that its adoptive parent has not collected yet is as good as gone."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def gone(number: int) -> bool:
    """Return whether a process is gone before long."""
    with suppress(TimeoutError):
        wait_until(lambda: not alive(number))
    return not alive(number)


@contextmanager
def no_descriptors(spare: int = 0) -> Iterator[None]:
    """Let opening fail with EMFILE once `spare` more descriptors are taken."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    highest = max(int(name) for name in os.listdir("/proc/self/fd"))
    resource.setrlimit(resource.RLIMIT_NOFILE, (highest + 1, hard))
    held: list[int] = []
    try:
        try:
            while True:
                held.append(os.open("/dev/null", os.O_RDONLY))
        except OSError:
            pass
        for descriptor in held[:spare]:
            os.close(descriptor)
        held = held[spare:]
        yield
    finally:
        for descriptor in held:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
