"""The port between a flight and the way in which it perceives the pad."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, Protocol

from companion.config.model import Settings
from companion.runtime.pilot import Pilot
from estimator.contracts.estimates import PathName
from sitl.fault import Fault
from sitl.render_worker import RenderWorker
from sitl.truth import RenderedFrame
from sitl.world import World

Level = Literal["pixels", "model", "truth"]
LEVELS: tuple[Level, ...] = ("pixels", "model", "truth")


class Perception(Protocol):
    """One level of perception, for one flight.

    A flight asks it for the service's pilot, tells it of the world, and exposes every frame through it; what comes back is a
    frame like any other, and the pilot takes it like any other.
    """

    @property
    def level(self) -> Level: ...

    def pilot(self, settings: Settings, shadows: Sequence[PathName] = ()) -> Pilot:
        """Return a new pilot that perceives at this level.

        Raises:
            BadInput: the camera or pad file is missing or has a fault.
        """
        ...

    def refuse(self, faults: Sequence[Fault]) -> None:
        """Refuse faults that this level cannot represent.

        Raises:
            BadInput: there is one; the text names it.
        """
        ...

    def begin(self, world: World) -> None:
        """Begin a flight in this world.

        Raises:
            BadInput: the scenario has a fault that this level cannot represent; the text names it.
        """
        ...

    def expose(self, world: World, worker: RenderWorker | None) -> Callable[[], RenderedFrame]:
        """Expose a frame now; the call that comes back makes it when it arrives."""
        ...
