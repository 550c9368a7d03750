"""Compute what to send to the drone in each period: REF, PCMD and the watchdog reset, from command and navdata. No I/O.

The bit `REF_TAKE_OFF` orders the drone to be in the air: a flying drone that gets a REF without it lands. So it stays set in
flight and is cleared only for a commanded landing or on the ground; while the drone's state is not known no REF is sent at all.

The drone takes roll and pitch as fractions of a tilt angle, so a velocity needs a loop here: a PI controller on the measured
velocity with the drag of the commanded speed fed forward, solved for the tilt that gives that acceleration, limited as a vector.
The tilt follows its command late; commanding more than the tilt still lacks (`velocity_lead`) compensates part of that delay.
The drone itself closes the loops of climb and turn rate, which are only scaled here.

A tilt is flown as it is: its acceleration is the tilt. Its trim becomes the loop's integral, so a velocity that follows begins
with the tilt that holds against the wind, and the integral keeps its direction over the ground while the nose turns.

The default drag, 0.43 1/s, is the regression of acceleration on tilt and speed in a flight under motion capture.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from drivers.ardrone.arbiter import HOVER, STAY_UP, TimedCommand
from drivers.ardrone.at import PCMD_PROGRESSIVE, REF_BASE, REF_EMERGENCY, Pcmd
from drivers.ardrone.counters import Counters
from drivers.ardrone.landing_watch import ORDERED_ABOVE_M, SILENT_ABOVE_M, DroneReport, LandingWatch
from drivers.ardrone.navdata import ControlState, Navdata, NavdataState
from drivers.ardrone.options import ArDroneOptions
from estimator.contracts.commands import Command, CutMotors, Hover, Land, Lean, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import Attitude, BodyVelocity, Sample
from estimator.contracts.time import MonoNs, after, seconds_between


class Sticks(Struct, frozen=True):
    """Stick positions, -1..1 with PCMD's signs: roll + right, pitch + backward (nose up), gaz + up, yaw + clockwise."""

    roll: float = 0.0
    pitch: float = 0.0
    gaz: float = 0.0
    yaw: float = 0.0


_HELD_S = 2.0
"""Time over which the tilt of the drone's own hover is averaged, s: gusts are shorter."""


class LoopState(Struct, frozen=True):
    """The state of the loop: the integral's acceleration, m/s^2 forward and right."""

    forward_m_s2: float = 0.0
    right_m_s2: float = 0.0
    heading_rad: float | None = None
    """The heading for which it holds; None if it was not known."""

    def at_heading(self, heading_rad: float | None) -> LoopState:
        """Return the state in the axes of another heading: the wind stays where it is while the nose turns."""
        if heading_rad is None or self.heading_rad is None:
            return replace(self, heading_rad=self.heading_rad if heading_rad is None else heading_rad)
        c, s = math.cos(heading_rad - self.heading_rad), math.sin(heading_rad - self.heading_rad)
        x, y = self.forward_m_s2, self.right_m_s2
        return LoopState(c * x + s * y, c * y - s * x, heading_rad)


RESET = LoopState()


def acceleration_of(R_ned_body: Rotation) -> F64:
    """Return the acceleration that hovering thrust gives at this tilt, (2,) m/s^2 forward and right."""
    roll, pitch, _ = R_ned_body.rpy_rad
    return G_M_S2 * np.array([-math.tan(pitch), math.tan(roll) / math.cos(pitch)])


def step(
    state: LoopState, wanted: Velocity, v_level: F64, a_level: F64 | None, dt_s: float, options: ArDroneOptions
) -> tuple[LoopState, Sticks]:
    """Advance the loop by one period.

    Args:
        v_level: (3,) measured velocity, m/s forward, right, down; down is not used.
        a_level: (2,) acceleration of the present tilt (`acceleration_of`), m/s^2 forward and right; None for no lead.
        dt_s: time since the last step, for the integral, seconds; 0 on the first.

    Returns:
        The next state and the sticks. The integral is held while the tilt is at its limit and it would grow further.
    """
    error = np.asarray(wanted.v_level[:2] - v_level[:2])
    integral = np.array([state.forward_m_s2, state.right_m_s2])
    most_m_s2 = G_M_S2 * math.tan(options.euler_angle_max_rad)
    pushed = _within(integral + options.velocity_integral_1_s2 * max(0.0, dt_s) * error, most_m_s2)
    feed_forward = options.velocity_gain_1_s * error + options.velocity_drag_1_s * wanted.v_level[:2]
    if float(np.hypot(*(feed_forward + pushed))) <= most_m_s2 or float(error @ (feed_forward + integral)) <= 0.0:
        integral = pushed
    accelerate = _added(integral, feed_forward, most_m_s2)
    if a_level is not None:
        accelerate = _within(accelerate + options.velocity_lead * (accelerate - a_level), most_m_s2)
    state = LoopState(float(integral[0]), float(integral[1]), state.heading_rad)
    return state, _sticks(accelerate, float(wanted.v_level[2]), wanted.yaw_rate_rad_s, options)


def lean(wanted: Lean, heading_rad: float | None, options: ArDroneOptions) -> tuple[LoopState, Sticks]:
    """Return the sticks of a tilt, limited as a vector, and the loop's state from which a velocity would go on.

    Args:
        heading_rad: the present heading; None if it is not known.
    """
    most_m_s2 = G_M_S2 * math.tan(options.euler_angle_max_rad)
    trim = _within(wanted.trim_level, most_m_s2)
    accelerate = _within(wanted.a_level + wanted.trim_level, most_m_s2)
    state = LoopState(float(trim[0]), float(trim[1]), heading_rad)
    return state, _sticks(accelerate, float(wanted.v_level[2]), wanted.yaw_rate_rad_s, options)


def held(
    state: LoopState, v_level: F64, v_before: F64, a_level: F64, held_s: float, dt_s: float, options: ArDroneOptions
) -> LoopState:
    """Return the state after a period in which the drone held its place by itself: its tilt there is what cancels the wind.

    A mean of the tilt, less what accelerated the drone and what its own speed costs.

    Args:
        v_level, v_before: (2,) measured velocity now and a period before, m/s forward and right.
        a_level: (2,) acceleration of the present tilt (`acceleration_of`), m/s^2.
        held_s: time for which it has been holding, s: the mean begins with the first period.
        dt_s: the period, above 0, s.
    """
    trim = a_level - (v_level - v_before) / dt_s - options.velocity_drag_1_s * v_level
    integral = np.array([state.forward_m_s2, state.right_m_s2])
    integral = integral + dt_s / max(dt_s, min(_HELD_S, held_s)) * (trim - integral)
    integral = _within(integral, G_M_S2 * math.tan(options.euler_angle_max_rad))
    return replace(state, forward_m_s2=float(integral[0]), right_m_s2=float(integral[1]))


def _sticks(accelerate: F64, descend_m_s: float, yaw_rate_rad_s: float, options: ArDroneOptions) -> Sticks:
    """Return the sticks that give an acceleration, (2,) m/s^2 forward and right, a descent rate and a turn rate."""
    size = float(np.hypot(accelerate[0], accelerate[1]))
    tilt = math.atan2(size, G_M_S2) / options.euler_angle_max_rad
    forward, right = accelerate / size * tilt if size > 0 else (0.0, 0.0)
    return Sticks(
        roll=_unit(float(right)),
        pitch=_unit(-float(forward)),
        gaz=_unit(-descend_m_s / options.vz_max_m_s),
        yaw=_unit(yaw_rate_rad_s / options.yaw_rate_max_rad_s),
    )


def _progressive(sticks: Sticks) -> Pcmd:
    return Pcmd(PCMD_PROGRESSIVE, sticks.roll, sticks.pitch, sticks.gaz, sticks.yaw)


def _within(v: F64, length: float) -> F64:
    """Return the vector, shortened to at most this length."""
    size = float(np.hypot(v[0], v[1]))
    return v * (length / size) if size > length else v


def _added(base: F64, more: F64, length: float) -> F64:
    """Return the sum, with less of the second where it would be longer: what holds against the wind is not cut."""
    a, b, c = float(more @ more), float(base @ more), length * length - float(base @ base)
    if a == 0.0 or a + 2.0 * b <= c:
        return base + more
    return base + max(0.0, (math.sqrt(max(0.0, b * b + a * c)) - b) / a) * more


def _unit(x: float) -> float:
    return min(1.0, max(-1.0, x))


_EMERGENCY_PERIODS = 3
"""The drone acts on the rising edge; three periods survive a lost datagram."""
_CUT_AGAIN_S, _LEAVE_AGAIN_S = 0.3, 2.0
"""The emergency bit is sent again if navdata this long after it does not show its effect. If the first was only late, that undoes
it: motors that were to stop stay off all the same, but a drone that was to leave the emergency state would be back in it."""
_ON_GROUND = (ControlState.DEFAULT, ControlState.INIT, ControlState.LANDED, None)
_IN_THE_AIR_OR_DEAD = NavdataState.FLYING | NavdataState.EMERGENCY
_NOT_STEERABLE = (ControlState.TAKING_OFF, ControlState.LANDING, ControlState.LANDED)


class _Motion(Struct, frozen=True):
    """A velocity or a tilt that guidance requests."""

    wanted: Velocity | Lean
    asked_at: MonoNs


class _Landing(NamedTuple):
    """A commanded landing that is not finished yet."""

    renewed_at: MonoNs
    persistent: bool
    """A person ordered it, and nobody has to renew it."""


class CommandStreamer:
    """Holds the newest command and the drone's latest status, and builds the command of each period from them.

    A take-off holds until the drone flies; it is given up after `take_off_timeout_s` or an emergency. A landing is renewed in
    each guidance cycle; any other command, or `landing_timeout_s` without one, calls it off, except near the ground, where the
    drone finishes it. A landing that a person ordered holds until the drone is on the ground or a take-off is commanded. A
    landing that the firmware began because it received no commands is called off. Velocity, tilt and hover change the sticks
    alone; the tilt that holds against the wind is kept over a hover.
    """

    def __init__(self, options: ArDroneOptions, counters: Counters) -> None:
        self._o = options
        self._counters = counters
        self._motion: _Motion | None = None
        """The velocity or lean to fly; None to hover."""
        self._take_off_at: MonoNs | None = None
        self._landing: _Landing | None = None
        self._landing_called_off = False
        """Guidance gave another command after its landing."""
        self._watch = LandingWatch()
        self._emergency_periods = 0
        self._toggled_at: MonoNs | None = None
        self._toggled_to: bool | None = None
        """True if the newest toggle was to cut the motors; None before the first."""
        self._state: int | None = None
        self._navdata_at: MonoNs | None = None
        self._control: ControlState | None = None
        self._velocity: BodyVelocity | None = None
        self._attitude: Attitude | None = None
        self._loop = RESET
        self._stepped: MonoNs | None = None
        """Time of the newest period that was flown by the loop; None after one that was not."""
        self._held: tuple[MonoNs, F64] | None = None
        """Time and measured velocity of the newest period of a hover; None after one that was none."""
        self._known_s = 0.0
        """Time for which the loop's state has been learned, up to what its mean takes."""

    @property
    def flying(self) -> bool | None:
        """True if the newest navdata reports that the drone flies; None before the first navdata."""
        return None if self._state is None else bool(self._state & NavdataState.FLYING)

    @property
    def landing(self) -> bool:
        """True if a commanded landing is not finished yet."""
        return self._landing is not None

    def take(self, command: Command, now: MonoNs) -> None:
        """Take the newest command."""
        if isinstance(command, CutMotors | LeaveEmergency):
            self._toggle_emergency_unless(isinstance(command, CutMotors), now)
        elif isinstance(command, TakeOff):
            self._take_off_at, self._landing, self._motion = now, None, None
        elif isinstance(command, Land):
            persistent = command.persistent or (self._landing is not None and self._landing.persistent)
            self._landing = _Landing(now, persistent)
            self._take_off_at, self._motion, self._landing_called_off = None, None, False
        else:
            self._motion = _Motion(command, now) if isinstance(command, Velocity | Lean) else None
            ends = isinstance(command, Hover) and command.calls_off
            if self._landing is not None and (ends or not self._landing.persistent):
                self._landing, self._landing_called_off = None, True

    def _toggle_emergency_unless(self, cut: bool, now: MonoNs) -> None:
        """Ask the drone to cut its motors, or to leave the emergency state, unless it says that it has.

        The drone toggles, so a repeated command waits for navdata that would show what the one before did.
        """
        self._take_off_at, self._motion = None, None
        if self._state is not None and bool(self._state & NavdataState.EMERGENCY) is cut:
            return
        toggled_at, heard_at = self._toggled_at, self._navdata_at
        again_s = _CUT_AGAIN_S if cut else _LEAVE_AGAIN_S
        waits = toggled_at is not None and (heard_at is None or seconds_between(toggled_at, heard_at) < again_s)
        if not waits or self._toggled_to is not cut:
            self._toggled_at, self._toggled_to, self._emergency_periods = now, cut, _EMERGENCY_PERIODS

    def on_navdata(self, navdata: Navdata, now: MonoNs) -> None:
        """Take the next navdata datagram, in order."""
        self._state, self._navdata_at = navdata.state, now
        report = DroneReport.of(navdata)
        if report.control is not None:
            self._control = report.control
        self._watch.on_report(report, now, ordered=self._landing is not None)
        if report.state & _IN_THE_AIR_OR_DEAD:
            self._take_off_at = None
        elif self._control in _ON_GROUND:
            self._landing, self._landing_called_off, self._loop, self._known_s = None, False, RESET, 0.0

    def on_sample(self, sample: Sample) -> None:
        """Take a sample of the drone; velocities and attitudes are kept for steering, others are ignored."""
        # By the type itself, as there are hundreds of samples a second.
        if type(sample) is BodyVelocity:
            self._velocity = sample
        elif type(sample) is Attitude:
            self._attitude = sample

    def command(self, now: MonoNs) -> TimedCommand:
        """Return the command of this period, with the instant at which it expires."""
        watchdog = self._state is not None and bool(self._state & NavdataState.COM_WATCHDOG)
        self._counters.watchdog_resets += watchdog
        ref = self._ref_bits(now)
        sticks = self._sticks(now)
        # A velocity's lifetime counts from the guidance cycle that requested it, not from the period that repeats it.
        since = now if self._motion is None or sticks is HOVER else self._motion.asked_at
        landing = self._landing is not None and not self._landing.persistent
        return TimedCommand(after(since, self._o.command_timeout_s), sticks, ref, landing, watchdog)

    def leave(self, now: MonoNs) -> TimedCommand:
        """Return the final command: hover in place, or continue a landing that was commanded."""
        self._take_off_at = None
        return TimedCommand(after(now, self._o.command_timeout_s), HOVER, self._ref_bits(now))

    def _unknown(self, now: MonoNs) -> bool:
        return self._navdata_at is None or seconds_between(self._navdata_at, now) > self._o.navdata_silence_s

    def _ref_bits(self, now: MonoNs) -> int | None:
        if self._take_off_at is not None and seconds_between(self._take_off_at, now) > self._o.take_off_timeout_s:
            self._take_off_at = None
            self._counters.take_offs_given_up += 1
        if self._emergency_periods:
            self._emergency_periods -= 1
            return REF_BASE | REF_EMERGENCY
        if self._landing is not None and not self._landing.persistent:
            silent = seconds_between(self._landing.renewed_at, now) > self._o.landing_timeout_s
            if silent and self._watch.calls_off(now):
                self._landing, self._landing_called_off = None, True
                self._counters.landings_given_up += 1
        if self._landing is not None:
            return REF_BASE
        if self._take_off_at is not None:
            return STAY_UP
        if self._unknown(now):
            return None
        if self.flying and self._control is ControlState.LANDING:
            # Guidance that flies has an estimate and takes the drone further; without it the drone would only hover there.
            flies = self._motion is not None and seconds_between(self._motion.asked_at, now) <= self._o.command_timeout_s
            if self._watch.calls_off(now, ORDERED_ABOVE_M if self._landing_called_off or flies else SILENT_ABOVE_M):
                self._counters.landings_called_off += 1
                return STAY_UP
            return None
        return STAY_UP if self.flying else REF_BASE

    def _sticks(self, now: MonoNs) -> Pcmd:
        motion = self._motion
        steerable = bool(self.flying) and self._landing is None and self._control not in _NOT_STEERABLE
        if motion is None or not steerable:
            if steerable:
                self._feel_held(now)
            return self._hover()
        self._held = None
        if seconds_between(motion.asked_at, now) > self._o.command_timeout_s:
            self._counters.hover_for_age += 1
            return self._hover()
        attitude = self._attitude if self._recent(self._attitude, now) else None
        heading = None if attitude is None else attitude.R_ned_body.rpy_rad[2]
        if isinstance(motion.wanted, Lean):
            if attitude is None:
                return self._unmeasured(motion.wanted)
            self._loop, sticks = lean(motion.wanted, heading, self._o)
        else:
            measured = self._velocity
            if measured is None or not self._recent(measured, now):
                return self._unmeasured(motion.wanted)
            dt_s = 0.0 if self._stepped is None else seconds_between(self._stepped, now)
            a_level = None if attitude is None else acceleration_of(attitude.R_ned_body)
            self._loop, sticks = step(self._loop.at_heading(heading), motion.wanted, measured.v_level, a_level, dt_s, self._o)
        self._stepped, self._known_s = now, _HELD_S
        return _progressive(sticks)

    def _feel_held(self, now: MonoNs) -> None:
        """Learn the tilt with which the drone's own hover cancels the wind, from which a velocity goes on."""
        attitude, velocity, before = self._attitude, self._velocity, self._held
        if attitude is None or velocity is None or not (self._recent(attitude, now) and self._recent(velocity, now)):
            self._held = None
            return
        v = np.array(velocity.v_level[:2])
        self._held = now, v
        if before is None or (dt_s := seconds_between(before[0], now)) <= 0.0:
            return
        self._known_s = min(_HELD_S, self._known_s + dt_s)
        a_level, at_heading = acceleration_of(attitude.R_ned_body), self._loop.at_heading(attitude.R_ned_body.rpy_rad[2])
        self._loop = held(at_heading, v, before[1], a_level, self._known_s, dt_s, self._o)

    def _unmeasured(self, wanted: Velocity | Lean) -> Pcmd:
        """Return what flies where nothing measures the motion: a hover, or a climb with the tilt that holds against the wind.

        The firmware's hover keeps the height, and a deck that rises comes up to it.
        """
        self._counters.hover_for_blindness += 1
        climb = float(wanted.v_level[2])
        if climb >= 0.0:
            return self._hover()
        self._stepped = None
        trim = np.array([self._loop.forward_m_s2, self._loop.right_m_s2])
        return _progressive(_sticks(trim, climb, 0.0, self._o))

    def _recent(self, sample: BodyVelocity | Attitude | None, now: MonoNs) -> bool:
        return sample is not None and seconds_between(sample.stamp.measured_at, now) <= self._o.velocity_timeout_s

    def _hover(self) -> Pcmd:
        self._stepped = None
        return HOVER
