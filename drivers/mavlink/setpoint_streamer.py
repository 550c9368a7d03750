"""Choose what an autopilot is sent in each period, from the newest command and the state that it reports. No I/O.

`custody` is the table of who has the vehicle; here are the bytes and the few numbers that are streamed in each of its states.
A person's order to begin in flight, or the first velocity, takes the vehicle into its velocity mode (ArduPilot GUIDED, PX4
OFFBOARD, whose setpoints must stream for a while first). From then on every period carries a setpoint.
A command of guidance is flown only for a short time unless guidance renews it. A velocity or a landing that is not renewed
becomes a hold at the deck's own velocity, then one over the ground, then the autopilot's hold mode, and our stream ends.
A landing by velocity is bounded by time and by height as well, renewed or not.
A landing whose deck was felt stops the motors at once, by force, and its stream outlives them (`MotorStop`); a vehicle that
reports itself on the ground after a landing, still armed, is commanded to disarm. None is left armed on a deck.
When the process itself falls silent the autopilot's own failsafe acts: ArduPilot flies on for 3 s and brakes, PX4 brakes after
1 s. A landing by the autopilot's own mode (ArduPilot LAND) goes on then, by its own rules for a lost target (PLND_STRICT).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drivers.mavlink.custody import LEFT_ALONE, TABLE, Authority, Hand, HandEvent, ModeRequests
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.setpoint import level_setpoint, velocity_setpoint
from drivers.mavlink.take_off import SHOWN_S, Rested, RestVelocity, TakingOff
from drivers.mavlink.vehicle import (
    HOLD_MODE,
    LAND_MODE,
    RETURN_MODE,
    TARGET_MODE,
    VELOCITY_MODE,
    Condition,
    Identity,
    Stack,
    reposition,
    set_mode,
)
from estimator.contracts.commands import Command, CutMotors, Hover, Land, LandingPlace, Lean, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.geometry import F64, GeoPoint, Rotation, ned_between
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, seconds_between

FORCE = 21196.0
"""Parameter 2 of COMPONENT_ARM_DISARM that disarms whatever the autopilot takes itself to do (mavlink.io)."""
OUTLIVE_S = 0.5
"""Time for which setpoints go on after the report that the motors stand, s."""
_TURNS_RAD = math.radians(3.0)  # turn from which on a landing's heading is requested
_TURN_DEG_S = 30.0  # rate of that turn
_EACH_S = 0.2  # time between two requests to stop the motors at first
_SLOW_S = 1.0  # time between two such requests later, and between two requests for a heading
_QUICK_S = 5.0
"""Time after which requests are rarer, s."""
_PLACE_S = 2.0
"""Age of the vehicle's place beyond which nothing is done by it, s."""
_REACHED_M = 3.0
"""Distance from another place at which the vehicle is there, m."""
_MEAN_S = 1.0
"""The time over which the velocity that a landing continues with is averaged."""
_GAP_S = 0.5
"""Gap between two setpoints with which PX4 takes the stream to have ended, s."""
_ARMS_S = 1.2
"""Time after a request to arm for which the motors may turn though no report says so, s: some autopilots report each second."""


def disarm(target: tuple[int, int], *, forced: bool) -> Message:
    """Return the command that stops the motors."""
    number = mav.MAV_CMD_COMPONENT_ARM_DISARM
    return mav.MAVLink_command_long_message(*target, number, 0, 0.0, FORCE if forced else 0.0, 0, 0, 0, 0, 0)


class MotorStop:
    """One stop of the motors on deck, from the first request to disarm until the autopilot has reported for a while that it is.

    Both stacks refuse to disarm while they take themselves to fly. PX4's land detector compares the vertical speed over the
    ground with LNDMC_Z_VEL_MAX, which a heaving deck exceeds; so once guidance has felt the deck, and says so in every cycle, the
    forced form is sent. The setpoint stream goes on until the motors have stood for a while: an autopilot that is still armed
    when the stream ends takes that for a failure (COM_OF_LOSS_T, GUID_TIMEOUT).
    """

    def __init__(self, now: MonoNs) -> None:
        self.began = now
        self._asked: MonoNs | None = None
        self._stood: MonoNs | None = None

    def period(self, now: MonoNs, target: tuple[int, int], *, armed: bool | None, forced: bool) -> list[Message]:
        """Return the request of this period, if one is due."""
        if armed is False:
            self._stood = self._stood or now
            return []
        self._stood = None
        each_s = _EACH_S if seconds_between(self.began, now) < _QUICK_S else _SLOW_S
        if self._asked is not None and seconds_between(self._asked, now) < each_s:
            return []
        self._asked = now
        return [disarm(target, forced=forced)]

    def over(self, now: MonoNs) -> bool:
        """Return whether the motors have stood for long enough that the setpoints may end."""
        return self._stood is not None and seconds_between(self._stood, now) >= OUTLIVE_S


STILL = Velocity(np.zeros(3), 0.0)
_OF_OTHERS = (HandEvent.OTHER_MODE, HandEvent.MODE_SINCE, HandEvent.ARMED, HandEvent.DISARMED)
"""Events that others cause."""


class Tries:
    """The requests for one thing: a period apart, and a few of them."""

    def __init__(self, options: AutopilotOptions) -> None:
        self._o = options
        self._at: MonoNs | None = None
        self._made = 0

    @property
    def begun(self) -> bool:
        """True if a request was sent."""
        return self._made > 0

    def due(self, now: MonoNs) -> bool:
        """Return whether a request may be sent or repeated now, and count it."""
        if self._made >= self._o.request_tries or not self._answered(now):
            return False
        self._at, self._made = now, self._made + 1
        return True

    def spent(self, now: MonoNs) -> bool:
        """Return whether the last request had its time, too."""
        return self._made >= self._o.request_tries and self._answered(now)

    def _answered(self, now: MonoNs) -> bool:
        return self._at is None or seconds_between(self._at, now) >= self._o.request_period_s


@dataclass(slots=True)
class _Landing:
    """The newest landing."""

    order: Land
    at: MonoNs
    """Time of its newest renewal."""
    began: MonoNs
    from_m: float | None
    """Position below the autopilot's origin at which it began; None if it was not known."""
    by_velocity: bool
    spent: bool = False
    """True if it has used up its time or its height."""


class SetpointStreamer:
    """Holds the newest command and decides what to send."""

    def __init__(self, identity: Identity, options: AutopilotOptions, authority: Authority = Authority.SETPOINTS) -> None:
        self._id = identity
        self._o = options
        self._authority = authority
        self._now = MonoNs(0)
        self._motion: Velocity | Lean = STILL
        self._motion_at: MonoNs | None = None
        self._mean_velocity = np.zeros(3)
        """The mean of the velocities commanded lately, (3,) m/s: it follows the deck without the corrections."""
        self._v_deck = np.zeros(3)
        """The velocity of the surface below at the last commanded velocity, (3,) m/s in the level frame."""
        self._steered_at: MonoNs | None = None
        self._streamed: tuple[MonoNs, MonoNs] | None = None
        """Times of the first and the last setpoint of the stream."""
        self._climb: TakingOff | None = None
        """The take-off under way, or the one whose motors are being stopped."""
        self._place: GeoPoint | None = None
        self._placed_at = MonoNs(0)
        self._goal: GeoPoint | None = None
        """Place to land at, with the height to fly at; None if it returns by its own mode."""
        self._there = False
        self._rest = RestVelocity()
        self._stop = MotorStop(MonoNs(0))
        self._felt_at: MonoNs | None = None
        """Time when guidance last reported contact with the deck."""
        self._landing = _Landing(Land(), MonoNs(0), MonoNs(0), None, by_velocity=False)
        self._down_m: float | None = None
        self._condition = Condition()
        self._settled: tuple[Hand, bool] | None = None
        """The holder, and whether there is no take-off, for which the newest condition changes nothing more."""
        self._attitude: Attitude | None = None
        self._modes = ModeRequests()
        self._tries = Tries(options)
        self._turned: MonoNs | None = None
        """Time of the newest request for a heading; None before one."""
        self._engaged = False
        """True from a person's order to begin in flight until a mode is chosen, where targets alone lead."""
        self._ordered_since: MonoNs | None = None
        """Beginning of the failsafe in force when a person last ordered to take the vehicle; None if there was none then."""
        self.others_at: MonoNs | None = None
        """Newest report in which somebody else chose for the vehicle: a mode, an arming, a disarm, or a failsafe that came."""
        self.hand = Hand.NOBODY
        self.cause: HandEvent | None = None
        """The event that led to the present state; None at the start."""
        self.commanded = False
        """True once something of ours was sent to it."""
        self.motors_cut = False
        """True if a person cut the motors and the autopilot has reported that it is disarmed."""

    @property
    def _mode(self) -> str | None:
        return (HOLD_MODE if self._authority is Authority.MODES else VELOCITY_MODE).get(self._id.stack)

    @property
    def _land_mode(self) -> str | None:
        """The autopilot's own landing: on targets where guidance has nothing else, where it is the plain one."""
        led = self._authority is Authority.MODES and not self._landing.order.here
        return (TARGET_MODE if led else LAND_MODE).get(self._id.stack)

    @property
    def _lands_by_velocity(self) -> bool:
        chosen = self._o.landing if self._authority is Authority.SETPOINTS else "mode"
        return chosen == "velocity" or (chosen == "by stack" and self._id.stack is not Stack.ARDUPILOT)

    def _on(self, event: HandEvent) -> bool:
        """Take an event; return whether another one has the vehicle now, or it does another thing."""
        target = TABLE[self.hand][event]
        if target is self.hand or (target is Hand.TAKING and self.hand is not Hand.PERSON and self._modes.unsure):
            return False
        self.hand, self.cause, self._tries = target, event, Tries(self._o)
        self.motors_cut = self._engaged = False
        self.commanded |= target is not Hand.NOBODY
        if target in LEFT_ALONE:
            self._modes.forget()
            self._streamed = None
        elif target is Hand.OURS:
            self._modes.own = self._mode or ""
        if target not in (Hand.TAKING_OFF, Hand.STANDING):
            self._climb = None
        self._stop = MotorStop(self._now)
        return True

    @property
    def _failsafe_acts(self) -> bool:
        """True while a failsafe is in force that came after every person's order: no mode is requested against it."""
        failsafe = self._condition.failsafe
        return failsafe is not None and failsafe.since != self._ordered_since

    def _order(self) -> None:
        """Note that a person orders to take the vehicle, knowing of the failsafe in force."""
        failsafe = self._condition.failsafe
        self._ordered_since = None if failsafe is None else failsafe.since

    def take(self, command: Command, now: MonoNs, v_deck_level: F64 | None = None) -> None:
        """Take the newest command.

        Args:
            v_deck_level: (3,) m/s, velocity of the surface below, already included in a velocity; None if it is not known.
        """
        self._now = now
        if self._withholds(command):
            return
        match command:
            case CutMotors():
                if not self._on(HandEvent.CUT) and self.motors_cut and self._condition.armed:
                    self.motors_cut, self._stop = False, MotorStop(now)
            case LeaveEmergency():
                self._on(HandEvent.RESET)
            case TakeOff():
                # A QuadPlane's GUIDED winds up on a deck under way, and leaps astern as it leaves: its pilot takes off.
                by_us = self._id.stack is not Stack.PLANE
                if by_us and not self._condition.flying and self._on(HandEvent.TAKE_OFF):
                    self._order()
                    self._climb = TakingOff(now, self._id, self._down_m, self._o.take_off_height_m)
            case Land():
                self._motion_at = now
                self._take_land(command, now)
            case Hover():
                self._take_hover(command, now, v_deck_level)
            case _:
                self._take_velocity(command, now, v_deck_level)

    def _withholds(self, command: Command) -> bool:
        """Return whether a command, of guidance or a person, may not leave in any form."""
        if self._authority is Authority.SETPOINTS or isinstance(command, CutMotors | LeaveEmergency):
            return False
        return self._authority is Authority.NOTHING or isinstance(command, Velocity | Lean | TakeOff)

    def _take_land(self, command: Land, now: MonoNs) -> None:
        landing = self._landing
        self._felt_at = now if command.on_deck and self.hand not in LEFT_ALONE else None
        if self.hand is Hand.LANDING and not command.on_deck:
            if not landing.spent:
                landing.order, landing.at = command, now
        elif (command.on_deck or not landing.spent) and (self.hand is not Hand.NOBODY or self._condition.armed is not False):
            self._on(HandEvent.CONTACT if command.on_deck else HandEvent.LAND)
            if self.hand is Hand.LANDING:
                steers = self._authority is Authority.SETPOINTS and self._condition.mode == self._mode
                by_velocity = steers and (self._lands_by_velocity or self._failsafe_acts)
                self._landing = _Landing(command, now, now, self._down_m, by_velocity)

    def _take_hover(self, command: Hover, now: MonoNs, v_deck_level: F64 | None) -> None:
        self._motion, self._motion_at, self._landing.spent, self._felt_at = STILL, now, False, None
        if v_deck_level is not None:
            self._v_deck, self._steered_at = v_deck_level, now
        if command.calls_off and self.hand is Hand.TAKING_OFF:
            self._end_take_off(now)
        elif command.elsewhere is not None:
            if self.hand is Hand.OURS:
                self._leave_for(command.elsewhere, now)
        elif command.returns and self._id.stack in RETURN_MODE:
            if self._on(HandEvent.RETURN):
                self._goal = None
        elif self.hand is not Hand.STANDING or self._flies_again:
            self._on(HandEvent.HOVER)

    def _take_velocity(self, command: Velocity | Lean, now: MonoNs, v_deck_level: F64 | None) -> None:
        since_s = math.inf if self._steered_at is None else seconds_between(self._steered_at, now)
        weight = min(1.0, since_s / _MEAN_S)
        self._mean_velocity = self._mean_velocity + weight * (command.v_level - self._mean_velocity)
        self._v_deck = np.zeros(3) if v_deck_level is None else v_deck_level
        self._motion, self._motion_at, self._steered_at = command, now, now
        self._landing.spent, self._felt_at = False, None
        if self._mode is not None and self._flies_again:
            self._on(HandEvent.STEER)

    @property
    def _flies_again(self) -> bool:
        """True if the vehicle may be taken, or taken back from the deck: it flies by all that is known."""
        return self._condition.flying is not False and self._condition.armed is not False and self._climb is None

    def _here(self, now: MonoNs) -> GeoPoint | None:
        """Return the place of the vehicle; None if none was reported lately."""
        return self._place if seconds_between(self._placed_at, now) <= _PLACE_S else None

    def _leave_for(self, where: LandingPlace, now: MonoNs) -> None:
        """Begin the way to another place if that is known to be in range."""
        here = self._here(now)
        if here is not None and math.hypot(*ned_between(here, where.place)[:2]) <= where.range_max_m:
            highest_m = max(where.place.height_m or 0.0, here.height_m or 0.0)
            self._goal, self._there = GeoPoint(where.place.latitude_rad, where.place.longitude_rad, highest_m), False
            self._on(HandEvent.LEAVE)

    def engage(self) -> None:
        """Take the vehicle in flight, or allow one that a person took over to be taken: a person orders to begin or to land."""
        self._order()
        flies = self._condition.flying is True and self._condition.armed is not False
        steers = self._authority is Authority.SETPOINTS and self._mode is not None
        self._on(HandEvent.ENGAGE_ALOFT if flies and steers else HandEvent.ENGAGE)
        self._engaged = flies and self._authority is Authority.MODES and self.hand is Hand.NOBODY

    def on_answer(self, command: int, *, accepted: bool) -> None:
        """Take the autopilot's answer to a command of ours, by the command's number."""
        if command in (mav.MAV_CMD_DO_SET_MODE, mav.MAV_CMD_DO_REPOSITION):
            self._modes.on_answer(accepted=accepted)
        elif command == mav.MAV_CMD_COMPONENT_ARM_DISARM and accepted and self._climb is not None:
            self._climb.on_armed(self._now)

    def on_condition(self, condition: Condition, now: MonoNs | None = None, *, beat: bool = True) -> None:
        """Take the condition that the autopilot reports.

        Args:
            now: time of the report; None for that of the newest period.
            beat: whether it comes in a HEARTBEAT, which alone reports mode and motors; otherwise these are old.
        """
        if condition is self._condition and not beat and self._settled == (self.hand, self._climb is None):
            return
        self._now = self._now if now is None else now
        before, self._condition = self._condition, condition
        taken = []
        for event in self._reported(before, condition, beat=beat):
            if event in _OF_OTHERS and not (event is HandEvent.DISARMED and not before.armed):
                self.others_at = self._now
            taken.append(self._on(event))
        self._settled = None if any(taken) else (self.hand, self._climb is None)
        if self.hand is Hand.CUT and condition.armed is False and beat:
            self.motors_cut |= seconds_between(self._stop.began, self._now) >= SHOWN_S

    def _reported(self, before: Condition, now: Condition, *, beat: bool) -> Iterator[HandEvent]:
        """Yield the events in a report; each is taken before the next is looked for."""
        in_mode, own = now.mode == self._mode, now.mode != VELOCITY_MODE.get(self._id.stack)
        came = now.failsafe is not None and (before.failsafe is None or before.failsafe.since != now.failsafe.since)
        # A failsafe in the first report took nothing from us: PX4 has one where the service before this one died.
        if came and (before.mode != Condition().mode or self.hand is not Hand.NOBODY):
            self.others_at = self._now
            if own:
                yield HandEvent.FAILSAFE
        if beat:
            yield from self._by_mode(before, now, in_mode=in_mode, own=own)
        yield from self._by_arming(before, now, beat=beat)
        if now.flying is False:
            yield HandEvent.DOWN if now.armed is False else HandEvent.STOOD
        elif now.flying and self._climb is not None:
            self._climb.on_flying(self._now)
            yield HandEvent.LIFTED if in_mode else HandEvent.OTHER_MODE
        if in_mode:
            yield HandEvent.IN_MODE

    def _by_mode(self, before: Condition, now: Condition, *, in_mode: bool, own: bool) -> Iterator[HandEvent]:
        """Yield the events in the mode of a HEARTBEAT.

        Args:
            in_mode: it is the mode that guidance flies in.
            own: it is no mode for setpoints, so a person or a failsafe may have chosen it.
        """
        ours = self._modes.on_mode(now.mode, self._now, ambiguous=own)
        if ours and own and self._failsafe_acts:
            ours = False
        # PX4 goes back into OFFBOARD by itself once the setpoints come again whose end was its failure.
        given_back = self._tries.begun or before.failsafe is not None
        if ours is False and not (self.hand is Hand.TAKING and in_mode and given_back):
            if not self._engaged:
                yield HandEvent.OTHER_MODE
            elif now.mode != TARGET_MODE.get(self._id.stack):
                yield HandEvent.MODE_SINCE
            if in_mode and self._o.mode_is_order and self._authority is Authority.SETPOINTS:
                yield HandEvent.MODE_ORDER
        elif ours and not in_mode:
            yield HandEvent.LATE

    def _by_arming(self, before: Condition, now: Condition, *, beat: bool) -> Iterator[HandEvent]:
        """Yield the events in what a report tells of the motors."""
        climb = self._climb
        if self.motors_cut and now.armed and now.flying:
            yield HandEvent.FLOWN_AGAIN
        if now.armed is False and (climb is None or before.armed or (beat and climb.was_armed(self._now))):
            yield HandEvent.DISARMED
        elif now.armed and before.armed is False and (climb is None or not climb.arms):
            yield HandEvent.ARMED

    def on_position(self, down_m: float) -> None:
        """Take the autopilot's position below its own origin, metres."""
        self._down_m = down_m
        if self._climb is not None:
            self._climb.on_position(down_m)

    def on_place(self, place: GeoPoint, now: MonoNs) -> None:
        """Take the autopilot's place on the Earth."""
        self._place, self._placed_at = place, now

    @property
    def rested(self) -> Rested | None:
        """Return where the vehicle last stood, and its velocity then; None if it never did."""
        return self._rest.newest

    def on_velocity(self, v_ned: F64, p_ned: F64, now: MonoNs) -> None:
        """Take the autopilot's velocity over the ground and its place, (3,) m/s and m."""
        self._rest.on_velocity(v_ned, p_ned, now, stands=self._condition.flying is False)

    def on_attitude(self, attitude: Attitude) -> None:
        self._attitude = attitude

    def period(self, now: MonoNs) -> list[Message]:
        """Return the messages of this period; call it at 10 Hz or more."""
        self._now = now
        match self.hand:
            case Hand.TAKING | Hand.OURS:
                return self._steer(now)
            case Hand.LANDING:
                return self._descend(now)
            case Hand.STANDING:
                return self._stood(now)
            case Hand.HOLDING:
                return self._hold(now)
            case Hand.LEAVING:
                return self._go(now)
            case Hand.TAKING_OFF:
                return self._take_off(now)
            case Hand.CUT if not self.motors_cut:
                return self._stop.period(now, self._id.address, armed=None, forced=True)
            case _:
                return []

    @property
    def _lands_by_itself(self) -> bool:
        """True while the autopilot lands where it is by its own mode, which a person's order goes on with after us."""
        return self.hand is Hand.LANDING and self._landing.order.here and not self._landing.by_velocity

    def leave(self, now: MonoNs) -> list[Message]:
        """Return the final messages, a hold in place. A landing is called off, but for the autopilot's own where it is."""
        self._now = now
        if self.hand is Hand.TAKING_OFF:
            self._end_take_off(now)
        if self._lands_by_itself:
            return []
        if self.hand is Hand.STANDING:
            return [disarm(self._id.address, forced=self._forced(now))] if self._armed(now) is not False else []
        if self.hand not in (Hand.TAKING, Hand.OURS, Hand.LANDING, Hand.HOLDING):
            return []
        by_mode = self._id.stack is Stack.PX4 or (self.hand is Hand.LANDING and not self._landing.by_velocity)
        begun = self.hand is not Hand.TAKING or self._modes.pending
        return self._setpoint(now, STILL) + (self._ask(HOLD_MODE.get(self._id.stack), now) if by_mode and begun else [])

    def suspend(self, now: MonoNs) -> list[Message]:
        """Return the hold that is sent once when nothing may be commanded any more, so that no old velocity is flown on."""
        out = self.leave(now)
        if not self._lands_by_itself:
            self._on(HandEvent.UNCLEAR)
        return out

    def _due(self, now: MonoNs) -> bool:
        """Return whether a request may be sent or repeated now, and count it; one that was accepted is not repeated."""
        return not self._modes.accepted and self._tries.due(now)

    def _ask(self, mode: str | None, now: MonoNs) -> list[Message]:
        """Return the request for a mode, and remember it; none for a mode that the stack does not have, or against a failsafe."""
        if mode is None or self._failsafe_acts:
            return []
        self._modes.ask(mode, now)
        return [set_mode(self._id.stack, self._id.address, mode)]

    def _is_streamed(self, now: MonoNs) -> bool:
        """Return whether setpoints have come for long enough that the autopilot takes the mode that flies them."""
        if self._authority is not Authority.SETPOINTS or self._id.stack is not Stack.PX4:
            return True
        return self._streamed is not None and seconds_between(self._streamed[0], now) >= self._o.prestream_s

    @property
    def _silent_most_s(self) -> float:
        """Time without guidance for which the vehicle is kept in the velocity mode."""
        return self._o.stands_after_s if self._condition.flying is False else self._o.hold_mode_after_s

    def _steer(self, now: MonoNs) -> list[Message]:
        silent_s = math.inf if self._motion_at is None else seconds_between(self._motion_at, now)
        fresh = silent_s <= self._o.command_timeout_s
        if silent_s > self._silent_most_s and self._on(HandEvent.SILENT):
            return self._hold(now)
        out = self._setpoint(now, self._motion if fresh and self._motion is not STILL else self._held(now))
        there = self._condition.mode == self._mode and not self._modes.pending
        if self.hand is not Hand.TAKING or there:
            return out
        if self._authority is Authority.SETPOINTS and (not out or self._streamed is None):
            return out
        if self._is_streamed(now) and self._due(now):
            return out + self._ask(self._mode, now)
        if self._tries.spent(now):
            self._on(HandEvent.REFUSED)
        return out

    def _go(self, now: MonoNs) -> list[Message]:
        """Send the autopilot back, or to the place, and let it land there by its own mode; it lands nowhere else by this."""
        goal, here, mode = self._goal, self._here(now), LAND_MODE.get(self._id.stack)
        if goal is None:
            back = RETURN_MODE.get(self._id.stack)
            if self._condition.mode != self._mode:
                return []
            return self._setpoint(now, self._held(now)) + (self._ask(back, now) if self._due(now) else [])
        if here is None or self._condition.mode == mode:
            return []
        if not self._there and math.hypot(*ned_between(here, goal)[:2]) <= _REACHED_M:
            self._there, self._tries = True, Tries(self._o)
        # To PX4 the end of the setpoints is a failure until it has left OFFBOARD; to ArduCopter one more is another goal.
        out = self._setpoint(now, self._held(now)) if self._condition.mode == "offboard" else []
        if self._failsafe_acts or not self._due(now):
            return out
        if self._there:
            return out + self._ask(mode, now)
        self._modes.ask("guided" if self._id.stack.is_ardupilot else "auto.loiter", now)
        return [*out, reposition(self._id.address, goal)]

    def _held(self, now: MonoNs) -> Velocity:
        """Return the velocity that holds over the surface below while its velocity is known, later over the ground."""
        if self._steered_at is None or seconds_between(self._steered_at, now) > self._o.deck_hold_s:
            return STILL
        return Velocity(self._v_deck * (1.0, 1.0, 0.0), 0.0)

    def _descend(self, now: MonoNs) -> list[Message]:
        """Continue a landing while it is renewed and within its bounds, else hold."""
        landing = self._landing
        if not self._wanted(now):
            if not landing.by_velocity:
                return self._steer(now) if self._on(HandEvent.NOT_RENEWED) else []
            silent_s = seconds_between(landing.at, now)
            if silent_s > self._o.hold_mode_after_s and self._on(HandEvent.SILENT):
                return self._hold(now)
            velocity = self._mean_velocity * (1.0, 1.0, 0.0) if silent_s <= self._o.deck_hold_s else np.zeros(3)
            return self._setpoint(now, Velocity(velocity, 0.0))
        if landing.by_velocity:
            v = np.array([self._mean_velocity[0], self._mean_velocity[1], self._o.descent_rate_m_s])
            return self._setpoint(now, Velocity(v, 0.0))
        mode = self._land_mode
        if self._condition.mode == mode:
            return self._turns(now)
        return self._ask(mode, now) if self._due(now) else []

    def _turns(self, now: MonoNs) -> list[Message]:
        """Return the heading for ArduPilot's own landing, once a second while it is off the wanted one; PX4's takes none."""
        turn_rad, attitude = self._landing.order.turn_rad, self._attitude
        recent = self._turned is not None and seconds_between(self._turned, now) < _SLOW_S
        if self._id.stack is not Stack.ARDUPILOT or abs(turn_rad) < _TURNS_RAD or attitude is None or recent:
            return []
        if seconds_between(attitude.stamp.measured_at, now) > self._o.attitude_timeout_s:
            return []
        self._turned = now
        heading_deg = math.degrees(attitude.R_ned_body.rpy_rad[2] + turn_rad) % 360.0
        number, shortest = mav.MAV_CMD_CONDITION_YAW, 0.0
        return [mav.MAVLink_command_long_message(*self._id.address, number, 0, heading_deg, _TURN_DEG_S, shortest, 0, 0, 0, 0)]

    def _wanted(self, now: MonoNs) -> bool:
        """Return whether the landing continues, by velocity or by mode."""
        landing = self._landing
        if landing.spent or seconds_between(landing.at, now) > self._o.landing_timeout_s:
            return False
        if not landing.by_velocity:
            return True
        fell_m = 0.0 if self._down_m is None or landing.from_m is None else self._down_m - landing.from_m
        landing.spent = seconds_between(landing.began, now) > self._o.landing_most_s or fell_m > self._o.landing_depth_m
        return not landing.spent

    def _hold(self, now: MonoNs) -> list[Message]:
        """Request the autopilot's own hold mode, hold until it is active, and then send nothing."""
        name = HOLD_MODE.get(self._id.stack)
        if name is None or self._condition.mode == name:
            if name != self._mode and not self._modes.unsure:
                self._on(HandEvent.RESTS)
            return []
        ask = self._ask(name, now) if self._due(now) else []
        return self._setpoint(now, STILL) + ask if ask or not self._tries.spent(now) else []

    def _forced(self, now: MonoNs) -> bool:
        """Return whether the motors are stopped by force: guidance reports in every cycle that it feels the deck, in our mode."""
        fresh = self._felt_at is not None and seconds_between(self._felt_at, now) <= self._o.command_timeout_s
        lands = self._modes.own in (self._mode, self._land_mode)
        clear = self._condition.mode == self._modes.own and not self._modes.unsure
        return self._o.disarm_on_contact and fresh and lands and clear

    def _armed(self, now: MonoNs) -> bool | None:
        """Return whether the motors turn; None while a request of ours to arm may still be obeyed."""
        return None if self._climb is not None and self._climb.may_arm(now, _ARMS_S) else self._condition.armed

    def _stood(self, now: MonoNs) -> list[Message]:
        """Press on the deck while its motors are being stopped, and a little longer."""
        asked = self._stop.period(now, self._id.address, armed=self._armed(now), forced=self._forced(now))
        if self._stop.over(now):
            self._on(HandEvent.STOPPED)
            return []
        down = Velocity(self._v_deck * (1.0, 1.0, 0.0) + (0.0, 0.0, self._o.descent_rate_m_s), 0.0)
        return asked + (self._setpoint(now, down) if self._condition.mode == self._mode else [])

    def _end_take_off(self, now: MonoNs) -> None:
        """End the take-off: on deck its motors are stopped without force, in the air it holds over the deck."""
        climb = self._climb
        if climb is None or not climb.flew:
            self._on(HandEvent.ON_DECK)
            return
        v_deck = self._rest_level()
        if v_deck is not None:
            self._v_deck, self._steered_at = v_deck, now
        self._motion, self._motion_at = STILL, now
        self._on(HandEvent.ALOFT)

    def _take_off(self, now: MonoNs) -> list[Message]:
        """Arm and climb with the deck's velocity."""
        o, climb = self._o, self._climb
        over = climb is None or self._mode is None or seconds_between(climb.began, now) > o.take_off_timeout_s
        barred = climb is not None and not climb.flew and self._failsafe_acts
        if climb is None or over or barred or climb.done(now, self._down_m):
            self._end_take_off(now)
            return []
        out: list[Message] = []
        v_deck = self._rest_level()
        if v_deck is not None and climb.steers(self._down_m, self._condition):
            up = np.array([v_deck[0], v_deck[1], climb.climb_m_s(self._condition)])
            out += self._setpoint(now, Velocity(up, 0.0))
        streamed_s = 0.0 if self._streamed is None else seconds_between(self._streamed[0], now)
        if self._id.stack is Stack.PX4 and streamed_s < o.prestream_s:
            return out
        return out + climb.requests(now, self._condition, o.request_period_s, self._ask)

    def _rest_level(self) -> F64 | None:
        """Return the velocity that the vehicle had on deck, in its level frame; None without a heading."""
        if self._attitude is None:
            return None
        yaw_rad = self._attitude.R_ned_body.rpy_rad[2]
        mean = np.zeros(3) if self.rested is None else self.rested.v_ned
        return np.asarray(Rotation.from_rpy(0.0, 0.0, yaw_rad).inv @ mean)

    def _setpoint(self, now: MonoNs, velocity: Velocity | Lean) -> list[Message]:
        attitude = self._attitude if self._authority is Authority.SETPOINTS else None
        fresh = attitude is not None and seconds_between(attitude.stamp.measured_at, now) <= self._o.attitude_timeout_s
        if attitude is None or (self.hand is Hand.TAKING and not fresh):
            return []
        last = self._streamed
        self._streamed = (now if last is None or seconds_between(last[1], now) > _GAP_S else last[0], now)
        if not fresh:
            # Without any setpoint the autopilot would fly on with the last one, downwards too. The velocity of the surface below
            # was given by that old heading and turns back with it.
            up = np.array([0.0, 0.0, min(0.0, float(velocity.v_level[2]))])
            velocity = Velocity(self._held(now).v_level + up, 0.0)
        ms, rpy_rad = now // 1_000_000, attitude.R_ned_body.rpy_rad
        turn_rad = velocity.on_deck_turn_rad if isinstance(velocity, Lean) else None
        if turn_rad is not None and self._id.stack is Stack.ARDUPILOT:
            return [level_setpoint(ms, self._id.address, rpy_rad, turn_rad, velocity.yaw_rate_rad_s)]
        return [velocity_setpoint(ms, self._id.address, velocity, rpy_rad[2])]
