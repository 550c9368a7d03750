"""End the process on SIGTERM, SIGINT or SIGQUIT: they set a flag and cancel the main task, and a deadline enforces the end.

No exception is ever thrown through an event loop. While one runs (`companion.base.event_loop.run`), the first signal cancels
its main task, or calls the handler that was set instead. Tasks that have not ended `ABANDON_S` later are named in the log and
abandoned. Outside a loop the first signal raises `Stopped` at the program's present instruction.

A separate thread watches as well: `LAST_S` after SIGTERM or SIGQUIT, or at a second signal, it ends the process, whatever blocks
the other threads. It reads signals from the interpreter's wakeup descriptor, so it works even while the main thread is inside a
long library call.
"""

import os
import select
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import NoReturn

ABANDON_S = 1.2
"""Time after the signal at which the remaining tasks are abandoned."""
LAST_S = 1.7
"""Time after SIGTERM or SIGQUIT at which the process ends, whatever it is doing. Below 2 s, with room for a busy machine. A
program that flies nothing real may ask for more (`more_time`)."""
LINGER_S = 1.0
"""Time that a program which ends by itself waits for remaining tasks and threads."""
_ECHO_S = 0.1
"""A second signal within this time counts as a copy: shells and launchers pass on what the terminal has already sent."""
_WATCHER = "signals"
_WORDS_S = 0.1
"""Time for writing the last log lines, s: standard error may be a pipe without a reader."""
ENDING = (signal.SIGTERM, signal.SIGINT, signal.SIGQUIT)


class Stopped(BaseException):
    """A signal ended the process. It is not an `Exception`, so that code which continues after errors does not catch it.

    Args:
        number: the number of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number

    @property
    def exit_code(self) -> int:
        """The exit code by the convention of shells: 128 plus the signal's number."""
        return 128 + self.number


def _to_stderr(words: str) -> None:
    if words:
        sys.stderr.write(f"decklander: {words}\n")
    sys.stderr.flush()


class Process:
    """The state of this process's shutdown. There is one instance, `PROCESS`."""

    def __init__(self) -> None:
        self.pid = 0
        """Process id of the process that handles signals; 0 while none does."""
        self.number: int | None = None
        """The first ending signal; None before it comes."""
        self.at_s = 0.0
        """Time of that signal on the monotonic clock, s."""
        self.into_loop: Callable[[int], None] | None = None
        """Passes a signal to the running event loop; None while no loop runs."""
        self.unfinished: Callable[[], str] = str
        """Returns the names of the event loop's remaining tasks; empty if there are none."""
        self.extra_s = 0.0
        """Time by which both deadlines are later, s."""
        self.last_words: Callable[[str], None] = _to_stderr
        """Writes the last words before the process ends; it may block."""

    @property
    def heeding(self) -> bool:
        """True if this process handles signals: in our programs, not in a test or for a user of the library."""
        return self.pid == os.getpid()

    def heed(self, number: int, _: FrameType | None) -> None:
        """Handle a signal; the interpreter calls this on the main thread between two instructions."""
        if not self.heeding:
            os._exit(128 + number)  # this is a forked worker, which has nothing to clean up
        if number in ENDING:
            if self.number is not None:
                return  # the watching thread handles it
            self.number, self.at_s = number, time.monotonic()
        if self.into_loop is not None:
            self.into_loop(number)
        elif number in ENDING:
            raise Stopped(number)

    def left_s(self) -> float:
        """Return the time until tasks are abandoned, s; `LINGER_S` if no signal has come."""
        return LINGER_S if self.number is None else self.at_s + ABANDON_S + self.extra_s - time.monotonic()


PROCESS = Process()


def install() -> None:
    """Let the `ENDING` signals end this process as described above. Call it once, from the main thread."""
    PROCESS.pid = os.getpid()
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:  # a shell sets this for its background jobs
            signal.signal(number, PROCESS.heed)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    os.register_at_fork(before=_hold, after_in_parent=_release, after_in_child=_release_child)
    threading.Thread(target=_watch, args=(reading,), name=_WATCHER, daemon=True).start()


@contextmanager
def more_time(extra_s: float) -> Iterator[None]:
    """Let the process end this much later after a signal, s, so that it can write what would be lost."""
    PROCESS.extra_s = extra_s
    try:
        yield
    finally:
        PROCESS.extra_s = 0.0


def ending_signal() -> int | None:
    """Return the signal that ended this process's work; None before it comes."""
    return PROCESS.number


def check() -> None:
    """Raise `Stopped` if an ending signal has come.

    Raises:
        Stopped: an ending signal has come.
    """
    if PROCESS.number is not None:
        raise Stopped(PROCESS.number)


def leave(code: int) -> int:
    """Return the interpreter's exit code, or end the process here if a thread is left.

    After a signal the process always ends here: Python joins threads at exit, and one inside a library call may take long.
    A daemon thread is not joined but taken down when it requests the interpreter's lock, and inside a C++ library (vision that is
    still being loaded) that aborts the process.
    """
    deadline_s = time.monotonic() + (LINGER_S if PROCESS.number is None else 0.0)
    for thread in _holding():
        thread.join(max(0.0, deadline_s - time.monotonic()))
    left = _holding()
    if left and PROCESS.number is None:
        _end(code, f"threads that did not end: {', '.join(thread.name for thread in left)}; going without")
    if PROCESS.number is not None or any(t.daemon and t.name != _WATCHER for t in threading.enumerate()):
        _end(code, "")
    return code


def _hold() -> None:
    """Block signals during a fork: the child would lose one, and the parent would read it from the shared descriptor."""
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)


def _release() -> None:
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)


def _release_child() -> None:
    signal.set_wakeup_fd(-1)
    _release()


def _watch(descriptor: int) -> None:
    """Watch for signals and enforce the deadline, on a thread that nothing else can block."""
    first: int | None = None
    at_s = 0.0
    while True:
        timeout_s = None if first in (None, signal.SIGINT) else max(0.0, at_s + LAST_S + PROCESS.extra_s - time.monotonic())
        if select.select([descriptor], [], [], timeout_s)[0]:
            for number in os.read(descriptor, 64):
                if number not in ENDING:
                    continue
                if first is None:
                    first, at_s = number, time.monotonic()
                elif time.monotonic() - at_s > _ECHO_S:
                    _end(128 + number, "")
        elif first is not None:
            _end(
                128 + first,
                f"not ended {LAST_S + PROCESS.extra_s:.1f} s after {signal.Signals(first).name}, ending at once: {_unfinished()}",
            )


def _unfinished() -> str:
    words = []
    with suppress(RuntimeError):  # the set of tasks may change meanwhile
        if names := PROCESS.unfinished():
            words.append(f"tasks {names}")
    frame = sys._current_frames().get(threading.main_thread().ident or 0)
    if frame is not None:
        words.append(f"main thread in {place(frame)}")
    return "; ".join(words)


def place(frame: FrameType) -> str:
    """Return where a thread is, in words."""
    return f"{frame.f_code.co_name}, {frame.f_code.co_filename}:{frame.f_lineno}"


def threads() -> Iterator[str]:
    """Yield a line for each thread: its name, and the calls that it is in, the newest last."""
    names = {thread.ident: thread.name for thread in threading.enumerate()}
    for ident, frame in sys._current_frames().items():
        calls = " > ".join(
            f"{call.name} {Path(call.filename).name}:{call.lineno}" for call in traceback.extract_stack(frame)[-6:]
        )
        yield f"{names.get(ident, ident)}: {calls}"


def _holding() -> list[threading.Thread]:
    # One whose start a signal cut short is there and cannot be joined.
    there = (thread for thread in threading.enumerate() if thread.ident is not None and not thread.daemon)
    return [thread for thread in there if thread is not threading.main_thread()]


def _end(code: int, words: str) -> NoReturn:
    """End the process without the interpreter's shutdown, which may wait."""

    def say() -> None:
        with suppress(Exception):
            # Unlink the semaphores of multiprocessing, as the interpreter's shutdown would: else Python warns of a leak.
            util = sys.modules.get("multiprocessing.util")
            if util is not None:
                util._run_finalizers(0)
        with suppress(Exception):
            sys.stdout.flush()
        with suppress(Exception):
            PROCESS.last_words(words)

    saying = threading.Thread(target=say, daemon=True)
    with suppress(RuntimeError):  # no thread can be started
        saying.start()
        saying.join(_WORDS_S)
    os._exit(code)
