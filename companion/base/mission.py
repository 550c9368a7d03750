"""The words of the mission: its states, its events, and a change of state. `companion.guidance.mission` has what follows what."""

from enum import Enum

from msgspec import Struct

from companion.base.reason import Reason
from estimator.contracts.time import MonoNs


class State(Enum):
    """Phases of the flight; the value is the phase that people read. `companion/guidance/mission` has a file for each."""

    # By identity: an enumeration's own hash is that of its name, and the tables here are read in every guidance cycle.
    __hash__ = object.__hash__

    STANDBY = "waiting for the vehicle and the start"
    WAIT = "waiting for the vehicle"
    READY = "waiting for the start"
    PAUSED = "paused"
    RENDEZVOUS = "rendezvous"
    SEARCH = "search"
    INTERCEPT = "intercept"
    DESCEND = "descend"
    GATE = "gate"
    COMMIT = "commit"
    PRESS = "press"
    DOWN = "down"
    HOLD_BLIND = "hold blind"
    GO_AROUND = "go around"
    ANOTHER_PAD = "another pad"
    LANDED = "landed"
    LANDED_BY_OTHERS = "landed by others"
    REFUSED = "refused"
    GAVE_UP = "gave up"
    ABORTED = "aborted"
    TAKEN = "taken over"
    EMERGENCY = "emergency"


class Event(Enum):
    """Events of the mission. Of several in one guidance cycle the one that is named first here is taken first."""

    __hash__ = object.__hash__

    CUT = "motors cut"
    GROUNDED = "on the ground after our order"
    GROUNDED_BY_OTHERS = "on the ground without our order"
    TAKEN_OFF = "taken off"
    """The vehicle flies, the first time or after it has stood."""
    TAKEN = "vehicle taken over"
    """The vehicle's mode is no longer the one in which it obeys: a failsafe or a person has it."""
    ABORT = "abort ordered"
    PAUSE = "pause ordered"
    BEGIN = "landing ordered"
    OTHER_PAD = "another pad seen"
    CONTACT = "contact"
    PRESSED = "pressed"
    NO_CONDITIONS = "conditions beyond the limits"
    """They will not pass within this flight."""
    HOPELESS = "no way on"
    """The allowance of this attempt or of this flight is used up."""
    LIMIT = "limit exceeded"
    """A limit ends this attempt."""
    TIMEOUT = "time over"
    BATTERY_ENDS = "battery ends"
    """The pad is in sight of a drone that refused or gave up, and its battery will not last."""
    SIGHT_LOST = "sight lost"
    SIGHT = "sight"
    """There is a fresh, consistent estimate of the pad."""
    VESSEL_FAR = "vessel far"
    ARRIVED = "arrived"
    CLEAR = "clear"
    """High enough to begin again, or to look again."""
    OUT_OF_CONE = "out of the cone"
    IN_CONE = "in the cone"
    AT_GATE = "at the gate"
    GATE_OPEN = "gate open"


class StateChange(Struct, frozen=True):
    """One change of state."""

    at: MonoNs
    source: State
    event: Event
    target: State
    reason: Reason


_STAYS_UP = (State.REFUSED, State.GAVE_UP, State.ABORTED)
GROUND = frozenset({State.STANDBY, State.WAIT, State.LANDED, State.LANDED_BY_OTHERS, State.EMERGENCY})
"""States in which guidance leaves the vehicle alone."""
ENDED = frozenset({State.LANDED, State.LANDED_BY_OTHERS, State.TAKEN, State.EMERGENCY, *_STAYS_UP})
"""States that end a flight; the next one begins when the vehicle has stood and flies again."""
FLOWN = frozenset(State) - GROUND - ENDED - {State.READY, State.PAUSED}
"""States in which the machine flies a landing."""
DESCENDS = frozenset({State.INTERCEPT, State.DESCEND, State.GATE, State.COMMIT, State.PRESS, State.DOWN})
"""States in which the drone may be commanded to come nearer to the deck."""
CONTACT_INTENDED = frozenset({State.COMMIT, State.PRESS, State.DOWN})
"""States in which the drone may touch the deck with its motors turning."""

FAULTS = frozenset(
    {
        Event.CUT,
        Event.GROUNDED_BY_OTHERS,
        Event.TAKEN,
        Event.OTHER_PAD,
        Event.NO_CONDITIONS,
        Event.HOPELESS,
        Event.LIMIT,
        Event.TIMEOUT,
        Event.SIGHT_LOST,
    }
)
"""Events that are shown to people as warnings."""


class FlightOutcome(Enum):
    """The outcome of a flight."""

    LANDED = State.LANDED.value
    """The vehicle reports that it is on the ground after our order to land."""
    LANDED_BY_OTHERS = State.LANDED_BY_OTHERS.value
    """The vehicle reports that it is on the ground without our order to land."""
    GAVE_UP = State.GAVE_UP.value
    """The pad was not found again, or the attempts are used up; the vehicle is held still."""
    REFUSED = State.REFUSED.value
    """The conditions are beyond the limits; the vehicle is held still."""
    TAKEN = State.TAKEN.value
    """A failsafe of the autopilot or a person took the vehicle."""
    EMERGENCY = State.EMERGENCY.value
    """The vehicle cut its motors."""
    ABORTED = State.ABORTED.value
    """The operator aborted the flight; the vehicle is held still."""


AGAIN = (FlightOutcome.GAVE_UP, FlightOutcome.REFUSED, FlightOutcome.TAKEN)
"""Outcomes after which the operator may begin again in the air."""
REFUSALS = (FlightOutcome.GAVE_UP, FlightOutcome.REFUSED)
"""Outcomes in which it did not land by its own decision."""
