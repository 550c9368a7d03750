"""The one end of every flight, whatever vehicle flew it: the time after its outcome.

The contact is not the end: feet slide, and a deck that rolls carries a vehicle off. A refused vehicle is in the air, in the wind
that it was refused for, over a ship that goes on. The referee goes on counting, and a flight may fail by what it finds then.
"""

import math
import os

import numpy as np
from msgspec.structs import replace

from estimator.contracts.time import MonoNs, after, seconds_between
from sitl.flight.ending import Aftermath, Ending, Standing
from sitl.flight.grader import FlightGrader
from sitl.vehicle.airframe import Feet
from sitl.vehicle.vehicle import MOTORS_TURN, VehiclePhase
from sitl.world.truth import Truth

STANDS_AFTER_S = 5.0
"""Time after the contact at which the place of a vehicle on the deck is measured."""
WATCHED_S = 60.0
"""Time for which a vehicle is watched that is still in the air."""
_ON_DECK = (VehiclePhase.LANDED, VehiclePhase.EMERGENCY)


def cpu_s() -> float:
    """Return the CPU time of this process and of its ended children, s."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def standing_of(truth: Truth, disc_radius_m: float, feet: Feet) -> Standing | None:
    """Return where a vehicle stands; None where it does not stand on the deck.

    Args:
        truth: the true state, `STANDS_AFTER_S` after the newest contact or later.
        disc_radius_m: radius of the pad.
        feet: the vehicle's.
    """
    touch = truth.touchdown
    if touch is None or touch.surface == "water" or truth.phase not in _ON_DECK:
        return None
    R = truth.R_ned_pad.matrix
    d = R.T @ (truth.p_body_ned - truth.p_pad_ned)
    if float(np.linalg.norm(d - touch.p_body_pad)) > 1e2 or d[2] > 1.0:
        return None
    forward, starboard = float(d[0]), float(d[1])
    lateral_m = math.hypot(forward, starboard)
    slid_m = math.hypot(forward - touch.p_body_pad[0], starboard - touch.p_body_pad[1])
    since_s = seconds_between(touch.at, truth.at)
    at_m = d + feet.corners_m @ (R.T @ truth.R_ned_body.matrix).T
    on_pad = bool(np.hypot(at_m[:, 0], at_m[:, 1]).max() <= disc_radius_m)
    return Standing(since_s, on_pad, lateral_m <= disc_radius_m, lateral_m, (forward, starboard), truth.yaw_rad, slid_m)


class AftermathWatch:
    """Watches a vehicle that is in the air at the outcome; `truth` is its state then."""

    def __init__(self, truth: Truth) -> None:
        self._began, self._known = truth.at, len(truth.contacts)
        self._lowest_m, self._highest_m, self._farthest_m = math.inf, -math.inf, 0.0
        self.step(truth)

    def step(self, truth: Truth) -> None:
        """Note the true state at an instant; call it in order of time."""
        d = truth.d_body_pad_level
        self._lowest_m, self._highest_m = min(self._lowest_m, float(d[2])), max(self._highest_m, float(d[2]))
        self._farthest_m = max(self._farthest_m, float(np.hypot(d[0], d[1])))

    def result(self, truth: Truth, phase: str | None, unsafe: tuple[str, ...]) -> Aftermath:
        """Return what became of it; `phase` is that of guidance, None without a service, and `unsafe` the referee's lines."""
        self.step(truth)
        new = truth.contacts[self._known :]
        d = truth.d_body_pad_level
        return Aftermath(
            seconds_between(self._began, truth.at),
            phase,
            truth.phase.name.lower(),
            self._lowest_m,
            self._highest_m,
            self._farthest_m,
            float(np.hypot(d[0], d[1])),
            len(new),
            any(contact.surface == "water" for contact in new),
            unsafe,
        )


class Afterwards:
    """Follows a vehicle from the outcome until it stands, or for a minute where it flies. The world's owner moves it.

    Args:
        grader: of the flight; its owner goes on stepping it.
        ending: of the flight, at the outcome.
    """

    def __init__(self, grader: FlightGrader, ending: Ending) -> None:
        self._grader, self._ending = grader, ending
        world, truth = grader.world, grader.world.truth()
        served = world.guidance_phase is not None
        flies = ending.outcome is not None and truth.phase in MOTORS_TURN and served
        self._watch = AftermathWatch(truth) if flies else None
        self._over = frozenset(name for name, count in grader.referee.counts.items() if count.over)
        self._ends = truth.at
        if flies:
            self._ends = after(truth.at, WATCHED_S)
        elif truth.touchdown is not None:
            self._ends = after(truth.touchdown.at, STANDS_AFTER_S)

    @property
    def flies(self) -> bool:
        """True if the vehicle was in the air at the outcome, so that a service goes on as a daemon does."""
        return self._watch is not None

    @property
    def ends(self) -> MonoNs:
        """Instant at which there is nothing more to see."""
        return self._ends

    def step(self) -> None:
        """Note the true state; call it in order of time."""
        truth = self._grader.world.truth()
        if self._watch is not None:
            self._watch.step(truth)
        touch = truth.touchdown
        if touch is not None and truth.phase in _ON_DECK and seconds_between(touch.at, truth.at) >= STANDS_AFTER_S:
            self._ends = min(self._ends, truth.at)

    def ending(self, spent_s: float, *, stands: bool = True) -> Ending:
        """Return the ending with what came after the outcome.

        Args:
            spent_s: CPU time of the whole flight.
            stands: whether the vehicle can stand on the deck; else the flight ends with its contact.
        """
        grader, referee = self._grader, self._grader.referee
        grader.step()
        truth = grader.world.truth()
        lines = (count.in_words() for name, count in referee.counts.items() if count.over and name not in self._over)
        unsafe = tuple(f"{self._ending.word}, and then {line}" for line in lines)
        flown = None if self._watch is None else self._watch.result(truth, grader.world.guidance_phase, unsafe)
        judged = grader.regraded(self._ending.judged, unsafe, spent_s)
        if not stands:
            return replace(self._ending, judged=judged)
        return self._ending.followed(standing_of(truth, grader.disc_radius_m, grader.feet), flown, judged)
