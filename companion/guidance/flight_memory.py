"""Keep the state of a flight for the service that takes over in the air if this one dies.

A new process finds a vehicle that flies and knows neither who ordered what nor how high the deck is. Before it decides it reads
the range sensor and the vehicle's reports as always, and this: a landing that was under way goes on, from the search; one where
it is goes on down, to the place that was meant; a vehicle that was let down to the deck and stands has landed; a hold or an abort
of a person stays one; a height that was large enough spares a climb; and the ship is followed by the way that she kept. A vehicle
that a person had, or that is in another mode than it was left in, is a person's until he orders to begin: he may have chosen that
mode while no service watched.
"""

from collections.abc import Mapping

from msgspec import Struct, structs

from companion.base.mission import CONTACT_INTENDED, FLOWN, GROUND, Event, State
from companion.guidance.mission.out_of_reach import height_m
from companion.guidance.mission.progress import GuidanceCycle, Progress
from estimator.contracts.time import MonoNs, seconds_between

OLD_S = 30.0
"""Age up to which it is used, s: a service manager restarts a service within seconds; later a person has acted."""
KEPT_WAY_S = 300.0
"""Time for which a ship that is not seen and reports nothing is taken to keep her way, s."""
_NEARER_M_S = 0.5
"""Speed with which a deck may have come nearer to a vehicle that hovered meanwhile, m/s."""
_RESUMES: Mapping[State, Event] = dict.fromkeys(FLOWN, Event.BEGIN) | {
    State.PAUSED: Event.HOLD,
    State.ABORTED: Event.ABORT,
    State.TAKEN: Event.TAKEN,
    State.LAND_HERE: Event.LAND,
}
"""Events that lead a flight that is found in the air to where it was; states that are not named begin as the settings say."""


class FlightMemory(Struct, frozen=True):
    """The state of a flight at an instant."""

    at: MonoNs
    """Instant by a clock that outlives the service."""
    state: str
    """Name of the mission's state."""
    begun: bool
    """A landing was requested in this flight."""
    height_m: float | None = None
    """Least height over the deck; None if it is not known."""
    modes: tuple[str, ...] = ()
    """Modes of a vehicle that has not been taken since; empty where modes do not say who has it."""
    stays: bool = False
    """The order was to stay over the pad, not to land."""
    here: tuple[float, float] | None = None
    """Place that it comes down to where it lands where it is, as `Here.at_pad`."""
    way_ned: tuple[float, float] | None = None
    """The ship's way over the ground as measured beside an autopilot, m/s north and east; None if it is not known."""


def memory_of(p: Progress, s: GuidanceCycle) -> FlightMemory:
    """Return what to keep of a guidance cycle."""
    state = State.LAND_HERE if p.lands_here else p.state
    return FlightMemory(s.at, state.name, p.begun, height_m(p, s), stays=p.stays, here=None if p.here is None else p.here.at_pad)


def resumed_by(memory: FlightMemory | None, now: MonoNs, mode: str) -> Event | None:
    """Return the event that resumes the flight; None where the memory is too old, from the future, or says nothing.

    Args:
        mode: that the vehicle is found in.
    """
    if memory is None or not 0.0 <= seconds_between(memory.at, now) <= OLD_S or memory.state not in State.__members__:
        return None
    state = State[memory.state]
    if memory.modes and mode not in memory.modes and state not in GROUND:
        return Event.TAKEN
    return _RESUMES.get(state)


def carried_on(p: Progress, memory: FlightMemory, now: MonoNs, *, taken: bool) -> Progress:
    """Return the memory of the mission with what was requested, and the height that is left of the one that was known.

    Args:
        taken: whether a person has the vehicle, so that nothing is requested any more.
    """
    ordered = not taken and State[memory.state] in CONTACT_INTENDED
    p = structs.replace(p, begun=memory.begun and not taken, stays=memory.stays, ordered=ordered)
    if p.here is not None:
        p = structs.replace(p, here=structs.replace(p.here, at_pad=memory.here))
    if memory.height_m is None:
        return p
    return structs.replace(p, seen_height_m=max(0.0, memory.height_m - _NEARER_M_S * seconds_between(memory.at, now)))
