"""The levels at which a flight perceives the pad, and the one by rendered frames and the real vision."""

from collections.abc import Callable, Sequence
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from companion.guidance.pilot import Pilot, make_pilot
from companion.settings.model import Settings
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import PathName
from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from sitl.camera.camera import Exposure
from sitl.camera.render_worker import RenderWorker
from sitl.faults.fault import Corrupted, Corruptions, Fault, FaultTimer
from sitl.scenario.scenario import Scenario
from sitl.vessel.vessel import Mounted, Vessel
from sitl.world.truth import RenderedFrame, Truth

Level = Literal["pixels", "model", "truth"]
LEVELS: tuple[Level, ...] = ("pixels", "model", "truth")


class PerceivedWorld(Protocol):
    """Interface of a flight's world that a perception needs."""

    scenario: Scenario
    seed: int
    pad: Pad
    camera: Camera
    faults: FaultTimer
    corruptions: Corruptions
    vessel: Vessel

    def truth(self) -> Truth:
        """Return the true state at the newest step."""
        ...

    def pad_motion(self) -> Mounted:
        """Return the pad's true motion at the newest step, with shapes (3,) and (3, 3)."""
        ...

    def pad_ahead(self, ahead_s: F64) -> Mounted:
        """Return the pad's true motion at (H,) s after the newest step."""
        ...

    def expose(
        self, worker: RenderWorker | None = None, camera: Callable[[Exposure | None, int], NDArray[np.uint8]] | None = None
    ) -> Callable[[], RenderedFrame]:
        """Fix the scene now, and return the call that makes the frame; `camera` replaces the renderer."""
        ...


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

    def begin(self, world: PerceivedWorld) -> None:
        """Begin a flight in this world.

        Raises:
            BadInput: as `refuse`, of the scenario's faults.
        """
        self.refuse(world.scenario.faults)

    def expose(self, world: PerceivedWorld, worker: RenderWorker | None = None) -> Callable[[], RenderedFrame]:
        """Expose a frame now; the call that comes back makes it when it arrives."""
        return world.expose(worker)
