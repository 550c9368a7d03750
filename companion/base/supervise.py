"""Supervise the service's parts in two fault domains.

A vital part (the vehicle with vision and the filter; guidance) is restarted after a failure of the outside world. A bug of ours
ends it and the whole group with an error, and the process manager restarts the process. A part beside the flight (recorder,
links to people, metrics, the pulse for systemd) may fail in any way: it is restarted with growing back-off, and given up if
that does not help. The vital parts are not affected.
"""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping

from companion.base.containment import report
from companion.base.health import Health
from companion.settings.service import RestartOptions
from drivers.reconnect import BackOff, reconnect
from estimator.contracts.errors import Recoverable, in_words
from estimator.contracts.time import Clock, seconds_between

log = logging.getLogger(__name__)

Body = Callable[[], Awaitable[None]]

CLOSE_S = 1.0
"""Time that the parts beside the flight have to end, once the vital ones have ended."""


def _back_off(policy: RestartOptions) -> BackOff:
    return BackOff(policy.restart_first_s, policy.restart_cap_s, policy.restart_healthy_after_s, policy.restart_factor)


async def keep_alive(name: str, body: Body, policy: RestartOptions, health: Health, clock: Clock) -> None:
    """Run a vital `body` again after each `Recoverable`; anything else propagates. A body that returns has finished."""

    async def attempt() -> None:
        health.up(name)
        await uncancelled(name, body)

    await reconnect(name, attempt, _back_off(policy), clock, lambda why: health.down(name, why), (Recoverable,))


async def contain(name: str, body: Body, policy: RestartOptions, health: Health, clock: Clock) -> None:
    """Run a `body` beside the flight again after any error. This raises nothing but its own cancellation.

    An error that does not come from the outside world (`Recoverable`, `OSError`) is logged with its traceback the first time, and
    `policy.restart_give_up_after` of them in a row end the part for good. A body that returns has finished.
    """
    in_a_row = 0

    async def attempt() -> None:
        nonlocal in_a_row
        began = clock.now()
        try:
            health.up(name)
            await uncancelled(name, body)
            return
        except asyncio.CancelledError:
            raise
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            why = error
        if _cancelled():  # it failed while it was being cancelled
            report("%s failed while it ended", name, why=why)
            raise asyncio.CancelledError from why
        if seconds_between(began, clock.now()) >= policy.restart_healthy_after_s:
            in_a_row = 0
        if not _of_the_world(why):
            in_a_row += 1
            if health.contain(name) == 1:
                report("%s failed and will be restarted; the flight goes on", name, why=why)
        if in_a_row >= policy.restart_give_up_after:
            words = f"off after {in_a_row} failures: {in_words(why)}"
            health.down(name, RuntimeError(words))
            log.error("%s is %s", name, words)
            return
        raise Recoverable(in_words(why)) from why

    await reconnect(name, attempt, _back_off(policy), clock, lambda why: health.down(name, why))


async def run(
    parts: Mapping[str, Body],
    policy: RestartOptions,
    health: Health,
    clock: Clock,
    until: asyncio.Event | None = None,
    beside: Mapping[str, Body] | None = None,
) -> None:
    """Run all parts until each vital one has returned, `until` is set, a vital one has failed for good, or we are cancelled.

    The vital parts end first, so that the vehicle gets its final hover burst whatever the others do; those then have `CLOSE_S`.

    Args:
        parts: the vital parts, by name.
        beside: the parts that the flight does not need, by name.

    Raises:
        ExceptionGroup: a vital part raised something other than `Recoverable`.
    """
    for name in parts:
        health.vital(name)
    others = [asyncio.create_task(contain(name, body, policy, health, clock), name=name) for name, body in (beside or {}).items()]
    try:
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(keep_alive(name, body, policy, health, clock), name=name) for name, body in parts.items()]
            if until is not None:
                await until.wait()
                for task in tasks:
                    task.cancel()
    finally:
        await _close(others)


async def uncancelled(name: str, body: Body) -> None:
    """Run `body`, and treat a cancellation that nobody requested as a fault: a TaskGroup would take it for an orderly end.

    `sys.exit` in the body or in one of its tasks is a fault too: it would end the process silently, and with exit code 0.
    A task's `SystemExit` arrives here only with the loop of `companion.base.event_loop`; asyncio's own loop breaks.

    Raises:
        RuntimeError: the body was cancelled by none of us, or called `sys.exit`.
    """
    try:
        await body()
    except SystemExit as why:
        raise RuntimeError(f"{name} called sys.exit({why.code!r})") from why
    except asyncio.CancelledError as why:
        if _cancelled():
            raise
        raise RuntimeError(f"{name} was cancelled by none of us") from why


async def _close(tasks: list[asyncio.Task[None]]) -> None:
    for task in tasks:
        task.cancel()
    if tasks:
        _, left = await asyncio.wait(tasks, timeout=CLOSE_S)
        for task in left:
            log.error("%s did not end within %.1f s and is abandoned", task.get_name(), CLOSE_S)


def _cancelled() -> bool:
    task = asyncio.current_task()
    return task is not None and task.cancelling() > 0


def _of_the_world(error: BaseException) -> bool:
    if isinstance(error, BaseExceptionGroup):
        return all(_of_the_world(one) for one in error.exceptions)
    return isinstance(error, (Recoverable, OSError))
