"""Compare what a person ordered with what was sent to the vehicle: the instant of each act against the packets after it."""

from collections.abc import Iterable
from enum import Enum
from typing import NamedTuple

from companion.base.orders import CENTRED, StickPositions
from drivers.ardrone.at import PCMD_PROGRESSIVE, AtCommand, Pcmd, Ref
from estimator.contracts.time import MonoNs, seconds_between
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.truth import Truth

MOTORS_TURN = (VehiclePhase.TAKING_OFF, VehiclePhase.HOVERING, VehiclePhase.FLYING, VehiclePhase.LANDING)
"""Phases of a vehicle in which its motors turn."""
STAYS_UP = ("hold", "abort")
BY_REMOTE = ("mode", "disarm")
"""Acts of a remote control beside an autopilot: another mode, and motors off. After them nothing is sent."""
HANDS_ON = ("manual", "land", "emergency", *BY_REMOTE)
"""Acts after which the flight is the person's, until he gives it back."""
STOPS = ("emergency", "disarm")
"""Acts that stop the motors wherever the vehicle is."""
GIVES_BACK = ("begin", "stay", "release", "takeoff", "reset")
OBEYED_S = 0.3
"""Longest time in which an act is obeyed: a person's own time of reaction."""


class Asks(Enum):
    """The action that a packet requests of the vehicle."""

    HOVER = "hover"
    CENTRED = "sticks in the middle"
    """An AR.Drone's sticks alone: in flight a hover, and a landing goes on."""
    MOVE = "move"
    LAND = "land"
    STOP = "stop the motors"
    MODE = "change the mode"
    LEAVE = "fly elsewhere"
    ARM = "arm"


class SentPacket(NamedTuple):
    """One packet that was sent to the vehicle, whether it arrives or not."""

    at: MonoNs
    asks: Asks


def of_at(commands: Iterable[AtCommand], at: MonoNs) -> SentPacket | None:
    """Return what a datagram of AT commands asks; None where it steers nothing."""
    words = [command for command in commands if isinstance(command, Ref)]
    sticks = [command for command in commands if isinstance(command, Pcmd)]
    if any(word.emergency for word in words):
        return SentPacket(at, Asks.STOP)
    if words and not words[-1].take_off:
        return SentPacket(at, Asks.LAND)
    if not sticks:
        return None
    if sticks[-1].flags & PCMD_PROGRESSIVE:
        return SentPacket(at, Asks.MOVE)
    return SentPacket(at, Asks.HOVER if words else Asks.CENTRED)


class HandsWatch:
    """Watches whether the newest act of a person is obeyed, and whether anything starts that nobody ordered.

    Acts are named as `companion.base.orders` and as a remote control has them: `mode` and `disarm` besides.

    Args:
        takes_off: whether the flight begins on the deck, so that its first take-off is called for.
    """

    def __init__(self, *, takes_off: bool) -> None:
        self.late_s = 0.0
        """Longest time after an act at which the vehicle was still sent something else, or nothing."""
        self.disobeyed = ""
        """The act that was not obeyed, and the packet that was sent."""
        self.unordered: list[str] = []
        """Starts that nobody had ordered."""
        self.act: str | None = None
        """The newest act that stands."""
        self._since = MonoNs(0)
        self._answered = True
        self._may_start = takes_off
        self._motors = self._stood = False
        self.sank_m = 0.0
        """Largest descent after an act that keeps the vehicle up, against the deck or over the ground, the smaller."""
        self._stays_up = False
        self._held_at_m: tuple[float, float] | None = None

    @property
    def hands_on(self) -> bool:
        """True while the flight is the person's."""
        return self.act in HANDS_ON

    def acts(self, act: str, at: MonoNs, sticks: StickPositions = CENTRED) -> None:
        """Note an act of a person that was not refused with a reason."""
        if act in GIVES_BACK:
            self.act, self._may_start = None, True
        elif self.act in BY_REMOTE and act not in ("land", *STOPS):
            return  # the remote control stays above what is ordered at the computer
        elif act in (*STAYS_UP, *HANDS_ON):
            self.act, self._since, self._answered = act, at, act in BY_REMOTE
            self._stays_up = act in STAYS_UP or (act == "manual" and sticks.climb >= 0.0)
            self._may_start, self._held_at_m = False, None

    def sent(self, wire: SentPacket) -> None:
        """Note a packet; call it in order of time."""
        is_late = self.act is None or seconds_between(self._since, wire.at) > OBEYED_S
        if wire.asks is Asks.ARM and not self._may_start and is_late:
            whose = "" if self.act is None else f" after a person's {self.act}"
            self.unordered.append(f"{wire.asks.value}{whose}")
        if self.act is None:
            return
        if self._agrees(self.act, wire):
            self._answered = True
        elif self._motors:
            self._note(wire.at, wire.asks.value)

    def step(self, truth: Truth, *, reached: bool, served: bool) -> None:
        """Note the true state at an instant; call it in order of time.

        Args:
            reached: whether commands reach the vehicle.
            served: whether a service runs; a new one knows nothing of the acts before it.
        """
        motors = truth.phase in MOTORS_TURN
        if motors and not self._motors and (self._stood or truth.phase is VehiclePhase.TAKING_OFF):
            if not self._may_start:
                self.unordered.append("the motors started")
            self._may_start = False
        self._motors, self._stood = motors, not motors
        if not served and self.act not in (None, "emergency"):
            self.act = None
        if not motors:
            self._answered = True
        if self.act is not None and not self._answered:
            self._note(truth.at, "nothing that obeys")
        at_m = float(truth.d_body_pad_level[2]), -float(truth.p_body_ned[2])
        if self.act is None or not self._stays_up or not motors or not reached:
            self._held_at_m = None
        else:
            self._held_at_m = self._held_at_m or at_m
            self.sank_m = max(self.sank_m, descent_m(self._held_at_m, at_m))

    def _note(self, at: MonoNs, asks: str) -> None:
        late_s = seconds_between(self._since, at)
        if late_s > self.late_s:
            self.late_s, self.disobeyed = late_s, f"{self.act}, and was sent: {asks}"

    def _agrees(self, act: str, wire: SentPacket) -> bool:
        match act:
            case "emergency":
                return wire.asks is Asks.STOP
            case "land":
                return wire.asks is Asks.LAND or (self._answered and wire.asks is Asks.CENTRED)
            case "manual" | "hold" | "abort":
                # A place over a deck is held by moving, and a velocity flown by tilts either way: `step` sees what comes of it.
                return wire.asks in (Asks.HOVER, Asks.CENTRED, Asks.MOVE, Asks.MODE)
        return False


def descent_m(from_m: tuple[float, float], to_m: tuple[float, float]) -> float:
    """Return the descent between two pairs of height over the deck and altitude, the smaller of both.

    Against the deck alone a hovering vehicle over a heaving ship would seem to descend.
    """
    return min(from_m[0] - to_m[0], from_m[1] - to_m[1])
