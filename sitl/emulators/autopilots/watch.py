"""Watch a flight of an autopilot for its grader: the wires, a person's acts, and what became of each frame."""

import math

import numpy as np
from msgspec.structs import replace

from companion.base.health import Health
from companion.base.mission import FlightOutcome, State
from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.base.orders import CENTRED, HandledOrder
from companion.guidance.pilot import Pilot
from companion.settings.model import Settings
from drivers.mavlink import vehicle as mavlink
from drivers.mavlink.dialect import Message, mav
from estimator.contracts.time import Clock, MonoNs, after, seconds_between
from sitl.emulators.autopilots.body import Body
from sitl.faults.kinds import OperatorActs
from sitl.flight.ending import Ending
from sitl.flight.grader import FlightGrader
from sitl.flight.hands import STOPS, SentPacket, WireRequest
from sitl.flight.limits import ON_DECK_M
from sitl.world.truth import RenderedFrame

_WATCH_EACH_S = 0.05
"""Interval between two looks of the referee, as in an AR.Drone's flight."""
_LANDS = frozenset({*mavlink.LAND_MODE.values(), *mavlink.RETURN_MODE.values()})
"""Modes in which an autopilot lands by itself, here or where it started."""
_LAPSES_S = 3.0
"""Time after which an autopilot does not do any more what was requested."""
_CLIMBS_S = 30.0
"""Longest take-off."""
_SETPOINTS_END_S = 0.5
"""Silence after which PX4 has left OFFBOARD by itself, s: many times the interval of setpoints, below its COM_OF_LOSS_T."""
_FOLLOWS, _NEAR_M = (State.DESCEND.value, State.GATE.value), 2.0
_NO_PIXELS = np.empty((0, 0, 3), np.uint8)


class MavlinkWires:
    """Reads the messages between a service and its autopilot. Call both ways in order of time."""

    def __init__(self) -> None:
        self._stack = mavlink.Stack.OTHER
        self._mode, self._armed, self._critical = "", False, False
        self._requested: dict[str, MonoNs] = {}
        """The newest request for each mode, and for `WireRequest.STOP`."""
        self._moved_at: MonoNs | None = None
        """Time of the newest setpoint."""
        self._ended = False
        """True while PX4 is in the mode to which it left OFFBOARD by itself: that failsafe is the end of our own stream."""

    def to_vehicle(self, message: Message, at: MonoNs) -> SentPacket | None:
        """Return what a message of the service requests; None where it requests nothing."""
        request = self._request_in(message, at)
        return None if request is None else SentPacket(at, request)

    def from_vehicle(self, m: Message, at: MonoNs) -> str | None:
        """Return the act of a person, or of a failsafe, that a message shows: a mode, or disarming, that was not requested."""
        if m.get_type() != "HEARTBEAT" or not mavlink.is_autopilot(m, m.get_srcComponent()):
            return None
        act = None
        self._stack = mavlink.stack_of(m)
        mode, armed = mavlink.mode_name(self._stack, m.custom_mode), bool(m.base_mode & mavlink.ARMED)
        # It leaves OFFBOARD and comes back with our stream.
        ends = self._ends(mode, at) or (self._ended and mode == mavlink.VELOCITY_MODE[mavlink.Stack.PX4])
        self._ended = (ends or self._ended) and mode in (self._mode, mavlink.HOLD_MODE[mavlink.Stack.PX4])
        if self._armed and not armed and not self._was_requested(WireRequest.STOP.value, at):
            act = "disarm"
        elif armed and self._mode not in ("", mode) and not self._was_requested(mode, at) and not ends:
            act = "landing mode" if mode in _LANDS else "mode"
        critical = m.system_status >= mav.MAV_STATE_CRITICAL
        if act is None and armed and critical and not self._critical and not self._ended:
            # Its mode may be the one that the service has requested before.
            act = "landing mode" if mode in _LANDS else "mode"
        if mode != self._mode:
            self._requested.pop(mode, None)
        self._mode, self._armed, self._critical = mode, armed, critical
        return act

    def _ends(self, mode: str, at: MonoNs) -> bool:
        """Return whether PX4 left OFFBOARD by itself, as it does where setpoints end."""
        silent = self._moved_at is not None and seconds_between(self._moved_at, at) > _SETPOINTS_END_S
        return silent and (self._mode, mode) == (mavlink.VELOCITY_MODE[mavlink.Stack.PX4], mavlink.HOLD_MODE[mavlink.Stack.PX4])

    def _was_requested(self, what: str, at: MonoNs) -> bool:
        requested = self._requested.get(what)
        return requested is not None and seconds_between(requested, at) <= _LAPSES_S

    def _request_in(self, m: Message, at: MonoNs) -> WireRequest | None:
        match m.get_type():
            case "SET_POSITION_TARGET_LOCAL_NED" | "SET_ATTITUDE_TARGET":
                self._moved_at = at
                return WireRequest.MOVE
            case "COMMAND_LONG" | "COMMAND_INT":
                return self._command(m, at)
        return None

    def _command(self, m: Message, at: MonoNs) -> WireRequest | None:
        if m.command == mav.MAV_CMD_DO_SET_MODE:
            px4 = self._stack is mavlink.Stack.PX4
            mode = mavlink.mode_name(self._stack, int(m.param2) << 16 | int(m.param3) << 24 if px4 else int(m.param2))
            self._requested[mode] = at
            return (
                WireRequest.LAND
                if mode in mavlink.LAND_MODE.values()
                else WireRequest.LEAVE
                if mode in mavlink.RETURN_MODE.values()
                else WireRequest.MODE
            )
        if m.command == mav.MAV_CMD_COMPONENT_ARM_DISARM:
            if not m.param1:
                self._requested[WireRequest.STOP.value] = at
            return WireRequest.ARM if m.param1 else WireRequest.STOP
        if m.command == mav.MAV_CMD_DO_REPOSITION:
            self._requested["guided" if self._stack.is_ardupilot else mavlink.HOLD_MODE[mavlink.Stack.PX4]] = at
            return WireRequest.LEAVE
        if m.command == mav.MAV_CMD_NAV_TAKEOFF:
            # PX4 climbs in a mode of its own, and then holds by itself.
            self._requested |= {"auto.takeoff": at, mavlink.HOLD_MODE[mavlink.Stack.PX4]: after(at, _CLIMBS_S)}
            return WireRequest.ARM
        return None


class FlightWatch(NullObserver):
    """Watches the flight of an autopilot's vehicle for its grader, from the order to land on.

    As an observer of the daemon it learns guidance's phase, in which faults may begin, and what became of each frame.

    Args:
        settings: the daemon's.
        com_watchdog_s: time for which the program flies on with its last setpoint.
        unaided: whether the program lands by its own mode, and nobody else has it.
    """

    def __init__(self, settings: Settings, clock: Clock, com_watchdog_s: float, *, unaided: bool = False) -> None:
        self._settings, self._com_watchdog_s, self._unaided = settings, com_watchdog_s, unaided
        self.grader: FlightGrader | None = None
        """Watches from the order to land on; None before it."""
        self._wires = MavlinkWires()
        self._clock = clock
        self.body: Body | None = None
        """The newest world; None before the program has one."""
        self._graded: Body | None = None
        """The world that is graded."""
        self._views: dict[int, RenderedFrame] = {}
        """The true content of the frames that have arrived, by their number."""
        self._watched: MonoNs | None = None
        self._followed, self._beside_m2 = 0, 0.0

    def stepped(self, body: Body) -> None:
        """Note a step of the physics after the order to land; nothing is wrong, graded or counted as a contact before it."""
        if self._graded is not body:
            self._begin(body)
        assert self.grader is not None
        if body.faults.service_gone:
            body.guidance_phase = None
        if body.guidance_phase in _FOLLOWS and not body.contacts and body.height_m < _NEAR_M:
            beside = (body.pad_motion().p_ned - body.vehicle.p_ned)[:2]
            self._followed, self._beside_m2 = self._followed + 1, self._beside_m2 + float(beside @ beside)
        if self._watched is None or seconds_between(self._watched, body.at) >= _WATCH_EACH_S:
            self._watched = body.at
            self.grader.step()

    def _begin(self, body: Body) -> None:
        """Begin the flight that is graded, again in the world of a program that was started again."""
        body.begin()
        self._graded, self.grader = body, FlightGrader(body, self._settings, self._com_watchdog_s)
        if self._unaided:
            self.grader.referee.hands.acts("landing mode", body.at)

    @property
    def tracking_m(self) -> float | None:
        """Distance from the pad's centre over the ground below 2 m, in the descent and the gate: root mean square, m."""
        return math.sqrt(self._beside_m2 / self._followed) if self._followed else None

    def on_sent(self, message: Message) -> None:
        """Note a message that the service sent."""
        packet = self._wires.to_vehicle(message, self._clock.now())
        if self.grader is not None and packet is not None:
            self.grader.referee.hands.sent(packet)

    def on_arrived(self, message: Message) -> None:
        """Note a message that reached the service: an act that shows before commands reach the vehicle is its failsafe's."""
        now = self._clock.now()
        act = self._wires.from_vehicle(message, now)
        if self.grader is None or act is None or not self.grader.world.reached:
            return
        if act != "disarm" or self.grader.world.over_deck_m - self.grader.feet.below_m > ON_DECK_M:
            self.grader.referee.hands.acts(act, now)

    def on_located(self, at: MonoNs) -> None:
        """Note a true baseline of an instant that has arrived."""
        if self.grader is not None:
            self.grader.referee.sight.located(at)

    def on_order(self, handled: HandledOrder) -> None:
        if self.grader is not None:
            acting = self.grader.world.faults.on(OperatorActs)
            sticks, late_s = (acting[-1][0].sticks, acting[-1][0].late_s) if acting else (CENTRED, 0.0)
            self.grader.on_act(handled, sticks, late_s)

    def on_remote(self, act: str) -> None:
        """Note an act of the remote control that the vehicle obeys at once, before it reports it."""
        if self.grader is not None and act in STOPS:
            self.grader.referee.hands.acts(act, self._clock.now())

    def ending(self, body: Body, outcome: FlightOutcome | None, pilot: Pilot, health: Health) -> Ending:
        """Return how the flight ended, or the result so far; nothing is judged without an order to land."""
        if self.grader is None:
            return Ending(body.scenario.title, body.seed, outcome, body.contacts, 0.0, health.frames, body.started)
        ending = self.grader.result(outcome, pilot.operator.situation(body.at), health)
        if not body.upright:
            ending = replace(ending, without_outcome="turned over or fell into the water")
        return replace(ending, started=body.started)

    def on_shown(self, number: int, view: RenderedFrame) -> None:
        """Note the true content of a frame that has arrived."""
        self._views[number] = replace(view, px=_NO_PIXELS)

    def on_frame(self, processed: ProcessedFrame) -> None:
        view = self._views.pop(processed.frame.seq)
        if self.grader is not None:
            self.grader.on_verdict(view, processed.verdict)

    def on_decision(self, decision: Decision) -> None:
        if self.grader is not None:
            self.grader.on_decision(decision)
        if self.body is not None:
            self.body.guidance_phase = decision.phase
