"""The logs: the service's waits for nobody and tells what it left out, a server's holds errors of ours and none of a client's."""

import asyncio
import base64
import fcntl
import logging
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest
from aiohttp import web
from hypothesis import given
from hypothesis import strategies as st

from companion.base.http_server import ConnectionLimits, listen, make_runner
from companion.base.service_log import LINES_A_MINUTE, KindLimit, ReportedOnce, ServiceLog, logging_to_stderr
from tests.make import ns
from tests.support.waiting import PATIENCE_S, wait_until


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


def upgrade(address: bytes, *headers: bytes) -> bytes:
    """Return a browser's request for a websocket at an address (RFC 6455, section 4.1)."""
    key = b"Sec-WebSocket-Key: " + base64.b64encode(b"sixteen bytes of")
    asked = (b"Host: 127.0.0.1", b"Connection: Upgrade", b"Upgrade: websocket", b"Sec-WebSocket-Version: 13", key, *headers)
    return b"GET " + address + b" HTTP/1.1\r\n" + b"\r\n".join(asked) + b"\r\n\r\n"


async def _answers(handler_fails: bool, *pieces: bytes, hang_up: bool = True) -> list[bytes]:
    async def handle(request: web.Request) -> web.StreamResponse:
        if handler_fails:
            raise KeyError("ours")
        socket = web.WebSocketResponse()
        await asyncio.sleep(0.05)
        await socket.prepare(request)
        return socket

    app = web.Application()
    app.router.add_get("/", handle)
    runner, answers = make_runner(app), []
    await runner.setup()
    try:
        server = await listen(runner, ConnectionLimits(), "127.0.0.1", 0)
        for piece in pieces:
            reader, writer = await asyncio.open_connection("127.0.0.1", server.sockets[0].getsockname()[1])
            writer.write(piece)
            if hang_up:
                writer.write_eof()
            async with asyncio.timeout(PATIENCE_S):
                answers.append(await reader.read(4096))
            writer.close()
        await asyncio.sleep(0.1)
        server.close()
    finally:
        await runner.cleanup()
    return answers


async def test_unknown_peers_fill_no_log(caplog: pytest.LogCaptureFixture) -> None:
    """A request with a broken header, bytes that are no HTTP, and a client that hangs up."""
    with caplog.at_level(logging.DEBUG, "companion.base.http_server"):
        await _answers(False, b"GET / HTTP/1.1\r\nno header\r\n\r\n", b"\x16\x03\x01\x02\x00\r\n\r\n", upgrade(b"/"))
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING], caplog.text
    assert "BadHttpMessage" in caplog.text or "InvalidHeader" in caplog.text
    assert "ConnectionResetError" in caplog.text


@pytest.mark.parametrize(("text", "torn"), [(b"Upgrade: web", b"\x8d\x90"), (b"Sec-WebSocket-Key: c2l4", b"\x9c\xb6")])
async def test_bytes_that_are_no_text_are_refused(text: bytes, torn: bytes, caplog: pytest.LogCaptureFixture) -> None:
    (answer,) = await _answers(False, upgrade(b"/").replace(text, text + torn, 1), hang_up=False)
    assert answer.startswith(b"HTTP/1.1 400 Bad Request"), answer
    assert b"ASCII" in answer
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING], caplog.text


async def test_an_error_of_ours_is_reported_with_its_traceback(caplog: pytest.LogCaptureFixture) -> None:
    await _answers(True, b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
    (record,) = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert record.levelno == logging.ERROR
    assert isinstance(record.exc_info[1], KeyError)


def test_a_text_that_comes_and_goes_is_new_once_and_again_after_it_was_away() -> None:
    shown = ReportedOnce()
    times = [t for t in range(200) if t % 2 == 0 and not 100 <= t < 150 and shown.new([f"off by 0.{t} m"], ns(t))]
    assert times == [0, 150]
