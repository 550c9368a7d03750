"""The log waits for nobody and tells what it left out; one place in the source cannot fill it."""

import fcntl
import logging
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.base.service_log import LINES_A_MINUTE, KindLimit, ServiceLog, logging_to_stderr
from tests.support.waiting import wait_until


def record(text: object, line: int = 1, name: str = "companion.x", level: int = logging.WARNING) -> logging.LogRecord:
    return logging.LogRecord(name, level, "x.py", line, text, None, None)


@contextmanager
def log_into_pipe() -> Iterator[tuple[ServiceLog, int]]:
    """Yield a log into a pipe that takes 4 kB, and the end that somebody may read."""
    reading, writing = os.pipe()
    os.set_blocking(reading, False)
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)
    reported = ServiceLog(writing, timed=False)
    try:
        yield reported, reading
    finally:
        os.close(reading)
        reported.close()
        os.close(writing)


def read_until(reading: int, wanted: str) -> str:
    """Return the written bytes up to a text."""
    output = ""

    def there() -> bool:
        nonlocal output
        with suppress(BlockingIOError):
            output += os.read(reading, 65536).decode()
        return wanted in output

    wait_until(there)
    return output


@pytest.mark.hazard("H11")
def test_a_reader_that_stands_still_costs_lines_and_no_time() -> None:
    with log_into_pipe() as (reported, reading):
        for n in range(3000):  # a call that waited for the reader would not come back
            reported.handle(record(f"number {n} {'x' * 40}", line=n))
        dropped = reported.counts()["dropped"]
        assert dropped >= 1000
        output, missing = "", 0
        while missing < dropped:  # a thread that still wrote while others waited says it in parts
            output += read_until(reading, " of this log are missing")
            missing = sum(int(n) for n in re.findall(r"(\d+) lines of this log are missing", output))
        assert output.splitlines()[0] == f"WARNING companion.x: number 0 {'x' * 40}"
        assert missing == dropped
        reported.handle(record("and on", line=9999))
        read_until(reading, "and on")


@given(st.lists(st.tuples(st.integers(0, 3), st.floats(0.0, 30.0)), max_size=400))
def test_no_kind_has_more_lines_in_a_minute_and_every_line_is_accounted_for(arrivals: list[tuple[int, float]]) -> None:
    limit, now, written, held = KindLimit(), 0.0, dict[int, list[float]](), 0
    for kind, after in arrivals:
        now += after / 10.0
        for _, words in limit.due(now):
            held += int(words.split()[0])
        if limit.admits(record("text", kind), now):
            written.setdefault(kind, []).append(now)
    for _, words in limit.due(now + 61.0):
        held += int(words.split()[0])
    assert sum(map(len, written.values())) + held == len(arrivals)
    assert limit.held == held
    for times in written.values():
        assert all(sum(start <= t < start + 59.9 for t in times) <= 2 * LINES_A_MINUTE for start in times)


def test_a_flood_is_one_line_with_its_count() -> None:
    limit = KindLimit()
    assert sum(limit.admits(record(f"bad stream {n}"), 0.01 * n) for n in range(1000)) == LINES_A_MINUTE
    assert list(limit.due(60.0)) == [("companion.x", "940 more lines like this in 60 s: bad stream 999")]


def test_a_text_that_a_peer_chose_stays_on_one_line_and_other_peoples_loggers_are_shown_by_our_levels() -> None:
    with log_into_pipe() as (reported, reading):
        reported.handle(record("ship\n2026 ERROR forged: it landed\x1b[2J\u2028end"))
        assert read_until(reading, "end") == "WARNING companion.x: ship 2026 ERROR forged: it landed [2J end\n"
        for n, (name, level) in enumerate(
            [("pymavlink.dialects", logging.ERROR), ("aiohttp.web", logging.INFO), ("libav.h264", logging.WARNING)]
        ):
            reported.handle(record("not shown", n, name, level))
        reported.handle(record("task failed", 5, "asyncio", logging.ERROR))
        assert read_until(reading, "failed") == "ERROR asyncio: task failed\n"


def test_the_root_logger_is_given_back(capfd: pytest.CaptureFixture[str]) -> None:
    before = logging.getLogger().handlers[:]
    with logging_to_stderr("info"):
        logging.getLogger("companion.x").info("inside")
        logging.getLogger("companion.x").debug("below the level")
    assert logging.getLogger().handlers == [h for h in before if h in logging.getLogger().handlers]
    output = capfd.readouterr().err
    assert re.search(r"^INFO [-0-9]+ [:,0-9]+ companion\.x: inside$", output, re.MULTILINE), "the level leads the line"
    assert "below" not in output
