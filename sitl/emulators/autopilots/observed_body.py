"""A body that an autopilot program flies as the grader sees a world, with the faults of the streams around it and its wires."""

import math
from collections.abc import Callable

import numpy as np
from msgspec.structs import replace

from companion.base.health import Health
from companion.base.mission import FlightOutcome, State
from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.base.orders import CENTRED, HandledOrder
from companion.guidance.pilot import Pilot
from companion.settings.model import Settings
from drivers.mavlink import vehicle as mavlink
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from estimator.contracts.time import Clock, MonoNs, after, seconds_between
from sitl.emulators.autopilots.body import Body
from sitl.faults.fault import Corruptions, Fault, FaultTimer
from sitl.faults.faulty_streams import VehicleStreams
from sitl.faults.kinds import OperatorActs
from sitl.flight.ending import Ending
from sitl.flight.grader import FlightGrader
from sitl.flight.hands import STOPS, Asks, SentPacket
from sitl.flight.limits import ON_DECK_M
from sitl.scenario.scenario import Scenario
from sitl.world.truth import RenderedFrame, Touchdown, Truth

_WATCH_EACH_S = 0.05
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
    """Reads the datagrams between a service and its autopilot. Call both ways in order of time."""

    def __init__(self) -> None:
        self._out, self._in = (Codec(0, 0, datagrams=True) for _ in range(2))
        self._stack = mavlink.Stack.OTHER
        self._mode, self._armed, self._critical = "", False, False
        self._requested: dict[str, MonoNs] = {}
        """The newest request for each mode, and for `Asks.STOP`."""
        self._moved_at: MonoNs | None = None
        """Time of the newest setpoint."""
        self._ended = False
        """True while PX4 is in the mode to which it left OFFBOARD by itself: that failsafe is the end of our own stream."""

    def to_vehicle(self, data: bytes, at: MonoNs) -> list[SentPacket]:
        """Return what a datagram of the service asks."""
        asked = [self._asked(message, at) for message in self._out.feed(data)]
        return [SentPacket(at, asks) for asks in asked if asks is not None]

    def from_vehicle(self, data: bytes, at: MonoNs) -> str | None:
        """Return the act of a person, or of a failsafe, that a datagram shows: a mode, or disarming, that was not requested."""
        act = None
        for m in self._in.feed(data):
            if m.get_type() != "HEARTBEAT" or not mavlink.is_autopilot(m, m.get_srcComponent()):
                continue
            self._stack = mavlink.stack_of(m)
            mode, armed = mavlink.mode_name(self._stack, m.custom_mode), bool(m.base_mode & mavlink.ARMED)
            # It leaves OFFBOARD and comes back with our stream.
            ends = self._ends(mode, at) or (self._ended and mode == mavlink.VELOCITY_MODE[mavlink.Stack.PX4])
            self._ended = (ends or self._ended) and mode in (self._mode, mavlink.HOLD_MODE[mavlink.Stack.PX4])
            if self._armed and not armed and not self._was_requested(Asks.STOP.value, at):
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

    def _asked(self, m: Message, at: MonoNs) -> Asks | None:
        match m.get_type():
            case "SET_POSITION_TARGET_LOCAL_NED" | "SET_ATTITUDE_TARGET":
                self._moved_at = at
                return Asks.MOVE
            case "COMMAND_LONG" | "COMMAND_INT":
                return self._command(m, at)
        return None

    def _command(self, m: Message, at: MonoNs) -> Asks | None:
        if m.command == mav.MAV_CMD_DO_SET_MODE:
            px4 = self._stack is mavlink.Stack.PX4
            mode = mavlink.mode_name(self._stack, int(m.param2) << 16 | int(m.param3) << 24 if px4 else int(m.param2))
            self._requested[mode] = at
            return (
                Asks.LAND
                if mode in mavlink.LAND_MODE.values()
                else Asks.LEAVE
                if mode in mavlink.RETURN_MODE.values()
                else Asks.MODE
            )
        if m.command == mav.MAV_CMD_COMPONENT_ARM_DISARM:
            if not m.param1:
                self._requested[Asks.STOP.value] = at
            return Asks.ARM if m.param1 else Asks.STOP
        if m.command == mav.MAV_CMD_DO_REPOSITION:
            self._requested["guided" if self._stack.is_ardupilot else mavlink.HOLD_MODE[mavlink.Stack.PX4]] = at
            return Asks.LEAVE
        if m.command == mav.MAV_CMD_NAV_TAKEOFF:
            # PX4 climbs in a mode of its own, and then holds by itself.
            self._requested |= {"auto.takeoff": at, mavlink.HOLD_MODE[mavlink.Stack.PX4]: after(at, _CLIMBS_S)}
            return Asks.ARM
        return None


class GradedBody(NullObserver):
    """The world of one flight with an autopilot program, and its faults, which begin by the time since the order to land.

    As an observer of the daemon it learns guidance's phase, in which faults may begin, and what became of each frame.

    Args:
        settings: the daemon's.
        com_watchdog_s: time for which the program flies on with its last setpoint.
        unaided: whether the program lands by its own mode, and nobody else has it.
    """

    def __init__(
        self, scenario: Scenario, seed: int, settings: Settings, clock: Clock, com_watchdog_s: float, *, unaided: bool = False
    ) -> None:
        # The order to land comes in the air, wherever the scenario's vehicle starts.
        start, wrong = replace(scenario.start, where="air"), scenario.wrong_model.drawn(seed)
        self.scenario, self.seed = replace(scenario, start=start, wrong_model=wrong), seed
        self.faults = FaultTimer(scenario.faults, seed)
        self.streams = VehicleStreams(self.faults, seed)
        self.corruptions = Corruptions(self.faults, seed)
        self.guidance_phase: str | None = None
        """Phase of guidance; None before its first decision."""
        self.height_m = 0.0
        """Height over the deck's plane at the newest step, where faults are watched."""
        self._settings, self._com_watchdog_s, self._unaided = settings, com_watchdog_s, unaided
        self.grader: FlightGrader | None = None
        """Watches from the order to land on; None before it."""
        self._wires = MavlinkWires()
        self._clock = clock
        self.started = clock.now()
        """Instant of the order to land."""
        self.on_begun: Callable[[Fault], None] = lambda fault: None
        """Receives each fault that begins."""
        self._body: Body | None = None
        self._contacts: list[Touchdown] = []
        self._newest: Touchdown | None = None
        self._watched: MonoNs | None = None
        self._followed, self._beside_m2 = 0, 0.0

    @property
    def now(self) -> MonoNs:
        """The flight's time."""
        return self._clock.now()

    at = now

    @property
    def contacts(self) -> tuple[Touchdown, ...]:
        """Every contact since the order to land."""
        return tuple(self._contacts)

    @property
    def reached(self) -> bool:
        """True if a service's commands reach the vehicle."""
        return not (self.streams.commands.silent or self.faults.active("service_killed"))

    def stepped(self, body: Body, began: MonoNs | None) -> None:
        """Note a step of the physics, and begin the faults that are due.

        Args:
            began: instant of the order to land; nothing is wrong, graded or counted as a contact before it.
        """
        self._body = body
        if began is None:
            return
        self.started, now, landing = began, self._clock.now(), body.landing()
        if self.faults.active("service_killed"):
            self.guidance_phase = None
        if landing is not None and (self._newest is None or landing.at != self._newest.at):
            self._newest = landing
            self._contacts.append(body.touchdown(now, self.guidance_phase))
        if self.guidance_phase in _FOLLOWS and not self._contacts and body.height_m < _NEAR_M:
            beside = (body.p_pad_ned - body.state().p_ned)[:2]
            self._followed, self._beside_m2 = self._followed + 1, self._beside_m2 + float(beside @ beside)
        if self.grader is None:
            self.grader = FlightGrader(self, self._settings, self._com_watchdog_s)
            if self._unaided:
                self.grader.referee.hands.acts("landing mode", now)
        self.height_m = float(body.R_ned_pad.matrix[:, 2] @ (body.p_pad_ned - body.state().p_ned))
        for fault in self.faults.update(seconds_between(began, now), self.height_m, self.guidance_phase):
            self.on_begun(fault)
        if self._watched is None or seconds_between(self._watched, now) >= _WATCH_EACH_S:
            self._watched = now
            self.grader.step()

    @property
    def tracking_m(self) -> float | None:
        """Distance from the pad's centre over the ground below 2 m, in the descent and the gate: root mean square, m."""
        return math.sqrt(self._beside_m2 / self._followed) if self._followed else None

    def on_sent(self, data: bytes) -> None:
        """Note a datagram that the service sent."""
        for packet in self._wires.to_vehicle(data, self.now):
            if self.grader is not None:
                self.grader.referee.hands.sent(packet)

    def on_arrived(self, data: bytes) -> None:
        """Note a datagram that reached the service: an act that shows before commands reach the vehicle is its failsafe's."""
        act = self._wires.from_vehicle(data, self.now)
        if self.grader is None or act is None or not self.reached:
            return
        if act != "disarm" or self.height_m - self.grader.feet.below_m > ON_DECK_M:
            self.grader.referee.hands.acts(act, self.now)

    def on_located(self, at: MonoNs) -> None:
        """Note a true baseline of an instant that has arrived."""
        if self.grader is not None:
            self.grader.referee.sight.located(at)

    def on_order(self, handled: HandledOrder) -> None:
        if self.grader is not None:
            acting = self.faults.on(OperatorActs)
            sticks, late_s = (acting[-1][0].sticks, acting[-1][0].late_s) if acting else (CENTRED, 0.0)
            self.grader.on_act(handled, sticks, late_s)

    def on_remote(self, act: str) -> None:
        """Note an act of the remote control that the vehicle obeys at once, before it reports it."""
        if self.grader is not None and act in STOPS:
            self.grader.referee.hands.acts(act, self.now)

    def result(self, outcome: FlightOutcome | None, pilot: Pilot, health: Health) -> Ending:
        """Return how the flight ended, or the result so far; nothing is judged without an order to land."""
        if self.grader is None:
            return Ending(self.scenario.title, self.seed, outcome, self.contacts, 0.0, health.frames, self.started)
        ending = self.grader.result(outcome, pilot.operator.situation(self.now), health)
        if self._body is not None and not self._body.upright:
            ending = replace(ending, without_outcome="turned over or fell into the water")
        return replace(ending, started=self.started)

    def truth(self) -> Truth:
        """Return the true state at the newest step; call it after one."""
        assert self._body is not None
        contacts, newest = self.contacts, self._contacts[-1] if self._contacts else None
        return replace(self._body.truth(), at=self._clock.now(), touchdown=newest, contacts=contacts)

    def on_frame(self, processed: ProcessedFrame) -> None:
        stamp = processed.frame.stamp
        if self.grader is not None:
            self.grader.on_verdict(RenderedFrame(_NO_PIXELS, stamp.measured_at, processed.frame.exposure_s), processed.verdict)

    def on_decision(self, decision: Decision) -> None:
        if self.grader is not None:
            self.grader.on_decision(decision)
        self.guidance_phase = decision.phase
