"""Compare what a person ordered with what was sent to the vehicle: the instant of each act against the packets after it."""

from enum import Enum, StrEnum
from typing import NamedTuple

from companion.base.orders import CENTRED, StickPositions
from estimator.contracts.time import MonoNs, seconds_between
from sitl.vehicle.vehicle import MOTORS_TURN
from sitl.world.truth import Truth

STAYS_UP = ("hold", "abort")
BY_REMOTE = ("mode", "landing mode", "disarm")
"""Acts of a remote control or a failsafe beside an autopilot: another mode, one that lands, and motors off. After them nothing is
sent."""
HANDS_ON = ("manual", "land", "emergency", *BY_REMOTE)
"""Acts after which the flight is the person's, until he gives it back."""
STOPS = ("emergency", "disarm")
"""Acts that stop the motors wherever the vehicle is."""
GIVES_BACK = ("begin", "stay", "takeoff", "reset")
_REMEMBERED = (*STAYS_UP, "land")
"""Acts that a service carries on which comes back within `_REMEMBERED_S`."""
_REMEMBERED_S = 30.0
_HELD_S = 9.0
"""Least time for which an order to hold stands whatever the charge is."""
OBEYED_S = 0.3
"""Longest time in which an act is obeyed: a person's own time of reaction."""


class Decides(StrEnum):
    """The one who decides what the vehicle does. An order changes who that is; it never changes what is watched."""

    GUIDANCE = "guidance"
    HOLD = "a person who holds it, or has called the landing off"
    HAND = "a person with the sticks"
    LANDING = "a person who has ordered to land"
    CHARGE = "the last charge, with the pad long out of sight"
    AUTOPILOT = "the autopilot, by a pilot's mode or a failsafe's"
    AUTOPILOT_LANDS = "the autopilot, which lands or returns by itself"
    CUT = "a person who has stopped the motors"
    NOBODY = "nobody: no service runs, or nothing reaches the vehicle"


_DECIDES = {
    None: Decides.GUIDANCE,
    "hold": Decides.HOLD,
    "abort": Decides.HOLD,
    "manual": Decides.HAND,
    "land": Decides.LANDING,
    "mode": Decides.AUTOPILOT,
    "landing mode": Decides.AUTOPILOT_LANDS,
    "emergency": Decides.CUT,
    "disarm": Decides.CUT,
}


class WireRequest(Enum):
    """The action that a packet requests of the vehicle."""

    HOVER = "hover"
    CENTRED = "sticks in the middle"
    """Sticks alone, as of an AR.Drone: in flight a hover, and a landing goes on."""
    MOVE = "move"
    LAND = "land"
    STOP = "stop the motors"
    MODE = "change the mode"
    LEAVE = "fly elsewhere"
    ARM = "arm"


class SentPacket(NamedTuple):
    """One packet that was sent to the vehicle, whether it arrives or not."""

    at: MonoNs
    request: WireRequest


class HandsWatch:
    """Watches whether the newest act of a person is obeyed, and whether anything starts that nobody ordered.

    Acts are named as `companion.base.orders` and as a remote control has them: `mode` and `disarm` besides.

    Args:
        takes_off: whether the flight begins on the deck, so that its first take-off is called for.
        held_to: charge at which a hold or an abort gives way to the end that the person has chosen beforehand; 0 for none.
    """

    def __init__(self, *, takes_off: bool, held_to: float = 0.0) -> None:
        self._held_to = held_to
        self.late_s = 0.0
        """Longest time after an act at which the vehicle was still sent something else, or nothing."""
        self.disobeyed = ""
        """The act that was not obeyed, and the packet that was sent."""
        self.unordered: list[str] = []
        """Starts that nobody had ordered."""
        self.act: str | None = None
        """The newest act that stands."""
        self.since = MonoNs(0)
        """Instant of the newest act that stood."""
        self._centred = self._on_deck = False
        self._answered = True
        self._may_start = takes_off
        self._motors = self._stood = False
        self.sank_m = 0.0
        """Largest descent after an act that keeps the vehicle up, against the deck or over the ground, the smaller."""
        self._stays_up = False
        self._unserved_since: MonoNs | None = None
        self._back_at = MonoNs(0)
        """Instant since which a service runs again."""
        self._held_at_m: tuple[float, float] | None = None

    @property
    def hands_on(self) -> bool:
        """True while the flight is the person's."""
        return self.act in HANDS_ON

    def decides(self, *, reached: bool) -> Decides:
        """Return who decides; with his sticks in the middle a person holds it.

        Args:
            reached: whether a service runs, and its commands reach the vehicle.
        """
        whose = _DECIDES[self.act]
        if not reached and self.act not in (*BY_REMOTE, *STOPS):
            return Decides.NOBODY
        return Decides.HOLD if whose is Decides.HAND and self._centred else whose

    def acts(self, act: str, at: MonoNs, sticks: StickPositions = CENTRED, late_s: float = 0.0) -> None:
        """Note an act of a person that was not refused with a reason.

        Args:
            late_s: how long before it arrived it was given; what gives back or takes must not follow an act that came after it.
        """
        before_act = self.act is not None and seconds_between(self.since, at) < late_s
        if before_act and act in (*GIVES_BACK, "release", "land"):
            self.unordered.append(f"{act}, given {late_s:.1f} s before it arrived and before a person's {self.act}")
        if act == "release" and self.act == "manual":
            act = "hold"  # until he orders to go on
        if act in GIVES_BACK:
            self.act, self._may_start = None, True
        elif self.act in BY_REMOTE and act not in ("land", *STOPS):
            return  # the remote control stays above what is ordered at the computer
        elif act in (*STAYS_UP, *HANDS_ON):
            self.act, self.since, self._answered = act, at, act in BY_REMOTE
            self._stays_up = act in STAYS_UP or (act == "manual" and sticks.climb >= 0.0)
            self._may_start, self._held_at_m, self._centred = False, None, sticks.centred

    def sent(self, wire: SentPacket) -> None:
        """Note a packet; call it in order of time."""
        is_late = self.act is None or seconds_between(self.since, wire.at) > OBEYED_S
        if wire.request is WireRequest.ARM and not self._may_start and is_late:
            whose = "" if self.act is None else f" after a person's {self.act}"
            self.unordered.append(f"{wire.request.value}{whose}")
        if self.act is None:
            return
        if self._agrees(self.act, wire):
            self._answered = True
        elif self._motors and self._unserved_since is None:
            self._note(wire.at, wire.request.value)

    def step(self, truth: Truth, *, reached: bool, served: bool, on_deck: bool) -> None:
        """Note the true state at an instant; call it in order of time.

        Args:
            reached: whether commands reach the vehicle.
            served: whether a service runs; a new one knows a hold, an abort and an order to land, if it comes soon.
            on_deck: whether a foot touches the deck.
        """
        motors = truth.phase in MOTORS_TURN
        self._on_deck = on_deck
        if motors and not self._motors and self._stood:
            if not self._may_start:
                self.unordered.append("the motors started")
            self._may_start = False
        self._motors, self._stood = motors, not motors
        if served and self._unserved_since is not None:
            self._back_at = truth.at
        self._unserved_since = None if served else self._unserved_since or truth.at
        forgets = self._unserved_since is not None and seconds_between(self._unserved_since, truth.at) > _REMEMBERED_S
        if not served and (forgets or self.act not in _REMEMBERED) and self.act not in (None, "emergency"):
            self.act = None
        if not motors:
            self._answered = True
        if self.act is not None and not self._answered and (served or self.act not in _REMEMBERED):
            self._note(truth.at, "nothing that obeys")
        if self.act in STAYS_UP and truth.battery <= self._held_to and seconds_between(self.since, truth.at) > _HELD_S:
            self.act = None
        if self.act is None or not self._stays_up or not motors or not reached:
            self._held_at_m = None
        else:
            at_m = heights_m(truth)
            self._held_at_m = self._held_at_m or at_m
            self.sank_m = max(self.sank_m, descent_m(self._held_at_m, at_m))

    def _note(self, at: MonoNs, request: str) -> None:
        late_s = seconds_between(max(self.since, self._back_at), at)
        if late_s > self.late_s:
            self.late_s, self.disobeyed = late_s, f"{self.act}, and was sent: {request}"

    def _agrees(self, act: str, wire: SentPacket) -> bool:
        match act:
            case "emergency":
                return wire.request is WireRequest.STOP
            case "land":
                # It is flown down by velocities, and the motors are stopped on the deck.
                if wire.request is WireRequest.STOP:
                    return self._on_deck
                return wire.request in (WireRequest.LAND, WireRequest.MOVE, WireRequest.MODE) or (
                    self._answered and wire.request is WireRequest.CENTRED
                )
            case "manual" | "hold" | "abort":
                # A place over a deck is held by moving, a velocity by tilts either way: the referee sees where that leads.
                return wire.request in (WireRequest.HOVER, WireRequest.CENTRED, WireRequest.MOVE, WireRequest.MODE)
        return False


def heights_m(truth: Truth) -> tuple[float, float]:
    """Return the body's height over the pad, and over the still water."""
    down_m = float(truth.p_body_ned[2])
    return float(truth.p_pad_ned[2]) - down_m, -down_m


def descent_m(from_m: tuple[float, float], to_m: tuple[float, float]) -> float:
    """Return the descent between two pairs of heights over the pad and over the still water, the smaller of both.

    Against the deck alone a hovering vehicle over a heaving ship would seem to descend.
    """
    return min(from_m[0] - to_m[0], from_m[1] - to_m[1])
