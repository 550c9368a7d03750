"""The MAVLink face as a part of the service: its links, an observer of the drone, and a supervised body."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence

from companion.mavlink.face import Face
from companion.observer import Silent
from drivers.mavlink.dialect import mav
from drivers.mavlink.links import LinkOptions, Links, open_links
from estimator.contracts.commands import Command
from estimator.contracts.errors import Recoverable
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Sample

_TICK_S = 0.02


class FacePart(Silent):
    """See the module.

    Args:
        links: where ground stations are.
        system: MAVLink system id of the drone.
    """

    def __init__(self, links: Sequence[LinkOptions], system: int, clock: Clock) -> None:
        self._options = tuple(links)
        self._system = system
        self._clock = clock
        self._face: Face | None = None
        self.taker: Callable[[Command], None] | None = None
        """The open link's `command`; whoever opens the link sets it and takes it away again."""

    def command(self, command: Command) -> None:
        """To the drone.

        Raises:
            Recoverable: its link is not open.
        """
        if self.taker is None:
            raise Recoverable("the drone is not there")
        self.taker(command)

    def on_sample(self, sample: Sample) -> None:
        if self._face is not None:
            self._face.on_sample(sample)

    async def run(self) -> None:
        """For ever; the links come back by themselves."""
        identity = (self._system, int(mav.MAV_COMP_ID_ONBOARD_COMPUTER))
        async with open_links(self._options, self._clock, identity) as links, asyncio.TaskGroup() as group:
            self._face = face = Face(links.send, self.command)
            try:
                listening = group.create_task(self._listen(face, links))
                while not listening.done():
                    face.tick(self._clock.now())
                    await self._clock.sleep(_TICK_S)
            finally:
                self._face = None

    async def _listen(self, face: Face, links: Links) -> None:
        async for heard in links.heard:
            face.hear(heard, self._system, self._clock.now())
