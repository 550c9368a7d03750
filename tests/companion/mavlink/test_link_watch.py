"""Link faults that a running service reports within seconds: by the doctor's rules, in the log and in health."""

import asyncio
import logging
import socket
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest

from companion.base.health import Health
from companion.parts.mavlink import make
from companion.parts.mavlink.make import PART, LinkWatch
from drivers.clock import SystemClock
from drivers.endpoint import parse_endpoint
from drivers.mavlink.autopilot import open_autopilot
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import mav
from drivers.mavlink.links import LinkOptions
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.signing import Signing, SigningKey, SigningTimes
from drivers.reconnect import running_beside
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.support.waiting import until

HOST = "127.0.0.1"
KEY = SigningKey(bytes(range(32)))


@asynccontextmanager
async def watch_links(monkeypatch: pytest.MonkeyPatch, *, signed: bool = False) -> AsyncIterator[tuple[Health, tuple[str, int]]]:
    """Yield a watch ten times as fast as in flight, beside the links."""
    for name in ("_EACH_S", "_WINDOW_S", "_FIRST_S"):
        monkeypatch.setattr(make, name, 0.1 * getattr(make, name))
    clock = SystemClock()
    health, options = Health(clock), AutopilotOptions(f"udpin://{HOST}:0")
    signing = Signing(KEY, SigningTimes(None), 0) if signed else None
    links = (LinkOptions(parse_endpoint(options.links), signing),)
    async with open_autopilot(options, clock, links) as autopilot:
        await until(lambda: autopilot.links.all[0].local is not None)
        async with running_beside([("watch", LinkWatch(autopilot, 0, health, clock).run())]):
            assert autopilot.links.all[0].local is not None
            yield health, autopilot.links.all[0].local


def heartbeat_of(three_days_ago: bool) -> Callable[[], bytes]:
    """Return what makes heartbeats signed three days ago, or not signed at all."""
    times = SigningTimes(None, lambda: time.time() - 3 * 86_400.0)
    codec = Codec(1, 1, signing=Signing(KEY, times, 3) if three_days_ago else None)
    return lambda: codec.pack(mav.MAVLink_heartbeat_message(2, 3, 128, 5, 4, 3))


@pytest.mark.parametrize(
    ("data", "signed", "said"),
    [
        (heartbeat_of(True), True, "the time of their signature, which is 3.0 days behind ours"),
        (heartbeat_of(False), True, "refused for their signature"),
        (heartbeat_of(False), False, "answers nothing: no parameter, no stream, no TIMESYNC"),
        (lambda: bytes(range(90, 250)), False, "set the same speed on both sides"),
        (lambda: b"", False, "not one byte"),
    ],
    ids=["time", "key", "one way", "speed", "silent"],
)
async def test_a_fault_is_reported_once(data, signed, said, monkeypatch, caplog):
    async with watch_links(monkeypatch, signed=signed) as (health, address):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:

            async def send() -> None:
                while True:
                    if sent := data():
                        sock.sendto(sent, address)
                    await asyncio.sleep(0.02)

            async with running_beside([("sender", send())]):
                await until(lambda: PART in health.parts and said in health.parts[PART].last_error)
                await asyncio.sleep(0.5)
        assert not health.parts[PART].up
    assert sum(said in line for line in caplog.messages) == 1
    assert health.parts[PART].up


async def test_a_good_link_reports_nothing_and_a_fault_that_is_over_no_more(monkeypatch, caplog):
    caplog.set_level(logging.INFO)
    async with watch_links(monkeypatch) as (health, address):
        await until(lambda: PART in health.parts)
        async with MiniatureAutopilot().talking_to("udpout://{}:{}".format(*address)):
            await until(lambda: health.parts[PART].up)
            await asyncio.sleep(1.0)
            assert health.parts[PART].up
            assert health.parts[PART].restarts == 1
    assert any("nothing is wrong with the links any more" in line for line in caplog.messages)
