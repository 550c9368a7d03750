"""The one reconnect loop: rests, what ends it, and how little it logs."""

import asyncio
import logging
import math
from typing import Any

import pytest

from drivers.reconnect import BackOff, reconnect
from estimator.contracts.errors import BadInput, Recoverable
from tests.support.clocks import SleepingClock


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


@pytest.mark.parametrize("error", [BadInput("no such size"), ValueError("a bug"), asyncio.CancelledError()])
async def test_any_other_error_passes_through_as_it_is(error: BaseException) -> None:
    with pytest.raises(type(error)) as raised:
        await reconnect("camera", Body(SleepingClock(), [Recoverable("absent"), error]), BACK_OFF, SleepingClock())
    assert raised.value is error or isinstance(error, asyncio.CancelledError)


async def test_a_group_with_a_bug_in_it_passes_through() -> None:
    body = Body(SleepingClock(), [ExceptionGroup("both", [Recoverable("absent"), ValueError("a bug")])])
    with pytest.raises(ExceptionGroup) as raised:
        await reconnect("camera", body, BACK_OFF, SleepingClock())
    assert [type(e) for e in raised.value.exceptions] == [ValueError]


async def test_jitter_shortens_each_rest_by_at_most_its_part() -> None:
    clock = SleepingClock()
    await reconnect("broker", Body(clock, [Recoverable("refused")] * 50), BackOff(1.0, 1.0, 10.0, jitter=0.5), clock)
    assert all(0.5 <= s <= 1.0 for s in clock.slept)
    assert len({round(s, 6) for s in clock.slept}) > 25


@pytest.mark.parametrize(
    "numbers",
    [(0.0, 1.0, 1.0), (2.0, 1.0, 1.0), (1.0, 2.0, -1.0), (1.0, 2.0, 1.0, 0.5), (1.0, 2.0, 1.0, 2.0, 1.0), (math.nan, 1.0, 1.0)],
)
def test_a_back_off_out_of_range_is_refused(numbers: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="a back-off needs"):
        BackOff(*numbers)
