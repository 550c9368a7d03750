"""The outside world failing restarts one part; a bug of ours takes the group down; cancelling stops it cleanly."""

import asyncio
import sys

import pytest

from companion.base import event_loop
from companion.base.health import Health
from companion.base.supervise import contain, keep_alive, run
from companion.settings.restart import RestartOptions
from estimator.contracts.errors import Recoverable
from tests.support.clocks import SleepingClock


async def test_a_recoverable_failure_restarts_that_part_alone_with_growing_rests() -> None:
    clock = SleepingClock()
    health = Health(clock)
    lives = {"weak": 0, "strong": 0}

    async def weak() -> None:
        lives["weak"] += 1
        if lives["weak"] <= 5:
            raise Recoverable("cable")

    async def strong() -> None:
        lives["strong"] += 1

    await run({"weak": weak, "strong": strong}, RestartOptions(0.2, 2.0, 1.0, 5.0), health, clock)
    assert lives == {"weak": 6, "strong": 1}
    assert clock.slept == [0.2, 0.4, 0.8, 1.0, 1.0]
    assert health.parts["weak"].restarts == 5
    assert health.parts["weak"].last_error == "cable"
    assert health.parts["strong"].restarts == 0


async def test_a_part_that_was_healthy_for_long_rests_shortly_again() -> None:
    clock = SleepingClock()
    lives = 0

    async def body() -> None:
        nonlocal lives
        lives += 1
        if lives == 3:
            clock.advance(10.0)
        if lives < 5:
            raise Recoverable("gone")

    await keep_alive("part", body, RestartOptions(0.1, 2.0, 9.0, 5.0), Health(clock), clock)
    assert clock.slept == [0.1, 0.2, 0.1, 0.2]


async def test_a_recoverable_inside_a_task_group_of_the_part_counts_as_recoverable() -> None:
    clock = SleepingClock()
    lives = 0

    async def body() -> None:
        nonlocal lives
        lives += 1

        async def inner() -> None:
            if lives == 1:
                raise Recoverable("socket")

        async with asyncio.TaskGroup() as group:
            group.create_task(inner())

    await keep_alive("part", body, RestartOptions(), Health(clock), clock)
    assert lives == 2


async def test_a_bug_takes_everything_down() -> None:
    clock = SleepingClock()
    stopped = asyncio.Event()

    async def buggy() -> None:
        await asyncio.sleep(0)
        raise KeyError("ours")

    async def innocent() -> None:
        try:
            await asyncio.sleep(3600)
        finally:
            stopped.set()

    with pytest.raises(ExceptionGroup) as caught:
        await run({"buggy": buggy, "innocent": innocent}, RestartOptions(), Health(clock), clock)
    assert caught.value.subgroup(KeyError) is not None
    assert stopped.is_set()


async def test_a_cancellation_that_nobody_requested_is_a_bug_of_a_vital_part_and_not_its_orderly_end() -> None:
    async def body() -> None:
        raise asyncio.CancelledError

    with pytest.raises(ExceptionGroup) as caught:
        await run({"vehicle": body}, RestartOptions(), Health(SleepingClock()), SleepingClock())
    assert caught.value.subgroup(RuntimeError) is not None


def test_a_vital_part_whose_task_calls_sys_exit_ends_loudly_after_the_others_have_ended_in_order() -> None:
    """It was exit code 0 without a word, for which systemd starts nothing again."""
    ended = []

    async def vehicle() -> None:
        async def child() -> None:
            sys.exit(0)

        async with asyncio.TaskGroup() as group:
            group.create_task(child())

    async def guidance() -> None:
        try:
            await asyncio.sleep(3600)
        finally:
            await asyncio.sleep(0)
            ended.append("guidance")

    clock = SleepingClock()
    with pytest.raises(ExceptionGroup) as caught:
        event_loop.run(run({"vehicle": vehicle, "guidance": guidance}, RestartOptions(), Health(clock), clock))
    assert [str(why) for why in caught.value.exceptions] == ["vehicle called sys.exit(0)"]
    assert ended == ["guidance"]


async def test_a_part_beside_the_flight_that_does_not_end_is_abandoned(caplog: pytest.LogCaptureFixture) -> None:
    swallowed = 0

    async def stubborn() -> None:
        nonlocal swallowed
        while swallowed < 1000:
            try:
                await asyncio.sleep(3600)
            except asyncio.CancelledError:
                swallowed += 1

    async def vital() -> None:
        await asyncio.sleep(0)

    before = asyncio.all_tasks()
    await run({"vital": vital}, RestartOptions(), Health(SleepingClock()), SleepingClock(), beside={"stubborn": stubborn})
    assert swallowed == 1
    assert "stubborn did not end within 1.0 s and is abandoned" in caplog.text
    swallowed = 1000
    for task in asyncio.all_tasks() - before:
        task.cancel()


async def test_the_vital_parts_have_ended_before_the_others_are_ordered_to() -> None:
    output: list[str] = []

    async def part(name: str) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(0.01)
            output.append(name)

    ended = asyncio.Event()
    asyncio.get_running_loop().call_soon(ended.set)
    parts, clock = {"vehicle": lambda: part("vehicle")}, SleepingClock()
    await run(parts, RestartOptions(), Health(clock), clock, until=ended, beside={"mqtt": lambda: part("mqtt")})
    assert output == ["vehicle", "mqtt"]


async def test_a_failing_part_has_one_traceback_in_the_log_however_often_it_fails(caplog: pytest.LogCaptureFixture) -> None:
    health = Health(SleepingClock())

    async def body() -> None:
        raise KeyError("ours")

    await contain("mqtt", body, RestartOptions(), health, SleepingClock())
    assert sum(record.exc_info is not None for record in caplog.records) == 1
    assert health.contained["mqtt"] == 10
    assert health.flight_fault() is None
    assert health.fault() == "mqtt is down: off after 10 failures: 'ours'"
