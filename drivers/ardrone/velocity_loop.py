"""The velocity loop of an AR.Drone: tilt, climb and turn from a velocity or a tilt that is requested. No I/O.

The drone takes roll and pitch as fractions of a tilt angle, so a velocity needs a loop here: a PI controller on the measured
velocity with the drag of the commanded speed fed forward, solved for the tilt that gives that acceleration, limited as a vector.
The tilt follows its command late; commanding more than the tilt still lacks (`velocity_lead`) compensates part of that delay.
That lead is a loop of its own about the tilt, whose gain is below 1 (small gain theorem): with more, commands that come .1 s late
make the tilt swing from stop to stop until the firmware cuts the motors of a drone that leans too far.
The drone itself closes the loops of climb and turn rate, which are only scaled here.

A tilt is flown as it is: its acceleration is the tilt. Its trim becomes the loop's integral, so a velocity that follows begins
with the tilt that holds against the wind, and the integral keeps its direction over the ground while the nose turns.

The loop believes the measured velocity. Where that is refused, guidance requests tilts and hovers alone.

The default drag, 0.43 1/s, is the regression of acceleration on tilt and speed in a flight under motion capture.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct, structs

from drivers.ardrone.arbiter import HOVER
from drivers.ardrone.at import PCMD_PROGRESSIVE, Pcmd, unit
from drivers.ardrone.options import ArDroneOptions
from estimator.contracts.commands import Lean, Velocity
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import Attitude, BodyVelocity, Sample
from estimator.contracts.time import MonoNs, seconds_between

_HELD_S = 2.0
"""Time over which a tilt that holds against the wind is averaged, s: gusts are shorter."""
_LEANS_FAR_M_S2 = G_M_S2 * math.tan(math.radians(20.0))
"""Acceleration of a lean that no reversal of a tilt passes for long, m/s^2."""
_LEVELS_M_S = 0.3
"""Rate of climb that leaves the rotors thrust to turn the drone level, m/s."""


class Sticks(Struct, frozen=True):
    """Stick positions, -1..1 with PCMD's signs: roll + right, pitch + backward (nose up), gaz + up, yaw + clockwise."""

    roll: float = 0.0
    pitch: float = 0.0
    gaz: float = 0.0
    yaw: float = 0.0


class LoopState(Struct, frozen=True):
    """The state of the loop: the integral's acceleration, m/s^2 forward and right."""

    forward_m_s2: float = 0.0
    right_m_s2: float = 0.0
    heading_rad: float | None = None
    """The heading for which it holds; None if it was not known."""

    def at_heading(self, heading_rad: float | None) -> LoopState:
        """Return the state in the axes of another heading: the wind stays where it is while the nose turns."""
        if heading_rad is None or self.heading_rad is None:
            return structs.replace(self, heading_rad=self.heading_rad if heading_rad is None else heading_rad)
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
    accelerate = _add(integral, feed_forward, most_m_s2)
    if a_level is not None:
        accelerate = _within(accelerate + options.velocity_lead * (accelerate - a_level), most_m_s2)
    state = LoopState(float(integral[0]), float(integral[1]), state.heading_rad)
    return state, sticks_of(accelerate, float(wanted.v_level[2]), wanted.yaw_rate_rad_s, options)


def lean(wanted: Lean, heading_rad: float | None, options: ArDroneOptions) -> tuple[LoopState, Sticks]:
    """Return the sticks of a tilt, limited as a vector, and the loop's state from which a velocity would go on.

    Args:
        heading_rad: the present heading; None if it is not known.
    """
    most_m_s2 = G_M_S2 * math.tan(options.euler_angle_max_rad)
    trim = _within(wanted.trim_level, most_m_s2)
    accelerate = _within(wanted.a_level + wanted.trim_level, most_m_s2)
    state = LoopState(float(trim[0]), float(trim[1]), heading_rad)
    return state, sticks_of(accelerate, float(wanted.v_level[2]), wanted.yaw_rate_rad_s, options)


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
    return structs.replace(state, forward_m_s2=float(integral[0]), right_m_s2=float(integral[1]))


def sticks_of(accelerate: F64, descend_m_s: float, yaw_rate_rad_s: float, options: ArDroneOptions) -> Sticks:
    """Return the sticks that give an acceleration, (2,) m/s^2 forward and right, a descent rate and a turn rate."""
    size = float(np.hypot(accelerate[0], accelerate[1]))
    tilt = math.atan2(size, G_M_S2) / options.euler_angle_max_rad
    forward, right = accelerate / size * tilt if size > 0 else (0.0, 0.0)
    return Sticks(
        roll=unit(float(right)),
        pitch=unit(-float(forward)),
        gaz=unit(-descend_m_s / options.vz_max_m_s),
        yaw=unit(yaw_rate_rad_s / options.yaw_rate_max_rad_s),
    )


def levelling(sticks: Sticks, a_level: F64, options: ArDroneOptions) -> Sticks:
    """Return the sticks with little climb while the drone leans far against them.

    A climb that takes all thrust leaves none to turn: with a rotor at 70 % it tipped over within .5 s.

    Args:
        a_level: (2,) acceleration of the present tilt (`acceleration_of`), m/s^2.
    """
    against = -sticks.pitch * float(a_level[0]) + sticks.roll * float(a_level[1]) < 0.0
    if not against or float(np.hypot(a_level[0], a_level[1])) < _LEANS_FAR_M_S2:
        return sticks
    return structs.replace(sticks, gaz=min(sticks.gaz, unit(_LEVELS_M_S / options.vz_max_m_s)))


def _progressive(sticks: Sticks) -> Pcmd:
    return Pcmd(PCMD_PROGRESSIVE, sticks.roll, sticks.pitch, sticks.gaz, sticks.yaw)


def _within(v: F64, length: float) -> F64:
    """Return the vector, shortened to at most this length."""
    size = float(np.hypot(v[0], v[1]))
    return v * (length / size) if size > length else v


def _add(base: F64, more: F64, length: float) -> F64:
    """Return the sum, with less of the second where it would be longer: what holds against the wind is not cut."""
    a, b, c = float(more @ more), float(base @ more), length * length - float(base @ base)
    if a == 0.0 or a + 2.0 * b <= c:
        return base + more
    return base + max(0.0, (math.sqrt(max(0.0, b * b + a * c)) - b) / a) * more


class VelocityLoop:
    """Flies the newest velocity or tilt by the newest measurements, and remembers the tilt that holds against the wind."""

    def __init__(self, options: ArDroneOptions) -> None:
        self._o = options
        self._velocity: BodyVelocity | None = None
        self._attitude: Attitude | None = None
        self._loop = self._mean = RESET
        self._stepped: MonoNs | None = None
        """Time of the newest period that was flown by the loop; None after one that was not."""
        self._held: tuple[MonoNs, F64] | None = None
        """Time and measured velocity of the newest period of a hover; None after one that was none."""
        self._known_s = 0.0
        """Time for which the loop's state has been learned, up to what its mean takes."""

    def on_sample(self, sample: Sample) -> None:
        """Take a sample of the drone; velocities and attitudes are kept, others are ignored."""
        # By the type itself, as there are hundreds of samples a second.
        if type(sample) is BodyVelocity:
            self._velocity = sample
        elif type(sample) is Attitude:
            self._attitude = sample

    def reset(self) -> None:
        """Forget the tilt against the wind: the drone stands."""
        self._loop, self._mean, self._known_s = RESET, RESET, 0.0

    def hover(self) -> Pcmd:
        """Return the drone's own hover."""
        self._stepped = None
        return HOVER

    def climb(self, climb_m_s: float | None = None) -> Pcmd:
        """Return a climb, as fast as the drone can or in m/s, with the tilt that held against the wind."""
        trim = np.array([self._mean.forward_m_s2, self._mean.right_m_s2])
        return _progressive(sticks_of(trim, -(self._o.vz_max_m_s if climb_m_s is None else climb_m_s), 0.0, self._o))

    def fly(self, wanted: Velocity | Lean, now: MonoNs) -> Pcmd:
        """Return the sticks of this period for a velocity or a tilt."""
        self._held = None
        attitude = self._attitude if self._recent(self._attitude, now) else None
        heading = None if attitude is None else attitude.R_ned_body.rpy_rad[2]
        a_level = None if attitude is None else acceleration_of(attitude.R_ned_body)
        if isinstance(wanted, Lean):
            if attitude is None:
                return self._unmeasured(wanted)
            self._loop, sticks = lean(wanted, heading, self._o)
        else:
            measured = self._velocity
            if measured is None or not self._recent(measured, now):
                return self._unmeasured(wanted)
            dt_s = 0.0 if self._stepped is None else seconds_between(self._stepped, now)
            self._loop, sticks = step(self._loop.at_heading(heading), wanted, measured.v_level, a_level, dt_s, self._o)
        self._averages(0.0 if self._stepped is None else seconds_between(self._stepped, now))
        self._stepped, self._known_s = now, _HELD_S
        return _progressive(sticks if a_level is None else levelling(sticks, a_level, self._o))

    def feel_held(self, now: MonoNs) -> None:
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
        self._averages(dt_s)

    def _averages(self, dt_s: float) -> None:
        """Take the newest trim into its mean, from which a climb without measurements is flown: feet on a deck push it about."""
        if self._mean == RESET:
            self._mean = self._loop
        before, share = self._mean.at_heading(self._loop.heading_rad), 1.0 - math.exp(-dt_s / _HELD_S)
        self._mean = structs.replace(
            self._loop,
            forward_m_s2=before.forward_m_s2 + share * (self._loop.forward_m_s2 - before.forward_m_s2),
            right_m_s2=before.right_m_s2 + share * (self._loop.right_m_s2 - before.right_m_s2),
        )

    def _unmeasured(self, wanted: Velocity | Lean) -> Pcmd:
        """Return what flies where nothing measures the motion: a hover, or a climb with the tilt that holds against the wind.

        The firmware's hover keeps the height, and a deck that rises comes up to it.
        """
        climb = float(wanted.v_level[2])
        if climb >= 0.0:
            return self.hover()
        self._stepped = None
        return self.climb(-climb)

    def _recent(self, sample: BodyVelocity | Attitude | None, now: MonoNs) -> bool:
        return sample is not None and seconds_between(sample.stamp.measured_at, now) <= self._o.velocity_timeout_s
