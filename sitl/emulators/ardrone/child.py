"""A simulated AR.Drone in a child process, as `decklander demo` flies it once."""

import asyncio
import json
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import AbstractContextManager, asynccontextmanager, nullcontext, suppress
from pathlib import Path

from msgspec import structs

from companion.base.health import Health
from companion.base.observer import Observer
from companion.guidance.pilot import Pilot
from companion.service.daemon import Daemon
from companion.settings.load import load
from companion.settings.model import Settings
from drivers.pyav import has_pyav
from estimator.contracts.errors import Recoverable
from sitl.ardrone.state import GENERATIONS
from sitl.emulators.ardrone.truth_log import read as read_truth
from sitl.scenario.scenario import Scenario, camera_model, with_ardrone1
from sitl.scenario.settings import in_world
from sitl.world.truth import Truth

_READY_S = 120.0
"""Longest time until the simulated vehicle has started."""
_KEEP_EACH = 4
"""Every fourth sample of the truth is kept: it comes at 100 Hz, and the report needs 25 Hz."""


_WITHOUT_VIDEO = (
    "an AR.Drone 1.0 flies, for PyAV is not installed; for the 2.0 with its sharper camera: pip install 'decklander[video]'"
)
"""Notice where nothing can decode the 2.0's H.264."""


def demo_vehicle(name: str, scenario: Scenario, seed: int, truth: Path, *, first: bool) -> "ArDroneInChild":
    """Return the AR.Drone of the scenario, or a 1.0 where nothing can decode the 2.0's H.264.

    Args:
        name: of the scenario, as its process reads it.
        truth: the file that its process writes its truth into.
        first: whether it is a 1.0 whatever the scenario says.

    Raises:
        BadInput: it does not go with the scenario's camera.
    """
    if scenario.vehicle.generation != "1.0" and not first and not has_pyav():
        sys.stderr.write(f"{_WITHOUT_VIDEO}\n")
        first = True
    scenario = with_ardrone1(scenario) if first else scenario
    GENERATIONS[scenario.vehicle.generation].check_camera(camera_model(scenario))
    return ArDroneInChild(name, scenario, seed, truth)


class ArDroneInChild:
    """An AR.Drone whose process writes its truth into a file, and prints its counters at the end.

    Args:
        name: of the scenario, as its process reads it.
    """

    def __init__(self, name: str, scenario: Scenario, seed: int, truth: Path) -> None:
        self.scenario, self._name, self._seed, self._truth = scenario, name, seed, truth
        self.frames_due = self.frames_sent = 0
        """Numbers of frames that it had to send and sent; known after it has ended, like `stood_still_s`."""
        self.stood_still_s = 0.0
        settings = in_world(scenario, load("sim"))  # nobody reports for the ship
        self.settings = structs.replace(settings, service=structs.replace(settings.service, health_period_s=0.0))

    def rendering(self) -> AbstractContextManager[None]:
        """Prepare nothing: its process renders."""
        return nullcontext()

    @asynccontextmanager
    async def flying(self) -> AsyncIterator[Settings]:
        """Run it as a child, which ends with this process, even if killed, since its standard input closes.

        Raises:
            Recoverable: it did not start.
        """
        ports = [f"--{name}-port=0" for name in ("navdata", "video", "at", "control")]
        first = ["--ardrone1"] if self.scenario.vehicle.generation == "1.0" else []
        child = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "sitl.emulators.ardrone.serve", self._name, f"--seed={self._seed}"),
            *(f"--truth={self._truth}", *ports, *first),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            process_group=0,  # Ctrl-C is for this process, and the drone ends with the flight
        )
        assert child.stdin is not None
        assert child.stdout is not None
        ready = False
        try:
            try:
                async with asyncio.timeout(_READY_S):
                    line = await child.stdout.readline()
            except TimeoutError as why:
                slow = f"the simulated drone did not start within {_READY_S:.0f} s: this machine is busy with something else"
                raise Recoverable(f"{slow}; decklander simulate needs no speed") from why
            if not line:
                raise Recoverable("the simulated drone ended before it was ready; see its output above")
            ready, own = True, {f"{name}_port": port for name, port in json.loads(line)["ports"].items()}
            vehicle = structs.replace(self.settings.vehicle, **own)
            yield structs.replace(self.settings, vehicle=vehicle)
        finally:
            if not ready:
                child.kill()  # before it is ready it does not see that its standard input closes
            child.stdin.close()
            printed, _ = await child.communicate()
        self.ended(printed)

    def ended(self, printed: bytes) -> None:
        """Read its last output; a process that was killed leaves none."""
        for line in printed.splitlines():
            with suppress(ValueError):
                words = json.loads(line)
                if words.get("event") == "ended":
                    self.frames_due, self.frames_sent = (words["counters"].get(f"video_{what}", 0) for what in ("due", "sent"))
                    self.stood_still_s = words["stood_still_s"]

    def observers(self, pilot: Pilot, health: Health) -> Sequence[Observer]:
        """Return none: it needs no observer of the service."""
        return ()

    def serve(self, daemon: Daemon) -> None:
        """Give it nothing: all comes by the vehicle's own ports."""

    def truth(self) -> Sequence[Truth]:
        """Return the true states that a recording keeps, in order of time; call it after its end."""
        truth = read_truth(self._truth)
        return (*truth[:-1:_KEEP_EACH], *truth[-1:])
