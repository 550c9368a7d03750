"""The words of the mission: its states, its events, and a change of state. `companion.guidance.mission` has what follows what.

The reasons of changes are data: a cause, what was measured, the limit it is compared with. Text is made from them last.
"""

from enum import Enum

from msgspec import Struct

from estimator.contracts.estimates import IntegrityAlert, Verdict
from estimator.contracts.time import MonoNs


class ReasonCause(Enum):
    """Reason for a change of state; the value is the text for the operator, with places for the numbers."""

    VEHICLE_FLIES = "the vehicle flies"
    VEHICLE_STANDS = "the vehicle stands on the ground"
    MOTORS_CUT = "the vehicle cut its motors"
    TAKEN_OVER = "{detail:s}"
    GIVEN_BACK = "the vehicle was given back"
    OPERATOR = "by the operator's order"
    SERVICE = "by the service's own watch: {detail:s}"
    AUTOMATIC = "the settings say to begin by itself"
    RESTARTED = "the service came back {measured:.1f} s after its last record: {detail:s}"

    PAD_SEEN = "the pad is in sight at {measured:.1f} m"
    ARRIVED = "{measured:.2f} m beside the axis, {limit:.2f} m is the cone's radius here"
    OUT_OF_CONE = "{measured:.2f} m beside the axis, beyond the cone's {limit:.2f} m"
    LOW_ENOUGH = "{measured:.2f} m over the deck"
    ALL_LIMITS_HOLD = "all limits hold"
    AWAITS_PILOT = "the pad is sent to the autopilot: choose its landing mode"
    PILOT_LANDS = "the pilot chose {detail:s}"
    NOT_IN_MODE = "the autopilot did not take its landing mode within {measured:.0f} s: mode {detail:s}"
    FELT = "contact felt, a step of {measured:.1f} m/s^2"
    TURNED_ABOUT = "contact: the deck holds a foot, it turned by {measured:.0f} degrees a second"
    HELD_UP = "contact: held up by {measured:.1f} m/s against the commands"
    REACHED = "contact: by sight and what was reckoned since, the feet are {measured:.2f} m over the deck"
    PRESSED = "pressed on for {measured:.1f} s"
    HIGH_ENOUGH = "at least {measured:.1f} m over the deck"
    STAYED = "stayed over the pad for {measured:.0f} s (limit {limit:g} s)"
    VESSEL_FAR = "the vessel was {measured:.0f} m away"
    VESSEL_AWAY = "the vessel is {measured:.0f} m away"
    VESSEL_NEAR = "at the hold-off point, {measured:.0f} m from the pad"

    NO_OWN_PLACE = "no rendezvous: the drone does not know its own place (no GNSS)"
    NO_OWN_HEADING = "no rendezvous: the drone does not know its own heading"
    VESSEL_SILENT = "no rendezvous: the ship reports no place"
    VESSEL_OLD = "no rendezvous: the ship's newest place is {measured:.1f} s old (limit {limit:g} s)"
    VESSEL_LATE = "no rendezvous: the ship's reports come too late"
    VESSEL_JUMPED = "no rendezvous: the ship's reported place jumped"
    VESSEL_TOO_FAST = "no rendezvous: the ship reports a speed that she cannot have"
    VESSEL_SIGMA = "no rendezvous: the ship's place is known to {measured:.0f} m (limit {limit:g} m)"

    STALE = "the pad was not seen for {measured:.1f} s (limit {limit:g} s)"
    INCONSISTENT = "the sightings contradict the estimate"
    ALERT = "{detail}"
    NO_ESTIMATE = "there is no estimate of the pad"
    ANOTHER_PAD = "the pad is seen in another place, which no motion explains"
    NOBODY_DECIDED = "the pad is seen in another place, which no motion explains, and no operator confirmed it within {limit:g} s"
    LOST_LOW = "the pad was lost at {measured:.1f} m"
    NOT_FOUND = "the pad was not found within {limit:g} s"
    NOT_FOUND_AGAIN = "the pad was not found again within {limit:g} s"
    FRAMES = "{measured:.0f} % of frames {detail}"
    FRAMES_UNSEEN = "{measured:.0f} % of frames {detail}; {limit:.0f} % of those that were searched show no pad"

    TRY_TIME = "no landing within {limit:g} s"
    LANDING_TIME = "no landing within {limit:g} s, all tries together"
    LOW_TIME = "low over the deck for {measured:.0f} s without a landing (limit {limit:g} s, all tries together)"
    STATE_TIME = "no progress within {limit:g} s"
    LOSSES = "the pad was lost {measured:.0f} times in one descent (limit {limit:g})"
    SWEPT = "swept out of the cone near the deck {measured:.0f} times (limit {limit:g})"
    BLIND_DESCENT = "{measured:.2f} m lower without sight of the pad (limit {limit:g} m)"
    NO_LANDING = "no landing was reported within {limit:g} s"
    NO_CONTACT = "no contact was felt within {limit:g} s"
    FEET = "the feet touch {measured:.0f} cm above where guidance.cone.feet_below_m puts them, in {limit:g} tries"
    LENS = "the lens is {measured:.0f} cm from where the camera's file has it: {detail} (p_body_cam_m)"
    ROSE = "it rose by {measured:.2f} m instead of landing"
    OFF_DECK = "after the contact it is {measured:.2f} m over the deck again (limit {limit:.2f} m)"
    DRIFTED = "it drifted {measured:.2f} m off the pad while landing (limit {limit:.2f} m)"
    PAST_DECK = "it came down {measured:.2f} m past the deck"
    NOT_CLIMBING = "it did not climb within {limit:.0f} s"
    ROSE_AGAINST = "ordered down it rose by {measured:.1f} m within {limit:g} s"
    SANK_AGAINST = "against its order it sank by {measured:.1f} m within {limit:g} s"
    ANSWERS_LATE = "the vehicle answers {measured:.2f} s late (limit {limit:g} s)"
    OFF_ORDERS = "the vehicle flies {measured:.1f} m {detail} than ordered (limit {limit:g} m): something else steers it"
    UNCONFIRMED = "up to {measured:.0f} m flown unseen by a velocity that nothing confirms (limit {limit:g} m)"
    UNCHECKED = "up to {measured:.0f} m flown unseen: it holds by itself to check its velocity (limit {limit:g} m)"
    MOVES_IN_HOLD = "it holds by itself, and its velocity says {measured:.1f} m/s (limit {limit:g} m/s)"
    OFF_POSITION = "its velocity is {measured:.1f} m/s off its positions (limit {limit:g} m/s)"
    DOUBTFUL = "its velocity may be {measured:.1f} m/s off (limit {limit:g} m/s)"
    TIPPED = "it lies on what it touched, tilted by {measured:.0f} degrees (limit {limit:.0f}): its motors are stopped"
    STARVED = "guidance stood still for {measured:.1f} s of this try (limit {limit:g} s)"

    ON_PAD = "something {measured:.0f} cm wide lies {detail} from the pad's centre"
    GLARE = "{measured:.0f} % of the pad is in glare or overexposed: what lies there cannot be seen"
    NEAR_PAD = "something {detail} {measured:.1f} m from the pad's centre"
    ERROR = "{measured:.2f} m off the centre (limit {limit:g} m)"
    ERROR_AHEAD = "{measured:.2f} m off the centre at the contact to come (limit {limit:g} m)"
    SPEED_AHEAD = "{measured:.2f} m/s along the deck at the contact to come (limit {limit:g} m/s)"
    VIDEO_LATE = "video is {measured:.2f} s late: {limit:.1f} cm expected at the contact"
    SIGMA = "the place is known to {measured:.3f} m (limit {limit:g} m)"
    RELATIVE_SPEED = "{measured:.2f} m/s against the deck (limit {limit:g} m/s)"
    DECK_TILT = "the deck tilts by {measured:.1f} deg (limit {limit:g} deg)"
    DECK_RATE = "the deck moves at {measured:.2f} m/s (limit {limit:g} m/s)"
    DECK_RISE = "the deck will rise {measured:.2f} m more than the drone can climb (limit {limit:g} m)"
    DECK_FALL = "the deck will fall at {measured:.2f} m/s when the drone stands on it (limit {limit:g} m/s)"
    SIGHTING_AGE = "the newest sighting is {measured:.2f} s old (limit {limit:g} s)"
    NIS = "innovations are {measured:.1f} times their claimed size (limit {limit:g})"
    TIME_LOCK = "the frames' time is known to {measured:.3f} s (limit {limit:g} s)"
    HEADING = "the heading is {measured:.0f} deg off the arrow (limit {limit:g} deg)"
    HEADING_TURNED = "the arrow turned by {measured:.0f} deg between two estimates"
    WIND = "{measured:.1f} m/s of wind over the drone {detail}: its tilt can fly {limit:.1f} m/s"
    GUST = "a gust began, {measured:.1f} m/s off the mean wind (usual: {limit:.1f} m/s)"
    BATTERY = "battery at {measured:.0f} % (limit {limit:.0f} %)"
    BATTERY_ENDS = "battery at {measured:.0f} %: it lands on the pad in sight"
    CHARGE = "battery at {measured:.0f} %{detail:s}"
    LANDS_HERE = "battery at {measured:.0f} %: at {limit:.0f} % it lands where it is"


CONDITIONS = frozenset(
    {
        ReasonCause.RELATIVE_SPEED,
        ReasonCause.ERROR_AHEAD,
        ReasonCause.SPEED_AHEAD,
        ReasonCause.DECK_TILT,
        ReasonCause.DECK_RATE,
        ReasonCause.DECK_RISE,
        ReasonCause.DECK_FALL,
        ReasonCause.WIND,
        ReasonCause.GUST,
        ReasonCause.SWEPT,
        ReasonCause.BATTERY,
        ReasonCause.TIME_LOCK,
        ReasonCause.ON_PAD,
        ReasonCause.NEAR_PAD,
        ReasonCause.GLARE,
        ReasonCause.SIGMA,
    }
)
"""Causes that say that a landing is not to be made in these conditions: after them the machine refuses, it does not give up."""

_FRAME_WORDS = {
    Verdict.NO_PAD: "show no pad",
    Verdict.GATED: "contradict the estimate",
    Verdict.LOW_CONFIDENCE: "show a pad of low confidence",
    Verdict.TOO_OLD: "came too late",
    Verdict.TOO_NEW: "have stamps ahead of time",
    Verdict.SINGULAR: "gave no measurement",
    Verdict.REPLACED: "were replaced by newer ones: this machine is too slow",
    Verdict.SKIPPED: "were left out: this machine is too slow",
    Verdict.NO_ATTITUDE: "have no attitude of their time",
    Verdict.NO_GIMBAL: "came while the gimbal did not tell where it points, or not down",
    Verdict.FAILED: "could not be processed",
    Verdict.REPEATED: "repeat the one before",
    Verdict.FROZEN: "stand still while the body turns",
    Verdict.IMPOSSIBLE: "show what cannot be",
    Verdict.ELSEWHERE: "show a pad in another place",
    Verdict.FUSED: "show the pad",
}


class Reason(Struct, frozen=True):
    """A cause and its numbers."""

    cause: ReasonCause
    measured: float | None = None
    """Measured value in the unit that the cause's text names."""
    limit: float | None = None
    detail: IntegrityAlert | Verdict | str | None = None
    """The alert, the verdict on most of the frames, or the vehicle's own words, where the cause is about one."""

    @property
    def text(self) -> str:
        """The reason for the operator."""
        if isinstance(self.detail, Verdict):
            detail = _FRAME_WORDS[self.detail]
        else:
            detail = "" if self.detail is None else self.detail if isinstance(self.detail, str) else self.detail.value
        numbers = {"measured": _or_nan(self.measured), "limit": _or_nan(self.limit)}
        return self.cause.value.format(detail=detail, **numbers)


ORDERED = Reason(ReasonCause.OPERATOR)


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value


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
    STAY = "stay over the pad"
    DESCEND = "descend"
    GATE = "gate"
    COMMIT = "commit"
    PRESS = "press"
    DOWN = "down"
    LAND_HERE = "landing where it is"
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
    TIPPED = "tipped over"
    """It lies on the deck with turning motors."""
    TAKEN_OFF = "taken off"
    """The vehicle flies, the first time or after it has stood."""
    TAKEN = "vehicle taken over"
    """The vehicle's mode is no longer the one in which it obeys: a failsafe or a person has it."""
    ABORT = "abort ordered"
    HOLD = "hold ordered"
    LAND = "to land where it is"
    """A person ordered it, or the last charge is reached, or such a landing has left the deck again."""
    STAY = "stay ordered"
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
CONTACT_INTENDED = frozenset({State.COMMIT, State.PRESS, State.DOWN, State.LAND_HERE})
"""States in which the drone may touch the deck with its motors turning."""
DESCENDS = CONTACT_INTENDED | {State.INTERCEPT, State.STAY, State.DESCEND, State.GATE}
"""States in which the drone may be commanded to come nearer to the deck."""

FAULTS = frozenset(
    {
        Event.CUT,
        Event.GROUNDED_BY_OTHERS,
        Event.TIPPED,
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
    """The outcome of a flight: the state that ended it."""

    LANDED = State.LANDED.value
    LANDED_BY_OTHERS = State.LANDED_BY_OTHERS.value
    GAVE_UP = State.GAVE_UP.value
    REFUSED = State.REFUSED.value
    TAKEN = State.TAKEN.value
    EMERGENCY = State.EMERGENCY.value
    ABORTED = State.ABORTED.value


REFUSALS = (FlightOutcome.GAVE_UP, FlightOutcome.REFUSED)
"""Outcomes in which it did not land by its own decision."""
