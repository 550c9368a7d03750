"""Inputs of the mission machine in one guidance cycle, beside what guidance knows about pad and deck."""

import math
from collections import Counter
from collections.abc import Mapping
from typing import TypeGuard

import numpy as np
from msgspec import Struct, field

from companion.base.reason import Reason, ReasonCause
from companion.guidance.controller import Impact, Knowledge
from companion.guidance.mission.wind import WindOverDrone
from estimator.contracts.commands import Command, Hover, Lean, Velocity
from estimator.contracts.estimates import RelativeState, Verdict
from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs, seconds_between

_FRAMES_LEAST = 10
_UNFLOWN_S = 0.15
"""Age of the vehicle's newest sample, s, from which on its own hover is expected: an AR.Drone hovers at .25 s."""
_LANDS_M_S = 0.3
"""Speed of a deck that falls up to which the vehicle's own landing, at 0.4 m/s, presses on it."""


class InputQuality(Struct, frozen=True):
    """Quality of the service's inputs, beside the estimate."""

    normalized_nis: float | None = None
    """Recent mean of the sightings' NIS over the number of components; None before the first comparison."""
    time_sigma_s: float | None = None
    """Standard deviation of the newest sighting's time stamp; None before the first."""
    delay_s: float = 0.0
    """The camera's constant delay: how old a sighting is at least when it is fused."""


class VesselPosition(Struct, frozen=True, eq=False):
    """The pad's place and motion by the reports of ship and vehicle, without the camera."""

    at: MonoNs
    d_body_pad_level: F64
    """Vector from the body to the pad, (2,) m forward and right."""
    sigma_m: float
    """Horizontal standard deviation."""
    v_level: F64
    """Velocity of the ship over the ground, (2,) m/s forward and right."""
    axis_rad: float
    """Direction of the bow in `level`, clockwise from forward; that of north if nothing says where the bow points."""
    bow_known: bool
    height_m: float | None
    """Height of the body over the pad; None if one of the two does not know its own."""

    @property
    def distance_m(self) -> float:
        """Horizontal distance, metres."""
        return math.hypot(float(self.d_body_pad_level[0]), float(self.d_body_pad_level[1]))


class VehicleHold(Struct, frozen=True):
    """The hold that a vehicle has by itself, which decides what a command of guidance means to it."""

    over_ground: bool
    """True for an autopilot: its own hover holds over the ground, and its driver adds the deck's velocity to a `Velocity`, so one
    of zero stays with the deck. False for an AR.Drone: it holds against the deck by optical flow, and ranges a near surface."""

    def staying(self, climb_m_s: float) -> Command:
        """Return the command that stays with the deck, or climbs from it, where no estimate of the pad will do."""
        return Velocity(np.array([0.0, 0.0, -climb_m_s]), 0.0) if self.over_ground or climb_m_s != 0.0 else Hover()

    def climbing(self, climb_m_s: float, knowledge: Knowledge) -> tuple[float, Command]:
        """Return the climb over the ground, m/s, and the command that climbs so fast against the deck and else stays with it."""
        if self.over_ground:
            return with_deck_m_s(climb_m_s, knowledge), self.staying(climb_m_s)
        rate_m_s = climb_m_s + (0.0 if climb_m_s == 0.0 else max(0.0, with_deck_m_s(0.0, knowledge)))
        return rate_m_s, self.staying(rate_m_s)

    def with_ship(self, v_level: F64, v_ship_level: F64) -> Velocity:
        """Return the command that flies a velocity to the ship, (3,) m/s, whose own is (2,) m/s over the ground."""
        v = np.array(v_level)
        if not self.over_ground:
            v[:2] += v_ship_level
        return Velocity(v, 0.0)

    def moves(self, command: Command) -> TypeGuard[Velocity | Lean]:
        """Return whether a command has a vertical speed over the ground, to which no driver adds the deck's."""
        return isinstance(command, Lean) or (isinstance(command, Velocity) and not self.over_ground)


def with_deck_m_s(climb_m_s: float, knowledge: Knowledge) -> float:
    """Return the climb over the ground of a vehicle that follows the deck and climbs from it, m/s."""
    return climb_m_s - (0.0 if knowledge.deck is None else knowledge.deck.v_level.item(2))


class GuidanceCycle(Struct, frozen=True, eq=False):
    """One guidance cycle."""

    at: MonoNs
    knowledge: Knowledge
    battery: float | None = None
    """Charge from 0 to 1; None if the vehicle does not report it."""
    wind: WindOverDrone | None = None
    """The wind over the drone; None before it was watched for some seconds."""
    quality: InputQuality = field(default_factory=InputQuality)
    frames: Mapping[Verdict, int] = field(default_factory=Counter)
    """Number of frames by verdict since the newest that was fused."""
    vessel: VesselPosition | Reason | None = None
    """The ship's place by reports, or why it is not known; None where the drone does not fly to it."""
    silent_s: float = 0.0
    """Time since the newest sample of the vehicle: while it is silent, nobody knows that it obeys."""
    feels: bool = True
    """True if the accelerometer is alive, so that its silence means no contact."""
    late_s: float | None = None
    """Delay of the vehicle's answer, if that is too late to fly; None otherwise."""
    touch: Impact | None = None
    """The newest push that one foot alone may have made; None before one."""
    range_m: float | None = None
    """The newest range to the surface below; None without a fresh one."""
    hold: VehicleHold = VehicleHold(over_ground=False)
    thing: Reason | None = None
    """Objects on the pad; None if nothing was seen lately, or if the operator says that it is clear."""
    unseen: Reason | None = None
    """Glare that hides a part of the pad; None if there is none, or if the operator says that it is clear."""
    off_orders: Reason | None = None
    """Height to which the vehicle went against what is ordered; None while it flies as ordered."""
    age_s: float = 0.0
    """Age of the newest measurement of the vehicle: where samples come late, its driver flies by none of them."""

    @property
    def unflown(self) -> bool:
        """True if its own landing is better than to press on: its motion is so old that its driver is about to let it hover.

        A deck that falls faster than the vehicle lands by itself would drag it along, and leaves a hover behind.
        """
        deck = self.knowledge.deck
        falls = deck is not None and deck.v_level.item(2) > _LANDS_M_S
        return self.silent_s > _UNFLOWN_S or (self.age_s > _UNFLOWN_S and not falls)

    @property
    def place(self) -> VesselPosition | None:
        """The ship's place by reports; None if it is not known."""
        return self.vessel if isinstance(self.vessel, VesselPosition) else None

    @property
    def estimate(self) -> RelativeState | None:
        """The estimate of the pad, fit to steer by or not."""
        return self.knowledge.relative


def fit_to_steer(estimate: RelativeState | None, now: MonoNs, stale_after_s: float) -> bool:
    """Return whether there is a consistent estimate, computed recently from a recent sighting."""
    return unfit(estimate, now, stale_after_s) is None


def unfit(estimate: RelativeState | None, now: MonoNs, stale_after_s: float) -> Reason | None:
    """Return why an estimate is not fit to steer by, or None if it is.

    Args:
        stale_after_s: age of the newest sighting, or of the estimate itself, beyond which it is not, seconds.
    """
    if estimate is None:
        return Reason(ReasonCause.NO_ESTIMATE)
    if estimate.alerts:
        return Reason(ReasonCause.ALERT, detail=estimate.alerts[0])
    age_s = max(abs(estimate.age_s(now)), abs(seconds_between(estimate.at, now)))
    if age_s > stale_after_s:
        return Reason(ReasonCause.STALE, age_s, stale_after_s)
    return None if estimate.consistent else Reason(ReasonCause.INCONSISTENT)


def of_frames(frames: Mapping[Verdict, int]) -> Reason | None:
    """Return what became of most frames without sight; None if there are too few to say, or they simply show no pad."""
    total = sum(frames.values())
    if total < _FRAMES_LEAST:
        return None
    verdict = max(frames, key=lambda each: frames[each])
    share = frames[verdict] / total
    return None if verdict is Verdict.NO_PAD or share < 0.5 else Reason(ReasonCause.FRAMES, 100.0 * share, 50.0, verdict)
