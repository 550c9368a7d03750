"""Fly a body with a stand-in in this process, in the lock step of the physics, over the same MAVLink links as a program."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from drivers.mavlink.endpoint import parse_endpoint
from drivers.mavlink.links import LinkOptions, open_links
from sitl.emulators.autopilots.body import Body
from sitl.emulators.autopilots.lock_step import LockStepClock
from sitl.emulators.autopilots.stand_in.base import StandIn

STEP_S = 0.004
"""Step of the physics and of the loops, s."""


class StandInProgram:
    """A stand-in in the place of a running program: it never ends by itself."""

    last_line = "it is a stand-in and prints nothing"

    @staticmethod
    async def ended() -> None:
        """Wait for ever."""
        await asyncio.Event().wait()


@asynccontextmanager
async def flying(
    stand_in: StandIn,
    body: Body,
    clock: LockStepClock,
    urls: tuple[str, str],
    stepped: Callable[[Body], None],
    settle: Callable[[], Awaitable[None]],
) -> AsyncIterator[StandInProgram]:
    """Step body and stand-in while the context is open.

    Args:
        urls: the links of its two MAVLink ports.
        stepped: called after each step.
        settle: awaited after each step.
    """

    async def step() -> None:
        while True:
            body.step(stand_in.step(body.state()))
            stepped(body)
            await settle()

    options = [LinkOptions(parse_endpoint(url)) for url in urls]
    async with open_links(options, clock, (stand_in.system, 1)) as links, asyncio.TaskGroup() as group:
        stand_in.links = links
        tasks = [group.create_task(stand_in._live()), group.create_task(stand_in._read(links)), group.create_task(step())]
        try:
            yield StandInProgram()
        finally:
            for task in tasks:
                task.cancel()
