"""The bottom camera where time is the physics' own: frames are developed and looked at while the world stands still."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass

from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp, after
from sitl.autopilots.body import Body
from sitl.autopilots.lock_step import LockStepClock
from sitl.world import RenderedFrame

_STAMP_SIGMA_S = 0.002
_NAP_S, _PATIENCE_S = 0.0005, 0.25


@dataclass(frozen=True, slots=True)
class CameraTiming:
    """How late frames are, in the flight's own time."""

    period_s: float = 1.0 / 30.0
    delay_s: float = 0.05
    """Delay from mid-exposure to the frame's arrival, for a camera on a short cable: half the exposure, read-out, driver."""
    vision_s: float = 0.03
    """Time that vision may take; the world waits for a slower machine."""


class LockStepCamera:
    """Takes frames of a body's deck while it is `on`.

    Args:
        offer: takes each frame when it has arrived.
        concluded: how many of them have been dealt with.
        pool: where frames are developed.
    """

    def __init__(
        self,
        clock: LockStepClock,
        offer: Callable[[Frame], object],
        concluded: Callable[[], int],
        pool: Executor,
        timing: CameraTiming | None = None,
    ) -> None:
        self.on = False
        self.frames = 0
        self.waited_out = 0
        """Times the world went on although a frame had not been dealt with in reasonable time."""
        self._clock, self._offer, self._concluded, self._pool = clock, offer, concluded, pool
        self._timing = timing or CameraTiming()
        self._due: MonoNs | None = None
        self._on_the_way: deque[tuple[MonoNs, asyncio.Future[RenderedFrame]]] = deque()
        self._looking_until: MonoNs | None = None

    def stepped(self, body: Body) -> None:
        """Call after each step of the physics."""
        now = self._clock.now()
        if not self.on or (self._due is not None and now < self._due):
            return
        self._due = after(self._due or now, self._timing.period_s)
        image = asyncio.get_running_loop().run_in_executor(self._pool, body.expose())
        self._on_the_way.append((now, image))

    async def settle(self) -> None:
        """Until every frame that should have arrived has, and those that should have been looked at were."""
        now = self._clock.now()
        while self._on_the_way and after(self._on_the_way[0][0], self._timing.delay_s) <= now:
            measured_at, developing = self._on_the_way.popleft()
            image = await developing
            self.frames += 1
            self._offer(Frame(Stamp(measured_at, now, _STAMP_SIGMA_S, "sim"), self.frames, image.px, image.exposure_s))
            self._looking_until = after(now, self._timing.vision_s)
        if self._looking_until is None or now < self._looking_until:
            return
        began = time.monotonic()
        while self._concluded() < self.frames:
            if time.monotonic() - began > _PATIENCE_S:
                # It may be waiting for time to go on.
                self.waited_out += 1
                return
            await asyncio.sleep(_NAP_S)
        self._looking_until = None
