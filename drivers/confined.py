"""Bound the time and memory of a process that reads files that others made: a child for one file, or this whole process."""

import os
import resource
import sys
from collections.abc import Callable, Mapping

from estimator.contracts.errors import BadInput

CHILD_S = 60.0
"""Time of a child process: tens of times what the largest honest drawing or board took."""
CHILD_BYTES = 1 << 30
"""Memory of a child process, likewise."""
_FREE = 0.25
"""Part of the machine's memory that a process that reads files of others leaves to all else."""
_REFUSED = 3  # exit code of a child that refuses its bytes
_MADE_MOST = 128 << 20  # the most that a child gives back, bytes


def in_child(module: str, task: str, data: bytes, where: str, *, most_s: float = CHILD_S, most_bytes: int = CHILD_BYTES) -> bytes:
    """Return what a module of ours prints when it is run with a task and given these bytes, in a process of its own.

    The module calls `confined_task`, which has its half of the agreement.

    Args:
        where: the file that the bytes are of, for errors.
        most_s: time for all of it.
        most_bytes: memory.

    Raises:
        BadInput: it takes more time or memory, its library ended it, or it refused the bytes; the text says which.
    """
    import subprocess  # few files need a child

    words = [sys.executable, "-P", "-m", module, task, str(round(most_s) + 1), str(most_bytes)]
    try:
        done = subprocess.run(words, input=data, capture_output=True, timeout=most_s, check=False)
    except subprocess.TimeoutExpired as why:
        raise BadInput(f"{where}: not read within {most_s:g} s: it is made to take long, or far too intricate") from why
    if done.returncode == _REFUSED:
        raise BadInput(f"{where}: {done.stderr.decode(errors='replace').strip()}")
    if done.returncode:
        raise BadInput(f"{where}: reading it takes more than {most_bytes >> 20} MiB of memory, or ends the library that reads it")
    return done.stdout


def confined_task(tasks: Mapping[str, Callable[[bytes], bytes]]) -> int:
    """Run the task that `in_child` asks this process for, within its bounds; return the exit code."""
    task, most_s, most_bytes = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_CPU, (int(most_s), int(most_s)))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_DATA, (int(most_bytes), int(most_bytes)))
    try:
        if len(made := tasks[task](sys.stdin.buffer.read())) > _MADE_MOST:
            raise BadInput(f"it unpacks to {len(made)} bytes")
        sys.stdout.buffer.write(made)
    except BadInput as why:
        sys.stderr.write(str(why))
        return _REFUSED
    return 0


def confine() -> None:
    """Bound the memory of this process, so that a file that takes all of it ends this process and not another.

    What is mapped from files does not count, so recordings of any size are read.
    """
    most = round((1.0 - _FREE) * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    resource.setrlimit(resource.RLIMIT_DATA, (most, resource.getrlimit(resource.RLIMIT_DATA)[1]))
