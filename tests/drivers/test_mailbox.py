"""A mailbox loses nothing it does not count, whoever is cancelled and whenever."""

import asyncio
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.mailbox import Latest, Line
from estimator.contracts.errors import Recoverable

BOXES = [Latest, lambda: Line(4)]


async def test_latest_hands_over_the_newest_and_counts_what_it_replaced():
    box = Latest[int]()
    assert box.offer(1) is None
    assert box.offer(2) == 1
    assert box.offer(3) == 2
    assert await box.get() == 3
    assert (box.offered, box.replaced) == (3, 2)


async def test_line_keeps_order_and_counts_what_it_dropped():
    line = Line[int](3)
    for i in range(5):
        line.offer(i)
    assert len(line) == 3
    assert [await line.get() for _ in range(3)] == [2, 3, 4]
    assert (line.offered, line.dropped) == (5, 2)


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


async def test_what_waits_is_taken_in_order_and_leaves_an_empty_line():
    line = Line[int](3)
    for i in range(5):
        line.offer(i)
    assert line.waiting() == [2, 3, 4]
    assert line.waiting() == []
    line.offer(5)
    assert await line.get() == 5


async def test_what_has_come_elsewhere_is_fetched_before_what_waits_is_taken():
    socket = [1, 2]

    def fetch() -> None:
        while socket:
            line.offer(socket.pop(0))

    line = Line[int](3, fetch)
    assert len(line) == 0
    assert line.waiting() == [1, 2]
    socket.append(3)
    assert line.waiting() == [3]


def test_a_line_that_has_failed_reports_it_when_nothing_is_left():
    line = Line[int](3)
    line.check()
    line.offer(1)
    line.fail(Recoverable("gone"))
    line.check()
    assert line.waiting() == [1]
    with pytest.raises(Recoverable, match="gone"):
        line.check()
