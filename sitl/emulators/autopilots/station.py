"""The operator at the ground station: arms, takes off, flies to the start of the landing and commands the landing. No I/O.

The operator sees where the vehicle is relative to the ship, as people do: the view given here is the true one.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from enum import Enum

import numpy as np
from msgspec import Struct, field

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.joined_texts import JoinedTexts
from drivers.mavlink.setpoint import velocity_setpoint
from drivers.mavlink.setpoint_streamer import disarm
from drivers.mavlink.vehicle import ARMED, HOLD_MODE, VELOCITY_MODE, Stack, mode_name, set_mode
from estimator.contracts.commands import Velocity
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import MonoNs, seconds_between

STATION = (255, int(mav.MAV_COMP_ID_MISSIONPLANNER))
COMPANION = int(mav.MAV_COMP_ID_ONBOARD_COMPUTER)
_AUTOPILOT = int(mav.MAV_COMP_ID_AUTOPILOT1)
_REPEAT_S = 1.0
"""Interval at which a command is repeated that was not answered."""
_HEAVE_M = 2.0
"""Height off the start at which a vehicle is there: as far as pads heave."""
_CLIMB_M_S = 1.0
"""Rate of climb to the start."""
_ON_DECK_M = 0.15
"""Height of the body's origin over the pad below which it stands there."""
_REST_S = 4.0
"""Distance ahead of the start at which a vehicle stops that is to begin at rest: the way of the start in this time, s."""


class Task(Enum):
    """The operator's current task."""

    MEET = "waiting for the autopilot"
    ARM = "arming"
    TAKE_OFF = "taking off"
    GO = "flying to the start"
    REST = "resting over the ground until the start has come up"
    ORDER = "ordering the landing"
    WATCH = "watching the landing"
    FAILED = "failed"


_LIMITS: dict[Task, tuple[float, str]] = {
    Task.MEET: (60.0, "no heartbeat of the autopilot arrived"),
    Task.ARM: (90.0, "the autopilot would not arm: {text}"),
    Task.TAKE_OFF: (30.0, "it did not take off: {text}"),
    Task.GO: (60.0, "it did not reach the start of the landing"),
    Task.REST: (15.0, "the start of the landing did not come up to it"),
    Task.ORDER: (10.0, "the {lander} did not answer the order to land"),
}
"""Longest duration of each task, s, and the failure after it."""


class OperatorView(Struct, frozen=True, eq=False):
    """The true state that the operator sees."""

    to_start_level: F64
    """(3,) vector forward, right, down from the body to the position where the landing begins, m."""
    v_start_level: F64
    """(3,) velocity of that position, m/s."""
    v_rel_level: F64
    """(3,) velocity of that position minus that of the body, m/s."""
    yaw_rad: float
    """Heading of the body in ned."""
    turn_rad: float
    """Angle from the body's heading to the wanted heading, clockwise."""
    height_m: float
    """Height over the pad."""
    v_deck_level: F64 = field(default_factory=lambda: np.zeros(3))
    """(3,) velocity of the deck, m/s."""
    rests: bool = False
    """True if the landing begins at rest over the ground instead of with the velocity of the start."""


def _to_goal(view: OperatorView) -> F64:
    """Return the way to where the vehicle waits, (3,) m level: at rest it stops ahead of the start, which then comes up."""
    return np.asarray(view.to_start_level + (_REST_S * view.v_start_level if view.rests else 0.0))


READS = frozenset({"HEARTBEAT", "STATUSTEXT", "COMMAND_ACK"})
"""Messages that the ground station reads."""


class GroundStation:
    """Processes the messages of autopilot and companion and returns those to send.

    Args:
        height_m: height of the take-off, before going to the start.
        lands_by: the autopilot's own mode by which the pilot lands; None orders the companion to land.
        steers_on: whether it goes on with the start after the order until the mode changes, for a companion that does not steer.
    """

    def __init__(self, stack: Stack, *, height_m: float, lands_by: str | None = None, steers_on: bool = False) -> None:
        self.stack, self._height_m, self._lands_by, self._steers_on = stack, height_m, lands_by, steers_on
        self._autopilot, self._companion = (1, _AUTOPILOT), (1, COMPANION)
        self._since: MonoNs | None = None
        self._asked: dict[str, MonoNs] = {}
        self._there_since: MonoNs | None = None
        self._brought_back = False
        self.task = Task.MEET
        self.failure = ""
        """Reason why no landing took place; empty if none."""
        self.mode = ""
        self.armed = False
        self.began: MonoNs | None = None
        """Instant at which the companion first accepted the command to land, or the autopilot's landing mode was first seen."""
        self._joined = JoinedTexts()
        self.texts: deque[tuple[MonoNs, int, str]] = deque(maxlen=400)
        """The STATUSTEXTs as (time, component, text)."""
        self.results: list[tuple[int, int]] = []
        """The autopilot's COMMAND_ACKs that are not accepted, as (command, result)."""

    def on_message(self, message: Message, now: MonoNs) -> None:
        """Process any message of the vehicle's system."""
        kind, component = message.get_type(), message.get_srcComponent()
        if message.get_srcSystem() != self._autopilot[0]:
            return
        if kind == "STATUSTEXT":
            for _, text in self._joined.on_message(message, (message.get_srcSystem(), component)):
                self.texts.append((now, component, text))
        elif kind == "HEARTBEAT" and component == _AUTOPILOT:
            self.mode = mode_name(self.stack, message.custom_mode)
            self.armed = bool(message.base_mode & ARMED)
            if self.task is Task.MEET:
                self._next(Task.GO if self.armed else Task.ARM, now)
            elif self.task is Task.ARM and self.armed:
                self._next(Task.TAKE_OFF, now)
            elif self.task is Task.ORDER and self._lands_by and self.mode == self._lands_by:
                self._watch(now)
        elif kind == "COMMAND_ACK":
            self._answered(int(message.command), int(message.result), component, now)

    def again(self, now: MonoNs, height_m: float) -> None:
        """Bring the vehicle back to the start of the landing and order it once more, because a new companion runs.

        Args:
            height_m: height over the pad. From the deck PX4 leaves by setpoints. ArduCopter leaves by a take-off alone if it
                has noticed that it stands, and refuses it and leaves by setpoints if it has not.
        """
        if not self.armed:
            self._fail("its motors had stopped before the companion was back")
        else:
            self._brought_back = True
            on_deck = height_m < _ON_DECK_M and self.stack is not Stack.PX4
            self._next(Task.TAKE_OFF if on_deck else Task.GO, now)

    def _answered(self, command: int, result: int, component: int, now: MonoNs) -> None:
        if component == _AUTOPILOT and result != mav.MAV_RESULT_ACCEPTED:
            self.results.append((command, result))
            if self._brought_back and self.task is Task.TAKE_OFF and command == mav.MAV_CMD_NAV_TAKEOFF:
                self._next(Task.GO, now)
        asked = self.task is Task.ORDER and self._lands_by is None
        ordered = asked and command == mav.MAV_CMD_NAV_LAND and component == COMPANION
        if ordered and result in (mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_IN_PROGRESS):
            self._watch(now)
        elif ordered:
            self._fail(f"the companion refused the landing with result {result}")

    def holds(self) -> Message:
        """Return the choice of the autopilot's own mode that holds."""
        return set_mode(self.stack, self._autopilot, HOLD_MODE[self.stack])

    def disarms(self) -> Message:
        """Return the command that stops the motors, in the air too."""
        return disarm(self._autopilot, forced=True)

    def period(self, now: MonoNs, view: OperatorView) -> list[Message]:
        """Return the messages to send; call it at 10 Hz or more."""
        if self._since is None:
            self._since = now
        heartbeat = mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, 3
        out: list[Message] = [mav.MAVLink_heartbeat_message(*heartbeat)] if self._due("heartbeat", now) else []
        task = self.task
        if task in _LIMITS and seconds_between(self._since, now) > _LIMITS[task][0]:
            lander = "autopilot" if self._lands_by else "companion"
            self._fail(_LIMITS[task][1].format(text=self._last_status_text, lander=lander))
        return out + self._handlers[task](self, now, view)

    def _arm(self, now: MonoNs, view: OperatorView) -> list[Message]:
        # In GUIDED a QuadPlane on a deck under way winds up its velocity controller, and leaps astern as it leaves.
        mode = "qloiter" if self.stack is Stack.PLANE else VELOCITY_MODE[self.stack]
        out = self._carried(now, view, 0.0)
        if self.mode != mode:
            return [*out, *([set_mode(self.stack, self._autopilot, mode)] if self._due("mode", now) else [])]
        return [*out, *([self._command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)] if self._due("arm", now) else [])]

    def _take_off(self, now: MonoNs, view: OperatorView) -> list[Message]:
        if view.height_m > 0.85 * self._height_m:
            self._next(Task.GO, now)
            return []
        if self.stack is Stack.PX4:
            return self._carried(now, view, -_CLIMB_M_S)
        if view.height_m > 0.5 or not self._due("take off", now):
            return []
        if self.mode != VELOCITY_MODE[self.stack]:
            return [set_mode(self.stack, self._autopilot, VELOCITY_MODE[self.stack])]
        return [self._command(mav.MAV_CMD_NAV_TAKEOFF, height_m=self._height_m)]

    def _carried(self, now: MonoNs, view: OperatorView, v_down_m_s: float) -> list[Message]:
        """Return the setpoint that goes with the deck: PX4 leaves it in OFFBOARD, since AUTO.TAKEOFF holds over the ground."""
        if self.stack is not Stack.PX4:
            return []
        v = np.array([view.v_deck_level[0], view.v_deck_level[1], v_down_m_s])
        return [velocity_setpoint(now // 1_000_000, self._autopilot, Velocity(v, 0.0), view.yaw_rad)]

    def _go(self, now: MonoNs, view: OperatorView) -> list[Message]:
        to_goal = _to_goal(view)
        # The start heaves with the pad, so the vehicle does not follow it after that.
        close = math.hypot(*to_goal[:2]) < 0.6 and abs(to_goal[2]) < _HEAVE_M
        near = close and math.hypot(*view.v_rel_level[:2]) < 0.5 and abs(view.turn_rad) < math.radians(8.0)
        self._there_since = (self._there_since or now) if near else None
        if self._there_since is not None and seconds_between(self._there_since, now) > 1.0:
            self._next(Task.REST if view.rests else Task.ORDER, now)
        mode = VELOCITY_MODE[self.stack]
        takes = [set_mode(self.stack, self._autopilot, mode)] if self.mode != mode and self._due("mode", now) else []
        return [*takes, self.to_start(now, view)]

    def to_start(self, now: MonoNs, view: OperatorView) -> Message:
        """Return the setpoint that flies to the start of the landing and stays there, with the ship."""
        pull = 0.6 * _to_goal(view)
        size = float(np.linalg.norm(pull))
        v_level = view.v_start_level + pull * min(1.0, 1.5 / max(size, 1e-9))
        rate = min(max(0.8 * wrap_pi(view.turn_rad), -0.5), 0.5)
        return velocity_setpoint(now // 1_000_000, self._autopilot, Velocity(v_level, rate), view.yaw_rad)

    def _rest(self, now: MonoNs, view: OperatorView) -> list[Message]:
        if float(view.to_start_level[:2] @ view.v_start_level[:2]) >= 0.0:
            self._next(Task.ORDER, now)
        return [self._goes_with(view, now)]

    def _order(self, now: MonoNs, view: OperatorView) -> list[Message]:
        order = [self._order_to_land()] if self._due("order", now) else []
        # Until somebody else steers, its setpoints must not end.
        return [*order, self._goes_with(view, now)]

    def _goes_with(self, view: OperatorView, now: MonoNs) -> Message:
        """Return the setpoint with which the landing begins."""
        v_level = np.zeros(3) if view.rests else view.v_start_level
        return velocity_setpoint(now // 1_000_000, self._autopilot, Velocity(v_level, 0.0), view.yaw_rad)

    def _order_to_land(self) -> Message:
        if self._lands_by is not None:
            return set_mode(self.stack, self._autopilot, self._lands_by)
        return self._command(mav.MAV_CMD_NAV_LAND, to=self._companion)

    def _watch(self, now: MonoNs) -> None:
        self.began = self.began or now
        self._next(Task.WATCH, now)

    def _steer_on(self, now: MonoNs, view: OperatorView) -> list[Message]:
        steers = self._steers_on and self.mode == VELOCITY_MODE[self.stack]
        return [self._goes_with(view, now)] if steers else []

    def _nothing(self, now: MonoNs, view: OperatorView) -> list[Message]:
        return []

    _handlers: dict[Task, Callable[[GroundStation, MonoNs, OperatorView], list[Message]]] = {  # noqa: RUF012
        Task.MEET: _nothing,
        Task.ARM: _arm,
        Task.TAKE_OFF: _take_off,
        Task.GO: _go,
        Task.REST: _rest,
        Task.ORDER: _order,
        Task.WATCH: _steer_on,
        Task.FAILED: _nothing,
    }

    @property
    def _last_status_text(self) -> str:
        output = [text for _, component, text in self.texts if component == _AUTOPILOT]
        return output[-1] if output else "it printed nothing"

    def _next(self, task: Task, now: MonoNs) -> None:
        self.task, self._since = task, now
        self._asked.clear()

    def _fail(self, why: str) -> None:
        self.task, self.failure = Task.FAILED, why

    def _due(self, what: str, now: MonoNs) -> bool:
        last = self._asked.get(what)
        if last is not None and seconds_between(last, now) < _REPEAT_S:
            return False
        self._asked[what] = now
        return True

    def _command(self, number: int, param1: float = 0.0, *, height_m: float = 0.0, to: tuple[int, int] | None = None) -> Message:
        return mav.MAVLink_command_long_message(*(to or self._autopilot), number, 0, param1, 0, 0, 0, 0, 0, height_m)
