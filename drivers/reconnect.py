"""Run a connection to the outside world, and run it again with back-off when it fails; log each outage.

The vehicle's channels, MAVLink links, cameras, the MQTT broker and the parts of the service all use `reconnect`. A device may be
absent for hours, so the log has three lines for an outage: its first failure, the moment when the back-off stops growing, and
the recovery. The caller's counters and health count every failure.
"""

import asyncio
import logging
import random
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterable
from contextlib import asynccontextmanager
from typing import Any, NamedTuple, NoReturn

from msgspec import Struct

from estimator.contracts.errors import Recoverable, in_words
from estimator.contracts.time import Clock, seconds_between

_log = logging.getLogger(__name__)

_REASONS_MAX = 4
"""The number of different reasons of one outage that are logged."""


class BackOff(Struct, frozen=True):
    """The waits between attempts: `first_s`, then `factor` times longer each time up to `cap_s`.

    Raises:
        ValueError: a number is out of range.
    """

    first_s: float
    cap_s: float
    healthy_after_s: float
    """A run of at least this length ends the outage: the next wait is `first_s` again."""
    factor: float = 2.0
    jitter: float = 0.0
    """The fraction of each wait that is random, so that many clients of one server do not return at the same instant."""

    def __post_init__(self) -> None:
        if not 0.0 < self.first_s <= self.cap_s or not self.healthy_after_s >= 0.0:
            raise ValueError(f"a back-off needs 0 < first_s <= cap_s and healthy_after_s >= 0, got {self}")
        if not self.factor >= 1.0 or not 0.0 <= self.jitter < 1.0:
            raise ValueError(f"a back-off needs factor >= 1 and jitter in [0, 1), got {self}")


async def reconnect(
    name: str,
    body: Callable[[], Awaitable[None]],
    back_off: BackOff,
    clock: Clock,
    on_failure: Callable[[BaseException], None] = lambda why: None,
    failures: tuple[type[Exception], ...] = (Recoverable, OSError),
) -> None:
    """Run `body` until it returns, and run it again after each failure of the outside world. Any other error passes through.

    Args:
        name: the name in the log, with the address.
        on_failure: called with each failure before the wait.
        failures: the errors that count as the outside world's. A group of only such errors counts too.
    """
    outage = _Outage(name)
    delay_s = back_off.first_s
    while True:
        began = clock.now()
        # Only the log depends on the event loop's time: nothing that is computed waits for it.
        recovery = asyncio.get_running_loop().call_later(back_off.healthy_after_s, outage.end)
        try:
            await body()
            return
        except* failures as group:
            why: BaseException = group
        finally:
            recovery.cancel()
        if seconds_between(began, clock.now()) >= back_off.healthy_after_s:
            outage.end()
            delay_s = back_off.first_s
        on_failure(why)
        outage.log(why, delay_s, at_cap=delay_s >= back_off.cap_s)
        await clock.sleep(delay_s * random.uniform(1.0 - back_off.jitter, 1.0) if back_off.jitter else delay_s)
        delay_s = min(back_off.factor * delay_s, back_off.cap_s)


class _Outage:
    """The successive failures of one body, and which of them were logged."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._failures = 0
        self._reasons: set[str] = set()
        self._at_cap = False

    def log(self, why: BaseException, delay_s: float, *, at_cap: bool) -> None:
        self._failures += 1
        reason = in_words(why)
        if reason not in self._reasons and len(self._reasons) < _REASONS_MAX:
            self._reasons.add(reason)
            _log.warning("%s: %s; trying again", self._name, reason)
        elif at_cap and not self._at_cap:
            self._at_cap = True
            _log.warning("%s: still %s; trying every %.3g s until it comes back", self._name, reason, delay_s)
        else:
            _log.debug("%s: %s; trying again in %.3g s", self._name, reason, delay_s)

    def end(self) -> None:
        if self._failures:
            _log.info("%s: up again after %d failed attempts", self._name, self._failures)
        self._failures, self._at_cap = 0, False
        self._reasons.clear()


class Repeated(NamedTuple):
    """Work that is done again and again, without a loop of its own: a task sleeps between, a simulation steps it."""

    name: str
    step: Callable[[], float]
    """Does what is due now, and returns the time until it is to be called again, s."""
    first_s: float = 0.0
    """Time until the first call, s."""

    async def run(self, clock: Clock) -> NoReturn:
        """Do it until cancelled."""
        wait_s = self.first_s
        while True:
            if wait_s > 0.0:
                await clock.sleep(wait_s)
            wait_s = self.step()


@asynccontextmanager
async def running_beside(tasks: Iterable[tuple[str, Coroutine[Any, Any, None]]]) -> AsyncIterator[None]:
    """Run each (name, coroutine) as a task until the block ends; then cancel the tasks and wait for them.

    Raises:
        Exception: the block's own error, as it is.
        ExceptionGroup: the errors of tasks, which also end the block.
    """
    failed: Exception | None = None
    async with asyncio.TaskGroup() as group:
        started = [group.create_task(body, name=name) for name, body in tasks]
        try:
            yield
        except Exception as why:
            failed = why
        finally:
            for task in started:
                task.cancel()
    if failed is not None:
        raise failed
