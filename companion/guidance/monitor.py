"""The run-time monitor: what may be flown by a velocity that nothing confirms, and what is flown instead.

Out of sight of the pad a drone knows its speed by one sensor, and every loop, the estimate and the geofence follow it. A constant
error of that sensor is a constant speed that no sensor shows. The monitor (ASTM F3269: a small part with few rules and a recovery
that is always there) uses none of what it watches. Its witnesses are the sight of the pad, a position, the vehicle's own hold,
and the accelerometer across a leap. `RULES` has what each rule watches, by which witness, its limit, and what is flown then.

Trust is earned and is worth a way. Each witness bounds the error that the velocity may still have (`error_m_s`). Flying by the
velocity adds that error times the time to the way that may have been flown unseen. After `CHECK_M` the vehicle holds by its own
means, which shows what the velocity says of standing still. After `WAY_M` in all it stays there. Distrust ends by sight or
position, never by time. An error that was there before a hold of the same sensor cannot be known by anybody on board: then the
way is what bounds it.

Guidance's last way to the deck is left alone: there the contact is nearer than any recovery.
"""

from __future__ import annotations

import math
from enum import Enum, auto
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from companion.base.mission import Reason, ReasonCause
from companion.guidance.operator.command_limits import Fixed
from estimator.contracts.commands import Command, Hover, Lean, Velocity
from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between

PRIOR_M_S = 1.0
"""Error that a velocity may have which nothing has confirmed, m/s: five times what an AR.Drone's own is off in clean flights."""
CHECK_M = 11.0
"""Way that may be flown unseen before the vehicle holds for a check, m: some 8 s, in which a search in wind sees its pad."""
SUSPECT_M = 5.0
"""The same after a leap, or where sight or hold showed more than `PRIOR_M_S`, m."""
WAY_M = 15.0
"""Way that may be flown unseen in all, m: less than the length of a small ship (20 m), within which a person sees a drone."""
HOLD_M_S = 1.0
"""Mean velocity in the vehicle's own hold beyond which the velocity is wrong, m/s: gusts of Beaufort 7 make 0.9."""
POSITION_M_S = 1.0
"""Difference from the velocity by two positions beyond which the velocity is wrong, m/s: a stamp that is 0.2 s late makes 0.3."""
STICK_M_S = 3.0
"""Error by which no stick is flown on the velocity, m/s: more than most ships make, whose deck ends below the drone."""
_SETTLES_S = 1.5  # time in which a vehicle stops that begins to hold
_MEAN_S = 2.0  # time over which its velocity is averaged then
_SHOWS_S = 0.7
"""Time of a hold after which what the velocity says counts as its error, s: it may be the vehicle's own, still stopping."""
_HELD_SIGMA_M_S = 0.2
"""Error of the mean over such a hold, m/s."""
_DRIFT_M_S2 = 0.1
"""Rate at which the error may have grown since a witness, m/s^2."""
_KNOWN_M_S = 0.1
"""Error of a velocity that nothing contradicts, by which a place becomes uncertain, m/s: an AR.Drone's scale and offset."""
_SIGHT_S = 0.5  # time constant of the velocity's difference from sight
_POSITION_S = 3.0  # least time between two positions that are compared
_GAP_S = 0.5  # longest gap between two cycles that errors grow over
_WAITS_S = 10.0
"""Time without a velocity to fly by after which guidance refuses, s: the sight may come back."""


class Rule(NamedTuple):
    """One rule, as the documentation has it."""

    watches: str
    witness: str
    limit: str
    recovery: str


_HOLDS = "the vehicle's own hold, or a level climb where it is low; a stick is flown as a tilt against the drag"
RULES = {
    "unseen way": Rule(
        "the way flown by a velocity out of sight",
        "sight of the pad, or a position, ends it; else the error that the other rules leave possible, at least "
        f"{PRIOR_M_S:g} m/s, times the time",
        f"{CHECK_M:g} m to the next check, {SUSPECT_M:g} m after a leap or a larger error, {WAY_M:g} m in all",
        f"{_HOLDS}; {_WAITS_S:g} s later the landing is refused",
    ),
    "own hold": Rule(
        "the velocity while the vehicle holds by itself",
        "the vehicle's own hold",
        f"{HOLD_M_S:g} m/s, mean of {_MEAN_S:g} s after {_SETTLES_S:g} s",
        f"{_HOLDS}, until sight or position",
    ),
    "leap": Rule(
        "a change of the velocity that the accelerometer does not feel",
        "accelerometer",
        "0.8 m/s within 0.1 s; a deck that ends below a flow sensor leaps as well",
        "it counts as an error until the next check",
    ),
    "sight": Rule(
        "a flow's velocity against the sightings",
        "sight of the pad",
        f"more than {PRIOR_M_S:g} m/s counts as the error once the sight is lost",
        "guidance flies by the sightings meanwhile",
    ),
    "position": Rule(
        "the velocity against two positions",
        "GNSS of the vehicle",
        f"{POSITION_M_S:g} m/s over {_POSITION_S:g} s, for a velocity over the ground",
        f"{_HOLDS}, until they agree",
    ),
    "stick": Rule(
        "a stick that is flown by the velocity",
        "the error that the other rules leave possible",
        f"{STICK_M_S:g} m/s",
        "the stick is flown as a tilt against the drag, with the reason shown",
    ),
    "fence": Rule(
        "the place against the geofence",
        "position, else the error that is possible, integrated",
        "the fence, less the way that may have been flown unseen",
        "no way along the deck; an AR.Drone's or an autopilot's own hold",
    ),
}
"""The rules by their names."""


class FlownBy(Enum):
    """Source that a command is flown by."""

    OTHERS = auto()
    """Nothing that a velocity matters to: a landing, a take-off, or no command."""
    OWN_HOLD = auto()
    TILT = auto()
    """A tilt in place of a velocity."""
    VELOCITY = auto()
    """The measured velocity."""
    ESTIMATE = auto()
    """The estimate of the pad, which follows the velocity out of sight."""


def flown_by(command: Command | None, *, trusted: bool) -> FlownBy:
    """Return what a command is flown by.

    Args:
        trusted: the command may be flown by the velocity; else it was replaced.
    """
    if isinstance(command, Hover):
        return FlownBy.OWN_HOLD
    if not isinstance(command, Velocity | Lean):
        return FlownBy.OTHERS
    if not trusted:
        return FlownBy.TILT
    return FlownBy.VELOCITY if isinstance(command, Velocity) else FlownBy.ESTIMATE


class Witnesses(NamedTuple):
    """Inputs of one cycle."""

    at: MonoNs
    v_level: F64 | None
    """(2,) measured velocity, m/s forward and right; None without a fresh one."""
    v_pad_level: F64 | None
    """(2,) velocity of the pad against the body by a fresh, consistent sight of it, m/s; None without one."""
    leap_ned: tuple[float, float]
    """Leaps of the velocity since the cycle before that the accelerometer did not feel, m/s north and east."""
    fixed: Fixed | None
    """The newest position, with the integral of the measured velocity; None without a fresh one."""
    over_ground: bool
    """True if the velocity is over the ground, as the positions are; else it is over what lies below, deck or water."""


class Monitor(Struct, frozen=True):
    """The monitor's memory."""

    at: MonoNs | None = None
    flown: FlownBy = FlownBy.OTHERS
    by_hand: bool = False
    error_m_s: float = PRIOR_M_S
    """Error that the velocity may have, without leaps and drift."""
    leapt_ned: tuple[float, float] = (0.0, 0.0)
    since_witness_s: float = 0.0
    """Time since something last showed the error, s."""
    against_m_s: float = 0.0
    """Difference of the velocity from the sightings."""
    unchecked_m: float = 0.0
    """Way that may have been flown unseen since the newest check."""
    way_m: float = 0.0
    """The same since the newest sight or position."""
    held_s: float = 0.0
    """Time of the hold under way, s."""
    held_level: tuple[float, float] = (0.0, 0.0)
    """Mean velocity in it, m/s."""
    fault: Reason | None = None
    """Evidence that the velocity is wrong; None while nothing shows it."""
    in_sight: bool = False
    placed: bool = False
    """True while a position is known."""
    compared: Fixed | None = None
    """The position from which the next comparison begins."""
    waited_s: float = 0.0
    """Time for which guidance has had no velocity to fly by, s."""

    @property
    def leapt_m_s(self) -> float:
        """Size of what the leaps since the newest check add up to, m/s."""
        return math.hypot(*self.leapt_ned)

    @property
    def possible_m_s(self) -> float:
        """Error that the velocity may have now, m/s."""
        return self.error_m_s + self.leapt_m_s + _DRIFT_M_S2 * self.since_witness_s

    @property
    def suspect(self) -> bool:
        """True if the velocity is wrong, or may have a larger error than `PRIOR_M_S`."""
        return self.fault is not None or self.error_m_s > PRIOR_M_S or self.leapt_m_s > 0.0

    @property
    def place_m_s(self) -> float:
        """Rate at which a place becomes uncertain that is known by the velocity alone, m/s."""
        if self.placed or self.flown in (FlownBy.OWN_HOLD, FlownBy.OTHERS):
            return 0.0
        guided_blind = not self.by_hand and not self.in_sight
        return self.possible_m_s if self.suspect or guided_blind else _KNOWN_M_S

    def refusal(self, *, by_hand: bool) -> Reason | None:
        """Return why nothing is flown by the velocity; None if it may be.

        Args:
            by_hand: a person flies, who sees the drone; else guidance.
        """
        if by_hand:
            error_m_s = self.error_m_s + self.leapt_m_s
            return self.fault or (Reason(ReasonCause.DOUBTFUL, error_m_s, STICK_M_S) if error_m_s > STICK_M_S else None)
        if self.in_sight:
            return None
        if self.fault is not None or self.way_m >= WAY_M:
            return self.fault or Reason(ReasonCause.UNCONFIRMED, self.way_m, WAY_M)
        most_m = SUSPECT_M if self.suspect else CHECK_M
        return Reason(ReasonCause.UNCHECKED, self.unchecked_m, most_m) if self.unchecked_m >= most_m else None

    @property
    def refuses(self) -> Reason | None:
        """Reason for guidance to give up; None while the sight may come back or a check may end well."""
        why = self.refusal(by_hand=False)
        return why if self.waited_s > _WAITS_S and why is not None and why.cause is not ReasonCause.UNCHECKED else None


def watched(m: Monitor, seen: Witnesses) -> Monitor:
    """Return the memory after one cycle, in which `m.flown` was flown."""
    dt = 0.0 if m.at is None else min(_GAP_S, max(0.0, seconds_between(m.at, seen.at)))
    leapt = m.leapt_ned[0] + seen.leap_ned[0], m.leapt_ned[1] + seen.leap_ned[1]
    m = replace(
        m, at=seen.at, in_sight=seen.v_pad_level is not None, placed=seen.fixed is not None, leapt_ned=leapt,
        since_witness_s=m.since_witness_s + dt,
    )  # fmt: skip
    m = _held(_by_position(_by_sight(m, seen, dt), seen), seen, dt)
    if m.flown in (FlownBy.VELOCITY, FlownBy.ESTIMATE) and not m.in_sight and not m.placed:
        # The estimate has measured how the surface moves against the pad, and needs no velocity over that.
        error_m_s = m.possible_m_s if m.flown is FlownBy.VELOCITY else PRIOR_M_S + m.leapt_m_s
        unchecked_m = m.unchecked_m + (error_m_s * dt if m.flown is FlownBy.VELOCITY and not m.by_hand else 0.0)
        m = replace(m, way_m=m.way_m + error_m_s * dt, unchecked_m=unchecked_m)
    waits = m.refusal(by_hand=False) is not None
    return replace(m, waited_s=m.waited_s + dt if waits else 0.0)


def commanded(m: Monitor, command: Command | None, *, by_hand: bool, trusted: bool) -> Monitor:
    """Return the memory after a command was sent."""
    return replace(m, flown=flown_by(command, trusted=trusted), by_hand=by_hand)


def _by_sight(m: Monitor, seen: Witnesses, dt: float) -> Monitor:
    if seen.v_pad_level is None:
        return m
    against_m_s = m.against_m_s
    # Over the ground the difference is the ship's own way.
    if seen.v_level is not None and not seen.over_ground:
        now_m_s = math.hypot(*(seen.v_level + seen.v_pad_level))
        against_m_s += (1.0 - math.exp(-dt / _SIGHT_S)) * (now_m_s - against_m_s)
    return replace(m, against_m_s=against_m_s, error_m_s=max(PRIOR_M_S, against_m_s), **_CONFIRMED)


def _by_position(m: Monitor, seen: Witnesses) -> Monitor:
    fixed, before = seen.fixed, m.compared
    if fixed is None:
        return m if before is None else replace(m, compared=None)
    if not seen.over_ground:
        # What lies below may move: the position says where the drone is, and nothing of the velocity.
        return replace(m, error_m_s=PRIOR_M_S, **_CONFIRMED)
    span_s = 0.0 if before is None else seconds_between(before.at, fixed.at)
    if before is None or span_s < _POSITION_S:
        m = m if before is not None else replace(m, compared=fixed)
        return m if m.fault is not None else replace(m, unchecked_m=0.0, way_m=0.0)
    moved = np.subtract(fixed.p_ned, before.p_ned) - np.subtract(fixed.way_ned, before.way_ned)
    off_m_s, m = float(np.hypot(*moved)) / span_s, replace(m, compared=fixed)
    if off_m_s > POSITION_M_S:
        return replace(m, fault=Reason(ReasonCause.OFF_POSITION, off_m_s, POSITION_M_S), error_m_s=off_m_s)
    return replace(m, error_m_s=max(PRIOR_M_S, off_m_s), **_CONFIRMED)


_CONFIRMED: dict[str, object] = {
    "fault": None, "leapt_ned": (0.0, 0.0), "since_witness_s": 0.0, "unchecked_m": 0.0, "way_m": 0.0,
}  # fmt: skip


def _held(m: Monitor, seen: Witnesses, dt: float) -> Monitor:
    """Compare the velocity with the vehicle's own hold; over a moving deck in sight that is the sightings' to judge."""
    if m.flown is not FlownBy.OWN_HOLD or seen.v_level is None:
        return m if m.held_s == 0.0 else replace(m, held_s=0.0, held_level=(0.0, 0.0))
    before_s, held_s = m.held_s, m.held_s + dt
    # What it moves by while it stops is left out of the mean.
    averaged_s = held_s - _SETTLES_S if held_s > _SETTLES_S else held_s
    first = before_s <= _SETTLES_S < held_s
    share = 1.0 if first or averaged_s <= 0.0 else min(1.0, dt / min(averaged_s, _MEAN_S))
    x, y = m.held_level
    mean = x + share * (seen.v_level.item(0) - x), y + share * (seen.v_level.item(1) - y)
    m, moves_m_s = replace(m, held_s=held_s, held_level=mean), math.hypot(*mean)
    if m.in_sight or m.placed or held_s < _SHOWS_S:
        return m
    if held_s < _SETTLES_S + _MEAN_S:
        return replace(m, error_m_s=max(m.error_m_s, moves_m_s - m.leapt_m_s))
    if moves_m_s > HOLD_M_S:
        fault = m.fault or Reason(ReasonCause.MOVES_IN_HOLD, moves_m_s, HOLD_M_S)
        return replace(m, fault=fault, error_m_s=moves_m_s)
    return replace(m, error_m_s=moves_m_s + _HELD_SIGMA_M_S, leapt_ned=(0.0, 0.0), since_witness_s=0.0, unchecked_m=0.0)
