"""The service's log: one line a message, written by a thread of its own, so that logging never waits for a reader.

A journal on a card that hangs, a terminal after Ctrl-S or a container's log driver may stop reading at any time. Lines wait in a
bounded queue. Lines that find it full are counted, and the count is written when lines flow again. One place in the source is one
kind: at most `LINES_A_MINUTE` of it are written in a minute, then one line with the number of the others.

Libraries and child processes write past all this to standard output and error. While the log is open, both are a pipe whose other
end a thread reads, and what comes there is logged like anything else.
"""

import logging
import os
import queue
import re
import select
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress

from msgspec import Struct

from companion.base.signals import PROCESS
from estimator.contracts.address import masked
from estimator.contracts.time import MonoNs, seconds_between

LINES_A_MINUTE = 60
"""The most lines of one kind in a minute."""
_MINUTE_S = 60.0  # time in which a kind of line has its number of lines
_WAITING_MAX = 1000
"""Lines that may wait for a reader: some hours of a healthy flight."""
_TELL_S = 1.0
"""Time between two looks for counts that are due."""
_CLOSE_S = 0.3
"""Time that the last lines have at the end: a reader that stands still must not hold up the end of the service."""
_LINE_MAX = 2000
"""The most characters of one message; peers choose the length of some."""
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+")
"""Control characters and line separators in texts from a peer: they could begin a new line or control a terminal."""
_NUMBER = re.compile(r"\d+(\.\d+)?")
_AWAY_S = 30.0  # time without a text after which it is new again
_OURS = ("companion", "drivers", "estimator", "sitl")
_OTHERS = {"pymavlink": logging.CRITICAL, "paho": logging.CRITICAL, "mqtt": logging.CRITICAL, "libav": logging.ERROR}
"""Log levels of other people's loggers; WARNING if not named. Our drivers count and log what these report."""


def _admits(record: logging.LogRecord) -> bool:
    """Return whether a record of a library is shown; with our own level at debugging every one is."""
    package = record.name.partition(".")[0]
    if package in _OURS or logging.getLogger().level <= logging.DEBUG:
        return True
    return record.levelno >= _OTHERS.get(package, logging.WARNING)


class OneLine(logging.Formatter):
    """The form of every line: level, time, logger, message. journald adds the time itself. A traceback follows its line."""

    def __init__(self, *, timed: bool) -> None:
        super().__init__("%(levelname)s " + ("%(asctime)s " if timed else "") + "%(name)s: %(message)s")

    def format(self, record: logging.LogRecord) -> str:
        return masked(super().format(record))

    def formatMessage(self, record: logging.LogRecord) -> str:
        record.message = _CONTROL.sub(" ", record.message)[:_LINE_MAX]
        return super().formatMessage(record)


class _Kind(Struct):
    since_s: float
    written: int = 0
    held: int = 0
    name: str = ""
    last: str = ""


class KindLimit:
    """Admits `LINES_A_MINUTE` of each kind, and says how many it held back. Pure; times are of any clock, s."""

    def __init__(self) -> None:
        self._kinds: dict[tuple[str, int], _Kind] = {}
        self.held = 0
        """The number of lines that were held back."""

    def admits(self, record: logging.LogRecord, now_s: float) -> bool:
        """Return whether a record is written. One place in the source is one kind, whatever it says."""
        kind = self._kinds.setdefault((record.pathname, record.lineno), _Kind(now_s))
        if now_s - kind.since_s >= _MINUTE_S and not kind.held:
            kind.since_s, kind.written = now_s, 0
        if kind.written < LINES_A_MINUTE:
            kind.written += 1
            return True
        self.held += 1
        kind.held += 1
        kind.name, kind.last = record.name, _CONTROL.sub(" ", record.getMessage())[:_LINE_MAX]
        return False

    def due(self, now_s: float) -> Iterator[tuple[str, str]]:
        """Yield logger and words for each kind whose minute is over and that had lines held back."""
        for kind in self._kinds.values():
            if kind.held and now_s - kind.since_s >= _MINUTE_S:
                yield kind.name, f"{kind.held} more lines like this in {now_s - kind.since_s:.0f} s: {kind.last}"
                kind.since_s, kind.written, kind.held = now_s, 0, 0


class ReportedOnce:
    """Texts that come and go: each is new once, and again after it was away for `_AWAY_S`. Numbers in it do not count."""

    def __init__(self) -> None:
        self._seen: dict[str, MonoNs] = {}

    def new(self, texts: Iterable[str], now: MonoNs) -> list[str]:
        """Return which of the present texts are new."""
        present = {_NUMBER.sub("", text): text for text in texts}
        seen = {key for key, at in self._seen.items() if seconds_between(at, now) <= _AWAY_S}
        self._seen |= dict.fromkeys(present, now)
        return [text for key, text in present.items() if key not in seen]


class ServiceLog(logging.Handler):
    """Hands lines to its thread, which writes them to a descriptor.

    Args:
        descriptor: where lines are written; it may block for as long as it likes.
        timed: whether each line has the wall time.
    """

    def __init__(self, descriptor: int, *, timed: bool = True) -> None:
        super().__init__()
        self.addFilter(_admits)
        self.setFormatter(OneLine(timed=timed))
        self._descriptor = descriptor
        self._before = "\r\x1b[2K" if os.isatty(descriptor) else ""
        """Control sequence that takes away a line of progress, in whose place ours stands."""
        self._limit = KindLimit()
        self._queue: queue.Queue[str | None] = queue.Queue(maxsize=_WAITING_MAX)
        self._missing = 0
        """Lines that found the queue full or the descriptor broken, and are not reported yet."""
        self.written = 0
        self.dropped = 0
        self._thread = threading.Thread(target=self._work, name="log", daemon=True)
        self._thread.start()

    def counts(self) -> Mapping[str, float]:
        """Return the counters for health."""
        waiting = self._queue.qsize()
        return {"written": self.written, "waiting": waiting, "dropped": self.dropped, "held_back": self._limit.held}

    def emit(self, record: logging.LogRecord) -> None:
        try:
            if self._limit.admits(record, time.monotonic()):
                self._offer(self.format(record))
        except Exception:
            self.handleError(record)

    def close(self) -> None:
        """Write what waits, in bounded time."""
        with suppress(queue.Full):
            self._queue.put_nowait(None)
            self._thread.join(_CLOSE_S)
        super().close()

    def _offer(self, line: str) -> None:
        try:
            self._queue.put_nowait(line)
        except queue.Full:
            self._lose()

    def _lose(self) -> None:
        self._missing += 1
        self.dropped += 1

    def _work(self) -> None:
        while True:
            try:
                line = self._queue.get(timeout=_TELL_S)
            except queue.Empty:
                self._report()
                continue
            if line is None:
                self._report()
                return
            self._write(line)
            self._report()

    def _report(self) -> None:
        """Write the counts of lines that were held back or lost."""
        self.acquire()
        try:
            reports = list(self._limit.due(time.monotonic()))
            missing, self._missing = self._missing, 0
        finally:
            self.release()
        for name, words in reports:
            self._say(name, words)
        if missing and not self._say(__name__, f"{missing} lines of this log are missing: its reader did not take them"):
            self._missing += missing

    def _say(self, name: str, words: str) -> bool:
        return self._write(self.format(logging.LogRecord(name, logging.WARNING, __file__, 0, words, None, None)))

    def _write(self, line: str) -> bool:
        data = f"{self._before}{line}\n".encode(errors="backslashreplace")
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:  # somebody else who has the same file made it so
                select.select([], [self._descriptor], [], _TELL_S)
            except OSError:  # a terminal that hung up, a reader that went away, a full disk
                self._lose()
                return False
        self.written += 1
        return True


@contextmanager
def logging_to_stderr(level: str) -> Iterator[ServiceLog]:
    """Log everything by a `ServiceLog` to standard error while the context is open, and hear what else is written there.

    Args:
        level: the name of the lowest level of our own messages.
    """
    real = os.dup(2)
    service_log = ServiceLog(real, timed="JOURNAL_STREAM" not in os.environ)
    logging.basicConfig(level=level.upper(), handlers=[service_log], force=True)
    logging.captureWarnings(True)
    received = _hear() if PROCESS.heeding else None
    before_words, PROCESS.last_words = PROCESS.last_words, lambda words: _last_words(service_log, words)
    try:
        yield service_log
    finally:
        PROCESS.last_words = before_words
        if received is not None:
            sys.stdout.flush()
            for number, before in enumerate(received, 1):
                os.dup2(before, number)
                os.close(before)
        service_log.close()
        logging.getLogger().removeHandler(service_log)
        logging.captureWarnings(False)


def _last_words(service_log: ServiceLog, words: str) -> None:
    if words:
        service_log._offer(f"decklander: {words}")
    service_log.close()


def _hear() -> tuple[int, int]:
    """Put a pipe in the place of standard output and error, and log what comes out of it; return what was there before."""
    before = os.dup(1), os.dup(2)
    reading, writing = os.pipe()
    os.dup2(writing, 1)
    os.dup2(writing, 2)
    os.close(writing)
    threading.Thread(target=_repeat, args=(reading,), name="heard", daemon=True).start()
    return before


def _repeat(reading: int) -> None:
    """Log each line of libraries and children, until all of them have closed the pipe."""
    log = logging.getLogger("companion.printed")
    with os.fdopen(reading, "rb", buffering=0) as pipe:
        rest = b""
        while data := pipe.read(65536):
            *lines, rest = (rest + data).split(b"\n")
            rest = rest[-_LINE_MAX:]
            for line in lines:
                if line.strip():
                    log.warning("%s", line.decode(errors="replace").strip())
