"""Compute what to send to the drone in each period: REF, PCMD and the watchdog reset, from command and navdata. No I/O.

The bit `REF_TAKE_OFF` asks the drone to be in the air: a flying drone that gets a REF without it lands. So it stays set in flight
and is cleared only for a commanded landing or on the ground; while the drone's state is not known no REF is sent at all.
"""

from __future__ import annotations

from typing import NamedTuple

from msgspec import Struct

from drivers.ardrone.arbiter import HOVER, STAY_UP, TimedCommand
from drivers.ardrone.at import PCMD_PROGRESSIVE, REF_BASE, REF_EMERGENCY, Pcmd
from drivers.ardrone.counters import Counters
from drivers.ardrone.landing_watch import ORDERED_ABOVE_M, SILENT_ABOVE_M, DroneReport, LandingWatch
from drivers.ardrone.navdata import ControlState, Navdata, NavdataState
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.velocity_loop import RESET, acceleration_of, lean, step
from estimator.contracts.commands import Command, CutMotors, Hover, Land, Lean, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.samples import Attitude, BodyVelocity, Sample
from estimator.contracts.time import MonoNs, after, seconds_between

_EMERGENCY_PERIODS = 3
"""The drone acts on the rising edge; three periods survive a lost datagram."""
_CUT_AGAIN_S, _LEAVE_AGAIN_S = 0.3, 2.0
"""The emergency bit is sent again if navdata this long after it does not show its effect. If the first was only late, that undoes
it: motors that were to stop stay off all the same, but a drone that was to leave the emergency state would be back in it."""
_ON_GROUND = (ControlState.DEFAULT, ControlState.INIT, ControlState.LANDED, None)
_IN_THE_AIR_OR_DEAD = NavdataState.FLYING | NavdataState.EMERGENCY
_NOT_STEERABLE = (ControlState.TAKING_OFF, ControlState.LANDING, ControlState.LANDED)


class _Motion(Struct, frozen=True):
    """A velocity or a lean that guidance asks for."""

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
    landing that the firmware began because it received no commands is called off. Velocity, lean and hover change the sticks
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
        """Whether the newest toggle asked to cut the motors; None before the first."""
        self._state: int | None = None
        self._navdata_at: MonoNs | None = None
        self._control: ControlState | None = None
        self._velocity: BodyVelocity | None = None
        self._attitude: Attitude | None = None
        self._loop = RESET
        self._stepped: MonoNs | None = None

    @property
    def flying(self) -> bool | None:
        """Whether the newest navdata says that the drone flies; None before the first navdata."""
        return None if self._state is None else bool(self._state & NavdataState.FLYING)

    @property
    def landing(self) -> bool:
        """Whether a commanded landing is not finished yet."""
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
            self._landing, self._landing_called_off, self._loop = None, False, RESET

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
        # A velocity's lifetime counts from the guidance cycle that asked for it, not from the period that repeats it.
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
            return self._hover()
        if seconds_between(motion.asked_at, now) > self._o.command_timeout_s:
            self._counters.hover_for_age += 1
            return self._hover()
        attitude = self._attitude if self._recent(self._attitude, now) else None
        heading = None if attitude is None else attitude.R_ned_body.rpy_rad[2]
        if isinstance(motion.wanted, Lean):
            if attitude is None:
                self._counters.hover_for_blindness += 1
                return self._hover()
            self._loop, sticks = lean(motion.wanted, heading, self._o)
        else:
            measured = self._velocity
            if measured is None or not self._recent(measured, now):
                self._counters.hover_for_blindness += 1
                return self._hover()
            dt_s = 0.0 if self._stepped is None else seconds_between(self._stepped, now)
            a_level = None if attitude is None else acceleration_of(attitude.R_ned_body)
            self._loop, sticks = step(self._loop.at_heading(heading), motion.wanted, measured.v_level, a_level, dt_s, self._o)
        self._stepped = now
        return Pcmd(PCMD_PROGRESSIVE, sticks.roll, sticks.pitch, sticks.gaz, sticks.yaw)

    def _recent(self, sample: BodyVelocity | Attitude | None, now: MonoNs) -> bool:
        return sample is not None and seconds_between(sample.stamp.measured_at, now) <= self._o.velocity_timeout_s

    def _hover(self) -> Pcmd:
        self._stepped = None
        return HOVER
