"""Lifetimes. The outside world failing restarts one part; a bug of ours takes the whole group down, loudly."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass

from companion.health import Health
from estimator.contracts.errors import Recoverable
from estimator.contracts.ports import Clock
from estimator.contracts.time import seconds_between

log = logging.getLogger(__name__)

Body = Callable[[], Awaitable[None]]


@dataclass(frozen=True, slots=True)
class Restart:
    """How long a failed part rests: `first_s`, then `factor` times longer each time up to `cap_s`.

    A part that stayed up for `healthy_after_s` starts over with `first_s`.
    """

    first_s: float = 0.2
    factor: float = 2.0
    cap_s: float = 5.0
    healthy_after_s: float = 5.0


async def keep_alive(name: str, body: Body, policy: Restart, health: Health, clock: Clock) -> None:
    """Run `body` again after each `Recoverable`; anything else propagates. A body that returns is done for good."""
    delay_s = policy.first_s
    while True:
        began = clock.now()
        try:
            health.up(name)
            await body()
            return
        except* Recoverable as group:
            why = _first(group)
            health.down(name, why)
            log.warning("%s failed and will be restarted: %s", name, why)
        if seconds_between(began, clock.now()) >= policy.healthy_after_s:
            delay_s = policy.first_s
        await clock.sleep(delay_s)
        delay_s = min(delay_s * policy.factor, policy.cap_s)


async def run(
    parts: Mapping[str, Body], policy: Restart, health: Health, clock: Clock, until: asyncio.Event | None = None
) -> None:
    """All parts under one TaskGroup until each has returned, `until` is set, one has failed for good, or we are cancelled.

    Raises:
        ExceptionGroup: whatever escaped a part other than `Recoverable`.
    """
    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(keep_alive(name, body, policy, health, clock), name=name) for name, body in parts.items()]
        if until is not None:
            await until.wait()
            for task in tasks:
                task.cancel()


def _first(group: BaseExceptionGroup[Recoverable]) -> Recoverable:
    error: BaseException = group
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    assert isinstance(error, Recoverable)
    return error
