"""The bottom camera on the physics' own time: frames are rendered and processed while the simulated world stands still."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass

from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp, after
from sitl.emulators.autopilots.body import Body
from sitl.emulators.autopilots.lock_step import LockStepClock
from sitl.faults.faulty_streams import FaultyStream, InTransit
from sitl.world.truth import RenderedFrame

_STAMP_SIGMA_S = 0.002
_NAP_S = 0.0005
_TURNS = 40
"""Turns of the event loop after which a service that has a frame and does not look at it waits for the time to go on."""


@dataclass(frozen=True, slots=True)
class CameraTiming:
    """Delays of frames in the flight's own time."""

    period_s: float = 1.0 / 30.0
    delay_s: float = 0.05
    """Delay from mid-exposure to the frame's arrival, s: half the exposure, read-out and driver of a camera on a short cable."""
    vision_s: float = 0.03
    """Time that vision takes in the flight, s; the world waits for a slower machine."""


class LockStepCamera:
    """Takes frames of a body's deck while it is `on`.

    Args:
        offer: receives each frame when it has arrived.
        concluded: returns how many of the frames were processed.
        looking: returns whether vision is at work; the world stands still meanwhile, however long it takes.
        pool: executor that renders frames.
        stream: what becomes of the frames on their way.
        expose: fixes the scene of a body and returns the function that makes its frame.
    """

    def __init__(
        self,
        clock: LockStepClock,
        offer: Callable[[Frame], object],
        concluded: Callable[[], int],
        looking: Callable[[], bool],
        pool: Executor,
        stream: FaultyStream,
        timing: CameraTiming | None = None,
        expose: Callable[[Body], Callable[[], RenderedFrame]] = Body.expose,
    ) -> None:
        self.on = False
        self.frames = self.exposures = 0
        self.waited_out = 0
        """Number of times that the world went on although a frame was not processed, because the service waits for the time."""
        self._clock, self._offer, self._pool = clock, offer, pool
        self._concluded, self._looking = concluded, looking
        self._timing, self._expose = timing or CameraTiming(), expose
        self._due: MonoNs | None = None
        self._on_the_way: InTransit[tuple[MonoNs, asyncio.Future[RenderedFrame]]] = InTransit(stream)
        self._looking_until: MonoNs | None = None

    @property
    def period_s(self) -> float:
        """Time between two frames, s."""
        return self._timing.period_s

    def stepped(self, body: Body) -> None:
        """Note a step of the physics; call it after each one."""
        now = self._clock.now()
        if not self.on or (self._due is not None and now < self._due):
            return
        self._due = after(self._due or now, self._timing.period_s)
        self.exposures += 1

        def exposed() -> tuple[MonoNs, asyncio.Future[RenderedFrame]]:
            return now, asyncio.get_running_loop().run_in_executor(self._pool, self._expose(body))

        self._on_the_way.send(exposed, now, self._timing.delay_s)

    async def settle(self) -> None:
        """Wait until every due frame has arrived and every frame due to be processed was processed."""
        now = self._clock.now()
        while (arrived := self._on_the_way.arrived(now)) is not None:
            measured_at, developing = arrived[1]
            image = await developing
            self.frames += 1
            stamp = Stamp(measured_at, now, _STAMP_SIGMA_S, "sim")
            self._offer(Frame(stamp, self.frames, image.px, image.exposure_s, image.gain))
            self._looking_until = after(now, self._timing.vision_s)
        if self._looking_until is None or now < self._looking_until:
            return
        turns = 0
        while self._concluded() < self.frames:
            if self._looking():
                turns = 0
                await asyncio.sleep(_NAP_S)
                continue
            turns += 1
            if turns > _TURNS:
                self.waited_out += 1
                return
            await asyncio.sleep(0)
        self._looking_until = None
