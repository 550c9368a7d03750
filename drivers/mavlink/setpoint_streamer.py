"""Choose what an autopilot is sent in each period, from the newest command and the state that it reports. No I/O.

It steers only after the order to fly: the first velocity takes the vehicle into its velocity mode (ArduPilot GUIDED, PX4
OFFBOARD, whose setpoints must stream for a while first). From then on every period carries a setpoint. A person who chooses
another mode takes the vehicle over: nothing is sent until the mode is chosen again, the operator starts again, or the vehicle
has landed.
A command of guidance is flown only for a short time unless guidance renews it. A velocity or a landing that is not renewed
becomes a hold at the deck's own velocity, then one over the ground, then the autopilot's hold mode, and our stream ends.
A landing by velocity is bounded by time and by height as well, renewed or not. A landing that a person ordered needs no renewal
and may begin at any height; when its time is used up our stream ends too, and the autopilot's own landing mode continues it.
A landing whose deck was felt stops the motors at once, by force, and its stream outlives them (`MotorStop`); a vehicle that
reports itself on the ground after a landing, still armed, is commanded to disarm. None is left armed on a deck.
When the process itself falls silent the autopilot's own failsafe acts: ArduPilot flies on for 3 s and brakes, PX4 brakes after
1 s. A landing by the autopilot's own mode (ArduPilot LAND) goes on then, by its own rules for a lost target (PLND_STRICT).
"""

import math
from dataclasses import replace
from enum import Enum

import numpy as np

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.setpoint import Rested, RestVelocity, TakingOff, velocity_setpoint
from drivers.mavlink.vehicle import (
    HOLD_MODE,
    LAND_MODE,
    RETURN_MODE,
    VELOCITY_MODE,
    Condition,
    Identity,
    Stack,
    reposition,
    set_mode,
)
from estimator.contracts.commands import (
    Command,
    CutMotors,
    Hover,
    Land,
    LandingPlace,
    Lean,
    LeaveEmergency,
    TakeOff,
    Velocity,
)
from estimator.contracts.geodesy import GeoPoint, ned_between
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, seconds_between

FORCE = 21196.0
"""Parameter 2 of COMPONENT_ARM_DISARM that disarms whatever the autopilot takes itself to do (mavlink.io)."""
OUTLIVE_S = 0.5
"""Time for which setpoints go on after the report that the motors stand, s."""
_EACH_S, _SLOW_S = 0.2, 1.0
_QUICK_S = 5.0
"""Time after which requests are rarer, s."""


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
        self._began = now
        self._asked: MonoNs | None = None
        self._stood: MonoNs | None = None

    def period(self, now: MonoNs, target: tuple[int, int], *, armed: bool | None, forced: bool) -> list[Message]:
        """Return the request of this period, if one is due."""
        if armed is False:
            self._stood = self._stood or now
            return []
        self._stood = None
        each_s = _EACH_S if seconds_between(self._began, now) < _QUICK_S else _SLOW_S
        if self._asked is not None and seconds_between(self._asked, now) < each_s:
            return []
        self._asked = now
        return [disarm(target, forced=forced)]

    def over(self, now: MonoNs) -> bool:
        """Return whether the motors have stood for long enough that the setpoints may end."""
        return self._stood is not None and seconds_between(self._stood, now) >= OUTLIVE_S


STILL = Velocity(np.zeros(3), 0.0)
_PLACE_S = 2.0
"""Age of the vehicle's place beyond which nothing is done by it, s."""
_REACHED_M = 3.0
"""Distance from another place at which the vehicle is there, m."""
_MEAN_S = 1.0
"""The time over which the velocity that a landing continues with is averaged."""


class Hand(Enum):
    """The party that controls the vehicle, and how far a change of control has come."""

    IDLE = "idle"
    """This program has no order to fly the vehicle."""
    TAKING = "taking"
    """This program has requested the velocity mode."""
    OURS = "ours"
    LANDING = "landing"
    STANDING = "standing"
    """The vehicle stands on the deck: its motors are being stopped."""
    HOLDING = "holding"
    """Guidance is silent: the autopilot is in its own hold mode, or on its way there."""
    LEAVING = "leaving"
    """The autopilot flies to another place by itself, and lands there."""
    RELEASED = "released"
    """A person chose another mode, or the mode was refused."""


class SetpointStreamer:
    """Holds the newest command and decides what to send."""

    def __init__(self, identity: Identity, options: AutopilotOptions) -> None:
        self._id = identity
        self._o = options
        self._motion: Velocity | Lean = STILL
        self._motion_at: MonoNs | None = None
        self._mean_velocity = np.zeros(3)
        """The mean of the velocities commanded lately, (3,) m/s: it follows the deck without the corrections."""
        self._v_deck = np.zeros(3)
        """The velocity of the surface below at the last commanded velocity, (3,) m/s in the level frame."""
        self._steered_at: MonoNs | None = None
        self._streaming_since: MonoNs | None = None
        self._taking_off: TakingOff | None = None
        self._returns = False
        """True if the vehicle is to fly back by its own mode."""
        self._place: GeoPoint | None = None
        self._placed_at = MonoNs(0)
        self._goal: GeoPoint | None = None
        """Place to land at, with the height to fly at."""
        self._there = False
        self._rest = RestVelocity()
        self._stop: MotorStop | None = None
        self._felt_at: MonoNs | None = None
        """Time when guidance last reported contact with the deck."""
        self._cut_at: MonoNs | None = None
        """Time of a person's order to cut the motors; None without one."""
        self._asked: MonoNs | None = None
        self._asks = 0
        self._landed_from = ""
        self._descending = False
        self._land = Land()
        self._land_at = self._land_began = MonoNs(0)
        self._down_m: float | None = None
        self._land_from_m: float | None = None
        self._paused = False
        """True while the landing is paused because it is not renewed; it continues when it is renewed."""
        self._spent = False
        """True if the landing under way has used up its time or its height."""
        self._condition = Condition()
        self._attitude: Attitude | None = None
        self.hand = Hand.IDLE
        self.refused = False
        """True if the hand was released because the velocity mode was refused, and not because another was chosen."""
        self.blind_periods = 0
        """The number of periods without a recent heading, in which it was only held over the surface below, or climbed."""
        self.stale_periods = 0
        """The number of periods in which a velocity was too old to be flown."""
        self.landings_called_off = 0
        """The number of landings that ended in the air: not renewed, or with their time or height used up."""

    @property
    def _mode(self) -> str | None:
        return VELOCITY_MODE.get(self._id.stack)

    @property
    def _lands_by_velocity(self) -> bool:
        chosen = self._o.landing
        return chosen == "velocity" or (chosen == "by stack" and self._id.stack is Stack.PX4)

    def take(self, command: Command, now: MonoNs, v_deck_level: F64 | None = None) -> None:
        """Take the newest command.

        Args:
            v_deck_level: (3,) m/s, velocity of the surface below, already included in a velocity; None if it is not known.
        """
        if isinstance(command, CutMotors):
            if self._cut_at is None:
                self._cut_at, self._asked, self._asks = now, None, 0
        elif isinstance(command, LeaveEmergency):
            self._cut_at = None
        elif isinstance(command, TakeOff):
            self._taking_off = TakingOff(now, self._id, self._down_m, self._o.take_off_height_m)
        elif isinstance(command, Land):
            self._taking_off = None
            self._motion_at = now
            if command.on_deck and self.hand not in (Hand.IDLE, Hand.RELEASED):
                self._felt_at = now
                self._stand(now)
            elif self.hand is Hand.STANDING:
                pass
            elif self.hand is Hand.LANDING and command.persistent and not self._land.persistent:
                self._land, self._land_at, self._land_began, self._spent = command, now, now, False
            elif self.hand is Hand.LANDING and not self._spent:
                self._land_at = now
            elif self.hand not in (Hand.LANDING, Hand.RELEASED) and not self._spent:
                self._land, self._land_at, self._land_began, self._land_from_m = command, now, now, self._down_m
                self._landed_from = self._condition.mode
                self._descending = self._lands_by_velocity and self._landed_from == self._mode
                self._request_again(Hand.LANDING)
        elif isinstance(command, Hover):
            self._motion, self._motion_at, self._spent = STILL, now, False
            if command.returns and not self._returns and self.hand is Hand.OURS:
                self._request_again(Hand.OURS)
            self._returns = command.returns
            if (self.hand is Hand.LEAVING) != (command.elsewhere is not None) and self.hand in (Hand.OURS, Hand.LEAVING):
                self._leave_for(command.elsewhere, now)
            if v_deck_level is not None:
                self._v_deck, self._steered_at = v_deck_level, now
            if self.hand is Hand.STANDING and self._condition.armed is not False:
                self._request_again(Hand.TAKING)
            if self.hand is Hand.LANDING:
                self._call_off()
        else:
            since_s = math.inf if self._steered_at is None else seconds_between(self._steered_at, now)
            weight = min(1.0, since_s / _MEAN_S)
            self._mean_velocity = self._mean_velocity + weight * (command.v_level - self._mean_velocity)
            self._v_deck = np.zeros(3) if v_deck_level is None else v_deck_level
            self._motion, self._motion_at, self._steered_at, self._spent = command, now, now, False
            self._returns = False
            willing = (Hand.IDLE, Hand.LANDING, Hand.HOLDING, Hand.STANDING, Hand.LEAVING)
            if self.hand in willing and self._mode is not None and self._condition.flying is not False:
                self._request_again(Hand.TAKING)

    def _here(self, now: MonoNs) -> GeoPoint | None:
        """Return the place of the vehicle; None if none was reported lately."""
        return self._place if seconds_between(self._placed_at, now) <= _PLACE_S else None

    def _modes_on_the_way(self) -> tuple[str | None, ...]:
        own = self._mode, HOLD_MODE[Stack.PX4] if self._id.stack is Stack.PX4 else None
        return (*own, LAND_MODE.get(self._id.stack)) if self._there else own

    def _leave_for(self, where: LandingPlace | None, now: MonoNs) -> None:
        """Begin the way to another place if that is known to be in range, or end it."""
        here = self._here(now)
        if where is None:
            self._request_again(Hand.TAKING)
        elif here is not None and math.hypot(*ned_between(here, where.place)[:2]) <= where.range_max_m:
            highest_m = max(where.place.height_m or 0.0, here.height_m or 0.0)
            self._goal, self._there = replace(where.place, height_m=highest_m), False
            self._request_again(Hand.LEAVING)

    def _call_off(self) -> None:
        """End the landing; the velocity mode then holds the vehicle in place."""
        self.landings_called_off += 1
        self._request_again(Hand.TAKING)

    def engage(self) -> None:
        """Allow a vehicle that a person took over to be taken back, because the operator starts again."""
        if self.hand is Hand.RELEASED:
            self._request_again(Hand.IDLE)

    def on_condition(self, condition: Condition) -> None:
        """Take the condition that the autopilot reports."""
        self._condition = condition
        in_mode = condition.mode == self._mode
        held_modes = (self._mode, HOLD_MODE.get(self._id.stack))
        landing_modes = (self._landed_from, LAND_MODE.get(self._id.stack))
        taken_over = (
            (self.hand is Hand.OURS and not in_mode)
            or (self.hand is Hand.LANDING and condition.mode not in landing_modes)
            or (self.hand is Hand.HOLDING and condition.mode not in held_modes)
            or (self.hand is Hand.LEAVING and condition.mode not in self._modes_on_the_way())
        )
        if self._taking_off is not None:
            if self._taking_off.flew and not in_mode:
                self._taking_off, self.hand, self.refused = None, Hand.RELEASED, False
            return
        if condition.flying is False and self.hand not in (Hand.IDLE, Hand.STANDING):
            landing = self.hand in (Hand.LANDING, Hand.HOLDING)
            # One that is ours keeps its setpoints for as long as it is armed: their end would be a failure to it.
            if condition.armed is False or not (landing or self.hand is Hand.OURS):
                self._request_again(Hand.IDLE)
            elif landing:
                self._stop = None
                self._request_again(Hand.STANDING)
        elif self.hand in (Hand.TAKING, Hand.RELEASED) and in_mode:
            self.hand = Hand.OURS
        elif taken_over:
            self.hand, self.refused = Hand.RELEASED, False

    def on_position(self, down_m: float) -> None:
        """Take the autopilot's position below its own origin, metres."""
        self._down_m = down_m

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
        if self._cut_at is not None:
            return self._cut(now)
        if self._taking_off is not None:
            return self._take_off(now, self._taking_off)
        out: list[Message] = []
        if self.hand in (Hand.TAKING, Hand.OURS):
            out += self._steer(now)
        elif self.hand is Hand.LANDING:
            out += self._descend(now)
        elif self.hand is Hand.STANDING:
            out += self._stood(now)
        elif self.hand is Hand.HOLDING:
            out += self._hold(now)
        elif self.hand is Hand.LEAVING:
            out += self._go(now)
        else:
            self._streaming_since = None
        return out

    def leave(self, now: MonoNs) -> list[Message]:
        """Return the final messages, a hold in place. A landing of guidance is called off; one that a person ordered goes on."""
        if self.hand is Hand.LANDING and self._land.persistent:
            descending = self._descending
            return [set_mode(self._id.stack, self._id.address, LAND_MODE[self._id.stack])] if descending else []
        if self.hand is Hand.STANDING:
            return [disarm(self._id.address, forced=self._forced(now))] if self._condition.armed is not False else []
        if self.hand not in (Hand.TAKING, Hand.OURS, Hand.LANDING, Hand.HOLDING):
            return []
        by_mode = self._id.stack is Stack.PX4 or (self.hand is Hand.LANDING and not self._descending)
        name = HOLD_MODE.get(self._id.stack)
        hold = [set_mode(self._id.stack, self._id.address, name)] if by_mode and name is not None else []
        return self._setpoint(now, STILL) + hold

    def _request_again(self, hand: Hand) -> None:
        self.hand, self._asked, self._asks = hand, None, 0

    def _may_ask(self, now: MonoNs) -> bool:
        """Return whether a request may be sent or repeated now, and count it."""
        asked_s = math.inf if self._asked is None else seconds_between(self._asked, now)
        if self._asks >= self._o.request_tries or asked_s < self._o.request_period_s:
            return False
        self._asked, self._asks = now, self._asks + 1
        return True

    def _steer(self, now: MonoNs) -> list[Message]:
        silent_s = math.inf if self._motion_at is None else seconds_between(self._motion_at, now)
        fresh = silent_s <= self._o.command_timeout_s
        self.stale_periods += not fresh
        if self.hand is Hand.OURS and silent_s > self._o.hold_mode_after_s:
            self._request_again(Hand.HOLDING)
            return self._hold(now)
        out = self._setpoint(now, self._motion if fresh and self._motion is not STILL else self._held(now))
        if not out:
            return []
        if self._streaming_since is None:
            self._streaming_since = now
        if self.hand is Hand.TAKING and self._mode is not None:
            streamed_s = seconds_between(self._streaming_since, now)
            if (self._id.stack is not Stack.PX4 or streamed_s >= self._o.prestream_s) and self._may_ask(now):
                out.append(set_mode(self._id.stack, self._id.address, self._mode))
            elif self._asks >= self._o.request_tries and seconds_between(self._asked or now, now) >= self._o.request_period_s:
                self.hand, self.refused = Hand.RELEASED, True
        back = RETURN_MODE.get(self._id.stack)
        if self.hand is Hand.OURS and self._returns and back is not None and self._may_ask(now):
            # In its own mode it is no longer ours.
            out.append(set_mode(self._id.stack, self._id.address, back))
        return out

    def _go(self, now: MonoNs) -> list[Message]:
        """Send the autopilot to the place, and let it land there by its own mode; it lands nowhere else by this."""
        goal, here, mode = self._goal, self._here(now), LAND_MODE.get(self._id.stack)
        if goal is None or here is None or mode is None or self._condition.mode == mode:
            return []
        if not self._there and math.hypot(*ned_between(here, goal)[:2]) <= _REACHED_M:
            self._there = True
            self._request_again(Hand.LEAVING)
        # To PX4 the end of the setpoints is a failure until it has left OFFBOARD; to ArduCopter one more is another goal.
        out = self._setpoint(now, self._held(now)) if self._condition.mode == "offboard" else []
        if not self._may_ask(now):
            return out
        return [*out, set_mode(self._id.stack, self._id.address, mode) if self._there else reposition(self._id.address, goal)]

    def _held(self, now: MonoNs) -> Velocity:
        """Return the velocity that holds over the surface below while its velocity is known, later over the ground."""
        if self._steered_at is None or seconds_between(self._steered_at, now) > self._o.deck_hold_s:
            return STILL
        return Velocity(self._v_deck * (1.0, 1.0, 0.0), 0.0)

    def _descend(self, now: MonoNs) -> list[Message]:
        """Continue a landing while it is renewed and within its bounds, else hold."""
        if not self._wanted(now):
            if not self._descending:
                self._call_off()
                return self._steer(now)
            if not self._paused:
                self._paused = True
                self.landings_called_off += 1
            silent_s = seconds_between(self._land_at, now)
            if silent_s > self._o.hold_mode_after_s:
                self._request_again(Hand.HOLDING)
                return self._hold(now)
            velocity = self._mean_velocity * (1.0, 1.0, 0.0) if silent_s <= self._o.deck_hold_s else np.zeros(3)
            return self._setpoint(now, Velocity(velocity, 0.0))
        self._paused = False
        if self._descending and self._land.persistent and seconds_between(self._land_began, now) > self._o.landing_most_s:
            self._descending = False
        if self._descending:
            v = np.array([self._mean_velocity[0], self._mean_velocity[1], self._o.descent_rate_m_s])
            return self._setpoint(now, Velocity(v, 0.0))
        mode = LAND_MODE.get(self._id.stack)
        if mode is None or self._condition.mode == mode or not self._may_ask(now):
            return []
        return [set_mode(self._id.stack, self._id.address, mode)]

    def _wanted(self, now: MonoNs) -> bool:
        """Return whether the landing continues, by velocity or by mode."""
        if self._land.persistent:
            return True
        if self._spent or seconds_between(self._land_at, now) > self._o.landing_timeout_s:
            return False
        if not self._descending:
            return True
        fell_m = 0.0 if self._down_m is None or self._land_from_m is None else self._down_m - self._land_from_m
        self._spent = seconds_between(self._land_began, now) > self._o.landing_most_s or fell_m > self._o.landing_depth_m
        return not self._spent

    def _hold(self, now: MonoNs) -> list[Message]:
        """Request the autopilot's own hold mode, hold until it is active, and then send nothing."""
        name = HOLD_MODE.get(self._id.stack)
        if name is None or self._condition.mode == name or self._asks >= self._o.request_tries:
            return []
        ask = [set_mode(self._id.stack, self._id.address, name)] if self._may_ask(now) else []
        return self._setpoint(now, STILL) + ask

    def _stand(self, now: MonoNs) -> None:
        """Begin to stop the motors, because the deck was felt."""
        if self.hand is not Hand.STANDING:
            self._request_again(Hand.STANDING)
            self._stop = MotorStop(now)

    def _forced(self, now: MonoNs) -> bool:
        """Return whether the motors are stopped by force: guidance says in every cycle that it has felt the deck."""
        fresh = self._felt_at is not None and seconds_between(self._felt_at, now) <= self._o.command_timeout_s
        return self._o.disarm_on_contact and fresh

    def _stood(self, now: MonoNs) -> list[Message]:
        """Press on the deck while its motors are being stopped, and a little longer."""
        self._stop = self._stop or MotorStop(now)
        asked = self._stop.period(now, self._id.address, armed=self._condition.armed, forced=self._forced(now))
        if self._stop.over(now):
            self._stop = None
            self._request_again(Hand.IDLE)
            return []
        in_mode = self._condition.mode == self._mode
        down = Velocity(self._v_deck * (1.0, 1.0, 0.0) + (0.0, 0.0, self._o.descent_rate_m_s), 0.0)
        return asked + (self._setpoint(now, down) if in_mode else [])

    def _take_off(self, now: MonoNs, climbing: TakingOff) -> list[Message]:
        """Arm and climb with the deck's velocity."""
        o = self._o
        v_deck = self._rest_level()
        done, over = climbing.done(self._down_m, self._condition), seconds_between(climbing.began, now) > o.take_off_timeout_s
        if self._mode is None or done or over:
            if done and self._condition.mode == self._mode and v_deck is not None:
                self._v_deck, self._steered_at, self._motion, self._motion_at = v_deck, now, STILL, now
                self._request_again(Hand.OURS)
            self._taking_off, self._streaming_since = None, None
            return []
        out: list[Message] = []
        if v_deck is not None and climbing.steers(self._down_m, self._condition):
            up = np.array([v_deck[0], v_deck[1], climbing.climb_m_s(self._condition)])
            out += self._setpoint(now, Velocity(up, 0.0))
        if out and self._streaming_since is None:
            self._streaming_since = now
        streamed_s = 0.0 if self._streaming_since is None else seconds_between(self._streaming_since, now)
        return out + climbing.requests(now, self._condition, streamed_s, o.prestream_s, o.request_period_s)

    def _rest_level(self) -> F64 | None:
        """Return the velocity that the vehicle had on deck, in its level frame; None without a heading."""
        if self._attitude is None:
            return None
        yaw_rad = self._attitude.R_ned_body.rpy_rad[2]
        mean = np.zeros(3) if self.rested is None else self.rested.v_ned
        return np.asarray(Rotation.from_rpy(0.0, 0.0, yaw_rad).inv @ mean)

    def _cut(self, now: MonoNs) -> list[Message]:
        """Stop the motors by force until the autopilot reports that it is disarmed; the forced form works in flight."""
        assert self._cut_at is not None
        if not self._condition.armed or seconds_between(self._cut_at, now) > self._o.request_period_s * self._o.request_tries:
            self._cut_at = None
            self._request_again(Hand.RELEASED)
            return []
        if not self._may_ask(now):
            return []
        return [disarm(self._id.address, forced=True)]

    def _setpoint(self, now: MonoNs, velocity: Velocity | Lean) -> list[Message]:
        attitude = self._attitude
        if attitude is not None and seconds_between(attitude.stamp.measured_at, now) <= self._o.attitude_timeout_s:
            return [velocity_setpoint(now // 1_000_000, self._id.address, velocity, attitude.R_ned_body.rpy_rad[2])]
        self.blind_periods += 1
        if attitude is None or self.hand is Hand.TAKING:
            return []
        # Without any setpoint the autopilot would fly on with the last one, downwards too. The velocity of the surface below was
        # given by that old heading and turns back with it.
        up = np.array([0.0, 0.0, min(0.0, float(velocity.v_level[2]))])
        level = Velocity(self._held(now).v_level + up, 0.0)
        return [velocity_setpoint(now // 1_000_000, self._id.address, level, attitude.R_ned_body.rpy_rad[2])]
