"""No MAVLink input ends the service: any fields, right checksum, from socket to socket."""

import asyncio
import logging
import random
from collections.abc import Iterator
from contextlib import AsyncExitStack

import pytest
from hypothesis import HealthCheck, given, settings

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import mav
from drivers.mavlink.links import ReceivedMessage
from tests.companion.mavlink.border import AUTOPILOT, US, Border, bordered, frame, messages


@pytest.fixture(scope="module")
def border() -> Iterator[tuple[asyncio.AbstractEventLoop, Border]]:
    loop = asyncio.new_event_loop()
    stack = AsyncExitStack()
    yield loop, loop.run_until_complete(stack.enter_async_context(bordered()))
    loop.run_until_complete(stack.aclose())
    loop.close()


async def test_the_two_datagrams_that_ended_the_service() -> None:
    async with bordered() as border:
        await border.send(mav.MAVLink_command_long_message(*US, 511, 0, 0, 1e38, 0, 0, 0, 0, 0))
        await border.send(mav.MAVLink_command_long_message(*US, 510, 0, 0, 0, 0, 0, 0, 0, 0))
        acks = {m.command: m.result for m in border.answers() if m.get_type() == "COMMAND_ACK"}
        assert acks[511] == mav.MAV_RESULT_DENIED, "an interval that no answer can carry"
        assert acks[510] == mav.MAV_RESULT_ACCEPTED
        await border.alive()


def test_every_message_of_the_dialect_with_random_bytes_as_its_fields(border: tuple[asyncio.AbstractEventLoop, Border]) -> None:
    loop, service = border
    chance = random.Random(11)
    for cls in mav.mavlink_map.values():
        size = cls.unpacker.size
        payloads = [b"\xff" * size, b"\x00", *(chance.randbytes(size) for _ in range(3))]
        for source in (AUTOPILOT, (255, 190), (0, 0)):
            loop.run_until_complete(service.throw(*(frame(cls, payload, source) for payload in payloads)))
        assert dict(service.links.contained.faults) == {}, cls.msgname
    loop.run_until_complete(service.alive())


@settings(max_examples=300, derandomize=True, suppress_health_check=list(HealthCheck))
@given(data=messages())
def test_any_fields_with_the_right_checksum(border: tuple[asyncio.AbstractEventLoop, Border], data: bytes) -> None:
    loop, service = border
    loop.run_until_complete(service.throw(data))
    assert dict(service.links.contained.faults) == {}
    assert dict(service.links.unfit) == {}


@settings(max_examples=200, derandomize=True, suppress_health_check=list(HealthCheck))
@given(data=messages(mav.MAVLink_command_long_message))
def test_any_command(border: tuple[asyncio.AbstractEventLoop, Border], data: bytes) -> None:
    loop, service = border
    loop.run_until_complete(service.throw(data))
    assert dict(service.links.contained.faults) == {}
    assert dict(service.links.unfit) == {}


def test_and_the_service_goes_on_answering(border: tuple[asyncio.AbstractEventLoop, Border]) -> None:
    loop, service = border
    service.clock.leap(30.0)  # what other autopilots with its id seem to have said counts for seconds
    loop.run_until_complete(service.alive())
    loop.run_until_complete(service.told_of_the_pad())


async def test_a_bug_in_a_handler_is_counted_and_logged_once_and_ends_nothing(caplog: pytest.LogCaptureFixture) -> None:
    def broken(received: ReceivedMessage) -> None:
        raise ZeroDivisionError("a bug of ours")

    async with bordered() as border:
        border.autopilot._listeners.insert(0, broken)
        with caplog.at_level(logging.ERROR):
            await border.send(*(mav.MAVLink_statustext_message(4, b"any") for _ in range(20)))
        assert border.links.contained.faults["the handling of STATUSTEXT"] == 20
        logged = [r for r in caplog.records if "STATUSTEXT" in r.getMessage()]
        assert len(logged) == 1
        assert logged[0].exc_info, "with its traceback"
        assert "system 7, component 1" in logged[0].getMessage()
        border.autopilot._listeners.remove(broken)
        border.links.contained.faults.clear()
        await border.alive()


async def test_a_message_of_ours_that_does_not_fit_the_wire_is_a_counted_refusal(caplog: pytest.LogCaptureFixture) -> None:
    async with bordered() as border:
        for _ in range(3):
            assert not border.links.send(mav.MAVLink_message_interval_message(0, 10**20))
        assert border.links.unfit == {"MESSAGE_INTERVAL.interval_us": 3}
        assert len([r for r in caplog.records if "MESSAGE_INTERVAL.interval_us" in r.getMessage()]) == 1
        border.links.unfit.clear()
        await border.alive()


def test_a_key_in_clear_reaches_no_recording() -> None:
    async def flown() -> list[str]:
        names: list[str] = []
        async with bordered() as border:
            border.links.tap = lambda at, link, way, data, name: names.append(name)
            await border.throw(Codec(*AUTOPILOT).pack(mav.MAVLink_setup_signing_message(*US, list(range(32)), 1)))
            await border.alive()
        return names

    names = asyncio.run(flown())
    assert "COMMAND_LONG" in names
    assert "SETUP_SIGNING" not in names
