"""Compute what to send to the drone in each period: REF, PCMD and the watchdog reset, from command and navdata. No I/O.

Who has the drone, and so REF, is `custody`'s; the sticks are `velocity_loop`'s.
"""

from msgspec import Struct

from drivers.ardrone.arbiter import HOVER, TimedCommand
from drivers.ardrone.at import Pcmd
from drivers.ardrone.counters import Counters
from drivers.ardrone.custody import Custody, CustodyKeeper
from drivers.ardrone.landing_watch import DroneReport
from drivers.ardrone.navdata import Navdata, NavdataState
from drivers.ardrone.options import ArDroneOptions
from drivers.ardrone.velocity_loop import VelocityLoop
from estimator.contracts.commands import Command, Hover, Lean, Velocity
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs, after, seconds_between


class _Motion(Struct, frozen=True):
    """A velocity or a tilt that guidance requests."""

    wanted: Velocity | Lean
    asked_at: MonoNs


class CommandStreamer:
    """Holds the newest command and the drone's latest status, and builds the command of each period from them.

    Velocity, tilt and hover change the sticks alone, and only while the drone is ours; what orders are held, and for how long,
    is the table of `custody`.
    """

    def __init__(self, options: ArDroneOptions, counters: Counters) -> None:
        self._o = options
        self._counters = counters
        self._custody = CustodyKeeper(options, counters)
        self._loop = VelocityLoop(options, counters)
        self._motion: _Motion | None = None
        """The velocity or lean to fly; None to hover."""
        self._watchdog = False

    @property
    def custody(self) -> Custody:
        """The party that has the drone."""
        return self._custody.state

    def take(self, command: Command, now: MonoNs) -> None:
        """Take the newest command."""
        self._custody.order(command, now)
        self._motion = _Motion(command, now) if isinstance(command, Velocity | Lean) else None

    def on_navdata(self, navdata: Navdata, now: MonoNs) -> None:
        """Take the next navdata datagram, in order."""
        self._watchdog = bool(navdata.state & NavdataState.COM_WATCHDOG)
        self._custody.on_report(DroneReport.of(navdata), now)
        if self._custody.state is Custody.STANDS:
            self._loop.reset()

    def on_sample(self, sample: Sample) -> None:
        """Take a sample of the drone."""
        self._loop.on_sample(sample)

    def command(self, now: MonoNs) -> TimedCommand:
        """Return the command of this period, with the instant at which it expires."""
        self._counters.watchdog_resets += self._watchdog
        ref = self._custody.ref(now)
        sticks = self._sticks(now)
        # A velocity's lifetime counts from the guidance cycle that requested it, not from the period that repeats it.
        since = now if self._motion is None or sticks is HOVER else self._motion.asked_at
        renewed = self._custody.state is Custody.LANDING
        return TimedCommand(after(since, self._o.command_timeout_s), sticks, ref, renewed, self._watchdog, self._loop.climb())

    def leave(self, now: MonoNs) -> TimedCommand:
        """Return the final command: hover in place, or continue a landing that was commanded; a take-off ends."""
        if self._custody.state is Custody.TAKING_OFF:
            self._custody.order(Hover(calls_off=True), now)
        return TimedCommand(after(now, self._o.command_timeout_s), HOVER, self._custody.ref(now))

    def _sticks(self, now: MonoNs) -> Pcmd:
        motion = self._motion
        if not self._custody.steerable:
            return self._loop.hover()
        if motion is None:
            self._loop.feel_held(now)
            return self._loop.hover()
        if seconds_between(motion.asked_at, now) > self._o.command_timeout_s:
            self._counters.hover_for_age += 1
            return self._loop.hover()
        return self._loop.fly(motion.wanted, now)
