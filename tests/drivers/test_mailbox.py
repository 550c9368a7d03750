"""A mailbox loses nothing it does not count, whoever is cancelled; the reconnect loop rests, ends and logs little."""

import asyncio
import logging
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.mailbox import Latest, Line
from drivers.reconnect import BackOff, reconnect
from estimator.contracts.errors import BadInput, Recoverable
from tests.support.clocks import SleepingClock

BOXES = [Latest, lambda: Line(4)]


async def test_what_waits_in_a_line_is_read_together_and_then_its_error():
    line, read = Line[int](3), list[list[int]]()
    for i in range(5):
        line.offer(i)

    async def reading() -> None:
        async for items in line.together():
            read.append(items)

    reader = asyncio.create_task(reading())
    await asyncio.sleep(0)
    line.offer(5)
    await asyncio.sleep(0)
    line.offer(6)
    line.fail(Recoverable("gone"))
    with pytest.raises(Recoverable):
        await asyncio.wait_for(reader, 60)
    assert read == [[2, 3, 4], [5], [6]]
    assert (line.offered, line.dropped, len(line)) == (7, 2, 0)


@pytest.mark.parametrize("make", BOXES)
@pytest.mark.parametrize("turns", range(6))
async def test_cancelling_a_reader_at_any_turn_of_the_loop_loses_nothing(make, turns):
    box, got = make(), []

    async def read():
        async for item in box:
            got.append(item)

    reader = asyncio.create_task(read())
    await asyncio.sleep(0)
    box.offer("a")
    for _ in range(turns):
        await asyncio.sleep(0)
    reader.cancel()
    await asyncio.gather(reader, return_exceptions=True)
    if not got:
        got.append(await asyncio.wait_for(box.get(), 60))
    assert got == ["a"]


@pytest.mark.parametrize("make", BOXES)
async def test_a_failure_reaches_the_reader_after_what_was_left(make):
    box, got = make(), []
    box.offer("last")
    box.fail(Recoverable("unplugged"))

    async def read():
        async for item in box:
            got.append(item)

    with pytest.raises(Recoverable, match="unplugged"):
        await asyncio.wait_for(read(), 60)
    assert got == ["last"]
    with pytest.raises(Recoverable):
        await box.get()


@settings(max_examples=60)
@given(st.lists(st.sampled_from(["offer", "get", "cancelled get", "turn"]), max_size=40), st.integers(1, 5))
def test_every_item_is_read_dropped_or_still_there(script, capacity):
    async def play():
        latest, line = Latest[int](), Line[int](capacity)
        read: dict[object, list[Any]] = {latest: [], line: []}
        for i, what in enumerate(script):
            for box in (latest, line):
                if what == "offer":
                    box.offer(i)
                elif what == "turn":
                    await asyncio.sleep(0)
                else:
                    task = asyncio.create_task(box.get())
                    if what == "get":
                        await asyncio.sleep(0)
                        await asyncio.sleep(0)
                    if not task.done():
                        task.cancel()
                    result = (await asyncio.gather(task, return_exceptions=True))[0]
                    if not isinstance(result, BaseException):
                        read[box].append(result)
        assert all(items == sorted(set(items)) for items in read.values())
        left = 1 if latest._item is not None else 0
        assert latest.offered == len(read[latest]) + latest.replaced + left
        assert line.offered == len(read[line]) + line.dropped + len(line)
        assert len(line) <= capacity

    asyncio.run(play())


def test_what_waits_or_has_come_elsewhere_is_taken_in_order_and_then_the_error():
    socket = [4]

    def fetch() -> None:
        while socket:
            line.offer(socket.pop())

    line = Line[int](3, fetch)
    for i in range(4):
        line.offer(i)
    line.check()
    assert line.waiting() == [2, 3, 4]
    line.fail(Recoverable("gone"))
    assert line.waiting() == []
    with pytest.raises(Recoverable, match="gone"):
        line.check()


class Body:
    """Fails as the list says: an error, or a number of seconds to be up before it fails. It returns when the list is over."""

    def __init__(self, clock: SleepingClock, runs: list[BaseException | float]) -> None:
        self.clock, self.runs = clock, runs

    async def __call__(self) -> None:
        if not self.runs:
            return
        run = self.runs.pop(0)
        if isinstance(run, BaseException):
            raise run
        self.clock.advance(run)
        raise OSError("unplugged")


BACK_OFF = BackOff(0.5, 4.0, healthy_after_s=10.0)


async def test_rests_grow_to_the_cap_and_begin_again_after_a_healthy_run() -> None:
    clock, failures = SleepingClock(), list[Any]()
    body = Body(clock, [*[Recoverable("absent")] * 6, 9.9, 10.0, Recoverable("absent")])
    await reconnect("camera", body, BACK_OFF, clock, failures.append)
    assert clock.slept == [0.5, 1.0, 2.0, 4.0, 4.0, 4.0, 4.0, 0.5, 1.0]
    assert len(failures) == 9


async def test_an_absent_device_is_logged_twice_in_an_hour_and_once_when_it_is_back(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "drivers.reconnect")
    clock = SleepingClock()
    await reconnect("camera", Body(clock, [*[Recoverable("absent")] * 900, 11.0]), BACK_OFF, clock)
    assert clock.t > 3600e9 - 4e9
    assert caplog.messages == [
        "camera: absent; trying again",
        "camera: still absent; trying every 4 s until it comes back",
        "camera: up again after 900 failed attempts",
        "camera: unplugged; trying again",
    ]


BUG_IN_GROUP = ExceptionGroup("both", [Recoverable("absent"), ValueError("a bug")])


@pytest.mark.parametrize("error", [BadInput("no such size"), ValueError("a bug"), BUG_IN_GROUP, asyncio.CancelledError()])
async def test_any_other_error_passes_through_as_it_is(error: BaseException) -> None:
    with pytest.raises(type(error)) as raised:
        await reconnect("camera", Body(SleepingClock(), [Recoverable("absent"), error]), BACK_OFF, SleepingClock())
    if isinstance(raised.value, ExceptionGroup):
        assert [type(e) for e in raised.value.exceptions] == [ValueError]
    else:
        assert raised.value is error or isinstance(error, asyncio.CancelledError)


async def test_jitter_shortens_each_rest_by_at_most_its_part() -> None:
    clock = SleepingClock()
    await reconnect("broker", Body(clock, [Recoverable("refused")] * 50), BackOff(1.0, 1.0, 10.0, jitter=0.5), clock)
    assert all(0.5 <= s <= 1.0 for s in clock.slept)
    assert len({round(s, 6) for s in clock.slept}) > 25
