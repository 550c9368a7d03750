"""The port of a flight in virtual time that is stepped from outside, and the way to make one of the settings' kind of vehicle."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from msgspec import Struct

from companion.base.health import Health
from companion.base.observer import Observer
from companion.guidance.pilot import Pilot
from companion.settings.capabilities import vehicle_kind
from companion.settings.model import Settings
from estimator.contracts.errors import BadInput
from estimator.contracts.tables import imported
from sitl.camera.render_worker import RenderWorker
from sitl.flight.afterwards import Afterwards
from sitl.flight.ending import Ending
from sitl.flight.service import VISION_S
from sitl.perception.port import Perception
from sitl.scenario.scenario import Scenario
from sitl.world.world import World


class Timing(Struct, frozen=True):
    """The delays of the simulated service."""

    frame_period_s: float | None = None
    """None: as the vehicle is configured."""
    frame_delay_s: float = 0.09
    """Delay from mid-exposure to the frame's arrival: half the exposure, encoder, link, decoder."""
    vision_s: float = VISION_S
    """Time that vision takes for a frame."""


class SteppedFlight(Protocol):
    """A flight of a vehicle with frames of its own."""

    world: World
    health: Health
    worker: RenderWorker | None
    """Makes the frames, where one is set before the first step; else they are made in place. The same bits either way."""
    contained: bool
    """True if a bug of the service ends the flight and is part of the result, instead of being raised."""
    exposures: int
    """Number of frames exposed so far, whether they arrive or not."""

    @property
    def pilot(self) -> Pilot:
        """The service's."""
        ...

    def unwatched(self) -> None:
        """Leave the results of samples out of health: without observers either, none are made."""
        ...

    def step(self) -> bool:
        """Run one tick of 5 ms; return False when the flight is over."""
        ...

    def result(self) -> Ending:
        """Return the result of the flight: final if it has ended, else the result so far."""
        ...

    def afterwards(self) -> Afterwards:
        """Go on after the outcome, and return what came of it."""
        ...


def new_flight(
    scenario: Scenario,
    seed: int,
    settings: Settings,
    pilot: Pilot,
    *,
    observers: Sequence[Observer] = (),
    timing: Timing | None = None,
    renew: Callable[[], Pilot] | None = None,
    perception: Perception | None = None,
) -> SteppedFlight:
    """Return a flight of the settings' kind of vehicle.

    Args:
        observers: objects that receive what the daemon's observers would receive.
        renew: makes the pilot of a service that restarts after it was killed.
        perception: the way in which the pilot, which must be its own, perceives the pad; rendered frames if None.

    Raises:
        BadInput: no vehicle of this kind flies so, or it is not installed; or the scenario has what the vehicle, the perception
            or this flight cannot represent.
        SetupImpossible: the simulated vehicle refuses its setup.
    """
    vehicle = settings.vehicle
    if not (flight := vehicle_kind(vehicle.kind).flight):
        raise BadInput(f'vehicle.kind = "{vehicle.kind}": it flies by --autopilot')
    make: Any = imported(flight)
    flown: SteppedFlight = make(
        scenario, seed, settings, pilot, observers=observers, timing=timing, renew=renew, perception=perception
    )
    return flown
