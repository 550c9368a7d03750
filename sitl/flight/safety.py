"""Grade a simulated flight by the simulator's truth: whether it was safe and whether its outcome was right.

A descent without true sight of the pad, a contact off the pad, a contact that guidance did not intend, and a service that dies in
flight are unsafe.
"""

import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Literal, NamedTuple

import numpy as np

from companion.base.mission import CONTACT_INTENDED, REFUSALS, FlightOutcome, State
from companion.guidance.arbiter import BY_HAND, LANDING_FOR_PERSON
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs, after, seconds_between
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.truth import Touchdown, Truth

BLIND_AFTER_S = 1.0
"""Time after the newest true sight that still counts as sight; the last 0.3 m of a landing, without the pad, take less."""
BLIND_DESCENT_MAX_M = 0.5
"""Descent without sight that is allowed: what wind and the vehicle's own landing cause, and no more."""
UNREACHED_STOP_M = 0.3
"""Way down that an AR.Drone needs to stop when nothing reaches it and it begins to hover by itself."""
MET_AFTER_S = 0.5
"""Time after a command at which the vehicle has the speed that it requests, and meets the deck's."""
CLIMB_OUT_S = 1.0
"""Time that a vehicle needs to climb out of a deck's reach when it is reached again."""
TOO_HIGH_M = 3.0
"""Unsafe height above the highest height that a flight calls for: gusts do not carry a vehicle there."""
RECEIVERS_M = 10.0
"""Error of a height over the ship by two receivers of 2.5 m each, three standard deviations: the way to her is flown by it."""
SLIDE_MAX_M_S = 0.5
"""Speed along the deck at a contact beyond which feet catch and a vehicle tips over."""
STANDS_MAX_S = 3.0
"""Time for which a vehicle may stand on the deck with turning motors: several times what pressing on and a landing take."""
_STILL_M_S, _FEET_M = 0.15, 0.05
"""Speed against the deck and height of the feet below which a vehicle stands."""
STAMP_ERROR_MAX_S = 0.5
"""Error of a frame's stamp beyond which the frame says nothing about the pad's present position."""
COMMIT_PHASES = frozenset(state.value for state in CONTACT_INTENDED)
"""The phases of guidance in which contact is intended."""
PERSON_PHASES = frozenset({BY_HAND, LANDING_FOR_PERSON})
"""The phases in which a person commands; a contact is then the person's."""
GO_AROUND_PHASES = frozenset({State.GO_AROUND.value, State.ANOTHER_PAD.value})
"""The phases of guidance that end an attempt by climbing."""
Expected = Literal["land", "refuse", "go_around", "hold", "either"]
"""The outcome that a scenario expects: it lands on the pad, refuses to, goes around and then lands, holds for the operator, or
either lands or refuses."""
IN_THE_AIR = (VehiclePhase.HOVERING, VehiclePhase.FLYING, VehiclePhase.LANDING)
"""Phases of a vehicle whose motors carry it."""


@dataclass(frozen=True, slots=True)
class BlindDescent:
    """The deepest descent without true sight of the pad."""

    descent_m: float
    """Descent from the height at which sight was lost: the smaller of those against the deck and over the ground."""
    lowest_m: float
    """Lowest height over the deck meanwhile."""
    blind_s: float
    """Time since the newest true sight, at that height."""


class SightWatch:
    """Watches how far the vehicle comes down without true sight of the pad.

    A descent while nothing reaches the vehicle is kept apart: no order ends it, whatever the service does.
    """

    def __init__(self, start: MonoNs) -> None:
        self.worst = BlindDescent(0.0, math.inf, 0.0)
        self.unreached_m = 0.0
        """Deepest descent during one time in which nothing reached the vehicle, metres."""
        self.deck_fell_m_s = 0.0
        """Fastest fall of the deck at the beginning of such a time, where the last command was meant to meet it."""
        self.since_sight: Counter[Verdict] = Counter()
        """Number of frames by verdict since the newest true sight."""
        self._seen_at = start
        self._lost_at_m: tuple[float, float] | None = None
        self._unreached_at_m: tuple[float, float] | None = None
        self._unreached_since = start

    def frame(self, exposed_at: MonoNs, verdict: Verdict, *, true_view: bool, stamp_error_s: float) -> None:
        """Note a frame and the service's verdict on it."""
        if verdict is Verdict.FUSED and true_view and abs(stamp_error_s) <= STAMP_ERROR_MAX_S:
            self._seen_at = max(self._seen_at, exposed_at)
            self.since_sight.clear()
        else:
            self.since_sight[verdict] += 1

    def step(self, truth: Truth, *, reached: bool = True) -> None:
        """Note the true state at an instant; call it in order of time.

        Args:
            reached: whether the service's commands reach the vehicle.
        """
        at_m = float(truth.d_body_pad_level[2]), -float(truth.p_body_ned[2])
        if not reached:
            if self._unreached_at_m is None:
                self._unreached_at_m, self._unreached_since = at_m, truth.at
            if seconds_between(self._unreached_since, truth.at) <= MET_AFTER_S:
                self.deck_fell_m_s = max(self.deck_fell_m_s, float(truth.v_pad_ned[2]))
            if truth.phase in IN_THE_AIR:
                self.unreached_m = max(self.unreached_m, _descent_m(self._unreached_at_m, at_m))
            return
        if self._unreached_at_m is not None:
            if self._lost_at_m is not None:
                height_m, altitude_m = (now - was for now, was in zip(at_m, self._unreached_at_m, strict=True))
                self._lost_at_m = self._lost_at_m[0] + height_m, self._lost_at_m[1] + altitude_m
            self._unreached_at_m = None
        blind_s = seconds_between(self._seen_at, truth.at)
        if blind_s <= BLIND_AFTER_S or truth.phase not in IN_THE_AIR:
            self._lost_at_m = None
            return
        if self._lost_at_m is None:
            self._lost_at_m = at_m
        descent_m = _descent_m(self._lost_at_m, at_m)
        if descent_m > self.worst.descent_m:
            self.worst = BlindDescent(descent_m, at_m[0], blind_s)


class MotionWatch:
    """Watches how high the vehicle flies, and how long it stands with turning motors, while guidance commands it.

    Args:
        highest_m: the highest height over the pad, at its highest, that the flight calls for.
        feet_below_m: distance of the feet below the body's origin.
    """

    def __init__(self, highest_m: float, feet_below_m: float) -> None:
        self.called_for_m, self.highest_m = highest_m, -math.inf
        self.stood_s = 0.0
        """Longest time for which it stood with turning motors."""
        self._feet_below_m = feet_below_m
        self._crest_m = -math.inf
        """Highest altitude of the deck so far."""
        self._stands_since: MonoNs | None = None

    def step(self, truth: Truth, phase: str | None, *, reached: bool) -> None:
        """Note the true state at an instant; call it in order of time.

        Args:
            phase: phase of guidance, None where no service runs.
        """
        if phase is None or phase in PERSON_PHASES or not reached or truth.phase not in IN_THE_AIR:
            self._stands_since = None
            return
        height_m, altitude_m = float(truth.d_body_pad_level[2]), -float(truth.p_body_ned[2])
        # Over the highest deck so far: a vehicle keeps clear of the crests, and over a trough it does not climb.
        self._crest_m = max(self._crest_m, altitude_m - height_m)
        self.highest_m = max(self.highest_m, altitude_m - self._crest_m)
        low = height_m < self._feet_below_m + _FEET_M + truth.contacts[-1].lateral_m if truth.contacts else False
        if not low or float(np.linalg.norm(truth.v_pad_ned - truth.v_body_ned)) > _STILL_M_S:
            self._stands_since = None
            return
        if self._stands_since is None:
            self._stands_since = truth.at
        self.stood_s = max(self.stood_s, seconds_between(self._stands_since, truth.at))

    @property
    def unsafe(self) -> tuple[str, ...]:
        """Unsafe events, one line each."""
        out = []
        if self.highest_m > self.called_for_m + TOO_HIGH_M:
            out.append(f"flew {self.highest_m:.1f} m high, where {self.called_for_m:.1f} m are the most that is called for")
        if self.stood_s > STANDS_MAX_S:
            out.append(f"stood on the deck for {self.stood_s:.1f} s with turning motors")
        return tuple(out)


def called_for_m(guidance: GuidanceOptions, start_m: float) -> float:
    """Return the highest height over the pad that a flight calls for, metres."""
    heights = [start_m, guidance.tries.safe_height_m]
    if guidance.mission == "thesis":
        heights.append(guidance.thesis.approach_height_m)
    if guidance.rendezvous.enabled:
        heights.append(guidance.rendezvous.height_m + RECEIVERS_M)
    return max(heights)


def _descent_m(from_m: tuple[float, float], to_m: tuple[float, float]) -> float:
    """Return the descent between two pairs of height over the deck and altitude, the smaller of both.

    Against the deck alone a hovering vehicle over a heaving ship would seem to descend.
    """
    return min(from_m[0] - to_m[0], from_m[1] - to_m[1])


def unreached_descent_max_m(guidance: GuidanceOptions, com_watchdog_s: float, deck_fell_m_s: float = 0.0) -> float:
    """Return the descent that is allowed while nothing reaches the vehicle, metres.

    Without commands an AR.Drone flies on for `com_watchdog_s`, at most at the fastest rate of the mission's way down against the
    deck. Then it hovers. A landing that it begins by itself goes deeper.

    Args:
        deck_fell_m_s: how fast the deck fell where the last command was meant to meet it.
    """
    rate_m_s = guidance.thesis.speed_m_s if guidance.mission == "thesis" else guidance.cone.descent_rate_m_s
    if guidance.controller == "pid":
        rate_m_s = min(rate_m_s, guidance.pid.descent_rate_max_m_s)
    return com_watchdog_s * (rate_m_s + deck_fell_m_s) + UNREACHED_STOP_M


def dangers(
    worst: BlindDescent | None,
    contacts: Sequence[Touchdown],
    died: str | None,
    unreached_m: float = 0.0,
    unreached_max_m: float = UNREACHED_STOP_M,
    *,
    phases_known: bool = True,
    unreached: Collection[MonoNs] = (),
    motion: MotionWatch | None = None,
) -> tuple[str, ...]:
    """Return the unsafe events, one line each; the result is empty for a safe flight.

    Args:
        worst: the deepest descent without true sight, None if it was not watched.
        contacts: all contacts of the flight.
        died: the reason why the service died, None if it did not.
        unreached_m: the deepest descent while nothing reached the vehicle, metres.
        unreached_max_m: the result of `unreached_descent_max_m`.
        phases_known: whether the contacts have the phase of guidance, so that those which it did not intend are told.
        unreached: instants of the contacts that no order could prevent, where the scenario allows them: of these only those with
            water are unsafe.
        motion: watched the vehicle's height and standing; None if nobody did.
    """
    out = [] if motion is None else [*motion.unsafe]
    if died is not None:
        out.append(f"the service died in flight: {died}")
    if worst is not None and worst.descent_m > BLIND_DESCENT_MAX_M:
        out.append(
            f"came down {worst.descent_m:.2f} m, to {worst.lowest_m:.2f} m over the deck, without true sight of the pad "
            f"for {worst.blind_s:.1f} s"
        )
    if unreached_m > unreached_max_m:
        out.append(f"came down {unreached_m:.2f} m while nothing reached it")
    for contact in contacts:
        phase = contact.guidance_phase or "no service"
        stray = f", outside commit ({phase})" if phases_known and _outside_commit(contact) else ""
        if contact.surface == "water":
            out.append(f"in the water, {contact.lateral_m:.2f} m from the pad's centre{stray}")
            continue
        if contact.at in unreached:
            continue
        if contact.surface == "deck" or stray:
            out.append(f"touched the {contact.surface} {contact.lateral_m:.2f} m from the pad's centre{stray}")
        if contact.motors and contact.lateral_speed_m_s > SLIDE_MAX_M_S and contact.guidance_phase not in PERSON_PHASES:
            out.append(f"touched the {contact.surface} at {contact.lateral_speed_m_s:.2f} m/s along it")
    return tuple(out)


def outside_commit(contacts: Sequence[Touchdown]) -> int:
    """Return the number of contacts with turning motors while neither guidance intended to land nor a person commanded."""
    return sum(map(_outside_commit, contacts))


def _outside_commit(contact: Touchdown) -> bool:
    return contact.motors and contact.guidance_phase not in COMMIT_PHASES | PERSON_PHASES


class UnreachedContacts:
    """Notes the contacts that no order could prevent, because nothing reached the vehicle when it came down.

    A contact is one of them while nothing reaches the vehicle, for `CLIMB_OUT_S` after that, and until a landing that the
    vehicle began meanwhile has ended.
    """

    def __init__(self) -> None:
        self.at: list[MonoNs] = []
        """Instants of these contacts."""
        self._count = 0
        self._until: MonoNs | None = None
        self._lands = False

    def step(self, truth: Truth, *, reached: bool) -> None:
        """Note the true state at an instant; call it in order of time.

        Args:
            reached: whether the service's commands reach the vehicle.
        """
        if not reached:
            self._until = after(truth.at, CLIMB_OUT_S)
        until = self._until
        self._lands |= truth.phase is VehiclePhase.LANDING and until is not None and truth.at <= until
        for contact in truth.contacts[self._count :]:
            lands = self._lands and contact.phase is VehiclePhase.LANDING
            if lands or (until is not None and contact.at <= until):
                self.at.append(contact.at)
        self._count = len(truth.contacts)
        self._lands &= truth.phase in (VehiclePhase.LANDING, VehiclePhase.LANDED)


class Grade(Enum):
    """The grade of a flight."""

    ON_PAD = "on pad"
    REFUSED_RIGHTLY = "refused rightly"
    FAILED = "failed"


def on_pad_m(contacts: Sequence[Touchdown]) -> float | None:
    """Return the distance of the newest contact from the pad's centre, or None if it was not on the pad."""
    return contacts[-1].lateral_m if contacts and contacts[-1].on_pad else None


class AtEnd(NamedTuple):
    """The situation in which a flight ended."""

    left_alone: bool = False
    """There was no service or no link, so that nothing could be decided."""
    asks: bool = False
    """It hovered and waited for the operator's decision about another pad, which nobody makes in a simulation."""
    held: bool = False
    """A person held it, flew it, or had ended the landing."""
    go_arounds: int = 0
    """Number of go-arounds."""
    refusal: tuple[str, str] = ("", "")
    """Words that the reason of a refusal must hold, and the reason that it gave."""
    put_down: bool = False
    """It stands because it landed by itself while nothing reached it, and the scenario allows that."""


def grade(
    outcome: FlightOutcome | None,
    landed_m: float | None,
    unsafe: Sequence[str],
    expect: Expected,
    at_end: AtEnd | None = None,
) -> tuple[Grade, str]:
    """Return the grade of a flight and the reason for it.

    Args:
        outcome: the pilot's outcome; None if the time ran out.
        landed_m: the result of `on_pad_m`.
        unsafe: the result of `dangers`.
        expect: the outcome that the scenario expects.
        at_end: the situation in which it ended.
    """
    end = at_end or AtEnd()
    if unsafe:
        return Grade.FAILED, "; ".join(unsafe)
    if expect == "hold":
        if end.held:
            return Grade.REFUSED_RIGHTLY, "held for the operator"
        return Grade.FAILED, f"did not hold for the operator: {'time ran out' if outcome is None else outcome.value}"
    if outcome is FlightOutcome.LANDED and landed_m is not None:
        if expect == "go_around" and not end.go_arounds:
            return Grade.FAILED, f"landed {100 * landed_m:.1f} cm from the centre without going around first"
        return Grade.ON_PAD, f"{100 * landed_m:.1f} cm from the centre"
    if end.put_down and outcome is FlightOutcome.LANDED_BY_OTHERS:
        return Grade.REFUSED_RIGHTLY, "landed by itself while nothing reached it"
    if outcome in REFUSALS or (outcome is None and (end.left_alone or end.asks)):
        output = "hovered without a service" if end.left_alone else "hovered and waited for the operator"
        if outcome is not None:
            output = outcome.value
        if expect in ("land", "go_around"):
            return Grade.FAILED, f"{output}, though nothing was wrong enough for that"
        if outcome in REFUSALS and end.refusal[0].lower() not in end.refusal[1].lower():
            return Grade.FAILED, f"{output} for another reason than {end.refusal[0]!r}: {end.refusal[1]}"
        return Grade.REFUSED_RIGHTLY, output
    return Grade.FAILED, "time ran out: it neither landed nor gave up" if outcome is None else outcome.value
