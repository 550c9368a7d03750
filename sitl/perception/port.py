"""The levels at which a flight perceives the pad, and the one by rendered frames and the real vision."""

from collections.abc import Callable, Sequence
from typing import Literal

from companion.guidance.pilot import Pilot, make_pilot
from companion.settings.model import Settings
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import PathName
from sitl.camera.render_worker import RenderWorker
from sitl.faults.corrupted import Corrupted
from sitl.faults.fault import Fault
from sitl.world.truth import RenderedFrame
from sitl.world.world import World

Level = Literal["pixels", "model", "truth"]
LEVELS: tuple[Level, ...] = ("pixels", "model", "truth")


class Perception:
    """One level of perception, for one flight: at this one every frame is rendered and searched.

    A flight gets the service's pilot from it, gives it the world, and exposes every frame through it; what comes back is a
    frame like any other, and the pilot takes it like any other.
    """

    level: Level = "pixels"

    def pilot(self, settings: Settings, shadows: Sequence[PathName] = ()) -> Pilot:
        """Return a new pilot that perceives at this level; at this one it is the pilot that also flies a real drone.

        Raises:
            BadInput: the camera or pad file is missing or has a fault, or there is no error model of the settings' vision.
        """
        return make_pilot(settings, shadows)

    def refuse(self, faults: Sequence[Fault]) -> None:
        """Refuse faults that this level cannot represent: corrupted sightings, which vision makes and nobody draws.

        Raises:
            BadInput: there is one; the text names it.
        """
        if any(isinstance(fault, Corrupted) and fault.signal == "sighting" for fault in faults):
            raise BadInput("corrupted sightings are of drawn detections only; use --perception model")

    def begin(self, world: World) -> None:
        """Begin a flight in this world.

        Raises:
            BadInput: as `refuse`, of the scenario's faults.
        """
        self.refuse(world.scenario.faults)

    def expose(self, world: World, worker: RenderWorker | None = None) -> Callable[[], RenderedFrame]:
        """Expose a frame now; the call that comes back makes it when it arrives."""
        return world.expose(worker)
