"""Perception by rendered frames and the real vision."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from companion.guidance.make_pilot import make_pilot
from companion.guidance.pilot import Pilot
from companion.settings.model import Settings
from estimator.contracts.estimates import PathName
from sitl.camera.render_worker import RenderWorker
from sitl.faults.fault import Fault
from sitl.perception.port import Level, PerceivedWorld
from sitl.world.truth import RenderedFrame


class Pixels:
    """Every frame is rendered and searched."""

    level: Level = "pixels"

    def pilot(self, settings: Settings, shadows: Sequence[PathName] = ()) -> Pilot:
        """Return the pilot that also flies a real drone."""
        return make_pilot(settings, shadows)

    def refuse(self, faults: Sequence[Fault]) -> None:
        """Refuse no fault: every one acts on rendered frames."""

    def begin(self, world: PerceivedWorld) -> None:
        """Begin a flight."""

    def expose(self, world: PerceivedWorld, worker: RenderWorker | None) -> Callable[[], RenderedFrame]:
        """Render the scene as it is now."""
        return world.expose(worker)
